"""Choosing for a live robot: the situation (robomend.planning.advice) filled with what we know of it.

tried repairs, quarantine (store) ──────────────────────────┐
probes, if the model says what observing costs (worker) ────┼──► Situation ──► plans ──► Choice
diagnoses, OBS (robot state) ───────────────────────────────┘     another way instead of a useless
                                                                  or a forbidden one;
                                                                  what the policy refuses is no plan
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

from robomend.diagnosis.probes import ProbeResult
from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.errors import Overloaded, Refused, RobomendError, StateConflict
from robomend.model.components import ComponentModel
from robomend.oneshots.oneshots import OneShots
from robomend.oneshots.plan_json import choice_json
from robomend.oneshots.warm_model import given_diagnosis
from robomend.planning.advice import Situation
from robomend.planning.choice import Choice, suspected_most
from robomend.planning.cures import rates
from robomend.planning.plan import Plan
from robomend.planning.planner_pool import PlannerPool
from robomend.planning.planning import PlanOptions
from robomend.planning.policy import HOUR_NS, NODE_ACTIONS, POWER_ACTIONS, Mode, Policy
from robomend.planning.problem import Offer, Offers
from robomend.planning.quarantine import DEFAULT_PATIENCE, Patience
from robomend.repairs.executors.registry import kind_of
from robomend.repairs.flapping import lasting, not_undone
from robomend.repairs.left_off import NOTHING, LeftOff, unknown
from robomend.repairs.remembering import Remembered, began_ns, down, remembered
from robomend.robots.configuration import RobotConfig, policy_of, protected_of
from robomend.robots.readers import Readers
from robomend.robots.robot import Robot
from robomend.store import Store, attempts
from robomend_client.literals import Literal


def _modes(result: DiagnosisResult) -> dict[str, str]:
    """Return the fault mode of each suspect, by the first diagnosis that says it."""
    found: dict[str, str] = {}
    for diagnosis in result.diagnoses:
        for name, mode in diagnosis.modes.items():
            found.setdefault(name, mode)
    return found


PLAN_TIMEOUT_S = 10.0
"""For the plans of all leading diagnoses together."""

KEEP_S = 30.0
"""How often a planner is told that it may be needed; idle for some minutes, it would end."""

BUSY_S = 60.0
"""How long a repair waits for a planner when every one is busy."""


class Chooser:
    """One per instance; knows no robot, everything comes with the call."""

    def __init__(
        self,
        store: Store,
        planners: PlannerPool,
        one_shots: OneShots,
        readers: Readers,
    ) -> None:
        self._store = store
        self._readers = readers
        self._planners = planners
        self._one_shots = one_shots
        self._kept_s = -KEEP_S
        self._policies: WeakKeyDictionary[Robot, tuple[RobotConfig, ComponentModel | None, Policy]] = (
            WeakKeyDictionary()
        )

    def keep_ready(self, state: Robot) -> None:
        """A robot may have to be repaired at any time: a planner that starts only then costs seconds.

        Under other policies than `auto` a person is waited for anyway.
        """
        if state.config.policy == "auto" and time.monotonic() - self._kept_s >= KEEP_S:
            self._kept_s = time.monotonic()
            self._planners.start()

    def policy(self, state: Robot) -> Policy:
        """Return the robot's policy, with what the model and its board protect; asked at each diagnosis."""
        config, parts = state.config, state.system.parts
        known = self._policies.get(state)
        if known is None or known[0] is not config or known[1] is not parts:
            known = self._policies[state] = (config, parts, policy_of(config, parts))
        return known[2]

    async def actions(self, state: Robot) -> tuple[str, ...]:
        """Return the names of what may be done to the robot."""
        return await self._readers.actions(state.config.domain, state.system.parts)

    def not_idempotent(self, state: Robot, actions: Iterable[str]) -> frozenset[str]:
        """Return those of the actions that must not be sent twice: the user's own, unless they say
        otherwise.
        """
        return frozenset(
            name
            for name in actions
            if name not in POWER_ACTIONS | NODE_ACTIONS
            and not (state.config.actions.get(name) or {}).get("idempotent")
        )

    def patience_with(self, state: Robot) -> Patience:
        """Return the patience with repairs of this robot that do not last."""
        # Whoever allows many actions an hour means to mend what breaks often: a restart takes two.
        policy = self.policy(state)
        allowed = policy.limits.attempts_per_hour // 4
        soon_s = DEFAULT_PATIENCE.relapse_s + policy.hold_s  # it is not looked at before
        return Patience(max(DEFAULT_PATIENCE.relapses, allowed), soon_s)

    async def remembered(
        self, state: Robot, result: DiagnosisResult | None = None, since_ns: int = 0
    ) -> Remembered:
        """Return what was tried lately (since then) and what is left alone now; with a diagnosis also what
        came back.
        """
        suspected = frozenset(name for one in result.diagnoses for name in one.bad) if result else ()
        patience = self.patience_with(state)
        return await self._store.read(lambda view: remembered(view, state.id, patience, suspected, since_ns))

    async def nobody_does(self, state: Robot, plan: Plan) -> str | None:
        """Return why a step of a plan would find nobody, by what the agents say now; or None."""
        parts = state.system.parts
        if parts is None:
            return None
        offers = await offers_now(state, parts, await self.actions(state), self._store)
        found = ((s, offers.why_nobody(s.name, s.parameters)) for s in plan.steps)
        return next((f"{step}: {why}" for step, why in found if why is not None), None)

    async def attempts(self, robot: str) -> Mapping[str, int]:
        """Return component -> actions on it in the last hour."""
        since = time.time_ns() - HOUR_NS
        return await self._store.read(attempts.counted, robot, since)

    async def choose_in_turn(
        self,
        state: Robot,
        result: DiagnosisResult,
        *,
        looks: bool,
        literals: Iterable[Literal] | None = None,
        avoided: tuple[tuple[str, str], ...] = (),
        left_off: LeftOff = NOTHING,
        since_ns: int = 0,
        lingering: Collection[str] = (),
    ) -> Choice:
        """Choose; where the planners are busy with other robots, wait for a turn, but not for ever."""
        deadline, pause_s = time.monotonic() + BUSY_S, 0.2
        while True:
            try:
                return await self.choose(
                    state,
                    result,
                    looks=looks,
                    literals=literals,
                    avoided=avoided,
                    left_off=left_off,
                    since_ns=since_ns,
                    lingering=lingering,
                )
            except Overloaded:
                if time.monotonic() >= deadline:
                    raise
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, 5.0)

    async def choose(
        self,
        state: Robot,
        result: DiagnosisResult,
        *,
        looks: bool,
        avoided: tuple[tuple[str, str], ...] = (),
        left_off: LeftOff = NOTHING,
        lingering: Collection[str] = (),
        planner: str | None = None,
        timeout_s: float = PLAN_TIMEOUT_S,
        pddl: bool = False,
        permitted: bool = True,
        literals: Iterable[Literal] | None = None,
        since_ns: int = 0,
    ) -> Choice:
        """Plan for the leading diagnoses and return what to do first.

        Args:
            looks: whether somebody can be asked to look first.
            avoided: actions as text that must not be used, each with the reason.
            left_off: what a repair switched off or stopped, to be brought back, in quarantine or not.
            lingering: nodes that an act found there although they are observed not to run.
            permitted: whether only what the policy allows comes into question.
            literals: what is observed; by default what is known now and confirmed.
            since_ns: what was tried before that says nothing any more.

        Raises:
            Refused: the model does not say what can be repaired.
            DomainError, OptionRefused: the robot's own PDDL or planner is at fault.
        """
        parts = self._parts(state)
        memory = await self.remembered(state, result, since_ns)
        policy = self.policy(state)
        names = await self.actions(state)
        learned = memory.reconnecting & parts.nodes.keys()
        if learned:
            nodes = {n: replace(node, reconnects=True) for n, node in parts.nodes.items() if n in learned}
            parts = replace(parts, nodes={**parts.nodes, **nodes})
        known = state.sight.vouched() if literals is None else literals
        situation = replace(
            self._situation(state, parts, result, memory, (*known, *unknown(state, left_off))),
            asking=frozenset(n for n in names if policy.actions.get(n, policy.mode) is Mode.APPROVE),
        )
        options = PlanOptions(
            planner=planner or state.config.planner,
            timeout_s=timeout_s,
            domain=state.config.domain,
            expected_stopped=state.expected_stopped,
            quarantined=tuple(
                name
                for name in dict.fromkeys((*memory.quarantined, *sorted(situation.second_published)))
                if name in parts.components and name not in left_off
            ),
            protected=protected_of(state.config, parts),
            avoided=(*avoided, *situation.unfit),
            lingering=tuple(sorted({*lingering, *situation.lingering})),
            offers=await offers_now(state, parts, names, self._store),
            rates=tuple(situation.rates.values()),
            pddl=pddl,
        )
        forbidden = {name: why for name in names if (why := policy.forbids(name)) is not None}
        if len(forbidden) == len(names):  # there is no other way: what would be done is told
            forbidden = {}
        plans = await self._plans(situation, options, memory.useless, forbidden)
        if permitted:
            components = frozenset(parts.components)
            plans = [_permitted(plan, policy, memory.attempts, components) for plan in plans]
        if looks and len(situation.leading) > 1:
            situation = replace(situation, probes=await self._probes(state))
        choice = situation.decide(plans)
        if (named := choice.diagnosis) is not None:
            symptoms = [one for one in state.sight.entries() if not one.positive]
            began = (began_ns(state, named.bad, symptoms), tuple(down(symptoms).items()))
            choice = not_undone(choice, memory, *began, parts, situation.patience)
        return lasting(choice, result, memory, situation)

    def _situation(
        self,
        state: Robot,
        parts: ComponentModel,
        result: DiagnosisResult,
        memory: Remembered,
        observed: tuple[Literal, ...],
    ) -> Situation:
        return Situation(
            parts,
            observed,
            result,
            memory.tried,
            now_ns=time.time_ns(),
            patience=self.patience_with(state),
            cnf=state.system.cnf,
            loops=state.system.loops,
            onsets=state.sight.onsets(),
            surely_broken=memory.surely_broken,
            relapses=len(memory.relapses),
            symptoms=state.sight.kinds_of_symptoms(),
            rates=rates(parts, _modes(result), memory.outcomes),
            power_back=state.sight.power_back,
        )

    async def suspects(self, state: Robot, told: str) -> str:
        """Name who is suspected now, by weight; nothing where nobody is, or the only one is told of."""
        answer = None if state.current is None else state.current.answer
        result = None if answer is None else answer.result
        if result is None or result.healthy or not result.diagnoses or state.system.parts is None:
            return ""
        if len(result.diagnoses) == 1:
            bad = result.diagnoses[0].bad
            return "" if all(name in told for name in bad) else f"suspected: {' and '.join(bad)}"
        memory = await self.remembered(state, result)
        known = state.sight.vouched()
        return suspected_most(self._situation(state, state.system.parts, result, memory, known).suspects)

    async def _plans(
        self,
        situation: Situation,
        options: PlanOptions,
        useless: Mapping[frozenset[str], frozenset[str]],
        forbidden: Mapping[str, str],
    ) -> list[Plan]:
        """Return a plan for each wanted diagnosis; another way where one was tried in vain, or needs an
        action that is forbidden.
        """
        wanted = [diagnosis.bad for diagnosis in situation.wanted]
        plans = await self._planners.plans(situation.model, situation.observed, wanted, options)
        for position, diagnosis in enumerate(situation.wanted):
            in_vain = useless.get(frozenset(diagnosis.bad), ()) if position < len(situation.leading) else ()
            vain = tuple((text, "it was tried, and it did not help") for text in sorted(in_vain))
            other = replace(options, avoided=(*vain, *options.avoided))
            if in_vain:
                plans[position] = await self._instead(plans[position], situation, diagnosis, other)
            if any(step.name in forbidden for step in plans[position].steps):
                other = replace(other, forbidden=tuple(sorted(forbidden.items())))
                plans[position] = await self._instead(plans[position], situation, diagnosis, other)
        return plans

    async def _instead(
        self, plan: Plan, situation: Situation, diagnosis: Diagnosis, options: PlanOptions
    ) -> Plan:
        """Return another plan, if it repairs as much."""
        [way] = await self._planners.plans(situation.model, situation.observed, [diagnosis.bad], options)
        way = situation.helpful(way, diagnosis)
        return way if way.steps and len(way.unreachable) <= len(plan.unreachable) else plan

    async def _probes(self, state: Robot) -> ProbeResult | None:
        """Return the probes that somebody can make: those whose cost the model declares."""
        costs = state.system.cnf.costs
        if not costs:
            return None
        try:
            found = await self._one_shots.probes(*state.question(), state.config.engine, 10)
        except RobomendError:
            return None  # looking first is a saving, never a condition
        return replace(found, probes=tuple(probe for probe in found.probes if probe.atom in costs))

    async def describe(
        self,
        state: Robot,
        *,
        bad: Sequence[str] | None,
        planner: str | None,
        timeout_s: float,
        pddl: bool,
    ) -> dict[str, Any]:
        """Return what would be done now, as JSON: the dry run of POST …/plans."""
        self._parts(state)
        result = _present(state) if bad is None else given_diagnosis(bad, state.system)
        found = await self.choose(
            state,
            result,
            looks=bad is None,
            planner=planner,
            timeout_s=timeout_s,
            pddl=pddl,
            permitted=False,
        )
        return choice_json(found, state.system.cnf.components)

    def _parts(self, state: Robot) -> ComponentModel:
        if state.system.parts is None:
            raise Refused(f"a {state.system.format} model says nothing of what can be repaired")
        return state.system.parts


def _present(state: Robot) -> DiagnosisResult:
    answer = None if state.current is None else state.current.answer
    if answer is None or answer.result is None:
        why = "" if answer is None or answer.fault is None else f": {answer.fault}"
        raise StateConflict(f"robot {state.id!r} has no diagnosis now{why}")
    return answer.result


def _permitted(plan: Plan, policy: Policy, attempts: Mapping[str, int], components: Collection[str]) -> Plan:
    """Return the plan, or one without steps that says what the policy refuses."""
    refusal = policy.plan_refusal(plan.steps, attempts, components)
    return plan if refusal is None else replace(plan, steps=(), unreachable=(refusal, *plan.unreachable))


# --- who can carry out what, as far as this instance can know; by its model, who acts on what.


def hosts_of(parts: ComponentModel) -> dict[str, str | None]:
    """Return component -> the host whose agents act on it; None: any of the robot's."""
    return {name: part.host for name, part in parts.parts.items()}


async def offers_now(state: Robot, parts: ComponentModel, actions: Iterable[str], store: Store) -> Offers:
    """Return what agents say, and what nobody can do while the board is not connected.

    Of agents nothing is known where one may be there of which this instance has not heard: right after a
    start, and where there are other instances which it may ask for work.

    Args:
        actions: the names of the robot's domain's.
    """
    declared = state.sight.declared
    kinds = {name: kind_of(name, state.config.actions)[0] for name in actions}
    by_board = (name for name, kind in kinds.items() if kind == "board" and declared.boardless)
    by_hand = dict.fromkeys(by_board, "its board is not connected")
    if not declared.all_heard() or len(await store.ownership.instances()) > 1:
        return Offers((), frozenset(), {}, by_hand)
    said = tuple(Offer(each.agent, each.host, each.can) for each in declared.agents())
    by_agents = frozenset(name for name, kind in kinds.items() if kind == "agent")
    return Offers(said, by_agents, hosts_of(parts), by_hand)
