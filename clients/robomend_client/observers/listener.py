"""What a driver does, told to whoever writes it down: recording.py does, for replays."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from robomend_client.literals import Atom
from robomend_client.observers.base import Contact


class Listener:
    """Told of everything that a driver takes in; by itself it lets it pass."""

    def sample(self, source: str, time_ns: int, value: object, now_ns: int) -> None:
        """A sample was taken in."""

    def lapse(self, now_ns: int, until_ns: int) -> None:
        """Nobody looks until then."""

    def starved(self, now_ns: int, yes: bool) -> None:
        """This computer is starved from now on, or no more."""

    def sight(self, now_ns: int, source: str, sight: Contact) -> None:
        """Nobody looks at a source any more, or somebody does again."""

    def publishers(self, now_ns: int, source: str, nodes: Sequence[str]) -> None:
        """These nodes publish a source."""

    def settle(self, now_ns: int, n: int, atoms: Collection[Atom]) -> None:
        """Observers were told to judge anew."""

    def restart(self, now_ns: int) -> None:
        """Time begins again, here."""
