"""One repair of one robot: what the loop (robomend.cycle) asks for, answered by the service around it.

Everything that must outlive a crash goes through its record into the store before the loop goes on. A repair
itself keeps nothing: after a crash a new one is made from the store and fresh OBS.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial

from robomend.cycle import stands_no_more
from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.model.components import Criticality
from robomend.planning.advice import other_suspects
from robomend.planning.choice import Choice
from robomend.planning.influence import published
from robomend.planning.plan import Outcome, Plan, Step
from robomend.planning.policy import NODE_ACTIONS, POWER_ACTIONS
from robomend.planning.prediction import Prediction, theory_of
from robomend.repairs.acts import Acts
from robomend.repairs.calm import Calm, bad_sets
from robomend.repairs.choosing import Chooser
from robomend.repairs.conclusions import NAMED, Silent, named
from robomend.repairs.confirming import Confirming
from robomend.repairs.execution import execute
from robomend.repairs.execution_values import OWN_S, Ending, Execution, Setting, StepReport, Timing, timings
from robomend.repairs.foresight import doubts
from robomend.repairs.hearing import LOOK_S, Hearing
from robomend.repairs.left_off import returning
from robomend.repairs.permission import Permission
from robomend.repairs.record import RepairRecord
from robomend.repairs.remembering import by_evidence, kept_of, set_aside, spent
from robomend.repairs.signals import Halted, Signals
from robomend.repairs.states import RepairState, RepairTrigger
from robomend.robots.clock import CLOCK
from robomend.robots.health import health_of
from robomend.robots.robot import Robot
from robomend.robots.robots import Robots
from robomend.store import Store
from robomend_client.actions import Executor
from robomend_client.literals import Atom, Literal
from robomend_client.readings import Symptom

NEWS_S = 0.05
"""How often repeated news, which wakes nobody, are looked at."""

BETWEEN_ROUNDS = frozenset({RepairState.WAITING, RepairState.PLANNING, RepairState.VERIFYING})


MOST_ANEW = 5
"""Of choosing in one round, as what was chosen for has changed meanwhile."""

SOON_S = 0.05
"""How often a diagnosis that is not published yet is looked for."""

PUBLISHED_S = 10.0
"""For the diagnosis of what is known already to be on the disk, and that of the robot."""


class LiveRepair:
    """See the module; implements robomend.cycle.Repair."""

    def __init__(
        self,
        store: Store,
        robots: Robots,
        chooser: Chooser,
        state: Robot,
        record: RepairRecord,
        executors: Mapping[str, Executor],
        signals: Signals,
        heard_since: int | None,
        acts: Acts,
        before_acts: Callable[[], Awaitable[None]],
    ) -> None:
        """
        Args:
            heard_since: after a crash, the revision of OBS up to which observations do not count.
            before_acts: awaited before a plan is begun: a change of configuration may come first.
        """
        self._before_acts = before_acts
        self._robots = robots
        self._chooser = chooser
        self._state = state
        self._record = record
        self._executors = executors
        self._acts = acts
        self._signals = signals
        self._confirm = partial(store.ownership.confirm, record.fence)
        self._hearing = Hearing(store, robots, state, record, signals, heard_since)
        about = (state, record, signals, self._hearing.observed, self._newest)
        self._confirming = Confirming(*about, self._shows_s, self._start_up_s)
        self._calm = Calm(*about, partial(robots.diagnosing.of, state), self._would_choose, self._start_up_s)
        # A crash does not give a repair new rounds, but it may always finish.
        acts.influences = self._confirming.acted
        self.rounds = max(1, chooser.policy(state).limits.rounds - len(record.data.get("rounds", ())))
        self._permission = Permission(state, record, signals, chooser, acts, self._newest)
        self._other_suspects: frozenset[str] = frozenset()  # those that the present plan leaves alone
        self._taken_as_bad: frozenset[str] = frozenset()  # by the present plan; OBS may clear it
        self._anew_ns = 0  # what was tried before that may help now
        self._first = 0  # number of the present round's first step within the repair

    def _shows_s(self, *actions: str) -> float:
        """Return how long the effect of one of these actions, if it is the robot's, may take to show."""
        bounds = timings(self._state.config.actions, ())
        known = [bounds.get(one, Timing()).effect_timeout_s for one in actions if one in self._executors]
        return max(known, default=Timing().effect_timeout_s)

    def _answers_s(self, step: Step) -> float:
        """Return how long an action may take until its answer, where the robot's configuration does not say:
        by who carries it out, and by how long what it starts needs.
        """
        if (self._state.config.actions.get(step.name) or {}).get("timeout_s") is not None:
            return 0.0
        state, parts = self._state, self._state.system.parts
        said_s = state.sight.declared.takes_s(step.name, step.parameters)
        own = step.name not in POWER_ACTIONS | NODE_ACTIONS
        needs_s = 0.0
        if step.name == "start_node" and parts is not None:
            needs_s = state.sight.start_ups.needs_s(step.parameters[0], parts)
        return max(needs_s, (OWN_S if own else 0.0) if said_s is None else said_s)

    def _start_up_s(self, component: str) -> float:
        """Return how long a component that is on, or runs, may need until what rests on it shows that."""
        parts = self._state.system.parts
        if parts is None:
            return self._shows_s(*self._executors)
        needs_s = self._state.sight.start_ups.needs_s(component, parts)
        if component in parts.nodes:
            return max(self._shows_s("start_node"), needs_s)
        if component in parts.hardware:  # its driver may have to be started after it
            return max(self._shows_s("power_up", "start_node"), needs_s)
        return self._shows_s(*self._executors)

    # --- diagnose

    async def diagnose(self) -> DiagnosisResult:
        """Return the diagnosis of OBS now, after every configured observer was heard."""
        if await self._hearing.hear_all(explained=True):
            await self._record.update(RepairTrigger.HEARD, waiting_for=[])
        result = await self._newest()
        if result.healthy and await self._hearing.hear_all():
            await self._record.update(RepairTrigger.HEARD, waiting_for=[])
            result = await self._newest()
        result = await self._verified(result)
        for _ in range(MOST_ANEW):
            if result.healthy:
                break
            settled = await self._calm.settled(result)
            if not settled.healthy:
                result = settled
                break
            result = await self._verified(settled)  # what it finds is young, too
        wanted = self._record.data.get("wanted")
        if wanted and not result.healthy and not self._record.data.get("rounds"):
            named = tuple(d for d in result.diagnoses if set(d.bad) == set(wanted))
            if named:
                return replace(result, diagnoses=named, elapsed_s=0.0)
        return result

    async def _newest(self) -> DiagnosisResult:
        """Return the diagnosis of OBS as it is now; the fault, if there is none, is raised."""
        result = await self._signals.unless_halted(self._robots.waiting.result(self._state))
        sight = self._state.sight
        vouched = frozenset(sight.vouched())
        # What is on its way to the disk is known already: on a slow one an act might come too late for it.
        known = not self._state.writing and not sight.not_confirmed()
        if known and len(vouched) == len(self._state.literals()):
            return result
        confirmed = self._robots.diagnosing.of(self._state, vouched)
        return await self._signals.unless_halted(confirmed)

    async def _verified(self, result: DiagnosisResult) -> DiagnosisResult:
        """Return a diagnosis that is not healthy, or one that is, and of what is known of the robot now.

        What lapsed a moment ago may only be late: it is waited for, for one more of its lifetimes. So is a
        circle of topics that may be about to begin. Whoever ends the repair looks once more
        (robomend.robots.health).

        Raises:
            Silent: nobody could confirm what acts made uncertain.
        """
        told, deadline = False, time.monotonic() + PUBLISHED_S
        while result.healthy:
            result = await self._confirming.confirmed(result)
            how, unknown = health_of(self._state)
            late_s = max(self._state.sight.may_be_late_s(unknown), self._circle_begins_s())
            asked = self._record.data.get("asked") and not self._record.data.get("rounds")
            behind = how.faulty or bool(self._state.not_judged())
            behind = behind and time.monotonic() < deadline
            if not result.healthy or (not behind and (late_s <= 0 or asked)):
                return result
            if not told and late_s > 1.0:
                told, names = True, [str(atom) for atom in unknown]
                await self._record.update(RepairTrigger.UNHEARD, reason="for observers", waiting_for=names)
            look_s = SOON_S if behind else min(max(0.01, late_s), LOOK_S)
            await self._signals.unless_halted(self._state.changed(self._state.revision, look_s))
            result = await self._newest()
        return result

    def _circle_begins_s(self) -> float:
        """Return how long topics that wait for each other may need until one is seen, by what rose last."""
        waiting, sight = self._state.wait_for_themselves(), self._state.sight
        if not waiting:
            return 0.0
        rose_ns = max((sight.rose_ns(one.atom) or 0 for one in sight.entries() if one.positive), default=0)
        settling_ns = max(sight.delays(atom).settling_ns for atom in waiting)
        return max(0.0, (rose_ns + settling_ns + sight.on_its_way_ns() - CLOCK.now_ns()) / 1e9)

    # --- choose

    async def choose(self, result: DiagnosisResult) -> Choice | None:
        """Plan for the leading diagnoses; wait for a probe's outcome where looking first is cheaper.

        None: not all of what is planned for is blamed any more; on a busy computer planning takes a while.
        """
        found = await self._planned(result, looks=True)
        for _ in range(MOST_ANEW):
            if not await self._too_early(found, result):
                break
            result = await self.diagnose()
            if result.healthy:
                return None
            found = await self._planned(result, looks=True)
        if found.probe is not None:
            await self._hearing.look_at(found.probe.atom, found.reason)
            result = await self._newest()
            found = await self._planned(result, looks=False)
        if found.plan is None and (early := self._started_early()):
            since_ns, self._anew_ns = self._anew_ns, time.time_ns()
            again = await self._planned(result, looks=False)
            steps = () if again.plan is None else again.plan.steps
            if any(step.name == "start_node" and step.parameters[0] in early for step in steps):
                found = again
            else:
                self._anew_ns = since_ns
        if found.came_back:
            await self._record.set_aside(set_aside(self._state.id, found.came_back, time.time_ns()))
        if found.plan is not None and found.diagnosis is not None:
            blamed = {name for diagnosis in (await self._newest()).diagnoses for name in diagnosis.bad}
            if not blamed.issuperset(found.diagnosis.bad):
                return None
            found = self._permission.at_once(found)
            assert found.plan is not None
            assert found.diagnosis is not None
            self._other_suspects = other_suspects(found.diagnosis.bad, result)
            self._taken_as_bad = by_evidence(found.plan, found.diagnosis.bad)
            entries = self._state.sight.entries()
            self._confirming.begins(entries)
            self._doubt()
            self._first = await self._record.begin_round(found, result, entries, self._state.system.parts)
        else:
            self._record.not_mended(found, result, self._state.sight.entries())
        return found

    def _started_early(self) -> frozenset[str]:
        """Return the drivers that may have been started while their devices still booted: what was tried says
        nothing of them, and no person is called before they were started once more.
        """
        parts, sight = self._state.system.parts, self._state.sight
        if parts is None:
            return frozenset()
        heard = {
            atom.args[-1] for atom, kind in sight.kinds_of_symptoms().items() if kind is not Symptom.SILENT
        }
        mute = (name for name, node in parts.nodes.items() if heard.isdisjoint(node.publishes))
        return frozenset(name for name in mute if sight.start_ups.started_early(name, parts, sight))

    async def _too_early(self, choice: Choice, result: DiagnosisResult) -> bool:
        """Whether to choose anew: it was waited before a cut of power, or nothing can be done for what is not
        so any more. To give up is an act, too.
        """
        if choice.plan is not None or self._record.data.get("wanted"):
            return await self._calm.waits_with_cut(choice, result)
        return bad_sets(await self._newest()) != bad_sets(result)

    async def _would_choose(self, result: DiagnosisResult, literals: Iterable[Literal]) -> Choice:
        return await self._signals.unless_halted(
            self._chooser.choose_in_turn(
                self._state,
                result,
                looks=False,
                literals=literals,
                since_ns=self._record.tries_anew_from_ns,
            )
        )

    async def _planned(self, result: DiagnosisResult, *, looks: bool) -> Choice:
        return await self._signals.unless_halted(
            self._chooser.choose_in_turn(
                self._state,
                result,
                looks=looks,
                avoided=self._acts.exhausted(),
                left_off=self._acts.left_off(),
                since_ns=max(self._anew_ns, self._record.tries_anew_from_ns),
                lingering=self._acts.lingering,
            )
        )

    # --- approve

    async def approved(self, choice: Choice) -> bool:
        """Ask the policy, and a person where it says so; a yes counts while the plan's diagnosis stands."""
        if not await self._permission.approved(choice):
            return False
        await self._signals.unless_halted(self._before_acts())
        return not self._signals.halt.is_set()

    # --- act

    def setting(self, plan: Plan) -> Setting:
        """Return what the execution of this plan needs."""
        _, system, _ = self._state.question()
        once = self._chooser.not_idempotent(self._state, self._executors)

        async def report(report: StepReport) -> None:
            self._doubt()
            await self._record.report(report, self._first)

        return Setting(
            repair=self._record.id,
            first_step=self._first,
            sight=self._state.sight,
            prediction=Prediction(
                theory_of(system.cnf),
                [name for name in system.cnf.components if name not in self._other_suspects],
                plan.initial,
                self._state.sight.from_outside,
            ),
            executors=self._executors,
            journal=self._acts,
            permit=self._permission.refusal,
            halt=self._signals.halt,
            interlocked=self._state.interlocked,
            again=self._acts.again,
            observed=self._hearing.observed,
            timing=timings(self._state.config.actions, once),
            not_idempotent=once,
            answers_s=self._answers_s,
            confirm=self._confirm,
            report=report,
            later=self._later,
            well=self._well,
            moot=self._moot,
        )

    def _doubt(self) -> None:
        """Note which arrows of the model what is known now contradicts: when all is well, nothing does."""
        self._record.doubt(doubts(self._state.system.parts, self._state.sight.entries()))

    def _later(self, step: Step) -> int:
        """Return how little the robot needs what a step acts on: an agent does one act after the other."""
        parts = self._state.system.parts
        mended = (e.atom.args[0] for e in step.effects if e.positive and e.atom.predicate == "good")
        names = {*step.parameters, *mended}
        known = [part.criticality for name, part in parts.parts.items() if name in names] if parts else []
        return min(map(list(Criticality).index, known), default=len(Criticality))

    async def _well(self, step: Step) -> str | None:
        """Return by what evidence the bad that a step acts on is good now: all that it publishes and that is
        observed is, and no diagnosis blames it any more.

        What an act of this plan may have changed is waited for, as long as its observers need to say it anew.
        """
        parts = self._state.system.parts
        bad = {p.atom.args[0] for p in step.preconditions if p.positive and p.atom.predicate == "bad"}
        if step.name == "power_up" and step.parameters[0] not in self._acts.left_off():
            await self._look_at_power(step)
        if parts is None or not bad or not bad <= self._taken_as_bad:
            return None
        topics = [Atom("ok", (topic,)) for topic in sorted(published(parts, bad))]
        seen = [atom for atom in topics if atom in self._hearing.observed or self._state.sight.reported(atom)]
        sight = self._state.sight
        most_s = min(max(map(sight.settling_s, seen), default=0.0), Timing().effect_timeout_s)
        deadline = time.monotonic() + most_s
        while None in (values := [sight.value(atom) for atom in seen]) and False not in values:
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                return None
            await self._state.changed(self._state.revision, min(left_s, NEWS_S))
        if not seen or not all(values):
            return None
        try:
            if not stands_no_more(tuple(bad), await self._newest()):
                return None
        except Halted:  # which ends the execution itself
            return None
        return f"{', '.join(map(str, seen[:NAMED]))} by now: {', '.join(sorted(bad))} is not touched"

    async def _moot(self) -> str | None:
        """Return why nothing of the plan is to be done: what it was made for still fails, and by what is
        known since, something else is to blame. A busy computer takes a second from a choice to its first
        act, and slower observers speak meanwhile.
        """
        parts, bad = self._state.system.parts, self._taken_as_bad
        if parts is None or not bad or self._record.data.get("wanted"):
            return None
        sight = self._state.sight
        topics = [Atom("ok", (topic,)) for topic in sorted(published(parts, bad))]
        values = [sight.value(atom) for atom in topics if sight.reported(atom)]
        if None in values or False not in values:  # nothing is known of it, or it is well
            return None
        result = await self._newest()
        if not result.diagnoses or not stands_no_more(tuple(bad), result):
            return None
        blamed = " or ".join(named(each.bad) for each in result.diagnoses[:NAMED])
        return f"{blamed} is blamed by now, and not {named(sorted(bad))}"

    async def _look_at_power(self, step: Step) -> None:
        """Before power is switched on: it may be on again, and the board is about to say so."""
        board, on, sight = self._state.config.board, Atom("on", step.parameters), self._state.sight
        began_ns = CLOCK.now_ns()
        deadline = time.monotonic() + min(1.2 / board.rate_hz if board else 0.0, Timing().hold_s)
        while sight.value(on) is False and sight.repeated_ns <= began_ns:
            if (left_s := deadline - time.monotonic()) <= 0:
                return
            await self._state.changed(self._state.revision, min(left_s, NEWS_S))

    # --- give up

    async def bring_back(self) -> None:
        """Switch on and start again what this repair took away, before it gives up: as a round of its own, of
        which nothing is expected but that.
        """
        left, parts = self._acts.left_off(), self._state.system.parts
        steps = () if parts is None else returning(parts, left)
        if not steps or self._record.state not in BETWEEN_ROUNDS or self._signals.halt.is_set():
            return
        initial = frozenset(p.atom for step in steps for p in step.preconditions)
        plan = Plan(Outcome.SOLVED, steps, float(len(steps)), "none", initial, (), (), (), 0.0)
        why = "what was stopped or switched off for the repair is brought back before it gives up"
        choice = Choice(Diagnosis(tuple(left)), plan, None, (), plan.cost, why)
        nothing = DiagnosisResult(self._state.system.cnf.components, (), True, None, (), 0.0)
        first = await self._record.begin_round(
            choice, nothing, self._state.sight.entries(), self._state.system.parts
        )
        await self._record.update(RepairTrigger.PERMITTED)
        ends: list[Execution] = []
        for step in steps:  # each whatever comes of the others
            self._first = first + step.index
            alone = replace(plan, steps=(replace(step, index=0),))
            ends.append(await execute(alone, self.setting(alone)))
        last = next((one for one in ends if one.ending is not Ending.DONE), ends[-1])
        await self._record.end_round(str(last.ending), last.reason, helped=last.ending is Ending.DONE)

    # --- look, remember

    async def look(self, choice: Choice, execution: Execution) -> DiagnosisResult:
        """Return the diagnosis of what came after: at once when it is clear, else when OBS had its time."""
        assert choice.diagnosis is not None
        done, missing = execution.ending is Ending.DONE, execution.ending is Ending.EFFECT_MISSING
        acted = [report.step.name for report in execution.steps if report.sent_ns is not None]
        if missing:
            await self._hear_the_missing(execution)
        # That it was in vain may be told before all is: of the rest the next round waits for what matters.
        if not missing or stands_no_more(choice.diagnosis.bad, await self._newest()):
            await self._confirming.seen()
        had_their_time = dict.fromkeys((Ending.EFFECT_MISSING, Ending.MISMATCH, Ending.ACTION_FAILED), 0.0)
        waits = {Ending.DONE: self._shows_s(*acted), **had_their_time}
        waits_s = waits.get(execution.ending, Timing().hold_s)
        deadline = time.monotonic() + max(waits_s, self._found_again_s(execution))
        while True:
            revision = self._state.revision
            result = await self._newest()
            if result.healthy and await self._hearing.unheard():
                # Nothing is known to be wrong because nothing is known: an observer fell silent meanwhile.
                await self._hearing.hear_all()
                result = await self._newest()
            if result.healthy:
                result = await self._verified(result)
            helped = stands_no_more(choice.diagnosis.bad, result)
            if helped and (result.healthy or done):
                result = await self._confirming.stays(choice.diagnosis.bad, result)
                helped = stands_no_more(choice.diagnosis.bad, result)
            if result.healthy or (done and helped) or time.monotonic() >= deadline:
                return result
            await self._signals.unless_halted(self._state.changed(revision, LOOK_S))

    def _found_again_s(self, execution: Execution) -> float:
        """Return how long drivers that nobody restarts may still wait for what was switched on."""
        parts, sight = self._state.system.parts, self._state.sight
        ups = (one.step for one in execution.steps if one.sent_ns and one.step.name == "power_up")
        devices = {name for step in ups for name in step.parameters}
        if parts is None or not devices:
            return 0.0
        return (sight.start_ups.found_again_ns(devices, parts, sight) - CLOCK.now_ns()) / 1e9

    async def _hear_the_missing(self, execution: Execution) -> None:
        """An effect that nobody could tell us of says nothing of the robot: Silent, unless they speak."""
        missing = [literal.atom for report in execution.steps for literal in report.missing]
        silent = await self._hearing.still_silent(missing, self._acts.settled)
        if silent:
            why = (
                f"{execution.reason}, and nobody reported {', '.join(map(str, silent))} "
                "since: look whether the observers still work"
            )
            await self._record.end_round(str(Ending.STALE), why, helped=False)
            raise Silent(why)

    async def remember(self, choice: Choice, execution: Execution, *, helped: bool) -> None:
        """Keep the attempt; components whose repairs keep failing go into quarantine.

        A start that found its process there was none: it is stopped first, by the next plan. Nor was a round
        that did nothing, as the robot was not as it was planned for any more.
        """
        ending, entries = (str(execution.ending), execution.reason), self._state.sight.entries()
        self._doubt()
        nothing = not any(report.sent_ns for report in execution.steps) and not execution.kept
        overtaken = nothing and execution.ending is Ending.MISMATCH
        if (overtaken or self._acts.found_there(execution.steps)) and not helped:
            await self._record.end_round(*ending, helped=False, entries=entries)
            return
        assert choice.diagnosis is not None
        by_itself = self._confirming.by_itself(choice.diagnosis.bad) if helped else None
        undid = self._confirming.undid() if helped and by_itself is None else []
        if not helped:
            self._acts.in_vain(spent(self._state, choice, execution))
        memory = await self._chooser.remembered(self._state)
        tried, left_alone = kept_of(
            self._state,
            self._record.id,
            choice,
            execution,
            memory,
            helped=helped,
            by_itself=by_itself,
            undid=undid,
            symptoms=self._confirming.symptoms,
        )
        await self._record.end_round(
            *ending,
            helped=tried.helped,
            by_itself=by_itself,
            undid=undid,
            tried=tried,
            quarantined=left_alone,
            entries=entries,
        )
