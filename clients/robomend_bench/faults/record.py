"""What happened in one trial, with times: the only thing that the score is computed from.

Times are seconds; 0 is when the first fault began (in a stretch without faults, when the stretch began).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from robomend_bench.faults.classes import Blind
from robomend_bench.faults.condition import Act, DeviceCondition, NodeCondition, State
from robomend_bench.faults.kinds import Fault
from robomend_client.literals import Atom, Literal

SECOND_EAR = "second-ear"
"""An agent that contradicts another."""

ENDED = frozenset({"repaired", "unconfirmed", "escalated", "cancelled", "failed"})
"""States that a repair does not leave."""


@dataclass(frozen=True, slots=True)
class Trial:
    """What makes a trial: the same robot, class, seed and number draw the same scenario."""

    robot: str
    cls: str
    seed: int
    number: int

    def __str__(self) -> str:
        return f"{self.robot}/{self.cls}/{self.seed}.{self.number}"


def parse_trial(text: str) -> Trial:
    """Return the trial that its text names; ValueError if it names none."""
    robot, cls, numbers = text.split("/")
    seed, number = numbers.split(".")
    return Trial(robot, cls, int(seed), int(number))


@dataclass(slots=True)
class Acted:
    """An act that reached the robot."""

    at_s: float
    act: Act
    by: str  # the board, or the agent that was asked
    code: int | None = None  # its answer; None: it was withdrawn, or the trial ended before
    message: str = ""
    done_s: float | None = None  # when it was given; of the board, none: a relay moves at once


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """A diagnosis that the service published: the abnormal components of each, as it ranked them."""

    at_s: float
    bads: tuple[tuple[str, ...], ...]
    fault: str = ""  # why there is no result

    @property
    def healthy(self) -> bool:
        return () in self.bads


@dataclass(frozen=True, slots=True)
class RepairSeen:
    """A change of a repair that the service published."""

    at_s: float
    id: str
    state: str
    bad: tuple[str, ...]  # the diagnosis of its present round; empty before the first
    round: int
    reason: str
    plan: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Arrived:
    """A batch of observations that the service has answered."""

    at_s: float
    agent: str
    literals: tuple[Literal, ...]
    unknown: tuple[Atom, ...]
    lifetime_s: float
    sent_s: float  # from then on it may be known
    said_s: float  # of two that were on their way at a time the newer word counts, whichever comes first


@dataclass(frozen=True, slots=True)
class Credited:
    """A round of a repair of which the service says that it helped, and when it was carried out."""

    from_s: float
    until_s: float
    components: tuple[str, ...]  # that its acts were done to


@dataclass(slots=True)
class Record:
    """See the module. Lists are in the order of time."""

    trial: Trial
    observers: str  # the preset
    blind: Blind | None = None
    faults: list[tuple[float, Fault]] = field(default_factory=list)
    states: list[tuple[float, State]] = field(default_factory=list)
    said: list[tuple[float, tuple[Literal, ...]]] = field(default_factory=list)  # changes, as posted
    diagnoses: list[Diagnosed] = field(default_factory=list)
    unknown: list[tuple[float, tuple[str, ...]]] = field(default_factory=list)  # atoms, as it was told
    repairs: list[RepairSeen] = field(default_factory=list)
    acts: list[Acted] = field(default_factory=list)
    arrived: list[Arrived] = field(default_factory=list)
    called_healthy: list[tuple[float, float]] = field(default_factory=list)  # asked, and told that it is
    credited: list[Credited] = field(default_factory=list)
    silences: list[tuple[str, float, float]] = field(default_factory=list)  # topic, last message, the next
    held_up: list[tuple[str | None, float, float]] = field(default_factory=list)  # host, from, until
    notes: list[tuple[float, str]] = field(default_factory=list)
    account: list[str] = field(default_factory=list)  # the service's own, of its repairs, if it was asked
    contradictions: list[str] = field(default_factory=list)  # of repairs' reasons and their records
    late_s: float = 0.0  # how late the bench was at most, since the trial began
    starved_s: float = 0.0  # for how much of half a second the service was kept from the processor, at most
    end_s: float = 0.0
    error: str = ""  # why this is no measurement

    def shift(self, by_s: float) -> None:
        """Move what was noted so far in time."""
        self.states = [(at + by_s, state) for at, state in self.states]
        self.said = [(at + by_s, literals) for at, literals in self.said]
        self.arrived = [
            replace(each, at_s=each.at_s + by_s, sent_s=each.sent_s + by_s, said_s=each.said_s + by_s)
            for each in self.arrived
        ]
        self.called_healthy = [(asked + by_s, told + by_s) for asked, told in self.called_healthy]
        self.notes = [(at + by_s, text) for at, text in self.notes]
        self.unknown = [(at + by_s, atoms) for at, atoms in self.unknown]
        self.diagnoses = [replace(each, at_s=each.at_s + by_s) for each in self.diagnoses]
        self.repairs = [replace(each, at_s=each.at_s + by_s) for each in self.repairs]
        self.silences = [(topic, began + by_s, ended + by_s) for topic, began, ended in self.silences]
        self.held_up = [(host, began + by_s, ended + by_s) for host, began, ended in self.held_up]
        for acted in self.acts:
            acted.at_s += by_s
            acted.done_s = None if acted.done_s is None else acted.done_s + by_s

    @property
    def open_repairs(self) -> set[str]:
        """The ids of the repairs that have not ended."""
        ended = {seen.id for seen in self.repairs if seen.state in ENDED}
        return {seen.id for seen in self.repairs} - ended

    def told(self) -> list[tuple[float, Mapping[Atom, bool]]]:
        """Return what was known of the robot's reports, each with since when: what has arrived, was not taken
        back, and lives; with a stand-in, which hears all at once, what was said.
        """
        if not self.arrived:
            all_of_it: dict[Atom, bool] = {}
            found: list[tuple[float, Mapping[Atom, bool]]] = []
            for at_s, literals in self.said:
                all_of_it = all_of_it | {literal.atom: literal.positive for literal in literals}
                found.append((at_s, all_of_it))
            return found
        held: dict[Atom, tuple[bool, float, float]] = {}
        waiting = [batch for batch in self.arrived if batch.agent != SECOND_EAR]
        times = sorted({at_s for b in waiting for at_s in (b.at_s, b.at_s + b.lifetime_s)})
        waiting.reverse()
        found = []
        for at_s in times:
            while waiting and waiting[-1].at_s <= at_s:
                batch = waiting.pop()
                until_s = batch.at_s + batch.lifetime_s
                for literal in batch.literals:
                    if literal.atom not in held or held[literal.atom][2] <= batch.said_s:
                        held[literal.atom] = literal.positive, until_s, batch.said_s
                for atom in batch.unknown:
                    if atom in held and held[atom][2] <= batch.said_s:
                        del held[atom]
            known = {atom: positive for atom, (positive, until_s, _) in held.items() if until_s > at_s}
            if not found or known != found[-1][1]:
                found.append((at_s, known))
        return found

    def state_at(self, at_s: float) -> State:
        """Return the truth at a time."""
        found: State = frozenset()
        for since_s, state in self.states:
            if since_s > at_s:
                break
            found = state
        return found

    def states_between(self, first_s: float, last_s: float) -> Iterator[tuple[float, State]]:
        """Yield the truth at a time, and each that came after and before another, with its beginning."""
        yield first_s, self.state_at(first_s)
        yield from ((since_s, state) for since_s, state in self.states if first_s < since_s < last_s)

    def lines(self) -> list[str]:
        """Return the whole record for people, in the order of time."""
        found: list[tuple[float, str, str]] = []
        found += ((at, "fault", str(fault)) for at, fault in self.faults)
        found += ((at, "truth", describe(state)) for at, state in self.states)
        found += ((at, "seen", ", ".join(sorted(map(str, literals)))) for at, literals in self.said)
        found += ((d.at_s, "diagnosis", d.fault or " | ".join(map(_set, d.bads))) for d in self.diagnoses)
        found += ((at, "unknown", ", ".join(atoms) or "nothing any more") for at, atoms in self.unknown)
        found += ((r.at_s, "repair", _repair(r)) for r in self.repairs)
        found += ((a.at_s, "ACT", _acted(a)) for a in self.acts)
        found += ((at, "note", text) for at, text in self.notes)
        found.sort(key=lambda line: line[0])
        told = [f"{at:8.3f}  {kind:<10}{text}" for at, kind, text in found]
        return [*told, *(f"{'':10}account   {line}" for line in self.account)]


def describe(state: State) -> str:
    """Return a state in words."""
    return "; ".join(f"{name}: {_condition(c)}" for name, c in sorted(state, key=lambda p: p[0])) or "healthy"


def _condition(condition: NodeCondition | DeviceCondition) -> str:
    if isinstance(condition, DeviceCondition):
        words = [
            "" if condition.on else "off",
            str(condition.health),
            "stuck" if condition.stuck else "",
            "replaced by its spare" if condition.replaced else "",
            "complains for no reason" if condition.complains else "",
        ]
    else:
        after = [str(mood) for mood in condition.successors]
        words = [
            str(condition.mood) if condition.running else "stopped",
            "holds a dead connection" if condition.stale else "",
            "ends again and again" if condition.short_lived else "",
            f"while {condition.beside} runs" if condition.beside else "",
            "somebody else publishes its topics, too" if condition.doubled else "",
            "" if condition.starts else "does not start",
            f"then {', '.join(after)}" if after else "",
            "" if condition.ever == "well" else f"then {condition.ever} for ever",
        ]
    return ", ".join(word for word in words if word)


def _set(bad: Sequence[str]) -> str:
    return "{" + ", ".join(bad) + "}"


def _repair(seen: RepairSeen) -> str:
    plan = f" plan: {', '.join(seen.plan)}" if seen.plan and seen.state in ("planning", "running") else ""
    return f"{seen.id} {seen.state} {_set(seen.bad)} {seen.reason}{plan}"


def _acted(acted: Acted) -> str:
    return f"{acted.act} by {acted.by} → {acted.code} {acted.message}"
