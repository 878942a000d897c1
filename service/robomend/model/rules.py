"""The user's own rules and the sentences of fault modes: text to checked, ground formulas.

Rules share the language of observations (robomend.model.sentences) and may also speak of AB: `not
ab(router) -> ok(link)`, `forall n in nodes where on_host(n, arm_pc): running(n) -> ok(arm_pc_link)`. What
they speak of is declared by that: new predicates, and new names of `ok`. A name of another sort (`on`,
`running`, trends, `ab`) must be the model's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

from robomend.errors import ModelError, ObservationError, UnknownComponent
from robomend.model.budget import MODEL_STEPS, StepCount
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
    Variable,
    leaves,
    quantified,
)
from robomend.model.sentences import parse
from robomend.model.vocabulary import Vocabulary
from robomend.resources import resource
from robomend_client.literals import Atom, Literal

# --- quantifiers over the sorts of a model become conjunctions and disjunctions; clingo finds the instances.
#
# A quantifier is a rule of encodings/grounding.lp: its variables range over sorts, and the guard after
# `where` joins them over what the model fixes (`forall n in nodes, h in hardware where drives(n, h): …`).
# Clingo's grounder does that join. Names go in as numbers and come back as numbers: nothing that a user
# wrote becomes program text.
#
# Whoever calls has counted the steps before (robomend.model.budget): nothing grows beyond that here.


def ground(formula: Formula, vocabulary: Vocabulary) -> Formula:
    """Return the formula without quantifiers: `forall` over nothing is true, `exists` over nothing false."""
    if not quantified(formula):
        return formula
    program = _Program(vocabulary)
    program.collect(formula, scope=(), parent=None)
    return _Instances(program, program.solve()).ground(formula, {})


@dataclass
class _Program:
    """One rule per quantifier, numbered in the order of the sentence."""

    vocabulary: Vocabulary
    rules: list[str] = field(default_factory=list)
    sorts: set[str] = field(default_factory=set)
    relations: set[str] = field(default_factory=set)
    names: dict[str, int] = field(default_factory=dict)
    numbers: dict[int, int] = field(default_factory=dict)  # identity of a quantifier -> its number

    def collect(self, formula: Formula, scope: tuple[Variable, ...], parent: int | None) -> None:
        match formula:
            case Quantified(_, variable, _, guard, body):
                number = len(self.rules)
                self.numbers[id(formula)] = number
                self.rules.append(self._rule(number, scope, parent, formula, guard))
                self.collect(body, (*scope, variable), number)
            case Not(body):
                self.collect(body, scope, parent)
            case And(parts) | Or(parts):
                for part in parts:
                    self.collect(part, scope, parent)
            case Implies(left, right) | Iff(left, right):
                self.collect(left, scope, parent)
                self.collect(right, scope, parent)
            case _:
                pass

    def _rule(
        self,
        number: int,
        scope: tuple[Variable, ...],
        parent: int | None,
        quantifier: Quantified,
        guard: tuple[Literal, ...],
    ) -> str:
        places = {str(name): f"V{index}" for index, name in enumerate((*scope, quantifier.variable))}
        last = f"V{len(scope)}"
        self.sorts.add(quantifier.sort)
        body = [f'member("{quantifier.sort}", {last})']
        if parent is not None:
            body.insert(0, f"bound({parent}, {_tuple(list(places.values())[:-1])})")
        for literal in guard:
            self.relations.add(literal.atom.predicate)
            terms = ", ".join(
                places[arg] if isinstance(arg, Variable) else str(self.number(arg))
                for arg in literal.atom.args
            )
            name = "same" if literal.atom.predicate == "same" else f'"{literal.atom.predicate}"'
            body.append(f"{'' if literal.positive else 'not '}relation({name}, {terms})")
        return f"bound({number}, {_tuple(list(places.values()))}) :- {', '.join(body)}."

    def number(self, name: str) -> int:
        return self.names.setdefault(str(name), len(self.names))

    def solve(self) -> Mapping[int, list[tuple[str, ...]]]:
        """Return quantifier -> its instances, sorted by the order of the model."""
        import clingo

        facts = [
            f'member("{sort}", {self.number(name)}).'
            for sort in sorted(self.sorts)
            for name in self.vocabulary.sorts[sort]
        ]
        facts += [
            f'relation("{relation}", {self.number(one)}, {self.number(other)}).'
            for relation in sorted(self.relations - {"same"})
            for one, other in sorted(self.vocabulary.relations[relation])
        ]
        facts.append(f"name(0..{len(self.names) - 1}).")
        control = clingo.Control(["--warn=none"])
        control.load(str(resource("encodings", "grounding.lp")))
        control.add("sentence", [], "\n".join([*facts, *self.rules]))
        control.ground([("base", []), ("sentence", [])])
        names = list(self.names)
        found: dict[int, list[tuple[int, ...]]] = {}
        for atom in control.symbolic_atoms.by_signature("bound", 2):
            quantifier, values = atom.symbol.arguments
            found.setdefault(quantifier.number, []).append(tuple(v.number for v in values.arguments))
        return {
            quantifier: [tuple(names[value] for value in values) for values in sorted(instances)]
            for quantifier, instances in found.items()
        }


class _Instances:
    """Walks the formula with the values of the variables in scope."""

    def __init__(self, program: _Program, found: Mapping[int, list[tuple[str, ...]]]) -> None:
        self.numbers = program.numbers
        self.values: dict[tuple[int, tuple[str, ...]], list[str]] = {}  # quantifier, values around it
        for quantifier, instances in found.items():
            for values in instances:
                self.values.setdefault((quantifier, values[:-1]), []).append(values[-1])

    def ground(self, formula: Formula, scope: Mapping[str, str]) -> Formula:
        match formula:
            case Leaf(literal, position):
                atom = literal.atom
                args = tuple(scope[arg] if isinstance(arg, Variable) else arg for arg in atom.args)
                return Leaf(Literal(Atom(atom.predicate, args), literal.positive), position)
            case Quantified(universal, variable, _, _, body):
                around = tuple(scope.values())
                values = self.values.get((self.numbers[id(formula)], around), ())
                parts = tuple(self.ground(body, {**scope, variable: value}) for value in values)
                if not parts:
                    return Truth(universal)
                return And(parts) if universal else Or(parts)
            case Not(body):
                return Not(self.ground(body, scope))
            case And(parts):
                return And(tuple(self.ground(part, scope) for part in parts))
            case Or(parts):
                return Or(tuple(self.ground(part, scope) for part in parts))
            case Implies(left, right):
                return Implies(self.ground(left, scope), self.ground(right, scope))
            case Iff(left, right):
                return Iff(self.ground(left, scope), self.ground(right, scope))
            case Truth():
                return formula


def _tuple(terms: list[str]) -> str:
    """Return clingo's tuple, which needs a comma when it holds one term."""
    return f"({', '.join(terms)}{',' if len(terms) == 1 else ''})"


T = TypeVar("T")

ABNORMAL = {"ab": True, "AB": True, "nab": False, "NAB": False}


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence of the model, and where it stands."""

    text: str
    place: str  # "rule 2", "mode stuck of arm"
    line: int | None = None


def read_rules(
    sentences: Iterable[Sentence],
    vocabulary: Vocabulary,
    file: str | None = None,
    most: int = MODEL_STEPS,
    spent: int = 0,
) -> tuple[list[Formula], Vocabulary, list[str]]:
    """Return the ground formulas, the vocabulary with what they declare, and warnings.

    Args:
        most: steps that the model may take (robomend.model.budget), of which `spent` are.

    Raises:
        ModelError: a sentence that cannot be read, that takes too many steps, or that names what there is
            not.
    """
    rules = list(sentences)
    formulas = [
        _in_place(rule, file, parse, rule.text, vocabulary.sorts, vocabulary.relations) for rule in rules
    ]
    _check_steps(rules, formulas, vocabulary, most, spent, file)
    formulas = [ground(formula, vocabulary) for formula in formulas]
    declared = _declared(formulas, vocabulary)
    components = frozenset(vocabulary.sorts.get("components", ()))
    warnings: dict[str, None] = {}
    checked = []
    for rule, formula in zip(rules, formulas, strict=True):

        def leaf(found: Leaf, rule: Sentence = rule) -> Formula:
            return Leaf(
                _checked(found, rule, vocabulary, declared, components, warnings, file), found.position
            )

        checked.append(mapped(formula, leaf))
    mentioned = {leaf.literal.atom for formula in checked for leaf in leaves(formula)}
    atoms = frozenset(a for a in mentioned if a.predicate != AB and not vocabulary.declares(a))
    return checked, _with_atoms(vocabulary, vocabulary.atoms | atoms), list(warnings)


def mapped(formula: Formula, leaf: Callable[[Leaf], Formula]) -> Formula:
    """Return the formula with `leaf` applied to its leaves."""
    match formula:
        case Leaf():
            return leaf(formula)
        case Truth():
            return formula
        case Not(body):
            return Not(mapped(body, leaf))
        case And(parts):
            return And(tuple(mapped(part, leaf) for part in parts))
        case Or(parts):
            return Or(tuple(mapped(part, leaf) for part in parts))
        case Implies(left, right):
            return Implies(mapped(left, leaf), mapped(right, leaf))
        case Iff(left, right):
            return Iff(mapped(left, leaf), mapped(right, leaf))
        case Quantified(universal, variable, sort, guard, body):
            return Quantified(universal, variable, sort, guard, mapped(body, leaf))


def _checked(
    found: Leaf,
    rule: Sentence,
    vocabulary: Vocabulary,
    declared: Vocabulary,
    components: frozenset[str],
    warnings: dict[str, None],
    file: str | None,
) -> Literal:
    atom = found.literal.atom
    if atom.predicate in ABNORMAL and len(atom.args) == 1:
        if atom.args[0] not in components:
            raise UnknownComponent(atom.args[0], components, file, rule.line)
        return Literal(Atom(AB, atom.args), found.literal.positive == ABNORMAL[atom.predicate])
    literal = declared.canonical(found.literal)
    if vocabulary.declares(literal.atom):
        return literal
    atom = literal.atom
    known = atom.predicate in vocabulary.predicates
    if known and not (atom.predicate == "ok" and len(atom.args) >= 1):
        try:
            vocabulary.check(literal, rule.text, found.position)
        except ObservationError as error:
            raise ModelError(f"{rule.place}: {error}", file, rule.line) from error
    if known:
        warnings[f"{rule.place} speaks of {atom}, which is no topic or property: taken as declared by it"] = (
            None
        )
    return literal


def _declared(formulas: Iterable[Formula], vocabulary: Vocabulary) -> Vocabulary:
    """Return the vocabulary with every atom of the rules, `not_p` counting as p where p is known."""
    raw = {leaf.literal.atom for formula in formulas for leaf in leaves(formula)}
    known = {atom.predicate for atom in raw} | set(vocabulary.predicates)
    prefix = vocabulary.negative_prefix
    kept = {
        atom
        for atom in raw
        if atom.predicate not in ABNORMAL
        and not (atom.predicate.startswith(prefix) and atom.predicate[len(prefix) :] in known)
    }
    return _with_atoms(vocabulary, vocabulary.atoms | kept)


def _with_atoms(vocabulary: Vocabulary, atoms: frozenset[Atom]) -> Vocabulary:
    return replace(vocabulary, atoms=atoms)


def _in_place(rule: Sentence, file: str | None, function: Callable[..., T], *arguments: object) -> T:
    try:
        return function(*arguments)
    except ObservationError as error:
        raise ModelError(f"{rule.place}: {error}", file, rule.line) from error


def _check_steps(
    rules: Iterable[Sentence],
    formulas: Iterable[Formula],
    vocabulary: Vocabulary,
    most: int,
    spent: int,
    file: str | None,
) -> None:
    """Refuse what takes too many steps, before the first one: a rule alone, or all of them together."""
    count = StepCount(vocabulary)
    for rule, formula in zip(rules, formulas, strict=True):
        steps = _in_place(rule, file, count.check, formula, most, rule.text)
        spent += steps
        if spent > most:
            raise ModelError(
                f"{rule.place}: with what is before it, the model takes {spent:,} steps; "
                f"at most {most:,} are taken{count.remedy(formula)}",
                file,
                rule.line,
            )
