"""The state of a node with a lifecycle: ok(lifecycle,camera) while it is active.

    /camera/transition_event    ROS 2, lifecycle_msgs/TransitionEvent

ROS 2 says only when a state changes, and to say more a service would have to be asked. So it is unknown
until the first change after the agent began, and when nobody publishes the events any more: the node is gone.
Between two changes it stays what it is, over a reset too: then it counts once LOOK_S have passed in which
nothing else was said.

    active ── anything else             not ok at once
    unconfigured ── inactive ── …       it is coming up: not ok when that takes longer than `start_s`
    errorprocessing, finalized          not ok at once
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robomend_client.literals import Atom, Literal, parse_atom
from robomend_client.observers.base import NOTHING, Evidence, WrongKind, ns
from robomend_client.readings import Reading, Symptom

START, GOAL = "start_state.label", "goal_state.label"
EVENTS = f"{START},{GOAL}"

STATES = ("unconfigured", "inactive", "active", "finalized")
FAILED = ("errorprocessing", "finalized")

LOOK_S = 1.0

TYPE, END = "lifecycle_msgs/TransitionEvent", "/transition_event"


@dataclass(frozen=True)
class RightState:
    """Which state is right.

    Attributes:
        state: the state that it should be in: `active`, `inactive`, `unconfigured` or `finalized`.
        start_s: coming up may take so many seconds.
    """

    state: str = "active"
    start_s: float = 10.0

    def __post_init__(self) -> None:
        if self.state not in STATES:
            raise ValueError(f"state must be one of {', '.join(STATES)}, not {self.state!r}")
        if not 0 <= self.start_s <= 3600:
            raise ValueError(f"start_s must be from 0 to 3600, not {self.start_s:g}")


class LifecycleObserver:
    """Watches the state of one node."""

    latched = True
    """A change is said once, also one that was made just before a reset."""

    def __init__(
        self,
        atom: str,
        node: str | None = None,
        source: str | None = None,
        expected: RightState | None = None,
    ) -> None:
        """
        Args:
            atom: what it speaks of, e.g. `ok(lifecycle,camera)`; by default the entry's name.
            node: the node; by default the last name in the atom.
            source: where its changes come from, instead of the node's own topic.
            expected: of its state.
        """
        self._expected = expected or RightState()
        self.atoms = (parse_atom(atom),)
        self.node = (node or self.atoms[0].args[-1]).strip("/")
        self.sources = frozenset((source or f"{self.node}{END}:{EVENTS}",))
        self.period_ns = 0
        self.detection_s = LOOK_S
        self.settling_s = max(LOOK_S, self._expected.start_s)
        self._start_ns = ns(self._expected.start_s)
        self._signs = {good: (Literal(self.atoms[0], good),) for good in (True, False)}
        self._newest_ns = -1
        self._gone()
        self.reset(0)

    def _gone(self) -> None:
        self._state: str | None = None
        self._rising_ns: int | None = None  # since when it comes up
        self._good_ns: int | None = None  # when it was last seen to be right

    def reset(self, time_ns: int) -> None:
        """Its state stays what it is; it is a verdict once nothing else was said for a moment."""
        if time_ns < self._newest_ns:
            self._gone()
        if self._rising_ns is not None:
            self._rising_ns = max(self._rising_ns, time_ns)
        self._since_ns = time_ns
        self._from_ns = time_ns + ns(LOOK_S)

    def published_by(self, nodes: Sequence[str], time_ns: int) -> None:
        """The events have no publisher any more: the node is gone."""
        if not nodes:
            self._gone()

    def feed(self, source: str, time_ns: int, value: object) -> None:
        if not isinstance(value, Mapping) or not isinstance(value.get(GOAL), str):
            raise WrongKind(f"a change of state ({EVENTS}) is", value)
        before, state = str(value.get(START, "")), value[GOAL]
        right = self._expected.state
        self._newest_ns = time_ns
        if time_ns >= self._since_ns:
            self._since_ns = self._from_ns = time_ns
        if state == right:
            self._good_ns = time_ns
            self._rising_ns = None
        elif before == right or self._state == right or state in FAILED:
            self._rising_ns = None
        elif self._state is None:
            self._rising_ns = time_ns
        self._state = state[:100]

    def due_ns(self) -> int | None:
        if self._state is None:
            return None
        return self._rising_ns + self._start_ns if self._rising_ns is not None else self._from_ns

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        if self._state is None or now_ns < self._from_ns:
            return NOTHING
        if self._rising_ns is not None and now_ns < self._rising_ns + self._start_ns:
            return NOTHING
        return self._signs[self._state == self._expected.state]

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        if self._state == self._expected.state:
            return Evidence(self._since_ns, None, Reading(self._state))
        told = f"{self._state}, not {self._expected.state}"
        if self._rising_ns is not None:
            told += f" within {self._expected.start_s:g} s"
        return Evidence(self._since_ns, self._good_ns, Reading(told, symptom=Symptom.SELF_REPORT))


def suggested(topic: str, kind: str) -> dict[str, dict[str, Any]]:
    """Return the entry of `observers:` that a topic of this type suggests; nothing for others."""
    if kind != TYPE or not topic.endswith(END):
        return {}
    node = topic.removesuffix(END).strip("/")
    return {f"ok(lifecycle,{node})": {"kind": "lifecycle", "node": node}}
