"""The node observer (NObs): running(n) while node n runs, not running(n) otherwise.

It is fed with the names of the nodes that run; where they come from (a process table, a ROS master, DDS
discovery) is the feeder's business. A feeder that knows more gives a mapping from names to True, False, None
(it cannot be said whether it runs: it is being started), or to why it does not run:
{"why": "exit code 1: cannot open /dev/lidar", "symptom": "ended"}.

A table that is older than `lifetime_s` says nothing any more: when the feeder stops, the nodes are unknown,
and do not run on for ever. So a feeder repeats its table, changed or not.

The restarts observer counts in the same tables how often a node has begun again: ok(restarts,n) while that
was fewer than `restarts` times, each within `hold_s` of the one before.

Source: the paper, section IV-B; 10 Hz as published.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from robomend_client.literals import Atom, Literal, fails, holds
from robomend_client.observers.base import NOTHING, Evidence, WrongKind, ns, positive
from robomend_client.observers.incidents import Incidents, check_incidents
from robomend_client.readings import Reading, Symptom

PROCESSES = "processes"
"""The source whose values are collections of the names of running nodes."""

RUNS = Reading("runs")
NOT_THERE = Reading("not there", symptom=Symptom.ENDED)


@dataclass(frozen=True)
class Table:
    """How a table of running nodes is read.

    Attributes:
        rate_hz: how often the table comes at least, in tables per second.
        lifetime_s: a table that is older than so many seconds says nothing.
        table: the source of the names of the nodes that run: `processes` are the agent's own, `nodes` those
            that a bridge to ROS sees.
    """

    rate_hz: float = 10.0
    lifetime_s: float = 3.0
    table: str = PROCESSES

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "published": {"rate_hz": 10.0},
        "ros1": {"rate_hz": 0.5, "table": "nodes"},  # the bridge finds frozen nodes within 2 s
        "ros2": {"rate_hz": 1.0, "table": "nodes"},
    }

    def __post_init__(self) -> None:
        positive(rate_hz=self.rate_hz, lifetime_s=self.lifetime_s)
        if self.lifetime_s * self.rate_hz <= 1:
            raise ValueError(f"lifetime_s of {self.lifetime_s:g} is no longer than a table's interval")


class NodeObserver:
    """Watches whether nodes run."""

    def __init__(self, nodes: Iterable[str], expected: Table | None = None) -> None:
        """
        Args:
            nodes: the nodes that are watched, as the model has them; by default the entry's name.
            expected: of the table.
        """
        expected = expected or Table()
        self.nodes = tuple(sorted(set(nodes)))
        self.sources = frozenset((expected.table,))
        self.atoms = tuple(Atom("running", (node,)) for node in self.nodes)
        self.period_ns = 0
        self.detection_s = 1 / expected.rate_hz
        self.settling_s = max(0.5, 2 / expected.rate_hz)  # a table or two, on a busy computer
        self._lifetime_ns = ns(expected.lifetime_s)
        self._signs = {
            node: {True: holds("running", node), False: fails("running", node)} for node in self.nodes
        }
        self.reset(0)

    def reset(self, time_ns: int) -> None:
        self._said = NOTHING
        self._known: dict[str, bool | None] = {}
        self._why: dict[str, Reading] = {}
        self._table_ns: int | None = None
        self._ran_ns: dict[str, int] = {}  # node -> the newest table that it was in

    def feed(self, source: str, time_ns: int, value: object) -> None:
        """The nodes in `value` run, and no others."""
        if isinstance(value, Mapping):
            found = {node: value.get(node, False) for node in self.nodes}
            known = {node: False if isinstance(one, Mapping) else one for node, one in found.items()}
            self._why = {node: _read(one) for node, one in found.items() if isinstance(one, Mapping)}
        elif isinstance(value, Collection) and not isinstance(value, str | bytes):
            known = {node: node in value for node in self.nodes}
            self._why = {}
        else:
            raise WrongKind("a collection of the names of running nodes is", value)
        self._table_ns = time_ns
        for node, runs in known.items():
            if runs:
                self._ran_ns[node] = time_ns
        if known != self._known:
            self._known = known
            signs = self._signs
            self._said = tuple(signs[node][runs] for node, runs in known.items() if runs is not None)

    def due_ns(self) -> int | None:
        return None if self._table_ns is None else self._table_ns + self._lifetime_ns

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        if self._table_ns is None or now_ns >= self._table_ns + self._lifetime_ns:
            return NOTHING
        return self._said

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        assert self._table_ns is not None
        (node,) = atom.args
        if self._known[node]:
            return Evidence(self._table_ns, None, RUNS)
        return Evidence(self._table_ns, self._ran_ns.get(node), self._why.get(node, NOT_THERE))


@dataclass(frozen=True)
class RestartRules:
    """How many restarts are too many.

    Attributes:
        restarts: so many within hold_s are bad.
        hold_s: without another one it is good again after so many seconds.
        table: the source of the names of the nodes that run: `processes`, or `nodes` of a bridge.
    """

    restarts: int = 3
    hold_s: float = 30.0
    table: str = PROCESSES

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "ros1": {"table": "nodes"},
        "ros2": {"table": "nodes"},
    }

    def __post_init__(self) -> None:
        check_incidents(self.hold_s, self.restarts, "restarts")


class RestartsObserver(Incidents):
    """Watches how often a node begins again."""

    def __init__(self, atom: str, node: str | None = None, rules: RestartRules | None = None) -> None:
        """
        Args:
            atom: what it speaks of, e.g. `ok(restarts,laser)`; by default the entry's name.
            node: the node, as the model has it; by default the last name in the atom.
            rules: how many are too many.
        """
        rules = rules or RestartRules()
        super().__init__(atom, rules.restarts, rules.hold_s)
        self.node = node or self.atoms[0].args[-1]
        self.sources = frozenset((rules.table,))
        self._most = rules.restarts
        self._ran = False  # ever
        self._runs: bool | None = None
        self._why = ""

    def reset(self, time_ns: int) -> None:
        if time_ns < self._began_ns:
            self._ran, self._runs, self._why = False, None, ""
        super().reset(time_ns)

    def feed(self, source: str, time_ns: int, value: object) -> None:
        if isinstance(value, Mapping):
            found = value.get(self.node, False)
        elif isinstance(value, Collection) and not isinstance(value, str | bytes):
            found = self.node in value
        else:
            raise WrongKind("a collection of the names of running nodes is", value)
        if isinstance(found, Mapping):
            read = _read(found)
            if read.symptom is Symptom.HALTED:
                return  # its process is there
            self._why, found = str(read.value), False
        if found is None:
            return
        if found and self._runs is False and self._ran:
            self.incident(time_ns)
        self._ran = self._ran or found
        self._runs = found

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        if not self._bad:
            return self.evidence_of(now_ns, Reading(f"{self.count} restarts", "", f"below {self._most}"))
        told = f"{self.count} restarts, each within {self.hold_s:g} s"
        told += f", the last after: {self._why}" if self._why else ""
        return self.evidence_of(now_ns, Reading(told, "", f"below {self._most}", Symptom.ENDED))


def _read(value: Mapping[str, Any]) -> Reading:
    """Return why a node does not run."""
    try:
        return Reading(str(value["why"]), symptom=Symptom(value.get("symptom", "ended")))
    except (KeyError, ValueError) as error:
        raise WrongKind("why a node does not run, and ended or halted, is", value) from error
