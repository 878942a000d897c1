"""A baseline: conflict-directed A* (Williams and Ragno), the search at the core of Livingstone.

Each component is in one of its modes: healthy, one of its fault modes or, where it has none, "abnormal",
which allows anything. A node fixes the modes of some components; the others are in their cheapest mode,
healthy. The cost of a node is the sum of what its abnormal modes cost: 1 each, or, in order of probability,
ln((1 - p)/p).

    cheapest node ──► does it still hold all of a known conflict?  yes ──► children: one member of the
          ▲                       │ no                                     conflict in another mode each
          │                       ▼                                                 │
          │          consistent?  yes ──► diagnosis; what contains it is dropped    │
          │                       │ no                                              │
          │                       └──► a new conflict ──────────────────────────────┤
          └─────────────── only the cheapest child; the next one when it is taken ──┘

The children of a node divide its states: the k-th one fixes the members before it to what the conflict says,
healthy, so that no state is met twice. Nodes come in order of cost, and each part of a set costs less than
the set, so that a consistent node that contains no diagnosis found before is a minimal one.

Fault modes are *assigned* here, one after the other, as in Livingstone, and so conflicts speak of modes. The
default engine leaves them to the solver, and asks once for all modes of a set of components.

Sources:
    B. Williams, R. Ragno. Conflict-directed A* and its role in model-based embedded systems. DAM 155(12),
        2007.
    B. Williams, P. Nayak. A model-based approach to reactive self-configuring systems. AAAI 1996
        (Livingstone).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush

from robomend.diagnosis.base import BaseEngine, costs_of_blame, refuse_order_of_probability
from robomend.diagnosis.core_guided import MinimumTooLarge
from robomend.diagnosis.masks import bits, mask_of, members, outside
from robomend.diagnosis.observed import SignedObs, Supposed
from robomend.diagnosis.oracle import OutOfTime
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import NoDiagnosis, SearchState
from robomend.diagnosis.shrinking import CALLS, shrunk

SCALE = 1 << 40
"""Costs are integers, so that a set costs more than each of its parts however little a member adds."""

MAX_OPEN = 1_000_000
"""Nodes that wait, some 300 MB; with more the search ends as if its time were up."""


@dataclass(frozen=True, slots=True)
class ModeAssignment:
    """Some components in fixed modes. Masks are over variables: bit i is variable i + 1."""

    cost: int = 0
    healthy: int = 0  # components that are fixed to be healthy
    abnormal: int = 0  # components in another mode …
    modes: int = 0  # … and the variables of these modes, where they have any


@dataclass(frozen=True, slots=True)
class Children:
    """The children of a node, the cheapest first: (cost, component, variable of its mode or 0)."""

    parent: ModeAssignment
    moves: Sequence[tuple[int, int, int]]

    def make(self, index: int) -> ModeAssignment:
        """Return one of them; the members of the conflict that come before it are healthy in it."""
        cost, component, mode = self.moves[index]
        before = mask_of({other for _, other, _ in self.moves[:index]} - {component})
        return ModeAssignment(
            self.parent.cost + cost,
            self.parent.healthy | before,
            self.parent.abnormal | mask_of((component,)),
            self.parent.modes | (mask_of((mode,)) if mode else 0),
        )


class CdaStarEngine(BaseEngine):
    """See the module."""

    name = "cda_star"

    def _refuse(self, options: Options) -> None:
        if options.order == "probability":
            refuse_order_of_probability(self.cnf, options)
            costs_of_blame(self.cnf)

    def _search(self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState) -> None:
        self._clock.check()
        search = _Search(self, observed, what_if, options)
        forced = len(what_if.abnormal)
        most = len(self.cnf.components) if options.max_size is None else options.max_size - forced
        found: list[int] = []
        left_out = False
        while (node := search.cheapest()) is not None:
            self._clock.check()
            size = node.abnormal.bit_count()
            if options.minimal == "cardinality" and found and size > found[0].bit_count():
                return
            if any(not diagnosis & ~node.abnormal for diagnosis in found):
                continue
            if size > most:
                left_out = True
                continue
            if search.expand(node):
                continue
            oracle = self._consistency.oracle
            if oracle.sat(search.assumptions(node)):
                bad = tuple(sorted((*members(node.abnormal), *what_if.abnormal)))
                if self.cnf.modes:
                    answer.modes[bad] = self._consistency.modes_of(bad, oracle.model() or ())
                found.append(node.abnormal)
                answer.add(bad)
                continue
            search.learn(oracle.core() or (), answer)
            search.expand(node)
        if left_out and self._consistency.any_more([*observed.numbers, *what_if.numbers], answer.found):
            raise MinimumTooLarge
        if not found:
            raise NoDiagnosis


class _Search:
    """The nodes that wait and the conflicts that are known, for one question."""

    def __init__(
        self, engine: CdaStarEngine, observed: SignedObs, what_if: Supposed, options: Options
    ) -> None:
        self._engine = engine
        self._observed, self._what_if = observed, what_if
        cnf = engine.cnf
        n = len(cnf.components)
        if options.order == "probability":
            costs = [max(1, round(SCALE * cost)) for cost in costs_of_blame(cnf)]
        else:
            costs = [1] * n
        self._moves = {
            variable: [(cost, variable, mode) for mode in cnf.modes.get(component, {}).values()]
            or [(cost, variable, 0)]
            for variable, (component, cost) in enumerate(zip(cnf.components, costs, strict=True), 1)
        }
        self._modes = frozenset(mode for modes in cnf.modes.values() for mode in modes.values())
        self._free = (1 << n) - 1 & ~mask_of(what_if.abnormal)
        self._given = mask_of(what_if.abnormal)
        self._background = [*observed.numbers, *what_if.numbers]
        self._conflicts: list[int] = []
        self._counted = 0
        self._root: ModeAssignment | None = ModeAssignment(healthy=mask_of(what_if.healthy))
        self._open: list[tuple[int, int, Children, int]] = []  # cost, age, the child that waits

    def cheapest(self) -> ModeAssignment | None:
        """Take a cheapest node, of those that cost the same the youngest; None: there is no other.

        Raises:
            OutOfTime: more nodes wait than there is room for.
        """
        root, self._root = self._root, None
        if root is not None or not self._open:
            return root
        _, _, children, index = heappop(self._open)
        if index + 1 < len(children.moves):
            self._wait(children, index + 1)
        return children.make(index)

    def _wait(self, children: Children, index: int) -> None:
        if len(self._open) >= MAX_OPEN:
            raise OutOfTime
        self._counted += 1
        cost = children.parent.cost + children.moves[index][0]
        heappush(self._open, (cost, -self._counted, children, index))

    def expand(self, node: ModeAssignment) -> bool:
        """Divide a node by the known conflict that leaves the fewest choices; return whether there is one."""
        holds = self._free & ~node.abnormal | node.modes
        unresolved = [conflict for conflict in self._conflicts if not conflict & ~holds]
        if not unresolved:
            return False
        undecided = self._free & ~node.healthy & ~node.abnormal
        suspects = min((conflict & undecided for conflict in unresolved), key=int.bit_count)
        moves = [self._moves[variable] for variable in members(suspects)]
        moves.sort(key=lambda alternatives: alternatives[0][0])
        children = Children(node, [move for alternatives in moves for move in alternatives])
        if children.moves:
            self._wait(children, 0)
        return True

    def assumptions(self, node: ModeAssignment) -> list[int]:
        """Return what the solver must agree with: OBS, the modes that are fixed, all others healthy."""
        health = outside(self._engine._consistency.health, node.abnormal | self._given)
        return [*self._background, *(bit + 1 for bit in bits(node.modes)), *health]

    def learn(self, core: Iterable[int], answer: SearchState) -> None:
        """Make a minimal conflict of a core and keep it.

        Raises:
            NoDiagnosis: it names no component.
        """
        engine, oracle = self._engine, self._engine._consistency.oracle
        core = list(core)
        if self._modes.isdisjoint(core):
            known = engine._conflicts.minimise(oracle, core, self._observed, self._what_if)
            answer.known.append(known)
            conflict = known.mask
        else:
            n = len(engine.cnf.components)
            given = frozenset(self._background)

            def refute(some: list[int]) -> list[int] | None:
                return None if oracle.sat(self._background + some) else oracle.core() or []

            literals = [
                literal
                for literal in core
                if literal not in given and (0 < literal <= n or literal in self._modes)
            ]
            conflict = mask_of(shrunk(literals, refute, CALLS)[0])
        if not conflict:
            raise NoDiagnosis
        self._conflicts.append(conflict)
