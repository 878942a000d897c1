"""A baseline: Reiter's hitting-set DAG, with Greiner's correction and a SAT solver as the theorem prover.

Breadth first; an inner node is labelled with a conflict that its path H(n) does not hit, and has one edge
for each member of the conflict. A node without such a conflict is a diagnosis: H(n) itself.

    reuse    a known label that H(n) does not hit is used again; nodes with the same H(n) are one node
    close    a node whose H(n) contains a diagnosis is not grown
    prune    a new conflict inside an old label replaces it, and what hangs on the edges that go is removed
             *with the DAG kept intact*: only what is reachable no more (the correction)

Conflicts are minimal here, so that pruning seldom has anything to do; it is done all the same.

Sources:
    R. Reiter. A theory of diagnosis from first principles. AIJ 32(1), 1987.
    R. Greiner, B. Smith, R. Wilkerson. A correction to the algorithm in Reiter's theory of diagnosis. AIJ
        41(1), 1989.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from robomend.diagnosis.base import BaseEngine
from robomend.diagnosis.core_guided import MinimumTooLarge
from robomend.diagnosis.observed import SignedObs, Supposed
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import Bad, NoDiagnosis, SearchState

Path = frozenset[int]


@dataclass(slots=True)
class DagNode:
    """A node of the DAG; `path` is H(n)."""

    path: Path
    label: Path | None = None  # None: not labelled yet, or closed, or a diagnosis
    children: dict[int, DagNode] = field(default_factory=dict)  # edge -> node


class HsDagEngine(BaseEngine):
    """See the module."""

    name = "hs_dag"

    def _search(self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState) -> None:
        self._clock.check()
        root = DagNode(frozenset())
        level: dict[Path, DagNode] = {root.path: root}
        dag = _Dag(root)
        forced = sorted(what_if.abnormal)
        depth = len(forced)
        while level:
            too_deep = options.max_size is not None and depth > options.max_size
            if too_deep:
                if self._consistency.any_more([*observed.numbers, *what_if.numbers], answer.found):
                    raise MinimumTooLarge
                if not answer.found:
                    raise NoDiagnosis
                return
            below: dict[Path, DagNode] = {}
            for node in list(level.values()):
                if not dag.holds(node):
                    continue
                self._grow(node, dag, observed, what_if, answer)
                if node.label is not None:
                    dag.expand(node, below)
            if options.minimal == "cardinality" and answer.found:
                return
            level = below
            depth += 1

    def _grow(
        self, node: DagNode, dag: _Dag, observed: SignedObs, what_if: Supposed, answer: SearchState
    ) -> None:
        """Label one node, or close it, or find that it is a diagnosis."""
        if any(diagnosis <= node.path for diagnosis in dag.diagnoses):
            return
        self._clock.check()
        node.label = next((label for label in dag.labels if label.isdisjoint(node.path)), None)
        if node.label is not None:
            return
        abnormal = node.path | what_if.abnormal
        assumptions = [variable for variable in self._consistency.health if variable not in abnormal]
        assumptions += observed.numbers
        assumptions += [-variable for variable in what_if.abnormal]
        if self._consistency.oracle.sat(assumptions):
            bad: Bad = tuple(sorted(abnormal))
            if self.cnf.modes:
                answer.modes[bad] = self._consistency.modes_of(bad, self._consistency.oracle.model() or ())
            dag.diagnoses.append(node.path)
            answer.add(bad)
            return
        known = self._conflicts.minimise(
            self._consistency.oracle, self._consistency.oracle.core() or (), observed, what_if
        )
        if not known.mask:
            raise NoDiagnosis
        answer.known.append(known)
        node.label = frozenset(known.components)
        dag.prune(node.label)
        dag.labels.append(node.label)


class _Dag:
    """The nodes by path, the labels in use, the diagnoses found."""

    def __init__(self, root: DagNode) -> None:
        self.root = root
        self.labels: list[Path] = []
        self.diagnoses: list[Path] = []
        self._alive: set[Path] | None = None  # None: all nodes are; recomputed after pruning

    def holds(self, node: DagNode) -> bool:
        """Whether the node is still part of the DAG."""
        return self._alive is None or node.path in self._alive

    def expand(self, node: DagNode, below: dict[Path, DagNode]) -> None:
        """Give the node a child for each member of its label; children with the same path are one node."""
        for edge in node.label or ():
            path = node.path | {edge}
            child = below.get(path)
            if child is None:
                child = below[path] = DagNode(path)
                if self._alive is not None:
                    self._alive.add(path)
            node.children[edge] = child

    def prune(self, conflict: Path) -> None:
        """Let a new conflict replace the labels that contain it, and drop what is no longer reachable."""
        larger = [label for label in self.labels if conflict < label]
        if not larger:
            return
        self.labels = [label for label in self.labels if not conflict < label]
        alive: set[Path] = set()
        todo = [self.root]
        while todo:
            node = todo.pop()
            if node.path in alive:
                continue
            alive.add(node.path)
            if node.label is not None and conflict < node.label:
                for edge in node.label - conflict:
                    node.children.pop(edge, None)
                node.label = conflict
            todo.extend(node.children.values())
        self._alive = alive
