"""From the record of a trial to its score: pure, and by the truth alone. docs/score.md defines each word.

Nothing here looks at how the service came to what it did. What could be known is computed from the settled
observation of the true state (universe.py), what would have been enough from the cheapest policy (policy.py).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from robomend_bench.faults.anatomy import Anatomy
from robomend_bench.faults.condition import (
    Act,
    Condition,
    DeviceCondition,
    Mood,
    NodeCondition,
    State,
    abnormal,
    broken,
    device_in,
    unseen,
)
from robomend_bench.faults.field import BY_NAME
from robomend_bench.faults.kinds import FOR_EVER, PASSING, begun, settled
from robomend_bench.faults.observing import PRESETS, aspects_delay_s
from robomend_bench.faults.record import SECOND_EAR, Diagnosed, Record, RepairSeen
from robomend_bench.faults.robot import Robot
from robomend_bench.faults.times import Part, where_time_goes
from robomend_bench.faults.universe import touched
from robomend_client.literals import Atom, Literal

GRACE_S = 0.3
"""Of what arrives so shortly before something is said nobody knows whether it was known."""

LAPSE_GRACE_S = 0.05
"""The same of what has not been said again in its lifetime."""

POWER = frozenset({"shutdown", "power_up", "reset_bus", "switch_to_spare"})


def _no_power(part: tuple[str, Condition]) -> bool:
    """Whether what is wrong shows that nothing lacks power: too fast, standing still, only complaining."""
    _, wrong = part
    if isinstance(wrong, DeviceCondition):
        return wrong.complains
    return wrong.mood in (Mood.FAST, Mood.STILL) or wrong.doubled


@dataclass(slots=True)
class Score:
    """What came of one trial. None: the question does not arise."""

    trial: str
    cls: str
    group: str  # faults, apart (an observer is at fault), healthy (nothing is)
    seconds: float = 0.0
    detected: bool | None = None
    told_apart: bool | None = None
    told_by_onset: bool | None = None
    cause_first: bool | None = None
    repairable: bool | None = None
    repaired: bool | None = None
    escalated: bool | None = None
    cause_named: bool | None = None
    false_repaired: list[str] = field(default_factory=list)
    contradicted: list[str] = field(default_factory=list)
    acts: int = 0
    cuts: int = 0  # acts that take power away
    wrong: list[str] = field(default_factory=list)
    best_acts: int | None = None
    best_exact: bool = True
    credited: list[str] = field(default_factory=list)  # acts that are said to have helped, and did nothing
    called_healthy: list[str] = field(default_factory=list)  # what was not well while that was said
    left_stopped: list[str] = field(default_factory=list)  # healthy nodes that an act had stopped, at the end
    repeated: int = 0  # acts that were done before in this trial more than twice
    alarms: int = 0  # false ones: the truth was healthy
    detection_s: float | None = None  # from the fault
    first_act_s: float | None = None  # from the fault
    repaired_s: float | None = None  # from the detection to the last "repaired"
    waited_s: float | None = None  # from when the observers had told it all, to the first act
    confirmed_s: float | None = None  # from when the observers had told of health, to "repaired"
    parts: dict[str, float] = field(default_factory=dict)  # where `repaired_s` went (times.py)
    errors: float | None = None  # DXC: classification errors
    utility: float | None = None  # DXC: system repair utility
    points: float = 0.0  # calm and speed in one number

    @property
    def right(self) -> bool:
        """Whether it ended as it should: repaired, or escalated with the cause where nothing repairs it."""
        if self.false_repaired or self.called_healthy:
            return False
        return bool(self.repaired if self.repairable else self.escalated and self.cause_named)

    @property
    def beyond_s(self) -> float | None:
        """How much of detection → repaired the robot itself did not need: for acts, starts, and observers."""
        if self.repaired_s is None:
            return None
        needed = (Part.ACTS, Part.ROBOT, Part.OBSERVERS, Part.STAYS, Part.PASSES)
        return self.repaired_s - sum(self.parts.get(str(part), 0.0) for part in needed)

    @property
    def extra(self) -> int | None:
        """Acts beyond the cheapest policy's, of what ended right; below 0 where a guess was lucky."""
        if self.best_acts is None or not self.right:
            return None
        return self.acts - self.best_acts

    def as_json(self) -> dict[str, Any]:
        """Return the score as JSON values."""
        right = None if self.group == "healthy" else self.right  # a stretch has no end to be right
        return {**asdict(self), "right": right, "extra": self.extra, "beyond_s": self.beyond_s}


def score(record: Record, robot: Robot) -> Score:
    """Return the score of a record without error."""
    described = BY_NAME.get(record.trial.cls)
    if described is None:
        return _healthy(record, robot, _delay_s(record, robot))
    found = Score(str(record.trial), record.trial.cls, "apart" if described.apart else "faults", record.end_s)
    return _Scoring(record, robot, found).score()


def _delay_s(record: Record, robot: Robot) -> float:
    odd = abnormal(robot.anatomy, begun(robot.anatomy, *dict.fromkeys(fault for _, fault in record.faults)))
    rates_s = PRESETS[record.observers].delay_s(robot.slowest_hz)
    return max(rates_s, aspects_delay_s(robot.anatomy, {literal.atom for literal in odd}))


def _healthy(record: Record, robot: Robot, delay_s: float) -> Score:
    found = Score(str(record.trial), record.trial.cls, "healthy", record.end_s)
    found.acts = len(record.acts)
    found.wrong = [f"{act.at_s:.2f} s: {act.act}" for act in record.acts]
    diagnoses = record.diagnoses
    if robot.world == "field":  # where what starts slowly is silent in truth, and nobody's fault
        diagnoses = [
            d for d in diagnoses if d.healthy or not _silent(record, robot.anatomy, d.at_s - delay_s, d.at_s)
        ]
        found.called_healthy = _called_healthy(record, robot, delay_s)
    found.alarms = _alarms(record, diagnoses, delay_s)
    found.points = max(-1.0, 1.0 - 0.5 * found.acts - 0.1 * found.alarms)
    return found


def _alarms(record: Record, diagnoses: Iterable[Diagnosed], delay_s: float) -> int:
    """Return how often a diagnosis turned from healthy, or nothing, to not, and nothing was broken then.

    What an observer may just have seen is no false alarm: at boot, every process is stopped for a moment.
    """
    count, well = 0, True
    for each in diagnoses:
        if well and not each.healthy and not each.fault:
            count += not any(state for _, state in record.states_between(each.at_s - delay_s, each.at_s))
        well = each.healthy or bool(each.fault)
    return count


def _acted_on(anatomy: Anatomy, names: Collection[str]) -> set[str]:
    """Return what acts that name these change: a supply's cycle is one of what hangs on it, a bus too."""
    fed = {device for name in names for device in anatomy.fed.get(name, ())}
    return {*names, *fed, *(device.name for device in anatomy.devices.values() if device.bus in names)}


def _silent(record: Record, anatomy: Anatomy, from_s: float, until_s: float) -> list[str]:
    """Return the observed topics that were not heard between two times although they were to come."""
    return sorted(
        {
            topic
            for topic, last_s, next_s in record.silences
            if last_s <= until_s and next_s >= from_s and anatomy.topics[topic].observed
        }
    )


def _said_otherwise(record: Record, robot: Robot, at_s: float) -> list[str]:
    """Return what was bad by what was last said of it at a time, or not said again for its lifetime.

    What arrived so shortly before that, or after, that it may or may not have been known counts as good news;
    so does what was sent and not answered yet, of a service that is busy.
    """
    said: dict[Atom, tuple[float, bool | None]] = {}  # atom -> until when, and what
    fresh: set[Atom] = set()
    for batch in sorted(record.arrived, key=lambda batch: batch.said_s):
        if min(batch.sent_s, batch.at_s - GRACE_S) > at_s or batch.agent == SECOND_EAR:
            continue
        until_s = batch.at_s + batch.lifetime_s
        values: dict[Atom, bool | None] = {each.atom: each.positive for each in batch.literals}
        values |= dict.fromkeys(batch.unknown)
        now = {atom: (until_s, value) for atom, value in values.items()}
        if batch.at_s > at_s - GRACE_S:
            fresh |= {atom for atom, (_, positive) in now.items() if positive}
        if batch.at_s <= at_s:
            said |= now
        elif min(batch.sent_s, batch.at_s - LAPSE_GRACE_S) <= at_s:  # that it is said may be known, not what
            said |= {atom: (until_s, said[atom][1]) for atom in now if atom in said}
    found = []
    for literal in robot.anatomy.healthy:
        if literal.atom in said and literal.atom not in fresh:
            until_s, positive = said[literal.atom]
            if positive is False:
                found.append(f"{-literal} was said last")
            elif positive is None:
                found.append(f"{literal.atom} was said to be unknown")
        if literal.atom in said and said[literal.atom][0] < at_s - LAPSE_GRACE_S:
            found.append(f"{literal.atom} had not been said again in its lifetime")
    return sorted(found)


def _called_healthy(record: Record, robot: Robot, delay_s: float) -> list[str]:
    """Return when somebody was told that the robot is healthy, and it was not, or nobody could know.

    Observers that must judge anew, as their agent was held up, have the time that they say they need for it,
    and what they said lives on for its lifetime: only the time in which it runs counts.
    """
    topics = (topic for topic in robot.anatomy.topics.values() if topic.observed)
    rates = (PRESETS[record.observers].of(topic.rate_hz, topic.tolerance_hz) for topic in topics)
    anew_s = max((rate.first_verdict_s + rate.check_s for rate in rates), default=0.0)
    lasting_s = max(delay_s, anew_s) + 1.0
    found = []
    for asked_s, at_s in record.called_healthy:
        before = _said_otherwise(record, robot, asked_s)
        why = [each for each in _said_otherwise(record, robot, at_s) if each in before]
        for literal in sorted(abnormal(robot.anatomy, record.state_at(at_s))):
            since_s = _ran_since(record, _watches(robot.anatomy, literal), at_s, lasting_s)
            states = (state for _, state in record.states_between(since_s, at_s))
            why += [str(literal)] if all(literal in abnormal(robot.anatomy, one) for one in states) else []
        if why:
            found.append(f"{at_s:.2f} s: {', '.join(why[:3])}")
    return found


def _watches(anatomy: Anatomy, literal: Literal) -> str | None:
    """Return the computer whose agent observes this; "" is the board."""
    name, hosts = literal.atom.args[-1], anatomy.hosts
    for aspect in anatomy.aspects:
        if aspect.atom == literal.atom:
            return aspect.host or hosts[0]
    if literal.atom.predicate == "on":
        return (anatomy.devices[name].host or hosts[0]) if anatomy.power == "agent" else ""
    if literal.atom.predicate == "running":
        return anatomy.nodes[name].host or hosts[0]
    return anatomy.host_of(name)


def _ran_since(record: Record, host: str | None, at_s: float, for_s: float) -> float:
    """Return since when until `at_s` an agent ran `for_s` seconds, not counted what it was held up."""
    for _, began_s, ended_s in sorted((one for one in record.held_up if one[0] == host), reverse=True):
        if began_s >= at_s:
            continue
        ran_s = max(0.0, at_s - ended_s)
        if ran_s >= for_s:
            break
        at_s, for_s = began_s, for_s - ran_s
    return at_s - for_s


class _Scoring:
    def __init__(self, record: Record, robot: Robot, found: Score) -> None:
        self.record = record
        self.robot = robot
        self.anatomy = robot.anatomy
        self.found = found
        self.delay_s = _delay_s(record, robot)
        self.acts = [acted for acted in record.acts if acted.at_s >= 0]
        self.decision = _decision(record)
        planted = dict.fromkeys(fault for _, fault in record.faults)
        self.field = robot.world == "field"
        self.beyond_repair = any(fault.kind in FOR_EVER for fault in planted)
        self.all: State = settled(self.anatomy, *planted)
        self.components = {fault.component for fault in planted}

    def score(self) -> Score:
        self._detection()
        self._cause()
        self._end()
        self._acts()
        self._times()
        if self.field:
            self._field()
        self._points()
        return self.found

    # --- detection and cause

    def _unheard_s(self) -> list[float]:
        """Return when it was told that nobody observes any more what would show the fault."""
        found = []
        for at_s, atoms in self.record.unknown:
            shown = abnormal(self.anatomy, self.record.state_at(at_s)) if at_s >= 0 else ()
            if any(str(literal.atom) in atoms for literal in shown):
                found.append(at_s)
        return found

    def _detection(self) -> None:
        found, record = self.found, self.record
        found.alarms = _alarms(record, (each for each in record.diagnoses if each.at_s < 0), self.delay_s)
        at_s = [d.at_s for d in record.diagnoses if d.at_s >= 0 and not d.healthy and not d.fault]
        if not record.faults:
            found.alarms += len(at_s[:1])
            return
        at_s += self._unheard_s()
        at_s.sort()
        found.detected = bool(at_s)
        found.detection_s = at_s[0] if at_s else None

    def _roots(self, state: State, before_s: float) -> set[str]:
        """Return the components of faults that began before a time and are still there in this state."""
        there = broken(self.anatomy, state)
        return {fault.component for at_s, fault in self.record.faults if at_s <= before_s} & there

    def _cause(self) -> None:
        found, record, universe = self.found, self.record, self.robot.universe
        if not record.faults:
            return
        at_s = record.end_s if self.decision is None else self.decision.at_s
        state = record.state_at(at_s)
        if self.decision is None and not self._roots(state, at_s):
            at_s, state = 0.0, record.state_at(0.0)  # it went by itself
        roots = self._roots(state, at_s)
        odd = abnormal(self.anatomy, state)
        found.told_apart = universe.told_apart(roots, odd)
        found.told_by_onset = found.told_apart or universe.told_apart_by_onset(roots, odd, state)
        ranked = _ranked(record.diagnoses, at_s)
        blamed = set(self.decision.bad if self.decision is not None else ranked[0] if ranked else ())
        must = self._roots(state, at_s - self.delay_s)  # the others may not have been seen yet
        allowed = roots | broken(self.anatomy, state)
        found.cause_first = bool(blamed & roots) and must <= blamed <= allowed
        candidates = [set(bad) for bad in ranked] or [set()]
        parts = len(self.anatomy.devices) + len(self.anatomy.nodes)
        found.errors = _mean(len(each ^ roots) for each in candidates)
        found.utility = _mean(repair_utility(each, roots, parts) for each in candidates)

    # --- how it ended

    def _end(self) -> None:
        found, record = self.found, self.record
        truth = record.state_at(record.end_s)
        healed = not abnormal(self.anatomy, truth)
        last = record.repairs[-1] if record.repairs else None
        found.contradicted = list(record.contradictions)
        found.false_repaired = [
            f"{seen.at_s:.2f} s: {', '.join(wrong)} still wrong"
            for seen in record.repairs
            if seen.state == "repaired" and seen.at_s >= 0 and (wrong := self._left(seen.at_s))
        ]
        if not record.faults:
            return
        found.repairable = not self.beyond_repair and self.robot.policy.repairable(self.all)
        found.escalated = last is not None and last.state == "escalated"
        well = bool(record.diagnoses) and record.diagnoses[-1].healthy
        if found.repairable:
            ended = last is not None and (last.state == "repaired" or self._could_not_know(last))
            if not abnormal(self.anatomy, self.all):  # it mends itself: nobody need do anything
                ended = ended or last is None or last.state == "cancelled"
            found.repaired = healed and well and ended
        elif found.escalated and last is not None:
            named = {name for name in self.components if name in last.bad or _names(last.reason, name)}
            found.cause_named = bool(named) or self._stands(truth)

    def _could_not_know(self, last: RepairSeen) -> bool:
        """Whether a repair ended unconfirmed as what is observed had not been said again in its lifetime.

        Of reports that are rarer than that nobody knows when it ends; then this is the true word.
        """
        if last.state != "unconfirmed" or not self.field:
            return False
        moments = (last.at_s, *(batch.at_s - 2 * LAPSE_GRACE_S for batch in self.record.arrived))
        near = (at_s for at_s in moments if last.at_s - 3.0 <= at_s <= last.at_s)
        return any(_said_otherwise(self.record, self.robot, at_s) for at_s in near)

    def _stands(self, truth: State) -> bool:
        """Whether the true cause is among the diagnoses that stand at the end.

        Only the first of them count, as many as there are causes that nobody could tell apart.
        """
        roots = frozenset(self._roots(truth, self.record.end_s))
        alike = self.robot.universe.explanations(abnormal(self.anatomy, truth), len(roots))
        first = _ranked(self.record.diagnoses, self.record.end_s)[: len({e.components for e in alike})]
        return roots in map(frozenset, first)

    def _left(self, at_s: float) -> list[str]:
        """Return what is visibly wrong at a time, but for what could not have been noticed by then.

        That is what broke less than the observers' delay ago and was not acted upon: whoever restarts a node
        knows of it, and vouches for its successor.
        """
        known = {part for acted in self.acts if acted.at_s <= at_s for part in acted.act.parameters}
        known |= {f.component for began_s, f in self.record.faults if began_s <= at_s - self.delay_s}
        young = {fault.component for _, fault in self.record.faults} - known
        state = frozenset((name, what) for name, what in self.record.state_at(at_s) if name not in young)
        wrong = sorted(map(str, abnormal(self.anatomy, state)))
        if self.field:
            wrong += (
                f"{topic} not heard yet"
                for topic in _silent(self.record, self.anatomy, at_s, at_s - self.delay_s)
            )
        return wrong

    # --- acts

    def _acts(self) -> None:
        found = self.found
        found.acts = len(self.acts)
        found.cuts = sum(acted.act.name in ("shutdown", "reset_bus") for acted in self.acts)
        early = [acted for acted in self.record.acts if acted.at_s < 0]
        found.wrong = [f"{acted.at_s:.2f} s: {acted.act}" for acted in early]
        counts: dict[Act, int] = {}
        spoilt: list[tuple[str, float]] = []  # components, and when a wrong act touched them
        for acted in self.acts:
            counts[acted.act] = counts.get(acted.act, 0) + 1
            found.repeated += counts[acted.act] > 3
            if not self._was_due(acted.at_s, acted.act, spoilt):
                found.wrong.append(f"{acted.at_s:.2f} s: {acted.act}")
                for part in self._parts(acted.act):
                    spoilt += ((name, acted.at_s) for name in touched(self.anatomy, part))
        if not self.record.faults:
            return
        state = self._to_be_mended()
        odd = abnormal(self.anatomy, state)
        belief = {
            each.state: each.weight for each in self.robot.universe.explanations(odd, len(self.components))
        }
        belief.setdefault(state, min(belief.values(), default=1.0))
        best = self.robot.told_policy.outcome(state, belief.items())
        found.best_acts, found.best_exact = len(best.acts), best.exact

    def _to_be_mended(self) -> State:
        """Return the state that lasts when what passes has passed; or that of the first act, if a relay was
        seen to be open then: that it will close by itself nobody could know.
        """
        if not self.acts:
            return self.all
        before = self.record.state_at(self.acts[0].at_s - 1e-6)
        open_now = (
            not device_in(before, fault.component).on
            for _, fault in self.record.faults
            if fault.kind in PASSING
        )
        return before if any(open_now) else self.all

    def _parts(self, act: Act) -> set[str]:
        """Return the components that an act is done to."""
        if act.name == "reset_bus":
            return {device.name for device in self.anatomy.devices.values() if device.bus in act.parameters}
        return set(act.parameters[:1])

    def _was_due(self, at_s: float, act: Act, spoilt: Sequence[tuple[str, float]]) -> bool:
        """Whether one of an act's components was broken, had to be touched, or looked broken of late.

        What is wrong only because of an earlier wrong act does not count: bringing it back belongs to that.
        """
        parts = self._parts(act)
        planted = {fault.component for began_s, fault in self.record.faults if began_s <= at_s}
        for since_s, truth in self.record.states_between(at_s - self.delay_s, at_s):
            ours = {
                name
                for name, from_s in spoilt
                if from_s <= since_s and name not in planted and not self._came_back(name, from_s, since_s)
            }
            state = frozenset((name, what) for name, what in truth if name not in ours)
            there = broken(self.anatomy, state)
            if act.name in POWER and any(map(_no_power, state)):
                if any(parts & touched(self.anatomy, name) for name in there):
                    return True
                continue
            looks = self.robot.universe.suspects(abnormal(self.anatomy, state), max(1, min(2, len(there))))
            if any(parts & touched(self.anatomy, name) for name in there | looks):
                return True
        return False

    def _came_back(self, component: str, since_s: float, at_s: float) -> bool:
        """Whether a component that was well at first has been wrong since, and well again."""
        wrong = False
        for _, state in self.record.states_between(since_s, at_s):
            if component in dict(state):
                wrong = True
            elif wrong:
                return True
        return False

    # --- what only the field is asked

    def _field(self) -> None:
        found, record, anatomy = self.found, self.record, self.anatomy
        found.called_healthy = _called_healthy(record, self.robot, self.delay_s)
        found.false_repaired += (
            f"{seen.at_s:.2f} s: {', '.join(why[:3])}"
            for seen in record.repairs
            if seen.state == "repaired"
            and seen.at_s >= 0
            and (why := _said_otherwise(record, self.robot, seen.at_s))
        )
        stopped = {
            n for n, w in record.state_at(record.end_s) if isinstance(w, NodeCondition) and not w.running
        }
        found.left_stopped = [
            name
            for name in sorted(stopped - self.components)
            if any(acted.act == Act("stop_node", (name,)) for acted in self.acts)
        ]
        for each in record.credited:
            before = broken(anatomy, record.state_at(each.from_s))
            after = broken(anatomy, record.state_at(each.until_s + GRACE_S))
            if not (before - after) & _acted_on(anatomy, each.components):
                found.credited.append(f"{each.from_s:.2f} s: {', '.join(each.components)}")

    # --- times

    def _times(self) -> None:
        found, record = self.found, self.record
        if not record.faults:
            return
        if self.acts:
            found.first_act_s = self.acts[0].at_s
            told_s = self._told_s(0.0, self.acts[0].at_s)
            found.waited_s = None if told_s is None else self.acts[0].at_s - told_s
        done = [seen for seen in record.repairs if seen.state == "repaired" and seen.at_s >= 0]
        if found.repaired and found.detection_s is not None and done:
            found.repaired_s = done[-1].at_s - found.detection_s
            well_s = self._told_s(found.detection_s, done[-1].at_s)
            found.confirmed_s = None if well_s is None else done[-1].at_s - well_s
            parts = where_time_goes(record, self.anatomy, found.detection_s, done[-1].at_s)
            found.parts = {str(part): seconds for part, seconds in parts.items()}

    def _told_s(self, from_s: float, until_s: float) -> float | None:
        """Return when the observers had told all that is to be seen of the true state at `until_s`.

        None if they had not by then. What a board tells is not in the record, and comes within a broadcast.
        """
        odd = {literal.atom for literal in abnormal(self.anatomy, self.record.state_at(until_s))}
        board = self.anatomy.power == "board"
        unknown = unseen(self.anatomy, self.record.state_at(until_s))
        wanted = {
            literal.atom: literal.atom not in odd
            for literal in self.anatomy.healthy
            if not (board and literal.atom.predicate == "on") and literal.atom not in unknown
        }
        complete_s: float | None = None
        for at_s, held in self.record.told():
            if at_s > until_s:
                break
            if all(held.get(atom) == sign for atom, sign in wanted.items()):
                complete_s = at_s if complete_s is None else complete_s
            else:
                complete_s = None
        return None if complete_s is None else max(complete_s, from_s)

    # --- all in one

    def _points(self) -> None:
        found = self.found
        extra = max(0, found.extra or 0)
        slow_s = found.repaired_s or 0.0
        base = 1.0 if found.right else 0.0
        if not self.record.faults:
            base = 1.0 if not self.acts else 0.0
        found.points = base - 0.5 * len(found.wrong) - 0.1 * extra - 0.01 * slow_s * base
        if found.false_repaired:
            found.points -= 1.0
        found.points = max(-1.0, found.points)


def _decision(record: Record) -> RepairSeen | None:
    """Return the first diagnosis that a repair was planned for after the fault."""
    return next((seen for seen in record.repairs if seen.at_s >= 0 and seen.bad), None)


def _ranked(diagnoses: Iterable[Diagnosed], at_s: float) -> tuple[tuple[str, ...], ...]:
    """Return the abnormal components of each diagnosis that stood at a time."""
    found: tuple[tuple[str, ...], ...] = ()
    for each in diagnoses:
        if each.at_s <= at_s:
            found = each.bads
    return found


def _names(text: str, component: str) -> bool:
    """Whether a text names a component, as a word of its own."""
    return re.search(rf"(?<![\w-]){re.escape(component)}(?![\w-])", text) is not None


def repair_utility(diagnosis: set[str], truth: set[str], components: int) -> float:
    """Return the system repair utility of the DXC competition, 1 for the truth itself.

    Source: A. Feldman and others. Empirical evaluation of diagnostic algorithm performance using a generic
    framework. International Journal of Prognostics and Health Management, 2010.
    """
    missed, blamed = len(truth - diagnosis), len(diagnosis - truth)
    others = components - len(diagnosis)
    lost = missed * (others + 1) / (components * (missed + 1))
    return 1.0 - lost - blamed * (len(diagnosis) + 1) / (components * (blamed + 1))


def _mean(values: Iterable[float]) -> float:
    found = list(values)
    return sum(found) / len(found)
