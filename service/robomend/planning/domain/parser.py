"""A domain that robomend.planning.domain.sexpr has read, section by section, to a checked Domain.

    Brackets ──► sections ──► types, constants, predicates    robomend.planning.domain.vocabulary
                       ├─► actions, one by one             robomend.planning.domain.action_parser
                       └─► objects and init                here, and what only the whole domain can tell

What is allowed is told in robomend.planning.domain.loading.
"""

from __future__ import annotations

from robomend.errors import DomainError
from robomend.planning.domain.action_parser import action_name, parse_action
from robomend.planning.domain.formulas import atoms
from robomend.planning.domain.sexpr import Brackets, Word, fail
from robomend.planning.domain.values import Declared, Domain, Schema
from robomend.planning.domain.vocabulary import DomainVocabulary, hint

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
