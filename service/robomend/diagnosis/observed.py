"""Observations as the solvers see them: signed variables, looked up fast.

A call on a small robot takes some tens of microseconds, so reading its observations must not take more than
the search. A literal is a tuple of tuples, hashed and compared in C, and what was met before is looked up by
it alone, all of a set in one `map`: 0.1 µs a literal. One that is new is found by its predicate and its
arguments, so that making the tables hashes nothing. Sets that were asked lately are known again by comparing
objects, 0.002 µs a literal.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import compress
from operator import neg, not_
from typing import NamedTuple

from robomend.diagnosis.result import Options
from robomend.errors import ContradictoryModel, OptionRefused, UnknownComponent
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal

KEPT_LITERALS = 20_000
"""Of sets that are known again, in all: some 150 of a robot with 100 components."""

KEPT_UNUSED = 1_000
"""Literals that no rule mentions, which are known again as such."""

NOTHING: dict[tuple[str, ...], int] = {}
"""What is known of a predicate that no rule mentions."""


class SignedObs(NamedTuple):
    """OBS in the solver's numbers: signed variables, none with both signs."""

    numbers: tuple[int, ...]
    unused: tuple[Literal, ...]  # observed, but no rule mentions it
    seen: frozenset[int]  # the numbers, to look things up in
    failed: tuple[int, ...]  # the negative ones: of a robot few, and what goes wrong begins with them


class KnownLiterals(dict[Literal, int]):
    """Literal -> signed variable, 0 where no rule mentions its atom; filled as literals come."""

    def __init__(self, cnf: HealthCnf) -> None:
        super().__init__()
        self._variable: dict[str, dict[tuple[str, ...], int]] = {}  # by predicate: no atom is hashed
        for variable, atom in enumerate(cnf.atoms, len(cnf.components) + 1):
            self._variable.setdefault(atom.predicate, {})[atom.args] = variable
        self._room = 2 * len(cnf.atoms) + KEPT_UNUSED

    def __missing__(self, literal: Literal) -> int:
        atom, positive = literal
        number = self._variable.get(atom.predicate, NOTHING).get(atom.args, 0)
        if not positive:
            number = -number
        if number or len(self) < self._room:
            self[literal] = number
        return number


class ObservationReader:
    """Reads observations against one model."""

    def __init__(self, cnf: HealthCnf) -> None:
        self.known = KnownLiterals(cnf)
        # The literals are kept alive here, so that no others can have their id.
        self._lately: dict[tuple[int, int, int], tuple[tuple[Literal, ...], SignedObs]] = {}
        self._kept = 0

    def numbers(self, literals: Iterable[Literal]) -> list[int]:
        """Return each literal as a signed variable, 0 if no rule mentions its atom; nothing is refused."""
        return list(map(self.known.__getitem__, literals))

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
        seen = frozenset(numbers)
        unused: tuple[Literal, ...] = ()
        if 0 in seen:
            unused = tuple(compress(literals, map(not_, numbers)))
            if len({literal.atom for literal in unused}) < len(unused):
                _refuse_clash(unused)
                unused = tuple(dict.fromkeys(unused))
            numbers = tuple(filter(None, numbers))
            seen = seen.difference((0,))
        failed = tuple([number for number in numbers if number < 0])
        if len(seen) < len(numbers) or not seen.isdisjoint(map(neg, failed)):
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
    if options.conflicts not in (True, False, "all"):
        raise OptionRefused(f"conflicts is {options.conflicts!r}: say true, false or 'all'")
    if options.max_size is not None and options.max_size < 0:
        raise OptionRefused(f"max_size is {options.max_size}: give 0 or more, or none")
    if options.limit is not None and options.limit < 1:
        raise OptionRefused(f"limit is {options.limit}: give 1 or more, or none")
    if options.timeout_s is not None and not options.timeout_s >= 0:
        raise OptionRefused(f"timeout_s is {options.timeout_s}: give 0 or more, or none")
