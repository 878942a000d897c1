"""Topics that need each other in circles, and the clause that makes them explainable.

    ctl: state → cmd      the schemes say   ¬AB(ctl) ∧ ok(state) → ok(cmd)
    est: cmd, rate → state                  ¬AB(est) ∧ ok(cmd) ∧ ok(rate) → ok(state)

With all healthy, cmd and state may both be silent: each waits for the other, and nobody is to blame. So it is
before the circle has begun. Once it was up, it goes on as long as all in it work and get what they need:

    ¬AB(ctl) ∧ ¬AB(est) ∧ ok(rate) → ok(cmd) ∧ ok(state)

for each strongly connected component of topics: its members, and their devices, healthy, its outside inputs
ok, then its topics ok. The clause joins the system description of a robot as an assertion does, once the
topics were seen ok on it, and is shared by diagnosis and prediction, so that every mismatch is explainable.

Until then nobody is blamed for topics that are silent in a circle, and nobody knows that all is well either:
`wait_for_themselves` names them.

Circles within circles stay coarse: one clause for all of them, which blames any of its members.

Source: R. Tarjan. Depth-first search and linear graph algorithms. SIAM J. Computing 1(2), 1972.
"""

from __future__ import annotations

from collections.abc import Collection, Container, Iterable, Mapping
from dataclasses import dataclass

from robomend.model.clauses import Assertion
from robomend.model.components import ComponentModel
from robomend.model.formulas import And, Implies, Leaf, ab
from robomend_client.literals import Atom, Literal, holds


@dataclass(frozen=True, slots=True)
class Loop:
    """One strongly connected component of topics."""

    topics: tuple[str, ...]  # in the order of the model
    members: tuple[str, ...]  # the nodes that publish them
    components: frozenset[str]  # members, and the devices that they rest on
    nested: bool  # more than one circle
    clause: Assertion

    @property
    def atoms(self) -> tuple[Atom, ...]:
        """That its topics are ok."""
        return tuple(Atom("ok", (topic,)) for topic in self.topics)

    def was_up(self, known: Iterable[Atom], seen_ok: Container[Atom]) -> bool:
        """Return whether those of its atoms of which anything is known were all seen to hold, and there are
        some.
        """
        known = tuple(known)
        return bool(known) and all(atom in seen_ok for atom in known)


def loops_of(model: ComponentModel) -> tuple[Loop, ...]:
    """Return the circles of topics, in the order of the model."""
    inputs, publishers = _wiring(model)
    number = strong_components(inputs)
    together: dict[int, list[str]] = {}
    for topic in inputs:
        together.setdefault(number[topic], []).append(topic)
    return tuple(
        _loop(model, topics, inputs, publishers)
        for topics in together.values()
        if len(topics) > 1 or topics[0] in inputs[topics[0]]
    )


def wait_for_themselves(
    model: ComponentModel, loop: Loop, bad: Collection[str], good: Collection[str], stopped: Collection[str]
) -> tuple[str, ...]:
    """Return the topics of a circle that are bad, where nothing else explains it: none of what they wait for,
    however far up, comes from outside the model, or from a node that is meant to be stopped.

    Args:
        bad, good: topics that are reported not to be ok, and to be ok; of the others nothing is known.
    """
    inputs, publishers = _wiring(model)
    found = tuple(topic for topic in loop.topics if topic in bad)
    ahead, seen = list(found), set(found)
    while ahead:
        topic = ahead.pop()
        if topic not in publishers or not publishers[topic].keys().isdisjoint(stopped):
            return ()
        needed = inputs[topic].keys() - seen
        ahead += needed.difference(good)
        seen |= needed
    return found


def _wiring(model: ComponentModel) -> tuple[dict[str, dict[str, None]], dict[str, dict[str, None]]]:
    """Return topic -> what it rests on, and -> who publishes it; both in the order of the model."""
    inputs: dict[str, dict[str, None]] = {}
    publishers: dict[str, dict[str, None]] = {}
    for node in model.nodes.values():
        for topic, needed in node.publishes.items():
            publishers.setdefault(topic, {})[node.name] = None
            rests_on = inputs.setdefault(topic, {})
            if not node.drives or node.inputs_matter:
                rests_on.update(dict.fromkeys(needed))
    return inputs, publishers


def _loop(
    model: ComponentModel,
    topics: list[str],
    inputs: Mapping[str, Iterable[str]],
    publishers: Mapping[str, Iterable[str]],
) -> Loop:
    members = tuple(dict.fromkeys(name for topic in topics for name in publishers[topic]))
    within = set(topics)
    edges = sum(other in within for topic in topics for other in inputs[topic])
    outside = tuple(dict.fromkeys(o for topic in topics for o in inputs[topic] if o not in within))
    devices = tuple(
        dict.fromkeys(
            name
            for member in members
            for device in model.nodes[member].drives
            for name in (device, *model.feeders(device))
            if name != device or model.hardware[name].blame or model.switchable(name)
        )
    )
    premises: list[Literal] = [-ab(name) for name in (*members, *devices)]
    premises += [holds("ok", topic) for topic in outside]
    up = [holds("ok", topic) for topic in topics]
    formula = Implies(
        And(tuple(Leaf(premise) for premise in premises)) if len(premises) > 1 else Leaf(premises[0]),
        And(tuple(Leaf(literal) for literal in up)) if len(up) > 1 else Leaf(up[0]),
    )
    text = f"{' and '.join(map(str, premises))} -> {' and '.join(map(str, up))}"
    clause = Assertion(f"circle of {', '.join(topics)}", text, formula, steps=len(premises) * len(up))
    return Loop(tuple(topics), members, frozenset((*members, *devices)), edges > len(topics), clause)


def strong_components(successors: Mapping[str, Iterable[str]]) -> dict[str, int]:
    """Return the number of each vertex's strongly connected component; a successor's number is never higher.

    Source: R. Tarjan. Depth-first search and linear graph algorithms. SIAM J. Computing 1(2), 1972; with an
    explicit stack, as chains of a thousand nodes are deeper than Python recurses.
    """
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    found: dict[str, int] = {}
    path: list[str] = []
    count = 0
    for root in successors:
        if root in number:
            continue
        work = [(root, iter(successors[root]))]
        number[root] = low[root] = len(number)
        path.append(root)
        while work:
            vertex, rest = work[-1]
            for other in rest:
                if other not in number:
                    number[other] = low[other] = len(number)
                    path.append(other)
                    work.append((other, iter(successors.get(other, ()))))
                    break
                if other not in found:
                    low[vertex] = min(low[vertex], number[other])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[vertex])
                if low[vertex] == number[vertex]:
                    while (member := path.pop()) != vertex:
                        found[member] = count
                    found[vertex] = count
                    count += 1
    return found
