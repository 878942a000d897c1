"""Rules and assertions to clauses with provenance: where HealthCnf values are made and changed.

A formula becomes clauses by distribution where that stays small, and else through auxiliary variables, one
direction of each definition only (Plaisted and Greenbaum): x -> part. So the size stays linear, what the
other variables may be is unchanged, and a rule that never says "healthy" in a conclusion yields no clause
that does: weak fault models stay weak.

References:
    G. Tseitin. On the complexity of derivation in propositional calculus. 1968.
    D. Plaisted, S. Greenbaum. A structure-preserving clause form translation. JSC 2(3), 1986.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace

from robomend.errors import ModelError, UnknownComponent
from robomend.model.cnf import PARTIAL, Clause, HealthCnf, Output, Rule
from robomend.model.formulas import (
    AB,
    And,
    Formula,
    Iff,
    Implies,
    Leaf,
    Not,
    Or,
    Quantified,
    Truth,
    conjuncts,
    leaves,
)
from robomend_client.literals import Atom, Literal

DISTRIBUTE = 16
"""A formula that distributes into this many clauses, or into no more than it has leaves, needs no
variables."""

UNKNOWN_MODE = "unknown"


@dataclass(frozen=True, slots=True)
class Assertion:
    """A richer observation: it holds until it is withdrawn by its name. The formula is ground and
    canonical."""

    name: str
    text: str
    formula: Formula
    steps: int = field(default=0, compare=False)  # that it takes, by robomend.model.budget


@dataclass(frozen=True, slots=True)
class Modes:
    """The fault modes of a component: mode -> what holds in it."""

    component: str
    formulas: Mapping[str, tuple[Formula, ...]]
    exhaustive: bool
    line: int | None = None


def compile_rules(
    name: str,
    components: tuple[str, ...],
    rules: Iterable[tuple[Formula, Rule]],
    *,
    modes: Iterable[Modes] = (),
    priors: Mapping[str, float] | None = None,
    costs: Mapping[Atom, float] | None = None,
    puts_out: Mapping[str, tuple[Output, ...]] | None = None,
    partial: float = PARTIAL,
) -> HealthCnf:
    """Return the clauses of ground rules; `ab(c)` among their leaves is AB(c).

    Raises:
        UnknownComponent: a rule speaks of AB of something else.
    """
    rules, modes = list(rules), list(modes)
    health = {component: index for index, component in enumerate(components, 1)}
    variables: dict[Atom, int] = {}
    in_modes = (f for mode in modes for formulas in mode.formulas.values() for f in formulas)
    for formula in (*(formula for formula, _ in rules), *in_modes):
        _number(formula, health, variables)
    known = [rule for _, rule in rules]
    clausifier = Clausifier(_numbering(health, variables), len(components) + len(variables))
    clauses: list[Clause] = []
    origins: list[int] = []
    for index, (formula, _) in enumerate(rules):
        found = clausifier.clauses(formula)
        clauses.extend(found)
        origins.extend([index] * len(found))
    mode_variables: dict[str, Mapping[str, int]] = {}
    for mode in modes:
        mode_variables[mode.component] = _add_modes(
            mode, health[mode.component], clausifier, clauses, origins, known
        )
    return HealthCnf(
        name=name,
        components=components,
        atoms=tuple(variables),
        clauses=tuple(clauses),
        origins=tuple(origins),
        rules=tuple(known),
        variables=clausifier.last,
        priors=dict(priors or {}),
        costs=dict(costs or {}),
        modes=mode_variables,
        weak=_weak(clauses, len(components)),
        puts_out=dict(puts_out or {}),
        partial=partial,
    )


def extend(cnf: HealthCnf, assertions: Iterable[Assertion]) -> HealthCnf:
    """Return the system description with assertions as further rules; atoms new to it join the old ones."""
    asserted = tuple(assertions)
    if not asserted:
        return cnf
    variables = dict(cnf.atom_variable)
    first_auxiliary = len(cnf.components) + len(cnf.atoms)
    formulas = [assertion.formula for assertion in asserted]
    for formula in formulas:
        _number(formula, cnf.health, variables)
    shift = len(variables) - len(cnf.atoms)
    modes: Mapping[str, Mapping[str, int]] = {
        component: {mode: variable + shift for mode, variable in named.items()}
        for component, named in cnf.modes.items()
    }
    old = cnf.clauses
    if shift and cnf.variables > first_auxiliary:
        old = tuple(tuple(_shifted(lit, first_auxiliary, shift) for lit in clause) for clause in old)
    clausifier = Clausifier(_numbering(cnf.health, variables), cnf.variables + shift)
    clauses, origins, rules = list(old), list(cnf.origins), list(cnf.rules)
    for assertion, formula in zip(asserted, formulas, strict=True):
        found = clausifier.clauses(formula)
        clauses.extend(found)
        origins.extend([len(rules)] * len(found))
        rules.append(Rule(assertion.text, f"assertion {assertion.name}"))
    return replace(
        cnf,
        atoms=tuple(variables),
        clauses=tuple(clauses),
        origins=tuple(origins),
        rules=tuple(rules),
        variables=clausifier.last,
        modes=modes,
        weak=cnf.weak and _weak(clauses[len(old) :], len(cnf.components)),
    )


OF_WHAT_WORKS = frozenset({"scheme 1", "scheme 2", "scheme 3", "scheme 4", "scheme 5", "feed"})
"""Sources of rules that say what a component does while it works."""


def without_running(cnf: HealthCnf, names: Iterable[str]) -> HealthCnf:
    """Return the system description for a robot on which these components are expected to be stopped or off.

    A node's clause of scheme 5 (that it runs) is suspended, and a device's clause that it is on, of scheme 1
    or of its feed; with them what they publish, schemes 2 to 4, so that the silence of a topic that nobody
    else publishes blames nobody. The user's own rules, of modes and of related values stay.
    """
    stopped = {-cnf.health[name] for name in names if name in cnf.health}
    if not stopped:
        return cnf
    suspended = {index for index, rule in enumerate(cnf.rules) if rule.source in OF_WHAT_WORKS}
    kept = [
        index
        for index, clause in enumerate(cnf.clauses)
        if not (cnf.origins[index] in suspended and stopped.intersection(clause))
    ]
    return replace(
        cnf,
        clauses=tuple(cnf.clauses[index] for index in kept),
        origins=tuple(cnf.origins[index] for index in kept),
    )


class Clausifier:
    """Turns ground formulas into clauses; `last` is the highest variable used so far."""

    def __init__(self, variable: Callable[[Literal], int], last: int) -> None:
        self.last = last
        self._variable = variable
        self._found: list[Clause] = []
        self._defined: dict[tuple[Formula, bool], int] = {}
        self._sizes: dict[tuple[Formula, bool], int] = {}

    def clauses(self, formula: Formula) -> list[Clause]:
        """Return clauses that hold (for some values of the new variables) exactly when the formula does."""
        self._found = []
        if isinstance(formula, Implies) and isinstance(formula.right, Leaf):
            premises = conjuncts(formula.left)
            if premises is not None:  # the shape of the schemes: one clause, no need to look deeper
                numbers = [-self._variable(premise) for premise in premises]
                self._add([*numbers, self._variable(formula.right.literal)])
                return self._found
        self._defined = {}
        self._sizes = {}
        size = self._size(formula, True)
        if size <= DISTRIBUTE or size <= sum(1 for _ in leaves(formula)):
            for clause in self._distributed(formula, True):
                self._add(clause)
        else:
            self._assert(formula, True)
        return self._found

    def fresh(self) -> int:
        """Return a new variable."""
        self.last += 1
        return self.last

    def _add(self, clause: Iterable[int]) -> None:
        unique = tuple(dict.fromkeys(clause))
        if not unique:  # false: solvers disagree on the empty clause, so say it with a variable
            self._found.extend([(self.fresh(),), (-self.last,)])
        elif not any(-literal in unique for literal in unique):
            self._found.append(unique)

    def _size(self, formula: Formula, positive: bool) -> int:
        """Return how many clauses distribution would give, or some number above a million."""
        if isinstance(formula, Leaf):
            return 1
        key = (formula, positive)
        known = self._sizes.get(key)
        if known is None:
            conjunctive, parts = _view(formula, positive)
            if conjunctive:
                size = sum(self._size(*part) for part in parts)
            else:
                size = 1
                for part in parts:
                    size *= self._size(*part)
                    if size > 1_000_000:
                        break
            self._sizes[key] = known = size
        return known

    def _distributed(self, formula: Formula, positive: bool) -> list[Clause]:
        if isinstance(formula, Leaf):
            return [(self._literal(formula, positive),)]
        conjunctive, parts = _view(formula, positive)
        if conjunctive:
            return [clause for part in parts for clause in self._distributed(*part)]
        clauses: list[Clause] = [()]
        for part in parts:
            clauses = [(*left, *right) for left in clauses for right in self._distributed(*part)]
        return clauses

    def _assert(self, formula: Formula, positive: bool) -> None:
        conjunctive, parts = _view(formula, positive)
        if conjunctive and not isinstance(formula, Leaf):
            for part in parts:
                self._assert(*part)
        else:
            self._add(self._disjuncts(formula, positive))

    def _disjuncts(self, formula: Formula, positive: bool) -> list[int]:
        """Return literals of which one must hold for the formula to hold."""
        if isinstance(formula, Leaf):
            return [self._literal(formula, positive)]
        conjunctive, parts = _view(formula, positive)
        if conjunctive and len(parts) != 1:
            return [self._define(formula, positive)]
        return [literal for part in parts for literal in self._disjuncts(*part)]

    def _define(self, formula: Formula, positive: bool) -> int:
        """Return a variable that implies the formula, a conjunction."""
        key = (formula, positive)
        if key not in self._defined:
            self._defined[key] = variable = self.fresh()
            for part in _view(formula, positive)[1]:
                self._add([-variable, *self._disjuncts(*part)])
        return self._defined[key]

    def _literal(self, leaf: Leaf, positive: bool) -> int:
        variable = self._variable(leaf.literal)
        return variable if positive else -variable


def _view(formula: Formula, positive: bool) -> tuple[bool, tuple[tuple[Formula, bool], ...]]:
    """Return a formula, or its negation, as a conjunction (True) or a disjunction of parts with their
    signs."""
    match formula:
        case Leaf():
            return True, ()
        case Truth(value):
            return value == positive, ()
        case Not(body):
            return True, ((body, not positive),)
        case And(parts):
            return positive, tuple((part, positive) for part in parts)
        case Or(parts):
            return not positive, tuple((part, positive) for part in parts)
        case Implies(left, right):
            return not positive, ((left, not positive), (right, positive))
        case Iff(left, right) if positive:
            return True, ((Implies(left, right), True), (Implies(right, left), True))
        case Iff(left, right):
            return True, ((Or((left, right)), True), (Or((Not(left), Not(right))), True))
        case Quantified():
            raise ModelError("a quantifier is left: ground the formula first")


def _number(formula: Formula, health: Mapping[str, int], variables: dict[Atom, int]) -> None:
    """Give every new atom of a formula the next variable after the components' and the known atoms'."""
    for leaf in leaves(formula):
        atom = leaf.literal.atom
        if atom.predicate != AB or len(atom.args) != 1:
            variables.setdefault(atom, len(health) + 1 + len(variables))
        elif atom.args[0] not in health:
            raise UnknownComponent(atom.args[0], frozenset(health))


def _numbering(health: Mapping[str, int], atoms: Mapping[Atom, int]) -> Callable[[Literal], int]:
    def variable(literal: Literal) -> int:
        atom = literal.atom
        # AB(c) is the negation of c's health variable.
        number = -health[atom.args[0]] if atom.predicate == AB and len(atom.args) == 1 else atoms[atom]
        return number if literal.positive else -number

    return variable


def _add_modes(
    modes: Modes,
    healthy: int,
    clausifier: Clausifier,
    clauses: list[Clause],
    origins: list[int],
    rules: list[Rule],
) -> Mapping[str, int]:
    """Add AB(c) <-> exactly one mode, and each mode's sentences; return the variables of the modes."""
    names = [*modes.formulas] if modes.exhaustive else [*modes.formulas, UNKNOWN_MODE]
    variables = {name: clausifier.fresh() for name in names}
    numbers = list(variables.values())
    component = modes.component

    def add(text: str, new: Iterable[Clause]) -> None:
        found = list(new)
        clauses.extend(found)
        origins.extend([len(rules)] * len(found))
        rules.append(Rule(text, "mode", modes.line))

    add(f"ab({component}) -> {' or '.join(names)}", [(healthy, *numbers)])
    add(f"{' or '.join(names)} -> ab({component})", [(-number, -healthy) for number in numbers])
    pairs = [(-a, -b) for index, a in enumerate(numbers) for b in numbers[index + 1 :]]
    if pairs:
        add(f"at most one mode of {component}", pairs)
    for name, formulas in modes.formulas.items():
        for formula in formulas:
            found = clausifier.clauses(formula)
            # Definitions of auxiliary variables hold in every mode, yet guarding them all keeps this simple.
            text = f"{component} in mode {name} -> {describe(formula)}"
            add(text, [(-variables[name], *clause) for clause in found])
    return variables


def describe(formula: Formula, nested: bool = False) -> str:
    """Return a formula as a sentence of the language."""
    match formula:
        case Leaf(literal):
            return str(literal)
        case Truth(value):
            return str(value).lower()
        case Not(body):
            return f"not {describe(body, True)}"
        case And(parts) | Or(parts):
            if not parts:
                return str(isinstance(formula, And)).lower()
            word = " and " if isinstance(formula, And) else " or "
            text = word.join(describe(part, True) for part in parts)
        case Implies(left, right):
            text = f"{describe(left, True)} -> {describe(right, True)}"
        case Iff(left, right):
            text = f"{describe(left, True)} <-> {describe(right, True)}"
        case Quantified(universal, variable, sort, guard, body):
            word = "forall" if universal else "exists"
            where = f" where {' and '.join(map(str, guard))}" if guard else ""
            text = f"{word} {variable} in {sort}{where}: {describe(body)}"
    return f"({text})" if nested else text


def _weak(clauses: Iterable[Clause], components: int) -> bool:
    """Nothing follows from being abnormal: no clause has a health variable as one of its alternatives."""
    return not any(0 < literal <= components for clause in clauses for literal in clause)


def _shifted(literal: int, first_auxiliary: int, shift: int) -> int:
    if literal > first_auxiliary:
        return literal + shift
    return literal - shift if literal < -first_auxiliary else literal
