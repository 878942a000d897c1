"""What docstrings say of parameters, which editors show at the keys of a file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from robomend_client.docstrings import documented


class Base:
    """What all of them have.

    Attributes:
        kept: by the base.
        source: of the base.
    """

    def __init__(self, source: str, **rest: Any) -> None:
        """
        Args:
            source: where it comes from: topic and field, e.g.
                `odom:twist.twist.linear.x`.
            rest: what others take.

        Raises:
            ValueError: it is empty.
        """


class Own(Base):
    """One of somebody's own: it says nothing of `source`."""

    def __init__(self, limit: float, **rest: Any) -> None:
        """Make one.

        Args:
            limit: in °C.

                Beside an empty line, it goes on.
        """


def test_entries_of_a_class_and_of_its_bases_are_found_in_whole_sentences() -> None:
    assert documented(Own) == {
        "limit": "in °C. Beside an empty line, it goes on",
        "kept": "by the base",
        "source": "of the base",
        "rest": "what others take",
    }
    assert documented(Base)["source"] == "of the base", "what the class says comes first"


def test_a_function_and_a_dataclass_are_read_alike_and_nothing_is_made_up() -> None:
    def judge(value: float, limit: float) -> bool:
        """Return whether it is good.

        Args:
            limit: in amperes.
        """
        return value < limit

    @dataclass
    class Bare:
        limit: float

    def silent(limit: float) -> None: ...

    assert documented(judge) == {"limit": "in amperes"}
    assert documented(Bare) == documented(silent) == {}
