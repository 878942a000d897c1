"""One `(:action …)` to a Schema: parameters, precondition, effects and cost, checked word by word.

What is allowed is told in robomend.planning.domain.loading. Effects are flattened on the way: a `forall`
inside becomes variables, a `when` a condition, and each Effect is one atom added or deleted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from robomend.planning.domain.formulas import (
    TRUE,
    Conjunction,
    Disjunction,
    Equal,
    Exists,
    Forall,
    Formula,
    Is,
    Negation,
    Typed,
)
from robomend.planning.domain.sexpr import Brackets, Word, fail
from robomend.planning.domain.values import PAIRS, Effect, Schema
from robomend.planning.domain.vocabulary import DomainVocabulary

DEFAULT_COST = 1.0
MAX_PARAMETERS = 8
FIELDS = (":parameters", ":precondition", ":effect")

_Scope = Mapping[str, str]
"""The variables that are declared here, with their types."""


def action_name(section: Brackets) -> Word:
    """Return NAME of `(:action NAME …)`."""
    if len(section.items) < 2 or not isinstance(section.items[1], Word):
        fail(section, "expected (:action NAME :parameters (…) :precondition … :effect …)")
    return section.items[1]


def parse_action(section: Brackets, vocabulary: DomainVocabulary) -> Schema:
    """Return the checked action.

    Raises:
        DomainError: with file, line, and what is allowed.
    """
    name = action_name(section).text
    fields = _fields(section, name)
    if ":effect" not in fields:
        fail(section, f"action {name!r} has no :effect")
    given = fields.get(":parameters")
    parameters = vocabulary.variables(given.items, given) if given else ()
    if len(parameters) > MAX_PARAMETERS:
        fail(section, f"action {name!r} has {len(parameters)} parameters; at most {MAX_PARAMETERS}")
    scope = dict(parameters)
    reader = _ActionReader(vocabulary)
    condition = fields.get(":precondition")
    precondition = reader.condition(condition, scope) if condition and condition.items else TRUE
    reader.effect(fields[":effect"], scope, (), TRUE)
    if not reader.effects:
        fail(fields[":effect"], f"action {name!r} changes nothing")
    _check_pairs(name, reader.effects, vocabulary, fields[":effect"])
    cost = sum(reader.costs) if reader.costs else DEFAULT_COST
    return Schema(name, parameters, precondition, tuple(reader.effects), cost, section.line, section.file)


def _fields(section: Brackets, name: str) -> dict[str, Brackets]:
    fields: dict[str, Brackets] = {}
    rest = list(section.items[2:])
    while rest:
        key = rest.pop(0)
        if not isinstance(key, Word) or key.text not in FIELDS:
            found = key.text if isinstance(key, Word) else "a bracket"
            fail(key, f"expected one of {', '.join(FIELDS)} in action {name!r}, found {found!r}")
        if key.text in fields:
            fail(key, f"{key.text} is given twice in action {name!r}")
        value = rest.pop(0) if rest else None
        if not isinstance(value, Brackets):
            fail(key, f"{key.text} of action {name!r} needs a bracket after it")
        fields[key.text] = value
    return fields


class _ActionReader:
    """Reads conditions, and gathers the effects and costs of one action."""

    def __init__(self, vocabulary: DomainVocabulary) -> None:
        self._vocabulary = vocabulary
        self.effects: list[Effect] = []
        self.costs: list[float] = []

    # --- conditions -----------------------------------------------------------------------------

    def condition(self, item: Word | Brackets, scope: _Scope) -> Formula:
        """Return a condition as a formula."""
        if not isinstance(item, Brackets):
            fail(item, f"expected a condition in brackets, found {item.text!r}")
        if not item.items:
            return TRUE
        head = item.head
        if head is None:
            fail(item, "a condition starts with a word: and, or, not, imply, forall, exists, or a predicate")
        parts = item.items[1:]
        if head in ("and", "or"):
            formulas = tuple(self.condition(part, scope) for part in parts)
            return Conjunction(formulas) if head == "and" else Disjunction(formulas)
        if head == "not":
            _count(item, 1)
            return Negation(self.condition(parts[0], scope))
        if head == "imply":
            _count(item, 2)
            return Disjunction((Negation(self.condition(parts[0], scope)), self.condition(parts[1], scope)))
        if head in ("forall", "exists"):
            variables, inner = self._quantified(item, scope)
            body = self.condition(parts[1], inner)
            return Forall(variables, body) if head == "forall" else Exists(variables, body)
        if head == "=":
            _count(item, 2)
            return Equal(self._term(parts[0], scope)[0], self._term(parts[1], scope)[0])
        return self._atom(item, scope)

    def _quantified(self, item: Brackets, scope: _Scope) -> tuple[Typed, _Scope]:
        """Return the variables of a quantifier, and the scope inside it."""
        _count(item, 2)
        listed = item.items[1]
        if not isinstance(listed, Brackets) or not listed.items:
            fail(item, f"{item.head} needs its variables in brackets, then one condition or effect")
        variables = self._vocabulary.variables(listed.items, listed)
        for name, _ in variables:
            if name in scope:
                fail(listed, f"{name} is declared already, further out; use another name")
        return variables, {**scope, **dict(variables)}

    def _term(self, item: Word | Brackets, scope: _Scope) -> tuple[str, str]:
        """Return a term and its type."""
        if not isinstance(item, Word):
            fail(item, "expected a variable or a constant, found a bracket")
        if item.text.startswith("?"):
            if item.text not in scope:
                known = f"; declared are {', '.join(scope)}" if scope else "; none is declared"
                fail(item, f"the variable {item.text} is not declared{known}")
            return item.text, scope[item.text]
        constants = self._vocabulary.constants
        if item.text not in constants:
            fail(item, f"{item.text!r} is neither a variable (?{item.text}) nor in (:constants …)")
        return item.text, constants[item.text]

    def _atom(self, item: Brackets, scope: _Scope) -> Is:
        predicate = self._vocabulary.predicate_of(item)
        terms = [self._term(part, scope) for part in item.items[1:]]
        self._vocabulary.check_arity(predicate, len(terms), item)
        for (term, kind), wanted in zip(terms, predicate.types, strict=True):
            if not self._vocabulary.is_a(kind, wanted):
                fail(item, f"{predicate.name} wants a {wanted} here, and {term} is a {kind}")
        return Is(predicate.name, tuple(term for term, _ in terms))

    # --- effects --------------------------------------------------------------------------------

    def effect(self, item: Word | Brackets, scope: _Scope, variables: Typed, condition: Formula) -> None:
        """Gather an effect that happens for all `variables` (also in `scope`) where `condition` holds."""
        if not isinstance(item, Brackets):
            fail(item, f"expected an effect in brackets, found {item.text!r}")
        head = item.head
        if not item.items:
            return
        if head == "and":
            for part in item.items[1:]:
                self.effect(part, scope, variables, condition)
        elif head == "forall":
            new, inner = self._quantified(item, scope)
            self.effect(item.items[2], inner, variables + new, condition)
        elif head == "when":
            _count(item, 2)
            more = self.condition(item.items[1], scope)
            both = more if condition == TRUE else Conjunction((condition, more))
            self.effect(item.items[2], scope, variables, both)
        elif head == "increase":
            if variables or condition != TRUE:
                fail(item, "a cost cannot depend on a condition")
            self.costs.append(_cost(item))
        elif head == "not":
            _count(item, 1)
            part = item.items[1]
            if not isinstance(part, Brackets):
                fail(item, "(not …) in an effect takes a fact in brackets")
            self.effects.append(Effect(variables, condition, self._atom(part, scope), adds=False))
        elif head is None:
            fail(item, "an effect starts with a word: and, not, forall, when, increase, or a predicate")
        else:
            self.effects.append(Effect(variables, condition, self._atom(item, scope), adds=True))


def _count(item: Brackets, wanted: int) -> None:
    if len(item.items) - 1 != wanted:
        fail(item, f"{item.head} takes {wanted} part{'s' * (wanted > 1)}, found {len(item.items) - 1}")


def _cost(item: Brackets) -> float:
    parts = item.items[1:]
    if len(parts) != 2 or not isinstance(parts[0], Brackets) or parts[0].head != "total-cost":
        fail(item, "the only numeric effect is (increase (total-cost) NUMBER)")
    word = parts[1]
    try:
        cost = float(word.text) if isinstance(word, Word) else -1.0
    except ValueError:
        cost = -1.0
    if not 0 <= cost < 1e9:
        fail(item, "a cost is a number from 0 up to 1e9")
    return cost


def _check_pairs(name: str, effects: Sequence[Effect], vocabulary: DomainVocabulary, where: Brackets) -> None:
    """An action that adds a fact and leaves its opposite would plan in a state that cannot be."""
    deleted = {(effect.condition, effect.atom) for effect in effects if not effect.adds}
    for effect in effects:
        if not effect.adds:
            continue
        for pair in PAIRS:
            if effect.atom.predicate not in pair or not set(pair) <= vocabulary.predicates.keys():
                continue
            other = pair[1] if effect.atom.predicate == pair[0] else pair[0]
            opposite = Is(other, effect.atom.terms)
            if (TRUE, opposite) not in deleted and (effect.condition, opposite) not in deleted:
                terms = " ".join(effect.atom.terms)
                fail(
                    where,
                    f"action {name!r} adds ({effect.atom.predicate} {terms}) and leaves "
                    f"({other} {terms}); add (not ({other} {terms}))",
                )
