"""What is remembered of a robot's repairs: what was tried, whether it helped, and what is left alone now."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robomend.entry import Entry
from robomend.model.components import Node
from robomend.planning.choice import Choice
from robomend.planning.cures import ActOutcome, curing, once
from robomend.planning.influence import put_out
from robomend.planning.plan import Plan
from robomend.planning.policy import HOUR_NS, NODE_ACTIONS, POWER_ACTIONS
from robomend.planning.prediction import OBSERVED_FACTS
from robomend.planning.quarantine import Patience, Quarantined, came_back, quarantined, relapses, unlasting
from robomend.planning.tried import MEMORY_S, Attempt, attempt
from robomend.repairs.execution_values import Ending, Execution, StepReport
from robomend.repairs.states import StepState
from robomend.robots.robot import Robot
from robomend.store import View, attempts, drills, repairs
from robomend.store.records import Quarantine, StoredAttempt, StoredRepair
from robomend_client.literals import Atom, Literal


@dataclass(frozen=True, slots=True)
class Remembered:
    """What the store remembers of a robot's repairs."""

    tried: tuple[Attempt, ...]  # what helped and did not last is no cure; without what came back by itself
    quarantined: tuple[str, ...]
    useless: Mapping[frozenset[str], frozenset[str]]  # diagnosis -> actions that did not cure it
    attempts: Mapping[str, int]  # component -> actions on it in the last hour
    surely_broken: frozenset[str] = frozenset()  # to earlier rounds of the repair, which did not cure it
    relapses: tuple[Attempt, ...] = ()  # repairs in a row that helped what is suspected, and did not last
    aside: frozenset[str] = frozenset()  # in quarantine, by what is on disk
    outcomes: tuple[ActOutcome, ...] = ()  # of earlier repairs of one component alone, the fleet's as well
    reconnecting: frozenset[str] = frozenset()  # drivers that were seen to need no restart with their device
    all: tuple[Attempt, ...] = ()  # whoever is credited with them, the newest first


def remembered(
    view: View, robot: str, patience: Patience, suspected: Collection[str] = (), since_ns: int = 0
) -> Remembered:
    """Return what was tried lately and what is left alone now.

    Args:
        suspected: what any diagnosis blames now; without it nothing is known to have come back.
        since_ns: what was tried in vain before that may help now.
    """
    now = time.time_ns()
    drill = drills.open_of(view, robot)
    now_of = None if drill is None else drill.id
    # A drill's attempts say nothing of real faults, nor of another drill's.
    records = attempts.tried(view, robot, drill=now_of)
    tried = tuple(map(_attempt_of, records))
    again = relapses(tried, suspected, now_ns=now, patience=patience)
    back = came_back(again, suspected, now_ns=now, patience=patience)
    aside = [entry.component for entry in attempts.quarantine(view, robot) if not entry.over(now)]
    own = [(one, r) for one, r in zip(tried, records, strict=True) if not one.by_itself]
    repair = repairs.newest(view, [robot]).get(robot)
    open_ = repair.id if repair is not None and repair.open else ""
    useless = [replace(r, helped=one.helped and one not in again) for one, r in own]
    return Remembered(
        tuple(
            one for one in unlasting((one for one, _ in own), again) if one.helped or one.time_ns >= since_ns
        ),
        tuple(dict.fromkeys([*aside, *back])),
        useless_of(useless, since_ns=max(since_ns, now - int(MEMORY_S * 1e9)), open_repair=open_),
        attempts.counted(view, robot, now - HOUR_NS),
        surely_broken(records, repair),
        again,
        frozenset(aside),
        (*outcomes(records, repair), *outcomes(attempts.of_fleet(view, robot), None, fleet=True)),
        reconnecting(records),
        () if repair is not None and repair.open and _was_interrupted(repair) else tried,
    )


def outcomes(
    tried: Iterable[StoredAttempt], repair: StoredRepair | None, *, fleet: bool = False
) -> tuple[ActOutcome, ...]:
    """Return what came of acts that were carried out on one component alone, in repairs that have ended.

    What came back by itself says nothing of them.
    """
    now = repair.id if repair is not None and repair.open else None
    return tuple(
        ActOutcome(one.bad[0], frozenset(one.data["cures"]), one.helped, one.data.get("mode") or "", fleet)
        for one in tried
        if len(one.bad) == 1
        and one.repair != now
        and not one.data.get("by_itself")
        and not one.data.get("undid")
        and one.data.get("cures")
        and (one.helped or one.effect_seen)
    )


def surely_broken(tried: Iterable[StoredAttempt], repair: StoredRepair | None) -> frozenset[str]:
    """Return what every diagnosis blamed in an earlier round of the open repair, which did not cure it.

    Of this repair only: since it began the robot was never well.
    """
    if repair is None or not repair.open:
        return frozenset()
    found: set[str] = set()
    for one in sorted((one for one in tried if one.repair == repair.id), key=lambda one: one.time_ns):
        if _brought_back(one):
            found -= {*one.bad, *one.data.get("repaired", ())}
        else:
            found |= set(one.data.get("certain", ()))
    return frozenset(found)


def useless_of(
    tried: Iterable[StoredAttempt], *, since_ns: int, open_repair: str = ""
) -> dict[frozenset[str], frozenset[str]]:
    """Return, for each diagnosis, the actions that were done for it lately and did not cure it; in the open
    repair also for each component of the diagnosis: the rest of it may be well by now.
    """
    found: dict[frozenset[str], frozenset[str]] = {}
    for one in tried:
        if not one.helped and one.time_ns >= since_ns:
            alone = ([name] for name in one.bad if one.repair == open_repair)
            for bad in {frozenset(one.bad), *map(frozenset, alone)}:
                found[bad] = found.get(bad, frozenset()) | frozenset(one.data.get("direct", ()))
    return found


def kept_of(
    state: Robot,
    repair: str,
    choice: Choice,
    execution: Execution,
    memory: Remembered,
    *,
    helped: bool,
    by_itself: str | None = None,
    undid: Sequence[Atom] = (),
    symptoms: Collection[Entry] = (),
) -> tuple[StoredAttempt, list[Quarantine]]:
    """Return what is to be kept of a round, and the components that it puts into quarantine.

    What came back by itself is kept as no help, with why: choosing and priors learn nothing from it, and it
    counts only where what does not last is looked for.

    Args:
        helped: nobody blames any more what the round was for. It is credited with that unless it came back
            `by_itself`, or the round's acts put out something else (`undid`).
    """
    assert choice.plan is not None
    assert choice.diagnosis is not None
    now = time.time_ns()
    tried = attempt(
        choice.diagnosis,
        choice.plan,
        done=[report.step.index for report in execution.steps if _carried_out(report)],
        time_ns=now,
        effect_seen=execution.effect_seen,
        helped=helped,
        began_ns=min((report.sent_ns for report in execution.steps if report.sent_ns), default=0),
        model=state.system.parts,
    )
    ended = {
        "ending": str(execution.ending),
        "reason": execution.reason,
        "direct": direct(execution.steps, choice.diagnosis.bad),
        "certain": [name for name in choice.diagnosis.bad if name in choice.certain],
        "reconnected": sorted(execution.kept - set(choice.diagnosis.bad)),
        "cures": sorted({kind for kind, _ in curing(choice.plan, choice.diagnosis.bad).values()}),
        "mode": next(iter(choice.diagnosis.modes.values()), None),
        "symptom_ns": began_ns(state, choice.diagnosis.bad, symptoms),
        "sent_ns": sorted(report.sent_ns for report in execution.steps if report.sent_ns),
        "down": down(symptoms),
        **({"undid": [str(atom) for atom in undid]} if undid else {}),
    }
    credited = helped and by_itself is None and not undid
    if by_itself is not None:
        return _stored(tried, state.id, repair, {**ended, "by_itself": by_itself}, credited=credited), []
    left_alone = quarantined([*memory.tried, tried], now_ns=now)
    new = {name: entry for name, entry in left_alone.items() if name not in memory.quarantined}
    kept = _stored(tried, state.id, repair, ended, credited=credited)
    return kept, set_aside(state.id, new, now, execution.reason)


def _carried_out(report: StepReport) -> bool:
    """Return whether an action did what it is for, be it in vain: nothing that it switches or starts is
    missing.
    """
    if report.state in {StepState.DONE, StepState.ALREADY} or report.seen:
        return True
    facts = (literal for literal in report.missing if literal.atom.predicate in OBSERVED_FACTS)
    return report.result is not None and report.result.ok and next(facts, None) is None


def by_evidence(plan: Plan, bad: Collection[str]) -> frozenset[str]:
    """Return what a plan takes to be bad and evidence may clear: what its diagnosis blames, and drivers of
    devices that it gives their power. What is tied to another node must restart after it, whatever is seen.
    """
    dropped, tied = set(bad), set[str]()
    for step in plan.steps:
        names = (e.atom.args[0] for e in step.effects if e.positive and e.atom.predicate == "bad")
        (tied if step.name == "stop_node" else dropped).update(set(names) - set(step.parameters))
    return frozenset(dropped - tied)


def reconnecting(tried: Iterable[StoredAttempt]) -> frozenset[str]:
    """Return the drivers that were seen to come back by themselves with their devices, and not since to have
    had to be restarted.
    """
    found: set[str] = set()
    for one in sorted(tried, key=lambda one: one.time_ns):
        if one.helped:
            found -= set(one.bad)
        found |= set(one.data.get("reconnected", ()))
    return frozenset(found)


def set_aside(robot: str, found: Mapping[str, Quarantined], now_ns: int, last: str = "") -> list[Quarantine]:
    """Return the components that are left alone from now on, as the store keeps them."""
    return [
        Quarantine(
            robot=robot,
            component=name,
            reason=f"{entry.reason}; last: {last}" if last else entry.reason,
            failures=entry.failures,
            since_ns=now_ns,
            until_ns=entry.until_ns,
        )
        for name, entry in found.items()
    ]


def direct(reports: Iterable[StepReport], bad: Collection[str]) -> list[str]:
    """Return the actions that were done and should have made a component of the diagnosis good, and those of
    one's own that were asked for and answered that they failed.

    Where they did not help, another way is planned before the same is done again.
    """
    cures = {Literal(Atom("good", (name,))) for name in bad}
    return [
        str(report.step)
        for report in reports
        if report.result is not None
        and (report.result.ok or report.step.name not in POWER_ACTIONS | NODE_ACTIONS)
        and cures & set(report.step.effects)
    ]


def spent(state: Robot, choice: Choice, execution: Execution) -> frozenset[str]:
    """Return the acts of a round that did not help which this repair does not do again: once carried out
    wholly, with their effects awaited.
    """
    parts = state.system.parts
    if parts is None or choice.plan is None or choice.diagnosis is None:
        return frozenset()
    wholly = execution.ending in {Ending.DONE, Ending.EFFECT_MISSING} and execution.effect_seen
    return once(choice.plan, parts.hardware.keys() & choice.diagnosis.bad) if wholly else frozenset()


def _attempt_of(record: StoredAttempt) -> Attempt:
    """Return an attempt as choosing sees it."""
    return Attempt(
        bad=frozenset(record.bad),
        repaired=frozenset(record.data.get("repaired", ())),
        time_ns=record.time_ns,
        effect_seen=record.effect_seen,
        helped=_brought_back(record),
        actions=record.actions,
        cycled=frozenset(record.data.get("cycled", ())),
        began_ns=record.data.get("began_ns", 0),
        by_itself=bool(record.data.get("by_itself")),
        symptom_ns=record.data.get("symptom_ns", 0),
        down=tuple(sorted(record.data.get("down", {}).items())),
        sent_ns=tuple(record.data.get("sent_ns", ())),
    )


def _was_interrupted(repair: StoredRepair) -> bool:
    """Return whether it is gone on with after the service had ended: nobody knows what it did of a plan, and
    what is left to do is no repair of its own.
    """
    return any(one["ending"] == "interrupted" for one in repair.data.get("rounds", ()))


def _brought_back(one: StoredAttempt) -> bool:
    """Return whether what it was for was well after it, whoever is credited with that."""
    return one.helped or bool(one.data.get("by_itself") or one.data.get("undid"))


def began_ns(state: Robot, bad: Collection[str], symptoms: Iterable[Entry]) -> int:
    """Return when what these components put out began to fail, the newest of it; 0: nothing of that does."""
    names = frozenset(bad) if state.system.parts is None else put_out(state.system.parts, bad)
    return max((one.began_ns for one in symptoms if names.intersection(one.atom.args)), default=0)


def down(symptoms: Iterable[Entry]) -> dict[str, int]:
    """Return the nodes that do not run, each with since when."""
    return {one.atom.args[0]: one.began_ns for one in symptoms if one.atom.predicate == Node.state}


def _stored(
    tried: Attempt, robot: str, repair: str, data: Mapping[str, Any], *, credited: bool
) -> StoredAttempt:
    """Return an attempt as the store keeps it."""
    return StoredAttempt(
        robot=robot,
        bad=tuple(sorted(tried.bad)),
        actions=tried.actions,
        helped=credited,
        effect_seen=tried.effect_seen,
        repair=repair,
        time_ns=tried.time_ns,
        data={
            **data,
            "repaired": sorted(tried.repaired),
            "cycled": sorted(tried.cycled),
            "began_ns": tried.began_ns,
        },
    )
