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

from functools import lru_cache

from robomend.errors import DomainError
from robomend.planning.domain.parser import domain_name, parse
from robomend.planning.domain.sexpr import Brackets, Word, fail, read
from robomend.planning.domain.values import Domain
from robomend.resources import resource

DEFAULT_DOMAIN = "repair.pddl"
PAPER_DOMAIN = "paper-repair.pddl"
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
