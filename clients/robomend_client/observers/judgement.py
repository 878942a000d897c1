"""From readings that are each good or bad to a verdict that lasts: agreement, debounce, lifetime.

    readings   g g g b g g b b b b b g g g
    agreeing=3     ok ········· not ok ······ ok        a spike is no fault, and one good reading no recovery

A verdict needs `agreeing` readings in a row that say the same, over `debounce` at least. It lasts until as
many say the opposite, and is unknown when the newest reading is older than `lifetime`.
"""

from __future__ import annotations

from collections import deque
from typing import Any

from robomend_client.observers.base import Evidence


class Judgement:
    """What is held of one thing, by the readings that speak for and against it."""

    __slots__ = (
        "_agreeing",
        "_debounce_ns",
        "_evidence",
        "_good_ns",
        "_lifetime_ns",
        "_newest_ns",
        "_read",
        "_streak",
        "_streak_ns",
        "_times",
        "_verdict",
    )

    def __init__(self, agreeing: int = 1, debounce_ns: int = 0, lifetime_ns: int | None = None) -> None:
        self._agreeing = agreeing
        self._debounce_ns = debounce_ns
        self._lifetime_ns = lifetime_ns
        self._times: deque[int] = deque(maxlen=agreeing)  # of the newest readings that say the same
        self.reset()

    def reset(self) -> None:
        """Know nothing."""
        self._verdict: bool | None = None
        self._streak: bool | None = None
        self._streak_ns = 0
        self._newest_ns: int | None = None
        self._good_ns: int | None = None
        self._evidence = Evidence(0)
        self._read: dict[bool, object] = {}  # what the newest good reading was, and the newest bad one
        self._times.clear()

    def add(self, time_ns: int, good: bool, since_ns: int | None = None, read: object = None) -> None:
        """Take in a reading; `since_ns` is the beginning of what it was made of, where that is a span, and
        `read` what was read.
        """
        times = self._times
        if good is not self._streak:
            self._streak = good
            self._streak_ns = time_ns
            times.clear()
        times.append(time_ns if since_ns is None else since_ns)
        self._newest_ns = time_ns
        self._read[good] = read
        if len(times) == self._agreeing and time_ns - self._streak_ns >= self._debounce_ns:
            onset_ns = None if good else self._good_ns
            self._verdict = good
            self._evidence = Evidence(min(times[0], time_ns - self._debounce_ns), onset_ns)
        if good:
            self._good_ns = time_ns

    def at(self, now_ns: int) -> bool | None:
        """Return the verdict; None while nothing is known."""
        due_ns = self.due_ns()
        return None if due_ns is not None and now_ns >= due_ns else self._verdict

    def goes_on(self, times_ns: Any, until_ns: int) -> bool:
        """Return whether good readings at these times, an array, leave a good verdict that lasts as it is."""
        if self._verdict is not True or self._streak is not True or self._newest_ns is None:
            return False
        life_ns = self._lifetime_ns
        if life_ns is None:
            return True
        gaps_ns = times_ns[1:] - times_ns[:-1]
        longest_ns = max(int(times_ns[0]) - self._newest_ns, until_ns - int(times_ns[-1]))
        return longest_ns < life_ns and (not len(gaps_ns) or int(gaps_ns.max()) < life_ns)

    @property
    def evidence(self) -> Evidence:
        """What the verdict rests on."""
        return self._evidence

    @property
    def bad(self) -> bool:
        """Whether the verdict is bad, be it still of use or not."""
        return self._verdict is False

    @property
    def read(self) -> object:
        """What the newest reading was that says what the verdict does."""
        return None if self._verdict is None else self._read.get(self._verdict)

    @property
    def good_ns(self) -> int | None:
        """The newest good reading."""
        return self._good_ns

    def due_ns(self) -> int | None:
        """Return when the verdict turns unknown by itself."""
        if self._verdict is None or self._lifetime_ns is None or self._newest_ns is None:
            return None
        return self._newest_ns + self._lifetime_ns
