"""All minimal conflicts that a fixed set of sensors can give rise to, whatever they show.

A conflict rests on what was seen of some sensors, so it is kept as two masks: the components that cannot all
be healthy, and the states of sensors that say so. A robot whose clauses are Horn, with health as a premise
only, has all of them listed beforehand, by chaining the rules forward from what a sensor may show:

    label of ok(scan)    {hokuyo, hokuyo_node}                 derived: while these are healthy
                         {ok(scan) seen}                       or shown by its own sensor
    label of ok(map)     {hector_mapping, hokuyo, hokuyo_node}
                         {hector_mapping, ok(scan) seen}

    not ok(map) seen     with each of them: a conflict

Labels hold only minimal sets, and grow until no rule adds one. They may be exponentially many, so that there
is a bound, and beyond it the conflicts are found one by one (library.py).

Source: J. de Kleer. An assumption-based TMS. AIJ 28(2), 1986 (labels and environments).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robomend.diagnosis.derivations import Derivations
from robomend.diagnosis.masks import mask_of
from robomend.model.cnf import HealthCnf

MAX_ENVIRONMENTS = 20_000
"""Of all labels together, while they grow: a second or two."""

MAX_CONFLICTS = 10_000


class SensorConflict(NamedTuple):
    """Components that cannot all be healthy while the sensors are in these states."""

    components: int  # bit i: component i
    states: int  # bit 2s: sensor s shows true; bit 2s + 1: it shows false


class TooManyConflicts(Exception):
    """They cannot be listed beforehand."""


def all_conflicts(cnf: HealthCnf, sensors: Sequence[int]) -> list[SensorConflict]:
    """Return all minimal conflicts of these sensors.

    Args:
        sensors: the variable of each, 0 where no rule mentions it.

    Raises:
        TooManyConflicts: there are more than the bounds, or the clauses are not of the kind.
    """
    if not Derivations.suit(cnf):
        raise TooManyConflicts
    labels = _Labels(cnf, sensors)
    labels.grow()
    shift = len(cnf.components)
    healthy = (1 << shift) - 1
    found = labels.contradictions
    for sensor, variable in enumerate(sensors):
        holds, fails = 1 << (shift + 2 * sensor), 2 << (shift + 2 * sensor)
        found.append(holds | fails)
        found += [one | fails for one in labels.of.get(variable, ())]
    if len(found) > MAX_CONFLICTS:
        raise TooManyConflicts
    return [SensorConflict(one & healthy, one >> shift) for one in minimal_sets(found)]


def minimal_sets(masks: Iterable[int]) -> list[int]:
    """Return the masks without those that contain another."""
    kept: list[int] = []
    for mask in sorted(set(masks), key=int.bit_count):
        if not any(smaller & mask == smaller for smaller in kept):
            kept.append(mask)
    return kept


def containment(masks: Sequence[int]) -> NDArray[np.float32]:
    """Return, shape (masks, masks), 1 where the one of the row is inside that of the column.

    Of equal ones the first is inside the others.
    """
    table = [
        [one & other == one and (one != other or row < column) for column, other in enumerate(masks)]
        for row, one in enumerate(masks)
    ]
    return np.array(table, dtype=np.float32).reshape(len(masks), len(masks))


class _Labels:
    """Variable -> the minimal sets, of components and states, that derive it; see the module."""

    def __init__(self, cnf: HealthCnf, sensors: Sequence[int]) -> None:
        n = len(cnf.components)
        self.of: dict[int, list[int]] = {}
        self.contradictions: list[int] = []
        self._size = 0
        self._rules: list[tuple[int, tuple[int, ...], int]] = []  # health, body, head; 0: none
        self._users: dict[int, list[int]] = {}  # variable -> the rules that have it in their body
        for clause in dict.fromkeys(cnf.clauses):
            head = next((literal for literal in clause if literal > 0), 0)
            body = tuple(-literal for literal in clause if literal < -n)
            for variable in body:
                self._users.setdefault(variable, []).append(len(self._rules))
            self._rules.append((mask_of(-literal for literal in clause if -n <= literal < 0), body, head))
        for sensor, variable in enumerate(sensors):
            if variable:
                self.of[variable] = [1 << (n + 2 * sensor)]

    def grow(self) -> None:
        """Apply the rules until none adds a set."""
        waiting = dict.fromkeys(range(len(self._rules)))
        while waiting:
            rule = next(iter(waiting))
            del waiting[rule]
            mask, body, head = self._rules[rule]
            derived = [mask]
            for variable in body:
                label = self.of.get(variable, ())
                if len(derived) * len(label) > MAX_ENVIRONMENTS:
                    raise TooManyConflicts
                derived = minimal_sets([one | other for one in derived for other in label])
            if head:
                if self._add(head, derived):
                    waiting.update(dict.fromkeys(self._users.get(head, ())))
            else:
                self.contradictions = minimal_sets([*self.contradictions, *derived])

    def _add(self, variable: int, derived: list[int]) -> bool:
        before = self.of.get(variable, [])
        after = minimal_sets([*before, *derived])
        if after == before or set(after) == set(before):
            return False
        self._size += len(after) - len(before)
        if self._size > MAX_ENVIRONMENTS:
            raise TooManyConflicts
        self.of[variable] = after
        return True
