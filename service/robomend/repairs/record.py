"""What a repair writes down: its state, each plan, each action before it is sent and after, and who and why.

One write is one transaction, so that the journal, the event that tells of it and the audit entry are kept
together or not at all. Every write carries the fence of the robot's owner; once another instance has taken
over, the store refuses (Fenced) and the case ends at once, without sending anything more.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import structlog

from robomend.diagnosis.result import DiagnosisResult
from robomend.entry import Entry
from robomend.model.components import ComponentModel
from robomend.planning.choice import Choice
from robomend.repairs.account import MOST, blamed, grounds, outcome
from robomend.repairs.execution_values import StepReport, Withheld
from robomend.repairs.repair_json import plan_json, repair_json, report_json, step_number
from robomend.repairs.signals import NO_REASON
from robomend.repairs.states import ENDS, INITIAL, REPAIR, RepairState, RepairTrigger
from robomend.store import Store, Transaction, View, attempts, drills, global_stop, journal, repairs
from robomend.store.records import (
    AuditEntry,
    Fence,
    Paging,
    Quarantine,
    StoredAttempt,
    StoredDrill,
    StoredRepair,
)
from robomend.transitions import after
from robomend_client.actions import Action, ActionResult
from robomend_client.counts import counted
from robomend_client.events import Kind

log = structlog.get_logger("robomend.repairs")

Json = Mapping[str, Any]

LOOP = "robomend"
"""The actor in the audit log when nobody asked."""


def new_repair(
    tx: Transaction,
    robot: str,
    policy: str,
    *,
    by: str = LOOP,
    reason: str = "",
    fence: Fence | None = None,
    asked: bool = False,
    wanted: Sequence[str] | None = None,
    again: Json | None = None,
) -> StoredRepair:
    """Write a new repair with its event and audit entry; its owner takes it up.

    Args:
        asked: a person asks for it, who looks at the robot: observers that are silent are not waited for.
        wanted: the diagnosis to be repaired; None: to be chosen.
        again: the repair that it takes up, as that ended without success.
    """
    last = repairs.page(tx, robot, Paging(limit=1)).items
    data = {
        "policy": policy,
        "by": by,
        "asked": asked,
        "wanted": None if wanted is None else list(wanted),
        "again": again,
        "reason": reason,
        # What the last one asked a person, or left to ask, and nobody answered.
        "question": last[0].data.get("question") if last else None,
        "left_off": last[0].data.get("left_off")
        if last
        else None,  # what it switched off and did not bring back
    }
    drill = drills.open_of(tx, robot)
    if drill is not None:  # it answers a planted fault, and never counts as a real one
        data["drill"] = drill.id
    repair = repairs.create(tx, robot, state=INITIAL, data=data, fence=fence)
    tx.emit(Kind.REPAIR, robot, repair_json(repair))
    why = reason if asked else "the diagnosis is not healthy"
    if again is not None:
        why += f"; {again['of']}, which {again['why']}, is taken up again ({counted(again['times'], 'time')})"
    after_ = {"bad": data["wanted"]} if asked else None
    tx.note(AuditEntry(by, "repair.create", repair.id, robot, why, after=after_))
    return repair


def answered(view: View, drill: StoredDrill) -> bool:
    """Return whether a drill had its repair: when that has ended, the drill ends, too."""
    found = repairs.page(view, drill.robot, Paging(limit=1)).items
    return bool(found) and not found[0].open and found[0].data.get("drill") == drill.id


class ActionRecord:
    """The records of the actions of one open repair, or change of configuration."""

    def __init__(
        self, store: Store, repair: StoredRepair, fence: Fence, components: Collection[str] = ()
    ) -> None:
        """`components`: what attempts are counted for; a user's action has other parameters as well."""
        self._store = store
        self.fence = fence
        self._repair = repair
        self._components = frozenset(components)
        self._data: dict[str, Any] = dict(repair.data)
        self._why = ""

    @property
    def id(self) -> str:
        """The repair's id, or the change's."""
        return self._repair.id

    @property
    def robot(self) -> str:
        """The robot that is acted on."""
        return self._repair.robot

    @property
    def data(self) -> Json:
        """What is written of it besides its state."""
        return self._data

    @property
    def drill(self) -> str | None:
        """The drill whose fault it answers; None: the fault is a real one."""
        return self._data.get("drill")

    @property
    def left_off(self) -> dict[str, int]:
        """Component -> when this repair, or one before it, switched it off or stopped it (left_off.py)."""
        return dict(self._data.get("left_off") or {})

    def doubt(self, arrows: Iterable[dict[str, str]]) -> None:
        """Keep arrows of the model that are contradicted; on disk with the next state."""
        kept = {one["text"]: one for one in (*self._data.get("doubts", ()), *arrows)}
        if kept:
            self._data = {**self._data, "doubts": list(kept.values())[:MOST]}

    def leave_off(self, left: Mapping[str, int]) -> None:
        """Change what is left off; it is on disk with the next intent, outcome or state."""
        self._data = {**self._data, "left_off": dict(left)}

    def _keep_left_off(self, tx: Transaction) -> None:
        if self.left_off != (self._repair.data.get("left_off") or {}):
            repairs.update(
                tx, self.id, state=self._repair.state, data=self._data, open=True, fence=self.fence
            )

    # --- the journal of actions (robomend.repairs.execution_values.Journal)

    async def intend(self, action: Action, report: StepReport) -> None:
        """Write that an action will be sent, unless the global stop or a cancellation came first.

        Looked up in the transaction that the intent is written in, so that no action follows a stop that
        was acknowledged, whichever instance it was said to.
        """
        number, step = step_number(action.id), report.step
        entry = AuditEntry(
            actor=str(self._data.get("by") or LOOP),
            action="action.sent",
            subject=str(action),
            robot=self.robot,
            reason=self._why,
            before={"preconditions": [str(p) for p in step.preconditions]},
            after={"effects": [str(e) for e in step.effects]},
        )

        def write(tx: Transaction) -> str | None:
            stop = global_stop.hold(tx)
            if stop.active:
                return f"global stop: {stop.reason}"
            for request in repairs.requests(tx, self.robot):
                if request.what == "cancel" and request.repair == self.id:
                    return request.reason or NO_REASON
            journal.intend(
                tx,
                self.id,
                number,
                action=action.id,
                name=action.name,
                parameters=action.parameters,
                timeout_s=action.timeout_s,
                fence=self.fence,
            )
            counted = report.step.acts_on(self._components) if self.drill is None else ()
            for component in counted:
                attempts.count(tx, self.robot, component, self.id, fence=self.fence)
            tx.note(entry)
            self._put_step(tx, report, number)
            self._keep_left_off(tx)
            return None

        refusal = await self._store.write(write, robots=(self.robot,))
        if refusal is not None:
            raise Withheld(refusal)

    async def settle(
        self, action: Action, result: ActionResult, report: StepReport, anew: Json | None = None
    ) -> None:
        """Write the outcome of an action; `anew` is what agents are to judge anew, for its event."""
        entry = AuditEntry(
            actor=LOOP,
            action="action.result",
            subject=str(action),
            robot=self.robot,
            reason=result.message,
            after={"result": result.code},
        )

        def write(tx: Transaction) -> None:
            journal.settle(tx, action.id, result.code, result.message, fence=self.fence)
            tx.note(entry)
            self._put_step(tx, report, step_number(action.id), **({} if anew is None else {"settle": anew}))
            self._keep_left_off(tx)

        await self._store.write(write, robots=(self.robot,))

    async def report(self, report: StepReport, first: int) -> None:
        """Note how far a step came."""
        number = first + report.step.index
        await self._store.write(lambda tx: self._put_step(tx, report, number), robots=(self.robot,))

    def _put_step(self, tx: Transaction, report: StepReport, number: int, **told: Json) -> None:
        data = report_json(report, number)
        repairs.put_step(tx, self.id, number, state=str(report.state), data=data, fence=self.fence)
        told_of = {"repair": self.id, "round": self._data.get("round"), **data, **told}
        tx.emit(Kind.ACTION, self.robot, told_of)


class RepairRecord(ActionRecord):
    """The records of one open repair."""

    @property
    def state(self) -> RepairState:
        """What the repair is in."""
        return RepairState(self._repair.state)

    @property
    def tries_anew_from_ns(self) -> int:
        """What was tried before that may help now: of one that takes up an earlier one, its own beginning."""
        return self._repair.created_ns if self._data.get("again") else 0

    async def update(
        self,
        what: RepairTrigger,
        *,
        reason: str = "",
        by: str = LOOP,
        answers: Sequence[int] = (),
        also: Callable[[Transaction], None] | None = None,
        **changes: Any,
    ) -> None:
        """Note what happened and the state after it, with the event and the audit entry that tell of it.

        Args:
            answers: the requests that this answers: what somebody asked for is done with when what
                came of it is on disk, and not before.
            also: further changes of the same transaction.
        """
        before = self.state
        state = after(REPAIR, before, what)
        waits = _waits(self._data, what, reason, changes.get("waiting_for", ()))
        data = {**self._data, **changes, "waits": waits, "reason": reason}
        entry = AuditEntry(
            actor=by,
            action=f"repair.{state}",
            subject=self.id,
            robot=self.robot,
            reason=reason,
            before={"state": str(before)},
            after={"state": str(state), "diagnosis": data.get("diagnosis"), "round": data.get("round")},
        )

        def write(tx: Transaction) -> StoredRepair:
            still_open = state not in ENDS
            updated = repairs.update(tx, self.id, state=state, data=data, open=still_open, fence=self.fence)
            tx.emit(Kind.REPAIR, self.robot, repair_json(updated))
            if state != before or reason:
                tx.note(entry)
            for request in answers:
                repairs.answer(tx, request, fence=self.fence)
            if also is not None:
                also(tx)
            return updated

        self._data = data  # before it is on disk: steps that run side by side may write meanwhile, too
        self._repair = await self._store.write(write, robots=(self.robot,))
        if state != before:
            log.info(
                "repair",
                robot=self.robot,
                repair=self.id,
                state=str(state),
                **({"reason": reason} if reason else {}),
            )

    async def begin_round(
        self,
        choice: Choice,
        result: DiagnosisResult,
        entries: Iterable[Entry],
        model: ComponentModel | None = None,
    ) -> int:
        """Note the plan of a new round; return the number of its first step within the repair.

        With it goes what the choice rests on (account.py): its rivals, what it was chosen from (`result`),
        and what was known of the robot. The choice in words and the conflicts that it resolves go into the
        audit log, too.
        """
        plan, why = choice.plan, choice.reason
        assert plan is not None
        assert choice.diagnosis is not None
        entries = tuple(entries)
        rests_on = grounds(result, choice, entries)
        rounds = self.rounds_closed("not-permitted", "it was not begun")
        first = sum(len(past["plan"]) for past in rounds)
        bad, good = choice.diagnosis.bad, result.good(choice.diagnosis)
        diagnosis = {"bad": list(bad), "good": list(good)}
        steps = plan_json(plan, first, model, entries)
        new = {"began_ns": time.time_ns(), "diagnosis": diagnosis, "plan": steps, "why": why, "ending": None}
        rounds.append({**new, **rests_on})
        self._why = "; ".join((why, *rests_on["conflicts"]))
        self._data = _decided(self._data, self._repair.updated_ns, time.time_ns(), bad)
        await self.update(
            RepairTrigger.PLANNED,
            reason=why,
            round=len(rounds),
            rounds=rounds,
            unmended=None,
            diagnosis=diagnosis,
            plan=steps,
            cost=plan.cost,
            assumed=[str(literal) for literal in plan.assumed],
            unreachable=list(plan.unreachable),
            waiting_for=[],
        )
        return first

    def not_mended(self, choice: Choice, result: DiagnosisResult, entries: Iterable[Entry]) -> None:
        """Note what is blamed while nothing is known to mend it, and what that rests on."""
        bad = list(blamed(result, choice))
        good = [name for name in result.components if name not in bad]
        vain = {"began_ns": time.time_ns(), "diagnosis": {"bad": bad, "good": good}, "plan": []}
        self._data = {**self._data, "unmended": {**vain, **grounds(result, choice, entries)}}

    async def end_round(
        self,
        ending: str,
        reason: str,
        *,
        helped: bool,
        by_itself: str | None = None,
        undid: Sequence[object] = (),
        tried: StoredAttempt | None = None,
        quarantined: Sequence[Quarantine] = (),
        entries: Iterable[Entry] = (),
    ) -> None:
        """Note how the round ended, its symptoms then (`entries`), what was tried, and what is left alone.

        Args:
            by_itself: why it is well again, if that is nothing that the round has done.
            undid: what held before the round and fails since its acts: it did not help.
        """
        rounds = list(self._data["rounds"])
        after_it = outcome(rounds[-1], {entry.atom: entry for entry in entries})
        rounds[-1] = {**rounds[-1], "ending": ending, "reason": reason, "helped": helped, "after": after_it}
        if by_itself is not None:
            rounds[-1]["by_itself"] = by_itself
        if undid:
            rounds[-1]["undid"] = [str(atom) for atom in undid]

        def remember(tx: Transaction) -> None:
            if tried is not None:
                of_drill = {} if self.drill is None else {"drill": self.drill}
                kept = replace(tried, data={**tried.data, **of_drill})
                attempts.remember(tx, kept, fence=self.fence)
            self._set_aside(quarantined, tx)

        # What was approved is done with: a new plan is a new question.
        await self.update(
            RepairTrigger.ROUND_ENDED,
            reason=reason,
            rounds=rounds,
            approved=None,
            waiting_for=[],
            also=remember,
        )

    async def set_aside(self, entries: Sequence[Quarantine]) -> None:
        """Note components that are not tried again for a while; of a planted fault none is."""
        await self._store.write(partial(self._set_aside, entries), robots=(self.robot,))

    def _set_aside(self, entries: Sequence[Quarantine], tx: Transaction) -> None:
        for one in entries if self.drill is None else ():
            attempts.put_quarantine(tx, one, fence=self.fence)
            told = {"quarantine": one.component, "reason": one.reason, "until_ns": one.until_ns}
            tx.emit(Kind.ROBOT, self.robot, told)
            tx.note(AuditEntry(LOOP, "component.quarantined", one.component, self.robot, one.reason))

    async def interrupted(self) -> None:
        """Close the round that a crash or a shutdown cut short, if there is one."""
        rounds = self.rounds_closed("interrupted", "the service ended in the middle of it")
        await self.update(
            RepairTrigger.TAKEN_UP, reason="taken up again, with fresh observations", rounds=rounds
        )

    def rounds_closed(self, ending: str, reason: str) -> list[Json]:
        """Return the rounds, the last one ended like this if it has no ending yet."""
        rounds = list(self._data.get("rounds", ()))
        if rounds and rounds[-1]["ending"] is None:
            rounds[-1] = {**rounds[-1], "ending": ending, "reason": reason, "helped": False}
        return rounds


def _waits(written: Json, what: RepairTrigger, why: str, names: Sequence[str]) -> list[Json]:
    """Return what a repair has waited for, after this has happened: each with the round that it came before.

    One that goes on for fewer and fewer is one wait, for all that it began with.
    """
    now_ns, waits = time.time_ns(), list(written.get("waits", ()))
    open_ = waits[-1] if waits and waits[-1]["until_ns"] is None else None
    waiting = what in {RepairTrigger.UNHEARD, RepairTrigger.LOOKS_FIRST}
    if open_ is not None:
        if waiting and open_["why"] == why:
            return waits
        waits[-1] = {**open_, "until_ns": now_ns}
    if waiting and len(waits) < MOST:
        number = len(written.get("rounds", ())) + 1
        wait = {"from_ns": now_ns, "until_ns": None, "round": number, "why": why, "names": list(names)[:MOST]}
        waits.append(wait)
    return waits


DECIDED = "for verdicts, a diagnosis and a plan"

DECIDES_NS = 10**9
"""A person who reads the record is told of longer times between two lines of it."""


def _decided(written: Json, since_ns: int, now_ns: int, bad: Sequence[str]) -> dict[str, Any]:
    """Return what is written of a repair, with what it took to decide, where that would not be told else."""
    waits = list(written.get("waits", ()))
    told = waits and waits[-1]["until_ns"] is None
    if told or now_ns - since_ns < DECIDES_NS or len(waits) >= MOST:
        return dict(written)
    number = len(written.get("rounds", ())) + 1
    names = list(bad)[:MOST]
    decided = {"from_ns": since_ns, "until_ns": now_ns, "round": number, "why": DECIDED, "names": names}
    return {**written, "waits": [*waits, decided]}


def approval(by: str, steps: Iterable[str]) -> dict[str, object]:
    """Return the record of a yes: who said it, and to which actions."""
    return {"by": by, "steps": list(steps)}
