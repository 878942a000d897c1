"""Why: conflicts, diagnoses and cleared suspects in sentences.

A minimal conflict says that its components cannot all be healthy, given its observations. Minimal in both,
it has a handy property: leave out any one of its observations and the rest entails that observation's
opposite. So a conflict always reads as one expectation that was not met,

    scan should be ok because hokuyo and hokuyo_node are taken to be healthy, but it was seen not ok

whatever shape its rules have and however long the chain between premises and expectation: the chain is
collapsed by itself. All that is left to choose is which observation is the news. It is the one that a rule
of the conflict concludes, as its author wrote the rule; failing that, the head of a Horn clause; in a
circuit, the net at the end of the chain of gates.

Sources: R. Reiter. A theory of diagnosis from first principles. AIJ 32(1), 1987 (conflicts, hitting sets);
U. Junker. QuickXplain. AAAI 2004 (an explanation is a minimal set of premises).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import islice
from typing import TypeVar

from robomend.diagnosis.result import Conflict, Diagnosis
from robomend.model.cnf import HealthCnf
from robomend_client.counts import listed
from robomend_client.literals import Atom, Literal, quote

Thing = TypeVar("Thing", bound=Hashable)

NAMED_AT_MOST = 8
"""A sentence names so many things and counts the others."""

STATES = {
    "ok": ("ok", "not ok"),
    "on": ("on", "off"),
    "running": ("running", "not running"),
    "inc": ("increasing", "not increasing"),
    "dec": ("decreasing", "not decreasing"),
    "const": ("constant", "not constant"),
}
"""Predicates that read as a state of their one argument: the words for the literal and its negation."""


def conflict_in_words(
    cnf: HealthCnf,
    components: tuple[str, ...],
    observations: tuple[Literal, ...],
    rules: tuple[str, ...],
    minimal: bool = True,
) -> Conflict:
    """Return a minimal conflict with its sentence, and which observation is the unmet expectation.

    Args:
        components: cannot all be healthy …
        observations: … given these. What a what-if assumes is among them, as `ab(c)` or `not ab(c)`.
        rules: the texts of the rules that the conflict rests on.
    """
    seen = [literal for literal in observations if literal.atom.predicate != "ab"]
    unmet = _news(cnf, components, seen, rules) if seen else None
    text = _sentence(cnf, components, observations, unmet)
    return Conflict(components, observations, rules, text, unmet, minimal)


def _sentence(
    cnf: HealthCnf, components: Collection[str], observations: Sequence[Literal], news: Literal | None
) -> str:
    what_if = [literal for literal in observations if literal.atom.predicate == "ab"]
    assumed = _listed(map(_assumption, what_if)) if what_if else ""
    if news is None:
        because = f" when {assumed}" if assumed else ""
        if not components:
            return (
                f"the rules contradict one another{because or ', whatever is abnormal and whatever is seen'}"
            )
        return f"{_healthy(components)}, but the rules do not allow it{because}, whatever is seen"
    premises = [_healthy(components)] if components else []
    premises += [assumed] if assumed else []
    others = [literal for literal in observations if literal != news and literal.atom.predicate != "ab"]
    premises += [_was_seen(cnf, others)] if others else []
    because = f" because {' and '.join(premises)}" if premises else " whatever is abnormal"
    subject, plural = _subject(cnf, news.atom)
    was = "they were" if plural else "it was"
    return f"{subject} should {_infinitive(cnf, -news)}{because}, but {was} seen {_seen(cnf, news)}"


def explain_diagnoses(diagnoses: Sequence[Diagnosis], conflicts: Sequence[Conflict]) -> list[str]:
    """Return for each what its components explain, e.g. `jaguar explains not on(jaguar) and not ok(odom)`."""
    explained: dict[str, str] = {}  # diagnoses share components

    def sentence(component: str, mode: str | None) -> str:
        if component not in explained:
            explained[component] = _explained(component, conflicts)
        return f"{quote(component)}{f' (in mode {mode})' if mode else ''} {explained[component]}"

    nothing = "nothing is wrong: what was seen is what a healthy system shows"
    return [
        "; ".join([sentence(component, diagnosis.modes.get(component)) for component in diagnosis.bad])
        or nothing
        for diagnosis in diagnoses
    ]


def _explained(component: str, conflicts: Sequence[Conflict]) -> str:
    hit = [conflict for conflict in conflicts if component in conflict.components]
    seen = _distinct(literal for conflict in hit for literal in _unmet(conflict))
    if seen:
        return f"explains {_listed(map(str, seen))}"
    return "resolves a conflict between the rules" if hit else "is needed by a conflict that was not listed"


def _unmet(conflict: Conflict) -> tuple[Literal, ...]:
    """Return what was not expected; everything that was seen where an engine does not say which."""
    return conflict.observations if conflict.unmet is None else (conflict.unmet,)


def clear_suspects(diagnoses: Sequence[Collection[str]], conflicts: Sequence[Conflict]) -> dict[str, str]:
    """Return why each healthy suspect is cleared: in some conflict, yet not blamed by the leading diagnosis.

    Args:
        diagnoses: what each diagnosis blames, the leading one first.
        conflicts: the minimal conflicts that were found.
    """
    if not diagnoses:
        return {}
    leading = frozenset(diagnoses[0])
    reasons: dict[str, str] = {}
    for suspect in _distinct(name for conflict in conflicts for name in conflict.components):
        if suspect in leading:
            continue
        named_in = [conflict for conflict in conflicts if suspect in conflict.components]
        blamed = [name for name in diagnoses[0] if any(name in c.components for c in named_in)]
        if not blamed:
            continue  # a diagnosis hits every conflict: this one is of other observations
        seen = _distinct(literal for conflict in named_in for literal in conflict.observations)
        about = f" ({_listed(map(str, seen))})" if seen else ""
        which = "the only conflict" if len(named_in) == 1 else f"all {len(named_in)} conflicts"
        verb = _verb(blamed, "resolves", "resolve")
        reason = f"{_listed(map(quote, blamed))} already {verb} {which} naming it{about}"
        instead = [diagnosis for diagnosis in diagnoses if suspect in diagnosis]
        if instead:
            verb = "blames" if len(instead) == 1 else "blame"
            reason += f"; {len(instead)} of {len(diagnoses)} diagnoses {verb} it instead"
        reasons[suspect] = reason
    return reasons


class Cleared(Mapping[str, str]):
    """Healthy suspect -> why it is cleared; worked out when first looked at, as few callers do."""

    def __init__(self, blamed: Sequence[Sequence[str]], conflicts: Sequence[Conflict]) -> None:
        self._blamed = blamed
        self._conflicts = conflicts

    @cached_property
    def _reasons(self) -> dict[str, str]:
        return clear_suspects(self._blamed, self._conflicts)

    def __getitem__(self, component: str) -> str:
        return self._reasons[component]

    def __iter__(self) -> Iterator[str]:
        return iter(self._reasons)

    def __len__(self) -> int:
        return len(self._reasons)

    def __repr__(self) -> str:
        return repr(self._reasons)


def what_was_learned(conflicts: Sequence[Conflict]) -> dict[str, str]:
    """Return for each observation that clashes with something which suspects it raises."""
    raised: dict[Literal, list[str]] = {}
    for conflict in conflicts:
        if not conflict.components:
            continue  # of suppositions: it says nothing of what was seen
        suspects = _listed(map(quote, conflict.components))
        one = suspects if len(conflict.components) == 1 else f"one of {suspects}"
        for literal in conflict.observations:
            raised.setdefault(literal, []).append(f"{one} is abnormal")
    return {str(literal): _listed(_distinct(suspects)) for literal, suspects in raised.items()}


def _news(
    cnf: HealthCnf, components: Collection[str], observations: Sequence[Literal], rules: Collection[str]
) -> Literal:
    """Return the observation that reads best as the unmet expectation."""
    if len(observations) == 1:
        return observations[0]
    if cnf.circuit:
        gates = frozenset(components)
        driven = [literal for literal in observations if not gates.isdisjoint(literal.atom.args)]
        if len(driven) == 1:  # the only net that a gate of the conflict drives
            return driven[0]
    conclusions = {
        conclusion.strip() for rule in rules for _, arrow, conclusion in [rule.rpartition("->")] if arrow
    }
    for literal in observations:
        if str(-literal) in conclusions:
            return literal
    clauses = [clause for rule in rules for clause in cnf.clauses_of_rule.get(rule, ())]
    if cnf.circuit:
        return _last_net(cnf, components, observations, clauses)
    heads = {head for clause in clauses if (head := _horn_head(clause)) is not None}
    for literal in observations:
        variable = cnf.literal(literal)
        if variable is not None and -variable in heads:
            return literal
    return next((literal for literal in observations if not literal.positive), observations[-1])


def _horn_head(clause: Sequence[int]) -> int | None:
    positive = [literal for literal in clause if literal > 0]
    return positive[0] if len(positive) == 1 else None


def _last_net(
    cnf: HealthCnf,
    components: Collection[str],
    observations: Sequence[Literal],
    clauses: Sequence[Sequence[int]],
) -> Literal:
    """Return the observed net that the conflict's gates drive and read least: the end of their chain."""
    health = cnf.health
    gates_at: dict[int, set[int]] = {abs(cnf.literal(literal) or 0): set() for literal in observations}
    suspects = {health[component] for component in components}
    for clause in clauses:
        for literal in clause:
            if abs(literal) in gates_at:
                gates_at[abs(literal)].update(suspects.intersection(map(abs, clause)))

    def order(literal: Literal) -> tuple[bool, int]:
        driven = bool(literal.atom.args) and literal.atom.args[0] in health
        return (driven, -len(gates_at[abs(cnf.literal(literal) or 0)]))

    return max(observations, key=order)


def _healthy(components: Collection[str]) -> str:
    verb = _verb(components, "is", "are")
    return f"{_listed_as(quote, components)} {verb} taken to be healthy"


def _assumption(literal: Literal) -> str:
    return f"{quote(literal.atom.args[0])} is assumed {'abnormal' if literal.positive else 'healthy'}"


def _was_seen(cnf: HealthCnf, literals: Sequence[Literal]) -> str:
    def told(literal: Literal) -> str:
        subject, plural = _subject(cnf, literal.atom)
        return f"{subject} {'were' if plural else 'was'} seen {_seen(cnf, literal)}"

    return _listed_as(told, literals)


def _subject(cnf: HealthCnf, atom: Atom) -> tuple[str, bool]:
    """Return what a sentence is about, and whether it is plural."""
    if atom.predicate in STATES and len(atom.args) == 1:
        return quote(atom.args[0]), False
    if atom.predicate == "matched" and len(atom.args) == 2:
        return f"{quote(atom.args[0])} and {quote(atom.args[1])}", True
    return str(atom), False


def _infinitive(cnf: HealthCnf, literal: Literal) -> str:
    """Return `be ok`, `not match`, `be 0`: what follows `should`."""
    atom = literal.atom
    if atom.predicate in STATES and len(atom.args) == 1:
        positive, negative = STATES[atom.predicate]
        if literal.positive:
            return f"be {positive}"
        return f"not be {positive}" if negative.startswith("not ") else f"be {negative}"
    if cnf.circuit:
        return f"be {int(literal.positive)}"
    verb = "match" if atom.predicate == "matched" and len(atom.args) == 2 else "hold"
    return verb if literal.positive else f"not {verb}"


def _seen(cnf: HealthCnf, literal: Literal) -> str:
    """Return `ok`, `off`, `not to match`, `0`: what follows `was seen`."""
    atom = literal.atom
    if atom.predicate in STATES and len(atom.args) == 1:
        return STATES[atom.predicate][not literal.positive]
    if cnf.circuit:
        return str(int(literal.positive))
    verb = "match" if atom.predicate == "matched" and len(atom.args) == 2 else "hold"
    return f"to {verb}" if literal.positive else f"not to {verb}"


def _listed_as(told: Callable[[Thing], str], things: Collection[Thing]) -> str:
    """Return the same of things, of which only those that are named are put into words."""
    more = len(things) - NAMED_AT_MOST + 1 if len(things) > NAMED_AT_MOST else 0
    items = [told(thing) for thing in islice(things, len(things) - more)]
    return _listed([*items, f"{more} more"] if more else items)


def _listed(words: Iterable[str]) -> str:
    """Return `a`, `a and b`, `a, b and c`; beyond NAMED_AT_MOST, how many more there are."""
    items = list(words)
    if len(items) > NAMED_AT_MOST:
        items = [*items[: NAMED_AT_MOST - 1], f"{len(items) - NAMED_AT_MOST + 1} more"]
    return listed(items)


def _verb(things: Collection[str], one: str, many: str) -> str:
    return one if len(things) == 1 else many


def _distinct(things: Iterable[Thing]) -> list[Thing]:
    return list(dict.fromkeys(things))
