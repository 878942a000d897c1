"""State machines as tables: (state, what happens) → state. What has no row is refused.

    TABLE: Table[Door, Knock] = {(Door.OPEN, Knock.PUSHED): Door.SHUT, …}
    door = after(TABLE, door, Knock.PUSHED)

A machine's table is in one file with the enum of its states; whoever keeps such a state changes it by `after`
only. The diagrams of docs/ are drawn from the tables (docs/draw.py).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from enum import StrEnum
from typing import TypeVar

State = TypeVar("State", bound=StrEnum)
Trigger = TypeVar("Trigger", bound=StrEnum)


class NoTransition(Exception):
    """The table has no such row: a bug on our side, whatever the world did. No caller catches it by name."""

    def __init__(self, state: StrEnum, trigger: StrEnum) -> None:
        super().__init__(state, trigger)

    def __str__(self) -> str:
        state, trigger = self.args
        return f"{type(state).__name__} {state!s}: {trigger.name} ({trigger!s}) cannot happen here"


def after(table: Mapping[tuple[State, Trigger], State], state: State, trigger: Trigger) -> State:
    """Return the state after what happened. NoTransition if the table does not have it."""
    try:
        return table[state, trigger]
    except KeyError:
        raise NoTransition(state, trigger) from None


def diagram(
    table: Mapping[tuple[State, Trigger], State],
    initial: State,
    *,
    together: tuple[str, Collection[State]] = ("", ()),
) -> str:
    """Return the table as a Mermaid state diagram; triggers with the same ends share an arrow.

    `together` names a group of states; what happens to each of them alike is drawn once, from the group.
    """
    group, members = together
    arrows: dict[tuple[str, str], dict[str, None]] = {}
    for (state, trigger), then in table.items():
        alike = state in members and all(table.get((member, trigger)) == then for member in members)
        arrows.setdefault((group if alike else state, then), {})[str(trigger)] = None
    lines = [f"[*] --> {_id(initial)}"]
    names = {str(name): None for pair in arrows for name in pair}
    lines += [f'state "{name}" as {_id(name)}' for name in names if name != _id(name)]
    lines += [f"{_id(start)} --> {_id(end)} : {'; or '.join(why)}" for (start, end), why in arrows.items()]
    return "\n".join(["stateDiagram-v2", *(f"    {line}" for line in lines)])


def _id(state: str) -> str:
    return state.replace("-", "_").replace(" ", "_")
