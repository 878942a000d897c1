"""What a repair may do: the robot's policy, its limits, and a person where the policy asks for one."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace

from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.planning.choice import Choice
from robomend.planning.plan import Plan, Step
from robomend.planning.policy import NODE_ACTIONS, Mode, Policy
from robomend.planning.tried import repaired_by
from robomend.repairs.acts import Acts
from robomend.repairs.choosing import Chooser
from robomend.repairs.conclusions import NotPermitted, Overtaken, named, unconfirmed, unseen
from robomend.repairs.hearing import LOOK_S
from robomend.repairs.record import Json, RepairRecord, approval
from robomend.repairs.signals import Signals
from robomend.repairs.states import RepairTrigger
from robomend.robots.clock import CLOCK
from robomend.robots.health import HealthState, health_of
from robomend.robots.robot import Robot
from robomend_client.literals import Atom

FLICKER_S = 1.0
"""What a plan was made for has to be gone for so long, or as long as its observers need to settle …"""

MOST_FLICKER_S = 30.0
"""… and no longer than this, before a plan that waits for a yes is withdrawn."""

TELL_S = 1.0
"""Waits that take longer are written into the record."""


class Permission:
    """Of one repair."""

    def __init__(
        self,
        state: Robot,
        record: RepairRecord,
        signals: Signals,
        chooser: Chooser,
        acts: Acts,
        newest: Callable[[], Awaitable[DiagnosisResult]],
    ) -> None:
        """`newest` returns the diagnosis as it is now."""
        self._state = state
        self._record = record
        self._signals = signals
        self._chooser = chooser
        self._acts = acts
        self._newest = newest
        self._components = frozenset(state.system.cnf.components)

    @property
    def _policy(self) -> Policy:
        """The policy as it is configured now: a change counts from the next action on."""
        return self._chooser.policy(self._state)

    async def refusal(self, step: Step) -> str | None:
        """Return why a step may not be done now, if so."""
        refusal = self._policy.refusal(step, self._acts.attempts, self._components)
        if refusal is None and step.name in NODE_ACTIONS:  # nor is what runs stopped for a start in vain
            await self._booted(step.parameters[0])
        return refusal or await self._acts.interlocked()

    async def _booted(self, node: str) -> None:
        """Wait until the devices have booted that a node drives, or it is heard, which shows that they have;
        one that starts sooner may stay mute.
        """
        parts, sight = self._state.system.parts, self._state.sight
        told = False
        topics = () if parts is None or node not in parts.nodes else parts.nodes[node].publishes
        heard = [atom for atom in (Atom("ok", (topic,)) for topic in topics) if sight.reported(atom)]
        try:
            while parts is not None and not (heard and all(map(sight.value, heard))):
                left_s = (sight.start_ups.drivable_ns(node, parts, sight) - CLOCK.now_ns()) / 1e9
                if left_s <= 0:
                    break
                if not told and left_s > TELL_S:
                    told = True
                    devices = sight.start_ups.booting(node, parts, sight)
                    why = f"until {named(devices)} has booted: {node} is started after that"
                    await self._record.update(RepairTrigger.UNHEARD, reason=why, waiting_for=list(devices))
                await self._state.changed(self._state.revision, min(left_s, LOOK_S))
        finally:  # the plan may have ended meanwhile
            if told:
                await self._record.update(RepairTrigger.PERMITTED, waiting_for=[])

    def at_once(self, choice: Choice) -> Choice:
        """Return what of a choice needs no yes, if the rest does and has nothing to do with it; else all."""
        plan, diagnosis = choice.plan, choice.diagnosis
        if plan is None or diagnosis is None or self._policy.mode_for(plan.steps) is not Mode.APPROVE:
            return choice
        if self._covered(plan.steps):
            return choice
        free = [part for part in parts_of(plan) if self._policy.mode_for(part) is Mode.AUTO]
        mended = repaired_by(replace(plan, steps=tuple(step for part in free for step in part)))
        bad = tuple(name for name in diagnosis.bad if name in mended)
        if not bad:
            return choice
        part = narrowed(plan, [step for part in free for step in part])
        reason = f"{', '.join(bad)} first, as the rest of the plan waits for a yes; {choice.reason}"
        return replace(choice, diagnosis=Diagnosis(bad), plan=part, reason=reason)

    async def approved(self, choice: Choice) -> bool:
        """Ask the policy, and a person where it says so; a yes counts while the plan's diagnosis stands."""
        assert choice.plan is not None
        steps = choice.plan.steps
        self._acts.attempts = Counter(await self._chooser.attempts(self._state.id))
        refusal = self._policy.plan_refusal(steps, self._acts.attempts, self._components)
        if refusal is not None:
            raise NotPermitted(refusal)
        if (why := await self._signals.unless_halted(self._acts.interlocked())) is not None:
            raise NotPermitted(why)
        asked = bool(choice.yes) or self._policy.mode_for(steps) is Mode.APPROVE
        if not asked or self._covered(steps):
            await self._record.update(RepairTrigger.PERMITTED)
            return not self._signals.halt.is_set()
        self._signals.ask()  # before the question can be seen, or a quick yes would be lost
        await self._record.update(RepairTrigger.NEEDS_APPROVAL, reason=choice.reason)
        stands = Stands(
            self._state, choice, self._record.data, self._newest, self._chooser, await self._newest()
        )
        decided = False
        while not (await stands.now() and decided):  # a yes in the middle of a flicker waits for its end
            if decided:
                await self._signals.unless_halted(self._state.changed(self._state.revision, LOOK_S))
            decided = await self._signals.decided(0.0 if decided else LOOK_S)
            if self._signals.halt.is_set():
                return False
        by = self._signals.by
        await self._record.update(
            RepairTrigger.APPROVED,
            by=by,
            reason=f"approved by {by}",
            answers=self._signals.answers(),
            approved=approval(by, map(str, steps)),
        )
        return not self._signals.halt.is_set()

    def _covered(self, steps: Sequence[Step]) -> bool:
        """Whether a yes that was given before a crash covers the plan that is left."""
        given = self._record.data.get("approved")
        return given is not None and Counter(map(str, steps)) <= Counter(given["steps"])


class Stands:
    """Whether what a plan was made for is still blamed. What goes for a moment has not ended, as what comes
    for a moment has not begun: it has to be gone for as long as its observers may need to see it again.
    """

    def __init__(
        self,
        state: Robot,
        choice: Choice,
        written: Json,
        newest: Callable[[], Awaitable[DiagnosisResult]],
        chooser: Chooser,
        result: DiagnosisResult,
    ) -> None:
        """`result`: the diagnosis when the question was put."""
        assert choice.diagnosis is not None
        assert choice.plan is not None
        self._state = state
        self._plan = choice.plan
        self._chooser = chooser
        self._others = frozenset(blamed_by_all(result))
        self._agents: tuple[int, bool, bool] | None = None  # what was known of them when they were looked at
        self._bad = frozenset(choice.diagnosis.bad)
        self._written = written
        self._newest = newest
        symptoms = (entry.atom for entry in state.sight.entries() if not entry.positive)
        settling_ns = max((state.sight.delays(atom).settling_ns for atom in symptoms), default=0)
        self._gone_for_s = min(max(settling_ns / 1e9, FLICKER_S), MOST_FLICKER_S)
        self._gone_s: float | None = None  # since when it is not blamed, monotonic

    async def now(self) -> bool:
        """Return whether it is blamed; Overtaken: it is not any more, or nobody carries the plan out."""
        declared = self._state.sight.declared
        if self._agents != (agents := (declared.changes, declared.all_heard(), declared.boardless)):
            if (nobody := await self._chooser.nobody_does(self._state, self._plan)) is not None:
                raise Overtaken(f"{nobody}: the plan no longer applies")
            self._agents = agents
        result = await self._newest()
        stands = any(self._bad <= set(diagnosis.bad) for diagnosis in result.diagnoses)
        more = self._more(result)
        if stands and not more:
            self._gone_s = None
            return True
        if self._gone_s is None:
            self._gone_s = time.monotonic()
        if time.monotonic() - self._gone_s < self._gone_for_s:
            return stands
        if more:
            raise Overtaken(f"{named(more)} failed as well, which needs no yes: the plan is made anew")
        now = "the diagnosis is another one now"
        if result.healthy:
            how, unknown = health_of(self._state)
            now = unseen(self._state, self._written) or (
                "the robot is healthy again"
                if how is HealthState.HEALTHY
                else unconfirmed(unknown, self._state)
            )
        raise Overtaken(f"{now}: the plan no longer applies")

    def _more(self, result: DiagnosisResult) -> list[str]:
        """Return what is blamed for sure since the question was put, where not all needs a person's yes."""
        if self._state.config.policy != "auto":
            return []
        return sorted(blamed_by_all(result) - self._others - self._bad)


def blamed_by_all(result: DiagnosisResult) -> frozenset[str]:
    """Return the components that every diagnosis blames."""
    return frozenset[str].intersection(*(frozenset(one.bad) for one in result.diagnoses or (Diagnosis(()),)))


def parts_of(plan: Plan) -> list[list[Step]]:
    """Return a plan's steps in parts that have nothing to do with each other: no order, no name in both."""
    parts: list[tuple[set[str], set[int], list[Step]]] = []
    for step in plan.steps:
        literals = (*step.preconditions, *step.effects)
        names = {*step.parameters, *(arg for literal in literals for arg in literal.atom.args)}
        indices, steps = {step.index}, [step]
        for part in [one for one in parts if one[0] & names or one[1].intersection(step.after)]:
            parts.remove(part)
            names, indices, steps = names | part[0], indices | part[1], [*part[2], *steps]
        parts.append((names, indices, steps))
    return [steps for _, _, steps in parts]


def narrowed(plan: Plan, steps: Sequence[Step]) -> Plan:
    """Return a plan of some of its steps only, none of which is after another one."""
    kept = sorted(steps, key=lambda step: step.index)
    index = {step.index: position for position, step in enumerate(kept)}
    new = (replace(s, index=index[s.index], after=tuple(index[one] for one in s.after)) for s in kept)
    return replace(plan, steps=tuple(new), cost=sum(step.cost for step in kept))
