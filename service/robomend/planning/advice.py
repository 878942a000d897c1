"""From a diagnosis result to what to do next: the planning half of the loop.

    result ──► leading diagnoses, and what they share ──► a plan for each (worker) ──► choice

The service, the stateless one-shots and the command line all go through here.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from robomend.diagnosis.probes import ProbeResult
from robomend.diagnosis.ranking import likelihoods, onset_fit, works_in_part
from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.errors import ModelError
from robomend.model.cnf import HealthCnf
from robomend.model.components import KINDS, ComponentModel, Node
from robomend.model.loops import Loop
from robomend.model.system import System
from robomend.model.vocabulary import TRENDS
from robomend.planning.choice import Candidate, Choice, Look, choose, common_part
from robomend.planning.cures import Rates, carried, cycled, power_cuts
from robomend.planning.influence import influenced, published, put_out
from robomend.planning.plan import Plan
from robomend.planning.prediction import theory_of
from robomend.planning.quarantine import DEFAULT_PATIENCE, Patience
from robomend.planning.tried import (
    Attempt,
    interruptions,
    leading,
    repaired_by,
    unbroken_fits,
    weights,
)
from robomend_client.literals import Atom, Literal
from robomend_client.readings import Symptom

# --- a plan that repairs only a part of what is bad: whether that can help anybody. Pure.
#
#     its diagnosis, and what its acts break ──► less what it makes good ──► left bad
#                                                                             │
#                      a minimal diagnosis of OBS lies within that? ── yes ──► all that is observed stays
#                                                                              explained: it helps nothing
#
# A driver that cannot be restarted any more explains its silence by itself. To reset the bus of its device,
# and to restart the drivers beside it, would cost acts, and nobody would see a difference. A plan that
# brings back what is off or stopped helps that far. A driver that nobody can ever restart may find its
# device again by itself, whatever the domain says: that is seen after the plan.

LOST = frozenset(predicate for kind in KINDS for predicate in kind.lost)


def left_bad(plan: Plan, diagnosis: Diagnosis, model: ComponentModel) -> frozenset[str]:
    """Return what is bad after the plan, of its diagnosis and of what its acts break."""
    broken = {
        effect.atom.args[0]
        for step in plan.steps
        for effect in step.effects
        if effect.atom.predicate == "good" and not effect.positive and len(effect.atom.args) == 1
    }
    fixed = {name for name, node in model.nodes.items() if not node.restartable}
    # What is off or stopped, and left alone, is bad as well, though the diagnosis need not blame it.
    before = {fact.args[0] for fact in plan.initial if fact.predicate == "bad"}
    return frozenset((broken - fixed) | before | set(diagnosis.bad)) - repaired_by(plan)


def brings_back(plan: Plan) -> bool:
    """Return whether something is good after the plan that was off or stopped, and was not meant to be."""
    lost = {fact.args[0] for fact in plan.initial if fact.predicate in LOST and len(fact.args) == 1}
    return not (lost - set(plan.excluded)).isdisjoint(repaired_by(plan))


def explains_all(
    plan: Plan, diagnosis: Diagnosis, minimal: Sequence[Diagnosis], model: ComponentModel
) -> tuple[str, ...]:
    """Return what a plan leaves bad and what explains all that is observed; nothing where it may help.

    Args:
        diagnosis: what the plan is for.
        minimal: the minimal diagnoses of OBS.
    """
    if not plan.steps or brings_back(plan):
        return ()
    left = left_bad(plan, diagnosis, model)
    return next((one.bad for one in minimal if one.bad and left.issuperset(one.bad)), ())


def helpful(plan: Plan, diagnosis: Diagnosis, minimal: Sequence[Diagnosis], model: ComponentModel) -> Plan:
    """Return the plan, or one without steps that says why it can help nothing."""
    names = explains_all(plan, diagnosis, minimal, model)
    if not names:
        return plan
    why = (
        f"{', '.join(diagnosis.bad)}: its plan would leave {' and '.join(names)} broken, which explains all "
        "that is observed, and so help nothing"
    )
    return replace(plan, steps=(), cost=0.0, unreachable=(why, *plan.unreachable))


UNPOWERED: frozenset[Symptom | None] = frozenset(
    {Symptom.FAST, Symptom.STILL, Symptom.PUBLISHERS, Symptom.SELF_REPORT}
)
"""Symptoms of what has power and does something: it is not cut for these without a person."""

OTHERS: frozenset[Symptom | None] = frozenset({Symptom.FAST, Symptom.PUBLISHERS})
"""Symptoms of a second publisher: sure where who publishes is known, the first suspect where it is not."""

SELDOM: frozenset[Symptom | None] = frozenset({Symptom.FAST, Symptom.SELF_REPORT})

SELDOM_HELPS = 0.1
"""P(to act on it helps) against what a component reports of itself while its data are good, as its limit may
be wrong, and against what is too fast by one publisher, as far as is known.
"""


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
    symptoms: Mapping[Atom, Symptom] = field(default_factory=dict)  # in which way what is bad is so
    power_back: Mapping[str, int] = field(default_factory=dict)  # device -> when its power was seen to return
    rates: Rates = field(default_factory=dict)  # how probably acts cure, where that is given or learned
    asking: frozenset[str] = frozenset()  # actions to which a person has to say yes

    @property
    def _interrupted(self) -> tuple[list[Attempt], frozenset[str]]:
        """What was cycled without our doing, as attempts; the drivers whose connections that has cut."""
        return interruptions(self.model, self.power_back, self.onsets, self.tried)

    @property
    def _history(self) -> tuple[Attempt, ...]:
        """What was tried, and what happened besides that comes to the same."""
        return (*self.tried, *self._interrupted[0])

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
            self._history,
            fits=self._fits(self.result.diagnoses),
            switchable=frozenset(filter(self.model.switchable, self.model.hardware)),
            now_ns=self.now_ns,
        )
        return tuple(found)

    @property
    def suspects(self) -> list[tuple[Diagnosis, float]]:
        """The leading diagnoses with their weights, by what was tried."""
        found = self.leading
        fits = self._fits(found)
        weighed = weights(found, self.tried, fits=fits, now_ns=self.now_ns)
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
        ended = (self.surely_broken & self.model.nodes.keys()) | self._interrupted[1]
        if not ended:
            return fits
        known = unbroken_fits(blamed, ended, self.cnf.priors)
        return [fit * factor for fit, factor in zip(fits, known, strict=True)]

    def _works(self, diagnosis: Diagnosis) -> frozenset[str]:
        """Return what a diagnosis blames although something of it is seen to work."""
        return frozenset() if self.cnf is None else works_in_part(self.cnf, self.observed, diagnosis.bad)

    def helpful(self, plan: Plan, diagnosis: Diagnosis) -> Plan:
        """Return the plan, or one without steps where what it leaves broken explains all that is observed."""
        return helpful(plan, diagnosis, self.result.diagnoses, self.model)

    def _candidate(self, diagnosis: Diagnosis, plan: Plan) -> Candidate:
        """Return a diagnosis and its plan, with what the model and the symptoms say of them."""
        kinds = {name: self._kinds(name) for name in diagnosis.bad}
        along = carried(plan, self.model)
        cut = [name for name in diagnosis.bad if name in along | cycled(plan)]
        yes = self._without_cut(cut) if any(kinds[name] and kinds[name] <= UNPOWERED for name in cut) else ""
        elsewhere = self._symptoms_of(name for name, its in kinds.items() if its and its <= OTHERS)
        topics = ", ".join(sorted({name for atom in elsewhere for name in atom.args}))
        seldom = bool(kinds) and all(its and its <= SELDOM for its in kinds.values())
        meant = {str(one) for one in self.model.remedies if one.symptoms}  # others are not planned: unfit
        seldom = seldom and not any(str(step) in meant for step in plan.steps)
        return Candidate(
            diagnosis,
            plan,
            self._works(diagnosis),
            along,
            self._darkened(plan, diagnosis.bad),
            SELDOM_HELPS if seldom else 1.0,
            f"a second publisher: look who publishes {topics}" if topics else "",
            any(step.name in self.asking for step in plan.steps),
            yes,
            self.rates,
        )

    @property
    def second_published(self) -> frozenset[str]:
        """The suspects to be left alone, as what is wrong with their topics is surely a second publisher."""
        suspects = {name for one in self.result.diagnoses for name in one.bad}
        kinds = {name: self._kinds(name) for name in suspects}
        return frozenset(n for n, its in kinds.items() if its <= OTHERS and Symptom.PUBLISHERS in its)

    @property
    def unfit(self) -> tuple[tuple[str, str], ...]:
        """The remedies that are not for what is seen of what they mend, as text, each with the reason.

        What nobody says the kind of counts as silence.
        """
        found = []
        for one in self.model.remedies:
            if one.symptoms:
                kinds = {kind for name in one.mends for kind in self._kinds(name) or {None}}
                seen = {str(kind or Symptom.SILENT) for kind in kinds}
                if seen.isdisjoint(one.symptoms):
                    shown, meant = ", ".join(sorted(seen)), ", ".join(one.symptoms)
                    found.append((str(one), f"it is for {meant}, and what is seen is {shown}"))
        return tuple(found)

    @property
    def lingering(self) -> frozenset[str]:
        """The nodes that do not run by what is observed, and of which nobody says that they have ended."""
        said = {a: s for a, s in self.symptoms.items() if a.predicate == Node.state and len(a.args) == 1}
        return frozenset(atom.args[0] for atom, symptom in said.items() if symptom is not Symptom.ENDED)

    def _without_cut(self, names: Iterable[str]) -> str:
        """Return why a person is asked before these lose their power."""
        found = self._symptoms_of(names)
        shown = sorted(f"{atom} ({self.symptoms[atom]})" for atom in found if atom in self.symptoms)
        return f"power is not cut for {', '.join(shown)} without a person's yes"

    def _symptoms_of(self, bad: Iterable[str]) -> list[Atom]:
        """Return what is not as it should be of what these put out, or else of all that rests on them."""
        names = tuple(bad)
        if not names or not self.symptoms:
            return []
        # That a value does not fall is no symptom, unless its observer says so.
        fallen = [
            literal.atom
            for literal in self.observed
            if not literal.positive
            and (literal.atom.predicate not in TRENDS or literal.atom in self.symptoms)
        ]
        own = put_out(self.model, names)
        if found := [atom for atom in fallen if own.intersection(atom.args)]:
            return found
        if self.cnf is None:
            return []
        return sorted(influenced(self.model, theory_of(self.cnf), names, fallen))

    def _kinds(self, name: str) -> frozenset[Symptom | None]:
        """Return in which ways what a component puts out is bad; None: nobody says, as of what is silent.

        A self-report counts as one where data are seen to be good.
        """
        kinds = frozenset(self.symptoms.get(atom) for atom in self._symptoms_of([name]))
        if Symptom.SELF_REPORT not in kinds:
            return kinds
        topics = published(self.model, [name])
        said = (literal.atom for literal in self.observed if literal.positive)
        if any(atom.predicate == "ok" and topics.issuperset(atom.args) for atom in said):
            return kinds
        return kinds - {Symptom.SELF_REPORT} | {None}

    def _darkened(self, plan: Plan, bad: Collection[str]) -> frozenset[str]:
        """Return what loses its power by a plan, and is not seen to be broken."""
        cut = power_cuts(plan)
        if not cut:
            return frozenset()
        fallen = {literal.atom for literal in self.observed if not literal.positive}
        driven = {device for node in self.model.nodes.values() for device in node.drives}
        dark = {name for name in driven - cut if not cut.isdisjoint(self.model.feeders(name))}
        mute = {
            device
            for node in self.model.nodes.values()
            if any(Atom("ok", (topic,)) in fallen for topic in node.publishes)
            for device in node.drives
        }
        return frozenset(name for name in dark - mute - set(bad) if Atom("on", (name,)) not in fallen)

    def decide(self, plans: Sequence[Plan]) -> Choice:
        """Return the choice, given a plan for each of `wanted`."""
        diagnoses = self.leading
        pairs = [
            self._candidate(one, self.helpful(plan, one))
            for one, plan in zip(self.wanted, plans, strict=True)
        ]
        candidates, shared = pairs[: len(diagnoses)], pairs[len(diagnoses) :]
        choice = choose(
            candidates,
            self._history,
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
