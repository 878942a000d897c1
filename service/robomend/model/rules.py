"""The user's own rules and the sentences of fault modes: text to checked, ground formulas.

Rules share the language of observations (robomend.model.sentences) and may also speak of AB: `not
ab(router) -> ok(link)`, `forall n in nodes where on_host(n, arm_pc): running(n) -> ok(arm_pc_link)`. What
they speak of is declared by that: new predicates, and new names of `ok`. A name of another sort (`on`,
`running`, trends, `ab`) must be the model's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
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
    leaves,
)
from robomend.model.grounding import ground
from robomend.model.sentences import parse
from robomend.model.vocabulary import Vocabulary
from robomend_client.literals import Atom, Literal

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
