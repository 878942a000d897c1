"""Check and parse a domain that robomend.repair.sexpr has read.

What is allowed is told in robomend.repair.domain_loading.
"""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import NoReturn

from robomend.errors import DomainError
from robomend.repair.domain import PAIRS, Declared, Domain, Effect, Predicate, Schema
from robomend.repair.formulas import (
    TRUE,
    And,
    Equal,
    Exists,
    Forall,
    Formula,
    Is,
    Not,
    Or,
    Typed,
    atoms,
)
from robomend.repair.sexpr import Group, Word

SECTIONS = frozenset(
    {":requirements", ":types", ":constants", ":predicates", ":functions", ":action", ":objects", ":init"}
)
REQUIREMENTS = frozenset(
    {
        ":strips",
        ":typing",
        ":adl",
        ":action-costs",
        ":equality",
        ":negative-preconditions",
        ":disjunctive-preconditions",
        ":existential-preconditions",
        ":universal-preconditions",
        ":quantified-preconditions",
        ":conditional-effects",
    }
)
DEFAULT_COST = 1.0
MAX_PARAMETERS = 8

_Scope = Mapping[str, str]


def parse(source: Group) -> Domain:
    """Return the checked domain.

    Raises:
        DomainError: with file, line, and what is allowed.
    """
    return _Parser(source).domain()


def fail(where: Word | Group, message: str) -> NoReturn:
    raise DomainError(message, where.file, where.line)


def domain_name(group: Group) -> Word:
    """Return NAME of `(define (domain NAME) …)`."""
    items = group.items
    if group.head != "define" or len(items) < 2 or not isinstance(items[1], Group):
        raise DomainError("expected (define (domain NAME) …)", group.file, group.line)
    head = items[1]
    if head.head != "domain" or len(head.items) != 2 or not isinstance(head.items[1], Word):
        raise DomainError("expected (domain NAME) after define", head.file, head.line)
    return head.items[1]


def _hint(name: str, known: Mapping[str, object] | frozenset[str]) -> str:
    near = get_close_matches(name, sorted(known), n=1)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known are {', '.join(sorted(known))}" if known else ""


class _Parser:
    def __init__(self, source: Group) -> None:
        self.source = source
        self.supertype: dict[str, str] = {}
        self.constants: dict[str, str] = {}
        self.predicates: dict[str, Predicate] = {}
        self.schemas: dict[str, Schema] = {}
        self.objects: list[Declared] = []
        self.facts: list[Declared] = []

    def domain(self) -> Domain:
        name = domain_name(self.source)
        sections: dict[str, list[Group]] = {section: [] for section in SECTIONS}
        for item in self.source.items[2:]:
            head = item.head if isinstance(item, Group) else None
            if not isinstance(item, Group) or head is None:
                fail(item, "expected a section such as (:action …)")
            if head not in SECTIONS:
                fail(item, f"unknown section {head!r}{_hint(head, SECTIONS)}")
            sections[head].append(item)
        for section in sections[":requirements"]:
            self._requirements(section)
        for section in sections[":types"]:
            self._types(section)
        self._check_type_cycles(sections[":types"])
        for section in sections[":constants"]:
            for word, kind in self._typed(section.items[1:], section):
                if word.text in self.constants:
                    fail(word, f"the constant {word.text!r} is declared twice")
                self.constants[word.text] = kind
        for section in sections[":predicates"]:
            for item in section.items[1:]:
                self._predicate(item)
        for section in sections[":functions"]:
            self._functions(section)
        if "good" not in self.predicates or "component" not in self.supertype:
            fail(
                self.source,
                "a repair domain declares the type `component` and (good ?c - component), its goal",
            )
        for section in sections[":action"]:
            self._action(section)
        for section in sections[":objects"]:
            for word, kind in self._typed(section.items[1:], section):
                self.objects.append(Declared((word.text, kind), (word.quoted, False), word.line, word.file))
        for section in sections[":init"]:
            for item in section.items[1:]:
                self._fact(item)
        domain = Domain(
            name.text,
            self.supertype,
            self.predicates,
            self.schemas,
            self.constants,
            tuple(self.objects),
            tuple(self.facts),
            self.source,
        )
        self._check_conditions(domain)
        return domain

    # --- declarations ---------------------------------------------------------------------------

    def _requirements(self, section: Group) -> None:
        for item in section.items[1:]:
            if not isinstance(item, Word):
                fail(item, "requirements are words such as :typing")
            if item.text not in REQUIREMENTS:
                fail(item, f"{item.text} is not supported; supported are {', '.join(sorted(REQUIREMENTS))}")

    def _typed(self, items: tuple[Word | Group, ...], where: Group) -> list[tuple[Word, str]]:
        """Return the words of a typed list, `a b - t c`, each with its type."""
        found: list[tuple[Word, str]] = []
        waiting: list[Word] = []
        rest = iter(items)
        for item in rest:
            if not isinstance(item, Word):
                fail(item, "expected a name, found a bracket")
            if item.text != "-" or item.quoted:
                waiting.append(item)
                continue
            kind = next(rest, None)
            if isinstance(kind, Group):
                fail(kind, "(either …) is not supported; declare a common supertype")
            if kind is None or not waiting:
                fail(item, "'-' stands between names and their type")
            # In (:types …) a supertype may come later: _check_type_cycles looks.
            known = kind.text == "object" or kind.text in self.supertype or where.head == ":types"
            if not known:
                fail(kind, f"unknown type {kind.text!r}{_hint(kind.text, self.supertype)}")
            found.extend((word, kind.text) for word in waiting)
            waiting = []
        return found + [(word, "object") for word in waiting]

    def _types(self, section: Group) -> None:
        for word, parent in self._typed(section.items[1:], section):
            if word.text == "object":
                fail(word, "`object` is the root of all types and needs no declaration")
            if word.text in self.supertype:
                fail(word, f"the type {word.text!r} is declared twice")
            self.supertype[word.text] = parent

    def _check_type_cycles(self, sections: list[Group]) -> None:
        where = sections[-1] if sections else self.source
        for name, parent in self.supertype.items():
            if parent != "object" and parent not in self.supertype:
                word = _find(sections, parent) or where
                fail(word, f"unknown type {parent!r}{_hint(parent, self.supertype)}")
            seen = {name}
            while parent != "object":
                if parent in seen:
                    fail(_find(sections, name) or where, f"the type {name!r} is a kind of itself")
                seen.add(parent)
                parent = self.supertype.get(parent, "object")

    def _predicate(self, item: Word | Group) -> None:
        if not isinstance(item, Group) or item.head is None:
            fail(item, "expected a predicate such as (broken ?c - component)")
        name = item.head
        if name in ("=", "and", "or", "not", "imply", "forall", "exists", "when", "increase"):
            fail(item, f"{name!r} is a word of the language, not a predicate")
        if name in self.predicates:
            fail(item, f"the predicate {name!r} is declared twice")
        variables = self._variables(item.items[1:], item)
        self.predicates[name] = Predicate(name, tuple(kind for _, kind in variables))

    def _variables(self, items: tuple[Word | Group, ...], where: Group) -> Typed:
        variables: dict[str, str] = {}
        for word, kind in self._typed(items, where):
            if not word.text.startswith("?") or len(word.text) < 2:
                fail(word, f"{word.text!r} is no variable; variables start with '?'")
            if word.text in variables:
                fail(word, f"the variable {word.text} is declared twice")
            variables[word.text] = kind
        return tuple(variables.items())

    def _functions(self, section: Group) -> None:
        for item in section.items[1:]:
            if isinstance(item, Word) and item.text in ("-", "number"):
                continue
            if isinstance(item, Group) and item.head == "total-cost" and len(item.items) == 1:
                continue
            fail(item, "the only function is (total-cost); numbers are not supported")

    def _fact(self, item: Word | Group) -> None:
        if not isinstance(item, Group) or item.head is None:
            fail(item, "expected a fact such as (on_bus imu usb1)")
        name = item.head
        if name == "=" and len(item.items) > 1 and isinstance(item.items[1], Group):
            if item.items[1].head == "total-cost":
                return
            fail(item, "the only function is (total-cost); numbers are not supported")
        if name == "not":
            fail(item, "init lists what is true; leave out what is false")
        predicate = self._known_predicate(item)
        words = [word for word in item.items if isinstance(word, Word)]
        if len(words) != len(item.items):
            fail(item, f"the arguments of {name} are names")
        self._check_arity(predicate, len(words) - 1, item)
        for word in words[1:]:
            if word.text.startswith("?"):
                fail(word, f"a fact has no variables, found {word.text}")
        self.facts.append(
            Declared(
                tuple(word.text for word in words),
                tuple(word.quoted for word in words),
                item.line,
                item.file,
            )
        )

    # --- actions --------------------------------------------------------------------------------

    def _action(self, section: Group) -> None:
        items = section.items
        if len(items) < 2 or not isinstance(items[1], Word):
            fail(section, "expected (:action NAME :parameters (…) :precondition … :effect …)")
        name = items[1].text
        if name in self.schemas:
            fail(items[1], f"the action {name!r} is declared twice")
        fields: dict[str, Group] = {}
        rest = list(items[2:])
        while rest:
            key = rest.pop(0)
            allowed = (":parameters", ":precondition", ":effect")
            if not isinstance(key, Word) or key.text not in allowed:
                found = key.text if isinstance(key, Word) else "a bracket"
                fail(key, f"expected one of {', '.join(allowed)} in action {name!r}, found {found!r}")
            if key.text in fields:
                fail(key, f"{key.text} is given twice in action {name!r}")
            if not rest or not isinstance(rest[0], Group):
                fail(key, f"{key.text} of action {name!r} needs a bracket after it")
            value = rest.pop(0)
            assert isinstance(value, Group)
            fields[key.text] = value
        if ":effect" not in fields:
            fail(section, f"action {name!r} has no :effect")
        given = fields.get(":parameters")
        parameters = self._variables(given.items, given) if given else ()
        if len(parameters) > MAX_PARAMETERS:
            fail(section, f"action {name!r} has {len(parameters)} parameters; at most {MAX_PARAMETERS}")
        scope = dict(parameters)
        condition = fields.get(":precondition")
        precondition = self._formula(condition, scope) if condition and condition.items else TRUE
        effects: list[Effect] = []
        costs: list[float] = []
        self._effect(fields[":effect"], scope, (), TRUE, effects, costs)
        if not effects:
            fail(fields[":effect"], f"action {name!r} changes nothing")
        self._check_pairs(name, effects, fields[":effect"])
        cost = sum(costs) if costs else DEFAULT_COST
        self.schemas[name] = Schema(
            name, parameters, precondition, tuple(effects), cost, section.line, section.file
        )

    def _formula(self, item: Word | Group, scope: _Scope) -> Formula:
        if not isinstance(item, Group):
            fail(item, f"expected a condition in brackets, found {item.text!r}")
        if not item.items:
            return TRUE
        head = item.head
        if head is None:
            fail(item, "a condition starts with a word: and, or, not, imply, forall, exists, or a predicate")
        parts = item.items[1:]
        if head in ("and", "or"):
            formulas = tuple(self._formula(part, scope) for part in parts)
            return And(formulas) if head == "and" else Or(formulas)
        if head == "not":
            self._count(item, 1)
            return Not(self._formula(parts[0], scope))
        if head == "imply":
            self._count(item, 2)
            return Or((Not(self._formula(parts[0], scope)), self._formula(parts[1], scope)))
        if head in ("forall", "exists"):
            variables, inner = self._quantified(item, scope)
            body = self._formula(parts[1], inner)
            return Forall(variables, body) if head == "forall" else Exists(variables, body)
        if head == "=":
            self._count(item, 2)
            return Equal(self._term(parts[0], scope)[0], self._term(parts[1], scope)[0])
        return self._atom(item, scope)

    def _quantified(self, item: Group, scope: _Scope) -> tuple[Typed, _Scope]:
        self._count(item, 2)
        listed = item.items[1]
        if not isinstance(listed, Group) or not listed.items:
            fail(item, f"{item.head} needs its variables in brackets, then one condition or effect")
        variables = self._variables(listed.items, listed)
        for name, _ in variables:
            if name in scope:
                fail(listed, f"{name} is declared already, further out; use another name")
        return variables, {**scope, **dict(variables)}

    def _count(self, item: Group, wanted: int) -> None:
        if len(item.items) - 1 != wanted:
            fail(item, f"{item.head} takes {wanted} part{'s' * (wanted > 1)}, found {len(item.items) - 1}")

    def _term(self, item: Word | Group, scope: _Scope) -> tuple[str, str]:
        """Return a term and its type."""
        if not isinstance(item, Word):
            fail(item, "expected a variable or a constant, found a bracket")
        if item.text.startswith("?"):
            if item.text not in scope:
                known = f"; declared are {', '.join(scope)}" if scope else "; none is declared"
                fail(item, f"the variable {item.text} is not declared{known}")
            return item.text, scope[item.text]
        if item.text not in self.constants:
            fail(item, f"{item.text!r} is neither a variable (?{item.text}) nor in (:constants …)")
        return item.text, self.constants[item.text]

    def _atom(self, item: Group, scope: _Scope) -> Is:
        predicate = self._known_predicate(item)
        terms = [self._term(part, scope) for part in item.items[1:]]
        self._check_arity(predicate, len(terms), item)
        for (term, kind), wanted in zip(terms, predicate.types, strict=True):
            if not self._is_a(kind, wanted):
                fail(item, f"{predicate.name} wants a {wanted} here, and {term} is a {kind}")
        return Is(predicate.name, tuple(term for term, _ in terms))

    def _known_predicate(self, item: Group) -> Predicate:
        name = item.head or ""
        if name not in self.predicates:
            fail(item, f"unknown predicate {name!r}{_hint(name, self.predicates)}")
        return self.predicates[name]

    def _check_arity(self, predicate: Predicate, found: int, where: Group) -> None:
        if found != len(predicate.types):
            wanted = len(predicate.types)
            fail(where, f"{predicate.name} takes {wanted} argument{'s' * (wanted != 1)}, found {found}")

    def _is_a(self, kind: str, wanted: str) -> bool:
        while kind != wanted and kind != "object":
            kind = self.supertype[kind]
        return kind == wanted

    def _effect(
        self,
        item: Word | Group,
        scope: _Scope,
        variables: Typed,
        condition: Formula,
        effects: list[Effect],
        costs: list[float],
    ) -> None:
        if not isinstance(item, Group):
            fail(item, f"expected an effect in brackets, found {item.text!r}")
        head = item.head
        if not item.items:
            return
        if head == "and":
            for part in item.items[1:]:
                self._effect(part, scope, variables, condition, effects, costs)
        elif head == "forall":
            new, inner = self._quantified(item, scope)
            self._effect(item.items[2], inner, variables + new, condition, effects, costs)
        elif head == "when":
            self._count(item, 2)
            more = self._formula(item.items[1], scope)
            both = more if condition == TRUE else And((condition, more))
            self._effect(item.items[2], scope, variables, both, effects, costs)
        elif head == "increase":
            if variables or condition != TRUE:
                fail(item, "a cost cannot depend on a condition")
            costs.append(self._cost(item))
        elif head == "not":
            self._count(item, 1)
            part = item.items[1]
            if not isinstance(part, Group):
                fail(item, "(not …) in an effect takes a fact in brackets")
            effects.append(Effect(variables, condition, self._atom(part, scope), adds=False))
        elif head is None:
            fail(item, "an effect starts with a word: and, not, forall, when, increase, or a predicate")
        else:
            effects.append(Effect(variables, condition, self._atom(item, scope), adds=True))

    def _cost(self, item: Group) -> float:
        parts = item.items[1:]
        if len(parts) != 2 or not isinstance(parts[0], Group) or parts[0].head != "total-cost":
            fail(item, "the only numeric effect is (increase (total-cost) NUMBER)")
        word = parts[1]
        try:
            cost = float(word.text) if isinstance(word, Word) else -1.0
        except ValueError:
            cost = -1.0
        if not 0 <= cost < 1e9:
            fail(item, "a cost is a number from 0 up to 1e9")
        return cost

    # --- checks over a whole action -------------------------------------------------------------

    def _check_pairs(self, name: str, effects: list[Effect], where: Group) -> None:
        """An action that adds a fact and leaves its opposite would plan in a state that cannot be."""
        deleted = {(e.variables, e.condition, e.atom) for e in effects if not e.adds}
        for effect in effects:
            if not effect.adds:
                continue
            for pair in PAIRS:
                if effect.atom.predicate not in pair or not set(pair) <= self.predicates.keys():
                    continue
                other = pair[1] if effect.atom.predicate == pair[0] else pair[0]
                opposite = Is(other, effect.atom.terms)
                if not any(
                    atom == opposite and condition in (TRUE, effect.condition)
                    for _, condition, atom in deleted
                ):
                    terms = " ".join(effect.atom.terms)
                    fail(
                        where,
                        f"action {name!r} adds ({effect.atom.predicate} {terms}) and leaves "
                        f"({other} {terms}); add (not ({other} {terms}))",
                    )

    def _check_conditions(self, domain: Domain) -> None:
        for schema in domain.schemas.values():
            for effect in schema.effects:
                for atom in atoms(effect.condition):
                    if atom.predicate not in domain.static:
                        raise DomainError(
                            f"`when` in action {schema.name!r} asks for {atom.predicate}, which actions "
                            "change; only static predicates may guard an effect: write two actions instead",
                            schema.file,
                            schema.line,
                        )


def _find(sections: list[Group], name: str) -> Word | None:
    words = (word for section in sections for word in section.items if isinstance(word, Word))
    return next((word for word in words if word.text == name), None)
