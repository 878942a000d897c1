"""What OBS should show while a plan runs: the state that the plan predicts, in the words of the observers.

    facts of the plan's state   on(h), running(n), bad(c), …   ──► on/running literals of every component
    components predicted good,
    inputs from outside as seen ──► unit propagation over SD   ──► ok(t), and whatever the user's rules derive

The second line is the diagnosis' own theory read forwards. A literal that it derives and that OBS
contradicts is exactly what would start a new conflict, so a mismatch seen here is one that the next
diagnosis can explain. A mute driver after a power cycle is no mismatch: the plan calls that driver bad
until it is restarted.
"""

from __future__ import annotations

from collections import OrderedDict, defaultdict
from collections.abc import Callable, Iterable

from robomend.model.cnf import HealthCnf
from robomend.model.components import KINDS
from robomend.model.vocabulary import ACTIVE
from robomend.planning.plan import Step
from robomend_client.literals import Atom, Literal

OPPOSITES = {**{lost: kind.state for kind in KINDS for lost in kind.lost}, "bad": "good"}
"""The domain's second predicate of a pair (the paper's domain has names of its own) -> what it negates."""

OBSERVED_FACTS = frozenset(kind.state for kind in KINDS)


class Theory:
    """Unit propagation over SD, indexed once per system description."""

    def __init__(self, cnf: HealthCnf) -> None:
        self._cnf = cnf
        self._watching: dict[int, list[int]] = defaultdict(list)
        for index, clause in enumerate(cnf.clauses):
            for literal in clause:
                self._watching[literal].append(index)

    def derived(
        self, good: Iterable[str], given: Iterable[Literal] = (), without: Iterable[Literal] = ()
    ) -> frozenset[Literal]:
        """Return the literals over atoms that follow by unit propagation from these components being healthy,
        and from literals that are known anyhow, as far as a rule mentions them; nothing follows by way of
        those in `without`.

        Sound and, for Horn rules such as the six schemes, complete. A clause that becomes empty ends the
        propagation: then nothing is predicted, as the rules contradict each other.
        """
        cnf = self._cnf
        true: set[int] = set()
        barred = {cnf.literal(literal) for literal in without}
        known = (cnf.literal(literal) for literal in given)
        pending = [*(cnf.health[component] for component in good), *(k for k in known if k is not None)]
        missing: dict[int, int] = {}  # clause -> literals not yet false
        while pending:
            literal = pending.pop()
            if literal in true or literal in barred:
                continue
            if -literal in true:
                return frozenset()
            true.add(literal)
            for index in self._watching[-literal]:
                left = missing.get(index, len(cnf.clauses[index])) - 1
                missing[index] = left
                if left == 1:
                    pending.extend(other for other in cnf.clauses[index] if -other not in true)
        first = len(cnf.components)
        return frozenset(
            Literal(cnf.atoms[abs(literal) - first - 1], literal > 0)
            for literal in true
            if first < abs(literal) <= first + len(cnf.atoms)
        )

    def concluded(self, components: Iterable[str]) -> frozenset[Atom]:
        """Return the atoms that some rule concludes of one of these being healthy, whatever else it asks for:
        those that it has unnegated, or all where it has none.
        """
        cnf, first = self._cnf, len(self._cnf.components)
        found: set[Atom] = set()
        for component in components:
            for index in self._watching[-cnf.health[component]]:
                atoms = [one for one in cnf.clauses[index] if first < abs(one) <= first + len(cnf.atoms)]
                heads = [one for one in atoms if one > 0] or atoms
                found.update(cnf.atoms[abs(one) - first - 1] for one in heads)
        return frozenset(found)


THEORIES = 16
"""System descriptions whose index is kept; a fleet has few models, an index is as large as its clauses."""

_theories: OrderedDict[int, tuple[HealthCnf, Theory]] = OrderedDict()


def theory_of(cnf: HealthCnf) -> Theory:
    """Return the index of a system description, made once while it is in use."""
    # By identity: hashing a large model would cost what the index does. The entry keeps `cnf` alive, so that
    # no other object gets its id.
    known = _theories.pop(id(cnf), None)
    if known is None:
        known = (cnf, Theory(cnf))
    _theories[id(cnf)] = known
    while len(_theories) > THEORIES:
        _theories.popitem(last=False)
    return known[1]


class Prediction:
    """The predicted state: the plan's initial state, then what the actions do as they are sent and done."""

    def __init__(
        self,
        theory: Theory,
        components: Iterable[str],
        initial: Iterable[Atom],
        outside: Callable[[], frozenset[Literal]] = frozenset,
    ) -> None:
        """`outside` returns what is observed now of topics that nobody in the model publishes."""
        self._theory = theory
        self._outside = outside
        self._given: frozenset[Literal] = frozenset()
        self._components = tuple(components)
        self._facts = set(initial)
        self._failed: set[Literal] = set()  # what was expected, and is not to be seen
        self._expected: frozenset[Literal] | None = None  # until a fact changes

    def begin(self, step: Step) -> None:
        """The action is being sent: what it takes away may be gone now, what it gives is not there yet."""
        self._expected = None
        for effect in step.effects:
            if not effect.positive:
                self._facts.discard(effect.atom)
            elif effect.atom.predicate == "bad":
                self._hold(effect.atom)
            elif effect.atom.predicate in OBSERVED_FACTS:  # a remedy may stop what it starts
                self._facts.discard(effect.atom)

    def finish(self, step: Step) -> None:
        """The action reported success."""
        self._expected = None
        for effect in step.effects:
            if effect.positive:
                self._hold(effect.atom)
            else:
                self._facts.discard(effect.atom)

    def fail(self, literal: Literal) -> None:
        """This was expected, and was not to be seen: nor is anything to be expected that follows from it."""
        self._expected = None
        self._failed.add(literal)
        if literal.atom.predicate in OBSERVED_FACTS:
            self._facts.discard(Atom("good", literal.atom.args))

    def _hold(self, fact: Atom) -> None:
        """Add a fact; its opposite goes, also where the domain (the paper's) forgets to delete it."""
        gone = -observable(Literal(fact))
        self._facts = {other for other in self._facts if observable(Literal(other)) != gone}
        self._facts.add(fact)

    def expected(self) -> frozenset[Literal]:
        """Return the literals that OBS should hold, once the robot has had time to show them."""
        given = self._outside()
        if self._expected is None or given != self._given:
            self._given = given
            self._expected = self._now_expected()
        return self._expected

    def _now_expected(self) -> frozenset[Literal]:
        facts = {
            observable(Literal(fact))
            for fact in self._facts
            if OPPOSITES.get(fact.predicate, fact.predicate) in OBSERVED_FACTS or fact.predicate == ACTIVE
        }
        good = [name for name in self._components if Atom("good", (name,)) in self._facts]
        derived = self._theory.derived(good, self._given, self._failed) - self._given
        # A fact of the plan's own state is nearer than what the rules derive: a component may be called good
        # while one of its facts is on its way.
        atoms = {literal.atom for literal in facts}
        return frozenset(facts | {literal for literal in derived if literal.atom not in atoms})


def observable(literal: Literal) -> Literal:
    """Return a literal over the domain's predicates in the observers' words: off(h) is `not on(h)`."""
    predicate = OPPOSITES.get(literal.atom.predicate)
    if predicate is None:
        return literal
    return Literal(Atom(predicate, literal.atom.args), not literal.positive)
