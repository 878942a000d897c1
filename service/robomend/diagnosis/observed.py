"""Observations as the solvers see them: signed variables, looked up fast.

A call on a small robot takes some tens of microseconds, so reading its observations must not take more than
the search. Hashing a literal would take longest, as its hash and that of its atom are functions of Python, so
a literal is looked up by its sign, its predicate and its arguments, one table in the other: strings and their
tuples are hashed in C, and no key is made, so that a literal takes 0.05 µs, new or met before. Sets that were
asked lately are known again by comparing objects, 0.002 µs a literal.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import NamedTuple

from robomend.diagnosis.result import Options
from robomend.errors import ContradictoryModel, OptionRefused, UnknownComponent
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal

KEPT_LITERALS = 20_000
"""Of sets that are known again, in all: some 150 of a robot with 100 components."""

Table = dict[str, dict[tuple[str, ...], int]]
"""Predicate -> arguments -> signed variable."""

NOTHING: dict[tuple[str, ...], int] = {}
"""What is known of a predicate that no rule mentions."""


class SignedObs(NamedTuple):
    """OBS in the solver's numbers: signed variables, none with both signs."""

    numbers: tuple[int, ...]
    unused: tuple[Literal, ...]  # observed, but no rule mentions it
    seen: frozenset[int]  # the numbers, to look things up in
    failed: tuple[int, ...]  # the negative ones: of a robot few, and what goes wrong begins with them


class ObservationReader:
    """Reads observations against one model."""

    def __init__(self, cnf: HealthCnf) -> None:
        self._positive: Table = {}
        self._negative: Table = {}
        for variable, atom in enumerate(cnf.atoms, len(cnf.components) + 1):  # no atom is hashed
            self._positive.setdefault(atom.predicate, {})[atom.args] = variable
            self._negative.setdefault(atom.predicate, {})[atom.args] = -variable
        self._all_known = True  # whether the rules mentioned every atom of the set that was read last
        # The literals are kept alive here, so that no others can have their id.
        self._lately: dict[tuple[int, int, int], tuple[tuple[Literal, ...], SignedObs]] = {}
        self._kept = 0

    def numbers(self, literals: Sequence[Literal]) -> list[int]:
        """Return each literal as a signed variable, 0 if no rule mentions its atom; nothing is refused."""
        positive, negative = self._positive, self._negative
        if self._all_known:  # as last time: then subscripts, a quarter faster than calls of `get`, will do
            try:
                return [
                    (positive if one.positive else negative)[(atom := one.atom).predicate][atom.args]
                    for one in literals
                ]
            except KeyError:
                pass
        found = [
            (positive if one.positive else negative)
            .get((atom := one.atom).predicate, NOTHING)
            .get(atom.args, 0)
            for one in literals
        ]
        self._all_known = 0 not in found
        return found

    def read(self, observations: Iterable[Literal]) -> SignedObs:
        """Return the observations as signed variables.

        Raises:
            ContradictoryModel: a literal and its opposite are both observed.
        """
        asked = literals = tuple(observations)
        # Comparing copies would take longer than reading them: the outer two tell whether they are.
        key = (len(literals), id(literals[0]), id(literals[-1])) if literals else (0, 0, 0)
        known = self._lately.get(key)
        if known is not None and known[0] == literals:
            return known[1]
        numbers = tuple(self.numbers(literals))
        unused: tuple[Literal, ...] = ()
        if not self._all_known:
            unused = tuple(dict.fromkeys(compress(literals, [not number for number in numbers])))
            _refuse_clash(unused)
            numbers = tuple(filter(None, numbers))
        seen = frozenset(numbers)
        failed = tuple([number for number in numbers if number < 0])
        if len(seen) < len(numbers) or not seen.isdisjoint([-number for number in failed]):
            _refuse_clash(literals)
            numbers = tuple(dict.fromkeys(numbers))
            failed = tuple([number for number in numbers if number < 0])
        observed = SignedObs(numbers, unused, seen, failed)
        self._kept += len(asked)
        if self._kept > KEPT_LITERALS:
            self._lately.clear()
            self._kept = len(asked)
        self._lately[key] = (asked, observed)
        return observed


def _refuse_clash(literals: Iterable[Literal]) -> None:
    seen = set(literals)
    for literal in literals:
        if literal.positive and -literal in seen:
            raise ContradictoryModel((str(literal), str(-literal)))


@dataclass(frozen=True, slots=True)
class Supposed:
    """What-if: the health variables that are assumed true or false, whatever is observed."""

    healthy: frozenset[int] = frozenset()
    abnormal: frozenset[int] = frozenset()

    @property
    def numbers(self) -> list[int]:
        """As assumptions: signed health variables."""
        return [*self.healthy, *(-variable for variable in self.abnormal)]


NOTHING_SUPPOSED = Supposed()


def supposed(cnf: HealthCnf, options: Options) -> Supposed:
    """Return the options' `healthy` and `abnormal` as health variables.

    Raises:
        UnknownComponent: a name that is no component.
        OptionRefused: one component is assumed both healthy and abnormal.
    """
    if not options.healthy and not options.abnormal:
        return NOTHING_SUPPOSED
    for name in sorted(options.healthy | options.abnormal):
        if name not in cnf.health:
            raise UnknownComponent(name, frozenset(cnf.components))
    both = options.healthy & options.abnormal
    if both:
        raise OptionRefused(f"{min(both)!r} is assumed both healthy and abnormal: drop one of the two")
    return Supposed(
        frozenset(cnf.health[name] for name in options.healthy),
        frozenset(cnf.health[name] for name in options.abnormal),
    )


def check_options(options: Options) -> None:
    """Refuse bounds that mean nothing.

    Raises:
        OptionRefused: a negative or absurd bound.
    """
    if options.minimal not in ("cardinality", "subset"):
        raise OptionRefused(f"minimal is {options.minimal!r}: say 'cardinality' or 'subset'")
    if options.order not in ("size", "probability"):
        raise OptionRefused(f"order is {options.order!r}: say 'size' or 'probability'")
    if options.max_size is not None and options.max_size < 0:
        raise OptionRefused(f"max_size is {options.max_size}: give 0 or more, or none")
    if options.limit is not None and options.limit < 1:
        raise OptionRefused(f"limit is {options.limit}: give 1 or more, or none")
    if options.timeout_s is not None and not options.timeout_s >= 0:
        raise OptionRefused(f"timeout_s is {options.timeout_s}: give 0 or more, or none")
