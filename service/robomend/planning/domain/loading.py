"""PDDL text to a repair domain, checked and parsed once, with the user's own actions merged in.

    pddl/repair.pddl ──► read ──┐
                                ├─► merge ──► check and parse ──► Domain
    the user's text  ──► read ──┘

The user's text is a domain of its own when it declares the predicate `good`; otherwise it extends
repair.pddl: it names that domain, and its types, constants, predicates, actions, objects and init are added
to it. What is wrong is refused with file and line, and with what is allowed. Stock readers let an
undeclared variable or a wrong domain name pass, and name no line for a duplicate action, so the check is
ours.

Read: typing, equality, conjunction, disjunction, negation, implication and quantifiers in preconditions;
add, delete, `forall` and `when` in effects, `when` over static predicates only; constant costs. Refused, by
name: what the planners cannot do (numbers, durations, derived predicates, preferences).

Source: M. Fox, D. Long. PDDL2.1. JAIR 20, 2003, for the language.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache

from robomend.errors import DomainError
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
    atoms,
)
from robomend.planning.domain.sexpr import Brackets, Word, fail, read
from robomend.planning.domain.values import PAIRS, Declared, Domain, Effect, Predicate, Schema, is_a
from robomend.resources import resource
from robomend_client.near import did_you_mean

# --- what a domain declares: its types, constants and predicates, each use of them checked on the way in.
#
#     (:types …) (:constants …) (:predicates …)  ──►  DomainVocabulary  ──►  parse_action
#
# In that order: constants and predicates are typed, so the types are complete before them.

RESERVED = frozenset({"=", "and", "or", "not", "imply", "forall", "exists", "when", "increase"})
"""Words of the language, which name no predicate."""

MAX_TYPES = 1_000
"""Every use of a name walks up the kinds of its type."""


def hint(name: str, known: Collection[str]) -> str:
    """Return the end of a message on an unknown name: the one that was meant, or all there are."""
    return did_you_mean(name, known) or (f"; known are {', '.join(sorted(known))}" if known else "")


class DomainVocabulary:
    """The declared words of one domain. Every method refuses with DomainError, at the place of the word."""

    def __init__(self) -> None:
        self.supertype: dict[str, str] = {}  # type -> the type it is a kind of; `object` is the root
        self.constants: dict[str, str] = {}  # name -> type
        self.predicates: dict[str, Predicate] = {}

    # --- declarations ---------------------------------------------------------------------------

    def declare_types(self, sections: Sequence[Brackets]) -> None:
        """Read every (:types …) there is; a supertype may be declared later than its kinds."""
        for section in sections:
            for word, parent in self.typed(section.items[1:], section):
                if word.text == "object":
                    fail(word, "`object` is the root of all types and needs no declaration")
                if word.text in self.supertype:
                    fail(word, f"the type {word.text!r} is declared twice")
                self.supertype[word.text] = parent
                if len(self.supertype) > MAX_TYPES:
                    fail(word, f"more than {MAX_TYPES} types")
        for name, parent in self.supertype.items():
            if parent != "object" and parent not in self.supertype:
                fail(
                    _find(sections, parent) or sections[-1],
                    f"unknown type {parent!r}{hint(parent, self.supertype)}",
                )
            seen = {name}
            while parent != "object":
                if parent in seen:
                    fail(_find(sections, name) or sections[-1], f"the type {name!r} is a kind of itself")
                seen.add(parent)
                parent = self.supertype.get(parent, "object")

    def declare_constants(self, section: Brackets) -> None:
        """Read (:constants …)."""
        for word, kind in self.typed(section.items[1:], section):
            if word.text in self.constants:
                fail(word, f"the constant {word.text!r} is declared twice")
            self.constants[word.text] = kind

    def declare_predicates(self, section: Brackets) -> None:
        """Read (:predicates …)."""
        for item in section.items[1:]:
            if not isinstance(item, Brackets) or item.head is None:
                fail(item, "expected a predicate such as (broken ?c - component)")
            name = item.head
            if name in RESERVED:
                fail(item, f"{name!r} is a word of the language, not a predicate")
            if name in self.predicates:
                fail(item, f"the predicate {name!r} is declared twice")
            variables = self.variables(item.items[1:], item)
            self.predicates[name] = Predicate(name, tuple(kind for _, kind in variables))

    # --- uses -----------------------------------------------------------------------------------

    def typed(self, items: Sequence[Word | Brackets], where: Brackets) -> list[tuple[Word, str]]:
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
            if isinstance(kind, Brackets):
                fail(kind, "(either …) is not supported; declare a common supertype")
            if kind is None or not waiting:
                fail(item, "'-' stands between names and their type")
            # In (:types …) a supertype may come later: declare_types looks when it has them all.
            known = kind.text == "object" or kind.text in self.supertype or where.head == ":types"
            if not known:
                fail(kind, f"unknown type {kind.text!r}{hint(kind.text, self.supertype)}")
            found.extend((word, kind.text) for word in waiting)
            waiting = []
        return found + [(word, "object") for word in waiting]

    def variables(self, items: Sequence[Word | Brackets], where: Brackets) -> Typed:
        """Return the variables of a typed list, each name once."""
        variables: dict[str, str] = {}
        for word, kind in self.typed(items, where):
            if not word.text.startswith("?") or len(word.text) < 2:
                fail(word, f"{word.text!r} is no variable; variables start with '?'")
            if word.text in variables:
                fail(word, f"the variable {word.text} is declared twice")
            variables[word.text] = kind
        return tuple(variables.items())

    def predicate_of(self, item: Brackets) -> Predicate:
        """Return the predicate that heads an atom."""
        name = item.head or ""
        if name not in self.predicates:
            fail(item, f"unknown predicate {name!r}{hint(name, self.predicates)}")
        return self.predicates[name]

    def check_arity(self, predicate: Predicate, found: int, where: Brackets) -> None:
        """Refuse an atom with too few or too many arguments."""
        if found != len(predicate.types):
            wanted = len(predicate.types)
            fail(where, f"{predicate.name} takes {wanted} argument{'s' * (wanted != 1)}, found {found}")

    def is_a(self, kind: str, wanted: str) -> bool:
        """Return whether every object of type `kind` is one of type `wanted`."""
        return is_a(self.supertype, kind, wanted)


def _find(sections: Sequence[Brackets], name: str) -> Word | None:
    words = (word for section in sections for word in section.items if isinstance(word, Word))
    return next((word for word in words if word.text == name), None)


DEFAULT_DOMAIN = "repair.pddl"
MAX_CHARACTERS = 200_000


def load_domain(text: str | None = None, file: str | None = None, variants: str | None = None) -> Domain:
    """Return the domain of this text: the user's own whole domain, or repair.pddl extended by it.

    Args:
        text: PDDL; None or empty gives repair.pddl as it is.
        file: what messages call the text.
        variants: what is added to either (robomend.planning.configurations).

    Raises:
        DomainError: with file, line and what is allowed.
    """
    if text is None or not text.strip():
        return _load(None, None, variants)
    if len(text) > MAX_CHARACTERS:
        raise DomainError(f"{len(text)} characters; at most {MAX_CHARACTERS} are read", file)
    return _load(text, file, variants)


def shipped(name: str) -> str:
    """Return the text of a domain that robomend ships."""
    return resource("pddl", name).read_text(encoding="utf-8")


@lru_cache(maxsize=64)
def _load(text: str | None, file: str | None, variants: str | None) -> Domain:
    group = _shipped() if text is None else read(text, file)
    if not _declares(group, "good"):
        group = _merge(_shipped(), group)
    return parse(group if variants is None else _merge(group, read(variants, "variants of the model")))


def _shipped() -> Brackets:
    return read(shipped(DEFAULT_DOMAIN), DEFAULT_DOMAIN)


def _declares(group: Brackets, predicate: str) -> bool:
    sections = [item for item in group.items if isinstance(item, Brackets) and item.head == ":predicates"]
    return any(
        isinstance(item, Brackets) and item.head == predicate
        for section in sections
        for item in section.items
    )


def _is_section(item: Word | Brackets, *names: str) -> bool:
    return isinstance(item, Brackets) and item.head in names


def _merge(base: Brackets, extension: Brackets) -> Brackets:
    """Return the base with the sections of the extension added to its own."""
    name, extended = domain_name(base), domain_name(extension)
    if extended.text != name.text:
        fail(
            extended,
            f"this extends the domain {extended.text!r}, but actions are added to {name.text!r}: write "
            f"(define (domain {name.text}) …), or declare (good ?c - component) to bring your own domain",
        )
    merged = list(base.items)
    for item in extension.items[2:]:
        if not isinstance(item, Brackets):
            fail(item, f"expected a section in brackets, found {item.text!r}")
        if item.head == ":requirements":
            mine = next(i for i, one in enumerate(merged) if _is_section(one, ":requirements"))
            present = {word.text for word in _words(merged[mine])}
            new = tuple(
                word for word in item.items[1:] if not (isinstance(word, Word) and word.text in present)
            )
            merged[mine] = _extended(merged[mine], new)
        elif item.head in (":types", ":predicates", ":functions"):
            mine = next(i for i, one in enumerate(merged) if _is_section(one, item.head))
            new = item.items[1:]
            if item.head == ":functions":  # only (total-cost) is allowed, and the base has it
                new = tuple(one for one in new if isinstance(one, Brackets) and one.head != "total-cost")
            merged[mine] = _extended(merged[mine], new)
        else:
            merged.append(item)
    return Brackets(tuple(merged), base.line, base.file)


def _words(item: Word | Brackets) -> list[Word]:
    return [word for word in item.items if isinstance(word, Word)] if isinstance(item, Brackets) else []


def _extended(section: Word | Brackets, new: tuple[Word | Brackets, ...]) -> Brackets:
    assert isinstance(section, Brackets)
    return Brackets((*section.items, *new), section.line, section.file)


# --- a domain that sexpr.py has read, section by section, to a checked Domain.
#
#     Brackets ──► sections ─┬─► types, constants, predicates    DomainVocabulary
#                            ├─► actions, one by one             parse_action
#                            └─► objects and init, and what only the whole domain can tell

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


def domain_name(group: Brackets) -> Word:
    """Return NAME of `(define (domain NAME) …)`."""
    items = group.items
    if group.head != "define" or len(items) < 2 or not isinstance(items[1], Brackets):
        fail(group, "expected (define (domain NAME) …)")
    head = items[1]
    if head.head != "domain" or len(head.items) != 2 or not isinstance(head.items[1], Word):
        fail(head, "expected (domain NAME) after define")
    return head.items[1]


def parse(source: Brackets) -> Domain:
    """Return the checked domain.

    Raises:
        DomainError: with file, line, and what is allowed.
    """
    name = domain_name(source)
    sections = _sections(source)
    for section in sections[":requirements"]:
        _check_requirements(section)
    vocabulary = DomainVocabulary()
    vocabulary.declare_types(sections[":types"])
    for section in sections[":constants"]:
        vocabulary.declare_constants(section)
    for section in sections[":predicates"]:
        vocabulary.declare_predicates(section)
    for section in sections[":functions"]:
        _check_functions(section)
    if "good" not in vocabulary.predicates or "component" not in vocabulary.supertype:
        fail(source, "a repair domain declares the type `component` and (good ?c - component), its goal")
    schemas: dict[str, Schema] = {}
    for section in sections[":action"]:
        action = action_name(section)
        if action.text in schemas:
            fail(action, f"the action {action.text!r} is declared twice")
        schemas[action.text] = parse_action(section, vocabulary)
    domain = Domain(
        name=name.text,
        supertype=vocabulary.supertype,
        predicates=vocabulary.predicates,
        schemas=schemas,
        constants=vocabulary.constants,
        objects=tuple(
            Declared((word.text, kind), (word.quoted, False), word.line, word.file)
            for section in sections[":objects"]
            for word, kind in vocabulary.typed(section.items[1:], section)
        ),
        facts=tuple(
            fact
            for section in sections[":init"]
            for item in section.items[1:]
            if (fact := _fact(item, vocabulary)) is not None
        ),
        source=source,
    )
    _check_guards(domain)
    return domain


def _sections(source: Brackets) -> dict[str, list[Brackets]]:
    sections: dict[str, list[Brackets]] = {section: [] for section in SECTIONS}
    for item in source.items[2:]:
        head = item.head if isinstance(item, Brackets) else None
        if not isinstance(item, Brackets) or head is None:
            fail(item, "expected a section such as (:action …)")
        if head not in SECTIONS:
            fail(item, f"unknown section {head!r}{hint(head, SECTIONS)}")
        sections[head].append(item)
    return sections


def _check_requirements(section: Brackets) -> None:
    for item in section.items[1:]:
        if not isinstance(item, Word):
            fail(item, "requirements are words such as :typing")
        if item.text not in REQUIREMENTS:
            fail(item, f"{item.text} is not supported; supported are {', '.join(sorted(REQUIREMENTS))}")


def _check_functions(section: Brackets) -> None:
    for item in section.items[1:]:
        if isinstance(item, Word) and item.text in ("-", "number"):
            continue
        if isinstance(item, Brackets) and item.head == "total-cost" and len(item.items) == 1:
            continue
        fail(item, "the only function is (total-cost); numbers are not supported")


def _fact(item: Word | Brackets, vocabulary: DomainVocabulary) -> Declared | None:
    """Return a fact of (:init …); None for `(= (total-cost) 0)`, which says nothing of the state."""
    if not isinstance(item, Brackets) or item.head is None:
        fail(item, "expected a fact such as (on_bus imu usb1)")
    name = item.head
    if name == "=" and len(item.items) > 1 and isinstance(item.items[1], Brackets):
        if item.items[1].head == "total-cost":
            return None
        fail(item, "the only function is (total-cost); numbers are not supported")
    if name == "not":
        fail(item, "init lists what is true; leave out what is false")
    predicate = vocabulary.predicate_of(item)
    words = [word for word in item.items if isinstance(word, Word)]
    if len(words) != len(item.items):
        fail(item, f"the arguments of {name} are names")
    vocabulary.check_arity(predicate, len(words) - 1, item)
    for word in words[1:]:
        if word.text.startswith("?"):
            fail(word, f"a fact has no variables, found {word.text}")
    return Declared(
        tuple(word.text for word in words), tuple(word.quoted for word in words), item.line, item.file
    )


def _check_guards(domain: Domain) -> None:
    """Which predicates are static shows when all actions are read."""
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


# --- one `(:action …)` to a Schema: parameters, precondition, effects and cost, checked word by word.
#
# Effects are flattened on the way: a `forall` inside becomes variables, a `when` a condition, and each Effect
# is one atom added or deleted.

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
