"""Models that are no robot's but break searches: long, wide, circular, redundant, contradictory, hard by
design.

Each is a system and what was seen of it, and should be answered with default options: with the smallest
diagnoses if not with all, within the time-out, in bounded memory. The number in a name is the size.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping
from itertools import combinations, product

from robomend.model.bench import circuit
from robomend.model.cnf import Clause, HealthCnf, Rule
from robomend.model.compiling import compile_robot
from robomend.model.components import ComponentModel, Hardware, Node, Topic
from robomend_client.literals import Atom, Literal, fails, holds

Question = tuple[HealthCnf, tuple[Literal, ...]]


def chain(length: int) -> Question:
    """Each node reads the one before; only the last topic is seen, and it is silent."""
    nodes = [_node(i, [i - 1] if i else []) for i in range(length)]
    return _robot(nodes), (fails("ok", f"t{length - 1}"),)


def ring(length: int) -> Question:
    """A chain that bites its tail, fed from outside at every hundredth node."""
    nodes = [_node(i, [(i - 1) % length] if i % 100 else []) for i in range(length)]
    return _robot(nodes), (fails("ok", f"t{length - 1}"),)


def closed_ring(length: int) -> Question:
    """A ring that nothing feeds: nothing says that any topic should be there."""
    return _robot([_node(i, [(i - 1) % length]) for i in range(length)]), (fails("ok", "t0"),)


def fan_out(leaves: int) -> Question:
    """A chain twice as long as there are leaves, which all read its end and are all silent."""
    nodes = [_node(i, [i - 1] if i else []) for i in range(2 * leaves)]
    nodes += [_node(2 * leaves + i, [2 * leaves - 1]) for i in range(leaves)]
    return _robot(nodes), tuple(fails("ok", f"t{2 * leaves + i}") for i in range(leaves))


def fan_in(sources: int) -> Question:
    """One node reads many topics that nobody looks at, and is silent."""
    nodes = [_node(i, []) for i in range(sources)] + [_node(sources, range(sources))]
    return _robot(nodes), (fails("ok", f"t{sources}"),)


def grid(side: int) -> Question:
    """Each node reads the ones above and to the left; only the last corner is seen, and it is silent."""
    nodes = []
    for row, column in product(range(side), repeat=2):
        above = [(row - 1) * side + column] if row else []
        left = [row * side + column - 1] if column else []
        nodes.append(_node(row * side + column, above + left))
    return _robot(nodes), (fails("ok", f"t{side * side - 1}"),)


def silent(components: int) -> Question:
    """A third devices, a third drivers, a third that read a driver's topic; every topic is silent."""
    third = components // 3
    nodes = [Node(f"driver{i}", drives=(f"d{i}",), publishes={f"s{i}": ()}) for i in range(third)]
    nodes += [Node(f"n{i}", publishes={f"t{i}": (f"s{i}",)}) for i in range(third)]
    seen = [fails("ok", topic) for node in nodes for topic in node.publishes]
    return _robot(nodes, [Hardware(f"d{i}", channel=i + 1) for i in range(third)]), tuple(seen)


def independent(faults: int) -> Question:
    """So many drivers with a device each, all silent."""
    nodes = [Node(f"driver{i}", drives=(f"d{i}",), publishes={f"s{i}": ()}) for i in range(faults)]
    cnf = _robot(nodes, [Hardware(f"d{i}", channel=i + 1) for i in range(faults)])
    return cnf, tuple(fails("ok", f"s{i}") for i in range(faults))


def one_supply(devices: int) -> Question:
    """All devices hang on one supply, and all are silent."""
    hardware = [Hardware("supply", channel=1)]
    hardware += [Hardware(f"d{i}", channel=i + 2, fed_by=("supply",)) for i in range(devices)]
    nodes = [Node(f"driver{i}", drives=(f"d{i}",), publishes={f"s{i}": ()}) for i in range(devices)]
    return _robot(nodes, hardware), tuple(fails("ok", f"s{i}") for i in range(devices))


def many_publishers(publishers: int) -> Question:
    """One silent topic, so many publishers, of which each alone should be enough."""
    nodes = [Node(f"n{i}", publishes={"t": ()}) for i in range(publishers)]
    return _robot(nodes), (fails("ok", "t"),)


def ladder(rungs: int) -> Question:
    """Two publishers a topic, each reading the topic before: 2^rungs ways to derive the last one."""
    nodes = [
        Node(f"{side}{i}", publishes={f"t{i}": (f"t{i - 1}",) if i else ()})
        for i in range(rungs)
        for side in ("left", "right")
    ]
    return _robot(nodes), (fails("ok", f"t{rungs - 1}"),)


def all_alarms(components: int) -> Question:
    """Each component has an alarm of its own, and all are raised: one diagnosis, of all."""
    return conflicts(components, [(i,) for i in range(components)])


def no_news(components: int) -> Question:
    """A long chain of which nothing is seen."""
    return chain(components)[0], ()


def overlapping(pairs: int) -> Question:
    """Conflicts {1, 2}, {2, 3}, {3, 4}, …"""
    return conflicts(pairs + 1, [(i, i + 1) for i in range(pairs)])


def all_pairs(components: int) -> Question:
    """Every two components are a conflict: all but one must be abnormal."""
    return conflicts(components, list(combinations(range(components), 2)))


def random_triples(components: int) -> Question:
    """Twice as many conflicts as components, of three each: a random hitting-set problem."""
    chance = random.Random(f"triples {components}")
    return conflicts(components, [tuple(chance.sample(range(components), 3)) for _ in range(2 * components)])


def steiner(order: int) -> Question:
    """The lines of the affine geometry of 3^order points: a hitting-set problem that is hard by symmetry."""
    points = list(product(range(3), repeat=order))
    number = {point: index for index, point in enumerate(points)}
    lines = {
        tuple(sorted((number[a], number[b], number[tuple((-x - y) % 3 for x, y in zip(a, b, strict=True))])))
        for a, b in combinations(points, 2)
    }
    return conflicts(len(points), sorted(lines))


def dense(components: int) -> Question:
    """Random rules, ten a component, of up to three components and premises each."""
    chance = random.Random(f"dense {components}")
    atoms = components
    clauses: list[Clause] = []
    for _ in range(10 * components):
        health = [-v for v in chance.sample(range(1, components + 1), chance.randint(1, 3))]
        body = [-(components + v) for v in chance.sample(range(1, atoms + 1), chance.randint(0, 3))]
        clauses.append((*health, *body, components + chance.randint(1, atoms)))
    cnf = _rules(components, atoms, clauses)
    return cnf, tuple(Literal(atom, chance.random() < 0.7) for atom in cnf.atoms if chance.random() < 0.3)


def either_or(length: int) -> Question:
    """A chain whose rules conclude one thing or another, which is no Horn clause; its end is silent."""
    clauses: list[Clause] = []
    for i in range(length):
        before = [-(length + 2 * i - 1), -(length + 2 * i)] if i else []
        outputs = (length + 2 * i + 1, length + 2 * i + 2)
        clauses += [(-(i + 1), one, *outputs) for one in before] or [(-(i + 1), *outputs)]
    cnf = _rules(length, 2 * length, clauses)
    return cnf, (fails("ok", f"a{2 * length - 1}"), fails("ok", f"a{2 * length}"))


def either_or_apart(faults: int) -> Question:
    """Independent faults whose rules are no Horn clauses."""
    clauses = [
        (-(2 * i + 1), -(2 * i + 2), 2 * faults + 2 * i + 1, 2 * faults + 2 * i + 2) for i in range(faults)
    ]
    cnf = _rules(2 * faults, 2 * faults, clauses)
    return cnf, tuple(fails("ok", atom.args[0]) for atom in cnf.atoms)


def parity_chain(length: int) -> Question:
    """Rules that pass a parity on: nothing is known before all are taken together."""
    clauses: list[Clause] = []
    for i in range(1, length + 1):
        a, x, b = length + i, 2 * length + 1 + i, length + i + 1
        for p, q in product((1, -1), repeat=2):
            clauses.append((-i, p * a, q * x, -p * q * b))
    cnf = _rules(length, 2 * length + 1, clauses)
    inputs = [holds("ok", f"a{length + 1 + i}") for i in range(1, length + 1)]
    last = (fails if length % 2 == 0 else holds)("ok", f"a{length + 1}")
    return cnf, (*inputs, holds("ok", "a1"), last)


def pigeons(holes: int) -> Question:
    """Whether the one component can be healthy is a pigeonhole problem: hard for any resolution prover."""
    place = {(p, h): 2 + p * holes + h for p in range(holes + 1) for h in range(holes)}
    clauses: list[Clause] = [(-1, *(place[p, h] for h in range(holes))) for p in range(holes + 1)]
    clauses += [
        (-place[p, h], -place[q, h]) for h in range(holes) for p in range(holes + 1) for q in range(p)
    ]
    return _rules(1, len(place), clauses), ()


def modes(components: int) -> Question:
    """Each component fails in one of two ways, which show; a third of them does."""
    clauses: list[Clause] = []
    named = {}
    for i in range(1, components + 1):
        low, high, out = components + 3 * i - 2, components + 3 * i - 1, components + 3 * i
        clauses += [(i, low, high), (-low, -high), (-i, out), (-low, -out), (-high, out)]
        named[f"c{i}"] = {"low": low, "high": high}
    cnf = _rules(components, 3 * components, clauses, modes=named, weak=False)
    return cnf, tuple((fails if i % 3 else holds)("ok", f"a{3 * i}") for i in range(1, components + 1))


def contradiction(length: int) -> Question:
    """A chain of rules that need no component ends in what was seen to be otherwise."""
    clauses = [(-(i + 1), i + 2) for i in range(1, length)]
    return _rules(1, length, clauses), (holds("ok", "a1"), fails("ok", f"a{length}"))


def wide_rule(components: int) -> Question:
    """One rule of all components."""
    return conflicts(components, [tuple(range(components))])


def inverters(length: int) -> Question:
    """A chain of inverters whose end is wrong."""
    lines = ["INPUT(x0)", f"OUTPUT(x{length})", *(f"x{i + 1} = NOT(x{i})" for i in range(length))]
    return circuit("\n".join(lines)).cnf, (
        holds("v", "x0"),
        Literal(Atom("v", (f"x{length}",)), length % 2 == 1),
    )


def parity_tree(inputs: int) -> Question:
    """XOR gates over so many inputs, a power of two, all 1; the output is wrong."""
    lines = [f"INPUT(n{i})" for i in range(inputs)] + ["OUTPUT(n1t)"]
    level = [f"n{i}" for i in range(inputs)]
    while len(level) > 1:
        above = [f"n{len(level) // 2}t" if len(level) == 2 else f"{a}_" for a in level[::2]]
        lines += [f"{out} = XOR({a}, {b})" for out, a, b in zip(above, level[::2], level[1::2], strict=True)]
        level = above
    seen = [holds("v", f"n{i}") for i in range(inputs)]
    return circuit("\n".join(lines)).cnf, (*seen, holds("v", "n1t"))


def random_circuit(gates: int) -> Question:
    """Random NAND gates over 100 inputs; ten of the outputs that are seen are wrong."""
    chance = random.Random(f"circuit {gates}")
    nets = [f"i{i}" for i in range(100)]
    value = {net: chance.random() < 0.5 for net in nets}
    lines = [f"INPUT({net})" for net in nets]
    read = set()
    for index in range(gates):
        one, other = chance.sample(nets[-2_000:], 2)
        net = f"g{index}"
        value[net] = not (value[one] and value[other])
        lines.append(f"{net} = NAND({one}, {other})")
        nets.append(net)
        read |= {one, other}
    outputs = [net for net in nets if net not in read]
    lines += [f"OUTPUT({net})" for net in outputs]
    wrong = set(chance.sample(outputs, 10))
    seen = [Literal(Atom("v", (net,)), value[net]) for net in nets[:100]]
    return circuit("\n".join(lines)).cnf, (
        *seen,
        *(Literal(Atom("v", (net,)), value[net] != (net in wrong)) for net in outputs),
    )


def conflicts(components: int, sets: Iterable[Iterable[int]]) -> Question:
    """A system that has just these conflicts, of components counted from 0, each with an alarm of its own."""
    clauses: list[Clause] = []
    for number, members in enumerate(sets, 1):
        clauses.append((*(-(one + 1) for one in members), components + number))
    cnf = _rules(components, len(clauses), clauses)
    return cnf, tuple(Literal(atom, False) for atom in cnf.atoms)


def _node(index: int, reads: Iterable[int]) -> Node:
    return Node(f"n{index}", publishes={f"t{index}": tuple(f"t{one}" for one in reads)})


def _robot(nodes: Iterable[Node], hardware: Iterable[Hardware] = ()) -> HealthCnf:
    named = {node.name: node for node in nodes}
    devices = {device.name: device for device in hardware}
    topics = {topic: Topic(topic) for node in named.values() for topic in node.publishes}
    model = ComponentModel("odd", devices, named, topics, channels=max(10, len(devices)))
    return compile_robot(model).cnf


def _rules(components: int, atoms: int, clauses: Iterable[Clause], **more: object) -> HealthCnf:
    listed = tuple(clauses)
    return HealthCnf(
        name="odd",
        components=tuple(f"c{i}" for i in range(1, components + 1)),
        atoms=tuple(Atom("ok", (f"a{i}",)) for i in range(1, atoms + 1)),
        clauses=listed,
        origins=tuple(range(len(listed))),
        rules=tuple(Rule(f"rule {i}", f"user rule {i}") for i in range(1, len(listed) + 1)),
        variables=components + atoms,
        **{"weak": True, **more},  # type: ignore[arg-type]  # fields of HealthCnf, by name
    )


MODELS: Mapping[str, tuple[Callable[[int], Question], tuple[int, ...]]] = {
    "chain": (chain, (50, 5_000, 20_000)),
    "ring": (ring, (5_000,)),
    "closed-ring": (closed_ring, (5_000,)),
    "fan-out": (fan_out, (50, 1_000)),
    "fan-in": (fan_in, (2_000,)),
    "grid": (grid, (10, 50)),
    "silent": (silent, (1_000, 9_000)),
    "independent": (independent, (20, 200, 2_000)),
    "one-supply": (one_supply, (20, 300)),
    "many-publishers": (many_publishers, (500,)),
    "ladder": (ladder, (6, 12, 100)),
    "all-alarms": (all_alarms, (600, 5_000)),
    "no-news": (no_news, (10_000,)),
    "overlapping": (overlapping, (30, 400)),
    "all-pairs": (all_pairs, (30, 100)),
    "random-triples": (random_triples, (40, 200, 2_000)),
    "steiner": (steiner, (2, 3, 4)),
    "dense": (dense, (100, 1_000)),
    "either-or": (either_or, (30, 2_000)),
    "either-or-apart": (either_or_apart, (200,)),
    "parity-chain": (parity_chain, (30, 1_000)),
    "pigeons": (pigeons, (12,)),
    "modes": (modes, (30, 600)),
    "contradiction": (contradiction, (3_000,)),
    "wide-rule": (wide_rule, (5_000,)),
    "inverters": (inverters, (20_000,)),
    "parity-tree": (parity_tree, (4_096,)),
    "random-circuit": (random_circuit, (2_000, 19_000)),
}
"""Name -> how it is made, and sizes."""
