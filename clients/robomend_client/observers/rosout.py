"""Lines of a node's log: ok(log,camera) while it writes no ERROR, by what all nodes say on /rosout.

    rosout:level,name,msg     ROS 1 (rosgraph_msgs/Log), ROS 2 (rcl_interfaces/Log)

One line of `level` or worse is bad, or `lines` of them within `hold_s`; it is good again once none came for
`hold_s`. What is known to mean nothing is left out by `ignore`: a line that has all parts of a pattern, in
their order (`timed out*retrying`). So is, without being asked for, what is USUAL.

A line may be of any length and of any bytes: MOST_LOOKED_AT characters of it are looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robomend_client.literals import Atom
from robomend_client.observers.base import Evidence, WrongKind
from robomend_client.observers.incidents import Incidents, check_incidents, for_s
from robomend_client.readings import MAX_TEXT, Reading, Symptom

ROSOUT = "rosout:level,name,msg"

LEVELS = {"warn": (4, 30), "error": (8, 40), "fatal": (16, 50)}
"""From which number on, in ROS 1 and in ROS 2."""

SHOWN = {4: "WARN", 8: "ERROR", 16: "FATAL", 30: "WARN", 40: "ERROR", 50: "FATAL"}
ROS1_LEVELS = (1, 2, 4, 8, 16)

MOST_LOOKED_AT = 2000

USUAL = (
    "Received comm state*when in simple state*with SimpleActionClient",
    "on a goal handle that we're not tracking",
    "SimpleActionClient received DONE twice",
    "Got a result when we were already in the DONE state",
    "Invalid goal status transition from",
    "To transition to a cancelled state, the goal must be in a pending, recalling, active",
)
"""What actionlib logs as ERROR where a goal is cancelled or replaced while its end is on the way."""

TYPES = ("rosgraph_msgs/Log", "rcl_interfaces/Log")


@dataclass(frozen=True)
class LogRules:
    """Which lines are bad, and for how long.

    Attributes:
        level: the least bad level: `error`, `fatal`, or `warn`.
        lines: so many of them, in a row or within hold_s, are bad.
        hold_s: without another one it is good again after so many seconds.
    """

    level: str = "error"
    lines: int = 1
    hold_s: float = 10.0

    def __post_init__(self) -> None:
        check_incidents(self.hold_s, self.lines, "lines")
        if self.level not in LEVELS:
            raise ValueError(f"level must be one of {', '.join(LEVELS)}, not {self.level!r}")


class RosoutObserver(Incidents):
    """Watches what one node logs."""

    def __init__(
        self,
        atom: str,
        node: str | None = None,
        ignore: Sequence[str] = (),
        rules: LogRules | None = None,
        source: str = ROSOUT,
    ) -> None:
        """
        Args:
            atom: what it speaks of, e.g. `ok(log,camera)`; by default the entry's name.
            node: the node, with its namespace where it has one; by default the last name in the atom.
            ignore: lines that mean nothing, by parts of their text: `timed out`, `timed out*retrying`.
            rules: which lines are bad.
            source: where the lines come from.
        """
        rules = rules or LogRules()
        super().__init__(atom, rules.lines, rules.hold_s)
        self.sources = frozenset((source,))
        self.node = node or self.atoms[0].args[-1]
        self._name = _plain(self.node)
        self._rules = rules
        self._ignored = tuple(tuple(filter(None, text.split("*"))) for text in (*ignore, *USUAL))
        if not all(self._ignored):
            raise ValueError("ignore must name a part of a line, '*' alone is every line")
        self._first = self._newest = ""
        self._first_ns = 0

    def feed(self, source: str, time_ns: int, value: object) -> None:
        if not isinstance(value, Mapping):
            raise WrongKind("a line of a log (level, name, msg) is", value)
        try:
            level, name, text = value["level"], str(value["name"]), value["msg"]
            level = level[0] if isinstance(level, bytes) else int(level)
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise WrongKind("a line of a log (level, name, msg) is", value) from error
        if not reaches(level, self._rules.level) or not self._is_ours(name):
            return
        text = text[:MOST_LOOKED_AT] if isinstance(text, str) else str(text)[:MOST_LOOKED_AT]
        if any(_has(text, parts) for parts in self._ignored):
            return
        said = f"{SHOWN.get(level, f'level {level}')}: {' '.join(text.split())}"[:MAX_TEXT]
        fresh = not self.count or time_ns - self._noted[-1] >= self._hold_ns
        if fresh:
            self._first, self._first_ns = said, time_ns
        self._newest = said
        self.incident(time_ns)

    def _is_ours(self, name: str) -> bool:
        """Return whether a logger is the node's: itself, or a child of it."""
        name = _plain(name[:MAX_TEXT])
        return name == self._name or name.startswith(f"{self._name}.")

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        if not self._bad:
            what = self._rules.level.upper()
            return self.evidence_of(now_ns, Reading(f"no {what} for {self.hold_s:g} s"))
        told = self._first
        if self.count > 1:
            span = f"{self.count} lines in {for_s(max(0, self._noted[-1] - self._first_ns))}"
            half = (MAX_TEXT - len(span) - 20) // 2
            first, last = self._first[:half], self._newest[:half]
            told = f"{span}: {first}" if first == last else f"{span}, first {first}, last {last}"
        return self.evidence_of(now_ns, Reading(told, symptom=Symptom.SELF_REPORT))


def reaches(level: int, least: str) -> bool:
    """Whether a line's level, in the numbers of ROS 1 or ROS 2, is one of LEVELS or worse."""
    old, new = LEVELS[least]
    return level >= (old if level in ROS1_LEVELS else new)


def _plain(name: str) -> str:
    """Return a node's name as loggers of ROS 2 have it: robot1.camera is /robot1/camera."""
    return name.strip("/").replace("/", ".")


def _has(text: str, parts: Sequence[str]) -> bool:
    """Return whether a text has all these parts, one behind the other."""
    place = 0
    for part in parts:
        place = text.find(part, place)
        if place < 0:
            return False
        place += len(part)
    return True


def suggested(topic: str, kind: str, nodes: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the entries of `observers:` that a topic of this type suggests, one for each of these nodes."""
    if kind not in TYPES or topic != "/rosout":
        return {}
    found = {}
    for node in nodes:
        name = node.strip("/")
        found[f"ok(log,{name})"] = {"kind": "rosout", "node": name}
    return found
