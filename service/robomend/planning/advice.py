"""From a diagnosis result to what to do next: the planning half of the loop.

    result ──► leading diagnoses, and what they share ──► a plan for each (worker) ──► choice

The service, the stateless one-shots and the command line all go through here.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from robomend.diagnosis.likelihood import likelihoods, works_in_part
from robomend.diagnosis.onsets import onset_fit
from robomend.diagnosis.probes import ProbeResult
from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.errors import ModelError
from robomend.model.cnf import HealthCnf
from robomend.model.components import ComponentModel
from robomend.model.loops import Loop
from robomend.model.system import System
from robomend.planning.choice import Candidate, Choice, Look, choose, common_part
from robomend.planning.partial import helpful
from robomend.planning.plan import Plan
from robomend.planning.tried import DEFAULT_PATIENCE, Attempt, Patience, leading, unbroken_fits, weights
from robomend_client.literals import Atom, Literal


@dataclass(frozen=True)
class Situation:
    """Everything that choosing rests on: values only."""

    model: ComponentModel
    observed: tuple[Literal, ...]
    result: DiagnosisResult
    tried: tuple[Attempt, ...] = ()
    probes: ProbeResult | None = None  # only those that somebody can make now
    now_ns: int = 0
    patience: Patience = DEFAULT_PATIENCE
    cnf: HealthCnf | None = None  # says how well OBS fits a diagnosis; None: that does not count
    loops: tuple[Loop, ...] = ()
    onsets: Mapping[Atom, int] = field(default_factory=dict)  # of what is not ok, its last good sample
    surely_broken: frozenset[str] = frozenset()  # to earlier rounds of this repair, which did not cure it
    relapses: int = 0  # repairs in a row that helped what is suspected now, and did not last

    @property
    def wanted(self) -> tuple[Diagnosis, ...]:
        """The diagnoses to plan for, the shared part last where there is one."""
        found = self.leading
        certain = self.result.certain  # the leading ones may share more than all do
        shared = tuple(name for name in common_part(found) if name in certain)
        return (*found, Diagnosis(shared)) if shared else found

    @property
    def leading(self) -> tuple[Diagnosis, ...]:
        """The most probable diagnoses, by what was tried: those worth a plan of their own."""
        found = leading(
            self.result.diagnoses,
            self.tried,
            fits=self._fits(self.result.diagnoses),
            switchable=frozenset(filter(self.model.switchable, self.model.hardware)),
            now_ns=self.now_ns,
            patience=self.patience,
        )
        return tuple(found)

    @property
    def suspects(self) -> list[tuple[Diagnosis, float]]:
        """The leading diagnoses with their weights, by what was tried."""
        found = self.leading
        fits = self._fits(found)
        weighed = weights(found, self.tried, fits=fits, now_ns=self.now_ns, patience=self.patience)
        return list(zip(found, weighed, strict=True))

    def _fits(self, diagnoses: Sequence[Diagnosis]) -> list[float] | None:
        """Return how well OBS fits each, as far as their probabilities do not have it in them."""
        if self.cnf is None:
            return None
        blamed = [diagnosis.bad for diagnosis in diagnoses]
        weighed = bool(diagnoses) and all(one.probability is not None for one in diagnoses)
        fits = [1.0] * len(blamed) if weighed else likelihoods(self.cnf, self.observed, blamed)
        if self.onsets:
            order = [onset_fit(self.model, self.cnf, self.loops, self.onsets, bad) for bad in blamed]
            fits = [fit * factor for fit, factor in zip(fits, order, strict=True)]
        # A device that was off leaves its driver with a dead connection: that takes no second fault.
        ended = self.surely_broken & self.model.nodes.keys()
        if not ended:
            return fits
        known = unbroken_fits(blamed, ended, self.cnf.priors, self.patience)
        return [fit * factor for fit, factor in zip(fits, known, strict=True)]

    def _works(self, diagnosis: Diagnosis) -> frozenset[str]:
        """Return what a diagnosis blames although something of it is seen to work."""
        return frozenset() if self.cnf is None else works_in_part(self.cnf, self.observed, diagnosis.bad)

    def helpful(self, plan: Plan, diagnosis: Diagnosis) -> Plan:
        """Return the plan, or one without steps where what it leaves broken explains all that is observed."""
        return helpful(plan, diagnosis, self.result.diagnoses, self.model)

    def decide(self, plans: Sequence[Plan]) -> Choice:
        """Return the choice, given a plan for each of `wanted`."""
        diagnoses = self.leading
        pairs = [
            Candidate(one, self.helpful(plan, one), self._works(one))
            for one, plan in zip(self.wanted, plans, strict=True)
        ]
        candidates, shared = pairs[: len(diagnoses)], pairs[len(diagnoses) :]
        choice = choose(
            candidates,
            self.tried,
            looks(self.probes, candidates),
            common=shared[0] if shared else None,
            fits=self._fits(diagnoses),
            now_ns=self.now_ns,
            patience=self.patience,
            relapses=self.relapses,
        )
        return replace(choice, certain=self.result.certain)


def parts_of(system: System) -> ComponentModel:
    """Return what can be repaired.

    Raises:
        ModelError: the model is no component model.
    """
    if system.parts is None:
        raise ModelError(
            f"a model in {system.format} format says nothing of what can be switched or restarted: planning "
            "needs a component model (robomend: 1)"
        )
    return system.parts


def other_suspects(bad: Collection[str], result: DiagnosisResult) -> frozenset[str]:
    """Return the suspects that may still prevent what a repair of these components brings about: where only
    what all diagnoses share is repaired, whatever else they blame. Nothing is awaited that rests on them.
    """
    shared = set(bad)
    if not result.diagnoses or any(not shared < set(diagnosis.bad) for diagnosis in result.diagnoses):
        return frozenset()
    return frozenset(name for diagnosis in result.diagnoses for name in diagnosis.bad) - shared


def looks(probes: ProbeResult | None, candidates: Sequence[Candidate]) -> list[Look]:
    """Return the probes as choosing sees them."""
    if probes is None:
        return []
    index = {bad: position for position, bad in enumerate(probes.diagnoses)}
    positions = [index.get(one.diagnosis.bad) for one in candidates]
    return [
        Look(
            probe.atom,
            probe.cost_s,
            tuple(
                True if position in probe.if_true else False if position in probe.if_false else None
                for position in positions
            ),
        )
        for probe in probes.probes
    ]
