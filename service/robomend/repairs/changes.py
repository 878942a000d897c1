"""The configuration of one robot: decides which variants its functions are to work by, and changes to them.

    a diagnosis, a reading, the clock ──► decide ──► due? ──► plan ──► the policy ──► act ──► active is seen
                                            ▲                            │ approve          │ not
                                            └── a person's yes ◄─────────┘                  └──► the next one

A change is no repair: nothing is blamed, counted or put into quarantine. Its acts go the way of a repair's:
policy, protection, interlock, the stop, the journal (robomend.repairs.execution). It has a record of its own.
No repair begins to act meanwhile. Under a repair that acts only what has nothing to do with its acts is
changed; where a fault makes a change due, the cheaper way to be useful again comes first.

A change that a crash cuts off was made if that is seen within the time that its acts have. Else it is closed,
and what is due is decided anew.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import structlog

from robomend.errors import Fenced, NotFound, RobomendError, StoreError
from robomend.model.components import ComponentModel, Function
from robomend.model.functions import all_of, needs_of
from robomend.model.vocabulary import ACTIVE
from robomend.planning.configurations import (
    RETRY_NS,
    Decision,
    FunctionState,
    Keeper,
    Made,
    VariantChange,
    change_plan,
)
from robomend.planning.influence import put_out, touched
from robomend.planning.plan import Outcome, Plan, Step
from robomend.planning.planning import PlanOptions
from robomend.planning.policy import HOUR_NS, Mode, Policy
from robomend.planning.prediction import Prediction, theory_of
from robomend.planning.static_facts import OutOfWork, Work
from robomend.poller import wait_for
from robomend.repairs.acts import Acts
from robomend.repairs.change_record import RECALLED, ChangeRecord, begin, came_back, changes_of, is_held
from robomend.repairs.choosing import offers_now
from robomend.repairs.dependencies import Dependencies
from robomend.repairs.execution import execute
from robomend.repairs.execution_values import (
    MAY_HAVE_ACTED,
    OWN_S,
    Ending,
    Execution,
    Setting,
    StepReport,
    Timing,
    timings,
)
from robomend.repairs.record import LOOP
from robomend.repairs.signals import Requests, Signals
from robomend.repairs.states import ChangeState, ChangeTrigger, StepState
from robomend.robots.clock import CLOCK
from robomend.robots.configuration import protected_of
from robomend.robots.robot import Robot
from robomend.store import Transaction, journal, repairs
from robomend.store.records import Fence, Paging, StepRecord, StoredRepair
from robomend_client.actions import OK, TIMED_OUT
from robomend_client.literals import Atom

log = structlog.get_logger("robomend.repairs.changes")

IDLE_S = 3600.0
MINUTE_S = 60.0
"""Maintenance windows begin with one."""

RETRY_S = 1.0
"""After a failure of the store or of a worker."""

AGAIN_S = 0.01
"""Until the next variant is tried, or what else is due."""

SOON_S = 0.1
"""How often it is looked whether a repair still acts."""

AT_ONCE = 1_000_000
"""Steps of work of a plan, about a second of the processor: what takes more than that is given up."""

FINISHED_S = 60.0
"""How long a repair waits for a change that is under way, at most."""

DEFER_S = 10.0
"""So much longer than twice its cost a repair is waited for that is cheaper than the change."""

CUT_OFF = "it was cut off; decided anew"


@dataclass
class WaitingChange:
    """A change that waits for a person's yes."""

    record: ChangeRecord
    changes: tuple[VariantChange, ...]
    plan: Plan
    signals: Signals
    listener: asyncio.Task[None]


@dataclass
class CutOff:
    """A change that a crash cut off: whether it was made is for OBS to say."""

    record: ChangeRecord
    changes: tuple[VariantChange, ...]
    until_s: float  # monotonic; so long its acts and their effects may take


@dataclass
class Deferred:
    """A fault of which a repair is cheaper than the change that it makes due."""

    until_s: float = 0.0  # monotonic; 0: none is deferred
    round: int = 0  # of repairs, the one that is waited for
    tried: bool = False  # a repair has ended since


@dataclass
class Changes:
    """See the module; one task, everything else only wakes it."""

    needs: Dependencies
    robot: str
    fence: Fence
    acted_on: Callable[[], Collection[str] | None]  # by the repair whose plan is under way; None: none is
    left_off: Callable[[], Collection[str]]  # what a repair has switched off and not brought back
    acting: bool = False
    _news: asyncio.Event = field(default_factory=asyncio.Event)
    _idle: asyncio.Event = field(default_factory=asyncio.Event)
    _keeper: Keeper = field(default_factory=Keeper)
    _recalled: bool = False
    _looked: int = -1  # the count of diagnoses up to which it has decided
    _rounds: int = 0  # of repairs that have come to their acts
    _first: bool = False  # a repair waits with its acts until what is due is changed
    _waiting: WaitingChange | None = None
    _cut_off: list[CutOff] = field(default_factory=list)
    _signals: Signals | None = None  # of the change under way
    _deferred: Deferred = field(default_factory=Deferred)
    _held: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Function -> the better variant that waits, and why, as it was noted last."""

    def __post_init__(self) -> None:
        self._requests = Requests(self.needs.store, self.fence)

    # --- what wakes it

    def wake(self) -> None:
        """There is a new diagnosis, or a reading."""
        self._news.set()

    def asked(self) -> None:
        """Somebody said yes or no to a change."""
        self._requests.arrived.set()
        self._news.set()

    def reconsider(self) -> None:
        """The robot's configuration changed: what failed may work now."""
        self._keeper.reconsider()
        self._news.set()

    def repair_ended(self) -> None:
        """A repair has ended, whatever came of it."""
        self._deferred.tried = True
        self._news.set()

    def stopped(self) -> None:
        """The global stop changed."""
        stop = self.needs.switch.stop
        if stop.active:
            for signals in (self._signals, None if self._waiting is None else self._waiting.signals):
                if signals is not None:
                    signals.end(by=stop.by or LOOP, reason=f"global stop: {stop.reason}", stop=True)
        self._news.set()

    async def finished(self) -> None:
        """Return when the present diagnosis was looked at here, and no change is under way: a repair is about
        to act.
        """
        state = self.needs.robots.memory.states.get(self.robot)
        if state is None or not state.functions:
            return
        wanted, deadline = state.diagnosed.value, time.monotonic() + FINISHED_S
        self._rounds += 1
        self._looked, self._first = -1, True  # what was put off for a round before is decided anew
        self._news.set()
        try:
            while (self.acting or self._looked < wanted) and time.monotonic() < deadline:
                self._idle.clear()
                await wait_for(self._idle, SOON_S)
        finally:
            self._first = False

    async def run(self) -> None:
        """Keep the robot's configuration until it is lost, deleted, or the service ends."""
        try:
            while True:
                self._news.clear()
                try:
                    wait_s = await self._turn()
                except (NotFound, Fenced):
                    return
                except Exception as error:  # a fault of ours must not leave the robot as it is for ever
                    unforeseen = not isinstance(error, RobomendError)
                    log.warning(
                        "configuration is tried again",
                        robot=self.robot,
                        detail=str(error),
                        exc_info=unforeseen,
                    )
                    self._recalled, wait_s = False, RETRY_S  # what it cut off is taken up again
                self._idle.set()
                await wait_for(self._news, wait_s)
        finally:
            if self._waiting is not None:
                self._waiting.listener.cancel()

    # --- deciding

    async def _turn(self) -> float:
        """Decide, and do what is due; return in how many seconds to look again."""
        state = await self.needs.robots.memory.robot(self.robot)
        seen = state.diagnosed.value
        parts = state.system.parts
        if parts is None or not parts.functions:
            state.decided(None)
            if self._waiting is not None:
                await self._withdraw("the model has no such function any more")
            return IDLE_S
        if not self._recalled:
            await self._recall(state)
            self._recalled = True
        open_ = await self._look_at_cut_off(state)
        now_ns = CLOCK.now_ns()
        known = state.known(self.left_off())
        decision = self._keeper.decide(parts, state.system.conditions, known, now_ns, self._barred(state))
        if state.current is None:  # nobody knows yet what is good
            decision = decision._replace(changes=())
        if not any(change.fault for change in decision.changes):
            self._deferred = Deferred()
        due = tuple(change for change in decision.changes if change.function not in open_)
        state.decided(decision)
        await self._note_held(decision.states)
        wait_s = IDLE_S if decision.again_ns is None else max(AGAIN_S, (decision.again_ns - now_ns) / 1e9)
        if not self.needs.chooser.policy(state).may_begin(now_ns):
            wait_s = min(wait_s, MINUTE_S - time.time() % MINUTE_S)  # a window may open then
        first = self._first
        acted = None if first else self.acted_on()
        in_doubt = frozenset[str]() if acted is None else touched(parts, acted)
        if self._waiting is not None:
            due = await self._answered(state, self._waiting, due, in_doubt)
        apart = _apart(parts, due, in_doubt)
        if len(apart) < len(due) or open_:
            wait_s = min(wait_s, SOON_S)
        if apart:
            wait_s = min(wait_s, await self._do(state, parts, decision, apart, in_doubt, first))
        if wait_s > AGAIN_S:
            self._looked = seen
        return wait_s

    def _barred(self, state: Robot) -> Callable[[Function, str], str]:
        """Return what says why the acts of a variant may not be done now, or nothing; of those that may not
        no plan is made.
        """
        policy, stop = self.needs.chooser.policy(state), self.needs.switch.stop
        interlocked = state.interlocked()
        shut = not policy.may_begin(time.time_ns())

        def barred(function: Function, variant: str) -> str:
            if stop.active:
                return "the global stop is active"
            if policy.mode is Mode.OBSERVE:
                return "the robot is only observed"
            if function.adapt == Mode.OBSERVE:
                return f"`adapt` of {function.name} is 'observe'"
            if function.adapt is None and shut:
                return "no maintenance window is open"
            acts = (Step(0, name, args, 0.0, (), (), ()) for name, args in function.variants[variant].do)
            return policy.plan_refusal(acts, {}, ()) or interlocked or ""

        return barred

    async def _note_held(self, states: Mapping[str, FunctionState]) -> None:
        """Note with a change for the worse why it is not undone although that would do: once, as what is
        measured meanwhile changes with each reading.
        """
        for name, state in states.items():
            if state.waits is not None and self._held.get(name) != state.waits:
                (variant, why), function = state.waits, state.function
                await self.needs.store.write(
                    partial(is_held, fence=self.fence, function=function, target=variant, why=why),
                    robots=(self.robot,),
                )
                self._held[name] = state.waits

    # --- a person's yes

    async def _answered(
        self,
        state: Robot,
        waiting: WaitingChange,
        due: tuple[VariantChange, ...],
        in_doubt: frozenset[str],
    ) -> tuple[VariantChange, ...]:
        """Look what became of the change that waits for a yes; return what else is due."""
        signals, asked = waiting.signals, {(one.function, one.target) for one in waiting.changes}
        rest = tuple(one for one in due if (one.function, one.target) not in asked)
        if signals.halt.is_set():
            if not signals.stopped:
                self._failed(waiting.changes, f"declined by {signals.by}", HOUR_NS)
            await self._withdraw(signals.reason, by=signals.by)
            return ()
        if len(due) < len(rest) + len(asked):
            await self._withdraw("it is not due any more")
            return rest
        assert state.system.parts is not None
        apart = _apart(state.system.parts, waiting.changes, in_doubt, waiting.plan.steps)
        if not await signals.decided(0.0) or len(apart) < len(asked):
            return rest
        self._waiting = None
        by, answers = signals.by, signals.answers()
        await waiting.record.note(
            ChangeTrigger.PERMITTED, f"approved by {by}", by=by, answers=answers, approved=by
        )
        await self._act(state, waiting.record, waiting.changes, waiting.plan, signals)
        await _end(waiting.listener)
        return ()

    async def _withdraw(self, why: str, *, by: str = LOOP) -> None:
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            answers = waiting.signals.answers()
            await waiting.record.note(ChangeTrigger.OVERTAKEN, why, by=by, answers=answers)
            await _end(waiting.listener)

    def _failed(self, changes: Iterable[VariantChange], why: str, least_ns: int = RETRY_NS) -> None:
        for change in changes:
            self._keeper.failed(change.function, change.target, why, CLOCK.now_ns(), least_ns)

    # --- doing

    async def _do(
        self,
        state: Robot,
        parts: ComponentModel,
        decision: Decision,
        due: tuple[VariantChange, ...],
        in_doubt: frozenset[str],
        first: bool,
    ) -> float:
        """Plan what is due and do it; return in how many seconds to look again at the latest."""
        plan, due = await self._planned(state, parts, decision, due)
        if plan is None:
            return AGAIN_S
        policy = self.needs.chooser.policy(state)
        refusal = policy.plan_refusal(plan.steps, {}, ())
        if refusal is not None:
            await self._not_done(state, due, refusal)
            return AGAIN_S
        if len(_apart(parts, due, in_doubt, plan.steps)) < len(due):
            return SOON_S
        wait_s = await self._repair_is_cheaper(state, due, plan, first)
        if wait_s > 0:
            return wait_s
        asks = _mode(policy, [parts.functions[one.function] for one in due], plan.steps) is Mode.APPROVE
        if asks and self._waiting is not None:
            return IDLE_S
        record = await begin(self.needs.store, self.fence, state, due, plan, asks=asks)
        if record is None:
            return RETRY_S
        signals = Signals(lambda: self.needs.switch.active)
        listener = asyncio.create_task(self._listen(record.id, signals))
        if asks:
            signals.ask()
            self._waiting = WaitingChange(record, due, plan, signals, listener)
            return IDLE_S
        try:
            await self._act(state, record, due, plan, signals)
        finally:
            await _end(listener)
        return AGAIN_S

    async def _listen(self, change: str, signals: Signals) -> None:
        """Hand a person's word to a change, and wake whoever looks at it."""
        handing = asyncio.create_task(self._requests.listen(change, signals))
        try:
            await signals.decided()
            self._news.set()
            await signals.halt.wait()
            self._news.set()
        finally:
            handing.cancel()

    async def _planned(
        self, state: Robot, parts: ComponentModel, decision: Decision, due: tuple[VariantChange, ...]
    ) -> tuple[Plan | None, tuple[VariantChange, ...]]:
        """Return a plan, and the changes that it makes: all, or the first that can be made by itself."""
        config, policy = state.config, self.needs.chooser.policy(state)
        names = await self.needs.chooser.actions(state)
        options = PlanOptions(
            timeout_s=None,
            domain=config.domain,
            expected_stopped=state.expected_stopped,
            protected=protected_of(config, parts),
            forbidden=tuple((name, why) for name in names if (why := policy.forbids(name)) is not None),
            offers=await offers_now(state, parts, (*names, *parts.acts), self.needs.store),
        )
        bad = sorted(frozenset().union(*state.known().diagnoses[:1]))
        literals = state.sight.literals()
        reason = ""
        for some in (due, *((one,) for one in due if len(due) > 1)):
            try:
                plan = await asyncio.to_thread(
                    change_plan, parts, literals, bad, decision.states, some, options, Work(AT_ONCE)
                )
            except OutOfWork:
                reason = "no plan was found in time"
                continue
            nobody = None if options.offers is None else _nobody(plan, options.offers.why_nobody)
            if plan.outcome is Outcome.SOLVED and plan.steps and nobody is None:
                return plan, some
            reason = nobody or "; ".join(plan.unreachable) or "no act makes it active"
        await self._not_done(state, due, reason)
        return None, due

    async def _not_done(self, state: Robot, due: tuple[VariantChange, ...], reason: str) -> None:
        """Note what cannot be done: the next variant is taken, and this one is tried again later. Nothing was
        sent, so that there is one record of it for as long as the reason stays the same.
        """
        news = any(self._keeper.failed_by(one.function, one.target) != reason for one in due)
        self._failed(due, reason)
        record = await begin(self.needs.store, self.fence, state, due) if news else None
        if record is not None:
            await record.note(ChangeTrigger.WENT_WRONG, reason)

    async def _repair_is_cheaper(
        self, state: Robot, due: Sequence[VariantChange], plan: Plan, first: bool
    ) -> float:
        """Return how long to wait for a repair that makes the robot useful sooner than the change; 0: none
        does.

        Args:
            first: a repair waited with its acts when it was looked what is due; it may have begun since.
        """
        if not all(change.fault for change in due) or self._deferred.tried:
            return 0.0
        if self.acted_on() is not None and not first:  # none is begun before the one that acts is done
            return 0.0
        policy = self.needs.chooser.policy(state)
        if policy.mode is not Mode.AUTO or not policy.may_begin(time.time_ns()):
            return 0.0
        if self._deferred.until_s:
            in_vain = self._rounds > self._deferred.round
            return 0.0 if in_vain else max(0.0, min(SOON_S, self._deferred.until_s - time.monotonic()))
        result = await self.needs.robots.diagnosing.of(state, state.sight.vouched())
        choice = await self.needs.chooser.choose_in_turn(state, result, looks=False)
        if choice.plan is None or choice.yes or policy.mode_for(choice.plan.steps) is not Mode.AUTO:
            return 0.0
        helps = max((one.helps for one in choice.alternatives if one.plan is choice.plan), default=0.0)
        if helps <= 0 or choice.plan.cost / helps > plan.cost:
            return 0.0
        self._deferred.until_s = time.monotonic() + 2 * choice.plan.cost + DEFER_S
        self._deferred.round = self._rounds + (0 if first else 1)
        return SOON_S

    async def _act(
        self,
        state: Robot,
        record: ChangeRecord,
        changes: tuple[VariantChange, ...],
        plan: Plan,
        signals: Signals,
    ) -> None:
        """Carry a plan out, and note what came of it."""
        self.acting, self._signals = True, signals
        names = {arg for step in plan.steps for arg in step.parameters}
        state.is_changed(names.intersection(state.system.cnf.components))
        try:
            execution = await execute(plan, await self._setting(state, record, plan, signals))
            await self._note(state, record, changes, execution, signals)
        except StoreError:
            raise  # it stays open, and is taken up again
        except RobomendError as error:
            await self._went_wrong(record, changes, str(error), changes)
        finally:
            self.acting, self._signals = False, None
            state.is_changed(())
            self._idle.set()

    async def _setting(self, state: Robot, record: ChangeRecord, plan: Plan, signals: Signals) -> Setting:
        executors = await self.needs.executors(state, signals.halt, self.fence)
        acts = await Acts.of(self.needs.store, state, record)
        policy = partial(self.needs.chooser.policy, state)

        async def permit(step: Step) -> str | None:
            return policy().refusal(step, {}, ()) or await acts.interlocked()

        async def report(report: StepReport) -> None:
            await record.report(report, 0)

        def answers_s(step: Step) -> float:
            said_s = state.sight.declared.takes_s(step.name, step.parameters)
            return OWN_S if said_s is None else said_s

        return Setting(
            repair=record.id,
            first_step=0,
            sight=state.sight,
            prediction=Prediction(theory_of(state.system.cnf), (), ()),
            executors=executors,
            journal=acts,
            permit=permit,
            halt=signals.halt,
            interlocked=state.interlocked,
            again=acts.again,
            observed=state.sight.observed,
            timing=timings(state.config.actions, ()),
            answers_s=answers_s,
            confirm=partial(self.needs.store.ownership.confirm, self.fence),
            report=report,
        )

    async def _note(
        self,
        state: Robot,
        record: ChangeRecord,
        changes: tuple[VariantChange, ...],
        execution: Execution,
        signals: Signals,
    ) -> None:
        if execution.ending is Ending.HALTED:
            by, why = signals.by or LOOP, signals.reason or execution.reason
            if not signals.stopped:
                self._failed(changes, f"cancelled by {by}", HOUR_NS)
            await record.note(ChangeTrigger.OVERTAKEN, why, by=by, answers=signals.answers())
            return
        missing, reason = _not_seen(state, changes), execution.reason
        if missing and execution.ending is Ending.DONE:
            reason = f"{', '.join(str(_shown(one)) for one in missing)} was not seen"
        await self._conclude(
            state, record, changes, missing, reason, _to_blame(missing, execution, state.functions)
        )

    async def _conclude(
        self,
        state: Robot,
        record: ChangeRecord,
        changes: tuple[VariantChange, ...],
        missing: tuple[VariantChange, ...],
        reason: str,
        to_blame: Sequence[VariantChange],
    ) -> None:
        """Note which changes of a record were made; `reason`: why some, `missing`, were not."""
        if missing:
            await self._went_wrong(record, missing, reason, to_blame)
            changes = tuple(one for one in changes if one not in missing)
            done = await begin(self.needs.store, self.fence, state, changes) if changes else None
            if done is None:
                return
            record = done
        now_ns, known_ns = CLOCK.now_ns(), time.time_ns()
        for change in changes:
            self._keeper.changed(Made(now_ns, change.function, change.source, change.target, change.fault))
            self._held.pop(change.function, None)

        def also(tx: Transaction) -> None:
            for one in changes:
                if one.better:
                    came_back(tx, self.fence, state.functions[one.function], one.target, known_ns)

        reason = str(record.data.get("reason") or "")
        await record.note(ChangeTrigger.SEEN, reason, also=also, changed_ns=known_ns)

    async def _went_wrong(
        self,
        record: ChangeRecord,
        changes: Sequence[VariantChange],
        reason: str,
        to_blame: Sequence[VariantChange],
    ) -> None:
        """Note that some changes of a record were not made; those to blame are not tried again soon."""
        self._failed(to_blame, reason)
        names = {change.function for change in changes}
        told = [one for one in record.data["changes"] if one["function"] in names]
        await record.note(ChangeTrigger.WENT_WRONG, reason, changes=told)

    # --- after a restart

    async def _recall(self, state: Robot) -> None:
        """Take up what a crash or an error cut off, and remember what was changed within the hour."""
        since_ns = time.time_ns() - HOUR_NS
        known = {one.record.id for one in (self._waiting, *self._cut_off) if one is not None}
        paging = Paging(limit=RECALLED)
        found = await self.needs.store.read(repairs.page, self.robot, paging, changes=True)
        self._keeper.made.clear()
        for stored in reversed(found.items):
            at_ns = stored.data.get("changed_ns") or 0
            for one in changes_of(stored) if at_ns >= since_ns else ():
                self._keeper.made.append(Made(at_ns, one.function, one.source, one.target, one.fault))
            if stored.open and stored.id not in known:
                await self._take_up(state, stored)

    async def _take_up(self, state: Robot, stored: StoredRepair) -> None:
        """Settle the journal of a change that a crash cut off; what nobody has begun is taken back."""
        record = ChangeRecord(self.needs.store, stored, self.fence)
        if record.state is ChangeState.AWAITING_APPROVAL:
            await record.note(ChangeTrigger.OVERTAKEN, CUT_OFF)
            return
        intents = await self.needs.store.read(journal.unsettled, self.robot)
        fates = [(one.id, *await self._fate(one.id)) for one in intents if one.repair == stored.id]

        def settle(tx: Transaction) -> tuple[StepRecord, ...]:
            for action, code, message in fates:
                journal.settle(tx, action, code, message, fence=self.fence)
            return repairs.steps(tx, stored.id)

        steps = await self.needs.store.write(settle, robots=(self.robot,))
        functions = state.functions
        changes = tuple(
            change
            for change in changes_of(stored)
            if change.function in functions
            and {change.source, change.target} <= functions[change.function].variants.keys()
        )
        if not changes:
            await record.note(ChangeTrigger.WENT_WRONG, CUT_OFF)
            return
        wait_s = 0.0
        if all(code == OK or code in MAY_HAVE_ACTED for _, code, _ in fates):
            bounds = timings(state.config.actions, ())
            sent = [bounds.get(one.data["name"], Timing()) for one in steps if one.data.get("sent_ns")]
            wait_s = sum(one.action_timeout_s + one.effect_timeout_s for one in sent[-1:])
        self._cut_off.append(CutOff(record, changes, time.monotonic() + wait_s))

    async def _fate(self, action: str) -> tuple[int, str]:
        """Return what is known of an action whose outcome was not written."""
        with contextlib.suppress(NotFound):  # no agent's
            found = await self.needs.agents.withdraw(action, CUT_OFF)
            if found.code is not None:
                return found.code, found.message
        return TIMED_OUT, "it was cut off; whether it acted is for OBS to say"

    async def _look_at_cut_off(self, state: Robot) -> frozenset[str]:
        """Close what was cut off, once it is known whether it was made; return the functions of the rest."""
        for one in tuple(self._cut_off):
            missing = _not_seen(state, one.changes)
            if not missing or time.monotonic() >= one.until_s:
                self._cut_off.remove(one)
                await self._conclude(state, one.record, one.changes, missing, CUT_OFF, ())
        return frozenset(change.function for one in self._cut_off for change in one.changes)


def _apart(
    parts: ComponentModel, due: Sequence[VariantChange], in_doubt: frozenset[str], steps: Iterable[Step] = ()
) -> tuple[VariantChange, ...]:
    """Return the changes that have nothing to do with what a repair acts on at present, by any way of the
    model's arrows: what is seen of that, `in_doubt`, is its doing.

    Args:
        steps: the plan of the changes, where there is one.
    """
    planned = {name for step in steps for name in step.parameters}
    apart: dict[str, VariantChange] = {}
    for one in due:
        variants = [parts.functions[one.function].variants[name] for name in (one.source, one.target)]
        rests_on = frozenset[str]().union(*(all_of(variant, parts) for variant in variants))
        # Not what a supply feeds besides: that has nothing to do with the variant.
        shown = planned.union(rests_on & parts.nodes.keys(), *(variant.needs for variant in variants))
        needs = {need.function for variant in variants for need in needs_of(variant, parts)}
        waiting = {other.function for other in due} - apart.keys()
        if in_doubt.isdisjoint(rests_on | put_out(parts, shown)) and needs.isdisjoint(waiting):
            apart[one.function] = one
    return tuple(apart.values())


def _mode(policy: Policy, functions: Sequence[Function], steps: Sequence[Step]) -> Mode:
    """Return the strictest of what the functions say, or else the robot's policy, and of what it says of
    single acts.
    """
    own = [policy.mode if function.adapt is None else Mode(function.adapt) for function in functions]
    said = [policy.actions[step.name] for step in steps if step.name in policy.actions]
    return min([*own, *said], key=list(Mode).index)


def _shown(change: VariantChange) -> Atom:
    """Return what shows that a change was made."""
    return Atom(ACTIVE, (change.function, change.target))


def _not_seen(state: Robot, changes: Iterable[VariantChange]) -> tuple[VariantChange, ...]:
    now_ns = CLOCK.now_ns()
    return tuple(one for one in changes if not state.obs.known(_shown(one), now_ns))


def _to_blame(
    changes: Sequence[VariantChange], execution: Execution, functions: Mapping[str, Function]
) -> Sequence[VariantChange]:
    """Return the changes of which an act went wrong; all of them, if none of their own did."""
    wrong = {(one.step.name, one.step.parameters) for one in execution.steps if one.state is StepState.FAILED}
    own = [one for one in changes if not wrong.isdisjoint(functions[one.function].variants[one.target].do)]
    return own or changes


def _nobody(plan: Plan, why_nobody: Callable[[str, Sequence[str]], str | None]) -> str | None:
    """Return why a step of a plan would find nobody, or None."""
    found = ((step, why_nobody(step.name, step.parameters)) for step in plan.steps)
    return next((f"{step}: {why}" for step, why in found if why is not None), None)


async def _end(task: asyncio.Task[None]) -> None:
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
