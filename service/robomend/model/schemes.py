"""The six clause schemes of the paper, and what the opt-in keys of a component model change in them.

    1  h ∈ SH                        ¬AB(h) → on(h)
    2  s ∈ SN, t ∈ out(s)            ¬AB(s) ∧ ⋀ ¬AB(h), h ∈ hardware(s) → ok(t)
    3  h ∈ HN, t ∈ out(h)            ¬AB(h) → ok(t)
    4  n ∈ N,  t ∈ out(n)            ¬AB(n) ∧ ⋀ ok(i), i ∈ in(t, n) → ok(t)
    5  n ∈ C ∖ (H ∪ SH)              ¬AB(n) → running(n)
    6  related values v1 ≠ v2        ¬AB(n1) ∧ ¬AB(n2) → matched(v1, v2)
       of topics that n1, n2 publish

The paper prints out(s) in scheme 3, in(t, s) in scheme 4 and C \\ {H, SH} in schemes 5 and 6; what is meant
is above. hardware(s) holds the switchable devices of a driver: a device without channel beside one adds
nothing to scheme 2. Two publishers of one topic give two clauses, each literally as the scheme says.

Opt-in keys add premises, never clauses of another shape:

- `inputs_matter` on a driver: ok(i) for the inputs of t, as in scheme 4.
- `blame_hardware` on a device without channel: ¬AB(h) in the clauses of its drivers, so that it can be
  blamed.
- `fed_by: [psu]`: power is a chain of on(…), as data is a chain of ok(…). The fed device's clause 1 reads
  ¬AB(h) ∧ on(psu) → on(h), for every feeder (all are needed), and its drivers' clauses also need on(h): a
  device that gets no power is not to blame for being silent, nor is its driver. But on(h) of a channel is
  the position of a relay, which stays where it is when the supply fails: so the drivers' clauses need
  ¬AB(psu) as well, of every feeder up the chain, and a supply that hangs with its relay closed can be
  blamed. A feeder without channel gets a clause 1 of its own, since its on(psu) now bears weight. Without
  `fed_by` nothing changes.

- `computer: true` on a device: ok(load,pc) in the clauses 2 to 4 of nodes whose `host` it is, as an input is:
  what comes late on an overloaded computer blames no node. And ¬AB(pc) → ok(load,pc).

And one takes clauses away: a topic that is `silent` by design is no output in schemes 2 to 4.

Source: section IV-D of the paper.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from robomend.model.cnf import Output, Rule
from robomend.model.components import KINDS, LOAD, ComponentModel, Hardware, Node
from robomend.model.formulas import And, Formula, Implies, Leaf, ab
from robomend_client.literals import Atom, Literal, holds

Scheme = Iterator[tuple[Formula, Rule]]


def schemes(model: ComponentModel) -> Scheme:
    """Yield the rules of a model, scheme by scheme, each in the order of the model."""
    yield from power(model)
    yield from drivers(model)
    yield from nodes(model)
    yield from running(model)
    yield from related(model)
    yield from computers(model)
    yield from other_kinds(model)


def power(model: ComponentModel) -> Scheme:
    """Scheme 1, and its counterparts for feeders and fed devices without channel."""
    feeders = {feeder for device in model.hardware.values() for feeder in device.fed_by}
    for device in model.hardware.values():
        if device.channel is not None or device.fed_by or device.name in feeders:
            source = "scheme 1" if device.channel is not None and not device.fed_by else "feed"
            fed = [holds("on", feeder) for feeder in device.fed_by]
            yield _rule([-ab(device.name), *fed], holds("on", device.name), source, device.line)


def drivers(model: ComponentModel) -> Scheme:
    """Schemes 2 and 3."""
    for number, wanted in ((2, True), (3, False)):
        for node in model.nodes.values():
            devices = [model.hardware[name] for name in node.drives]
            if not devices or any(device.channel is not None for device in devices) != wanted:
                continue
            working = (premise for device in devices for premise in _working(model, device))
            premises = [-ab(node.name), *dict.fromkeys(working)]
            for topic, inputs in _heard(model, node):
                needed = [holds("ok", i) for i in inputs] if node.inputs_matter else []
                needed += _load(model, node)
                yield _rule([*premises, *needed], holds("ok", topic), f"scheme {number}", node.line)


def nodes(model: ComponentModel) -> Scheme:
    """Scheme 4."""
    for node in model.nodes.values():
        if not node.drives:
            for topic, inputs in _heard(model, node):
                needed = [*(holds("ok", i) for i in inputs), *_load(model, node)]
                yield _rule([-ab(node.name), *needed], holds("ok", topic), "scheme 4", node.line)


def running(model: ComponentModel) -> Scheme:
    """Scheme 5."""
    for node in model.nodes.values():
        yield _rule([-ab(node.name)], holds("running", node.name), "scheme 5", node.line)


def related(model: ComponentModel) -> Scheme:
    """Scheme 6; `matched` is symmetric, so each pair of values comes once for each pair of publishers."""
    publishers = publishers_of(model)
    seen = set()
    for pair in model.related:
        first, second = sorted(pair)
        for one in publishers.get(model.values[first].topic, ()):
            for other in publishers.get(model.values[second].topic, ()):
                key = (first, second, *sorted({one.name, other.name}))
                if key not in seen:
                    seen.add(key)
                    premises = [-ab(name) for name in dict.fromkeys((one.name, other.name))]
                    yield _rule(premises, holds("matched", first, second), "scheme 6", one.line)


def computers(model: ComponentModel) -> Scheme:
    """A computer that is healthy is not overloaded."""
    for name in model.computers:
        yield _rule([-ab(name)], holds("ok", LOAD, name), "computer", model.hardware[name].line)


def other_kinds(model: ComponentModel) -> Scheme:
    """What components of kinds that the paper does not have say of themselves."""
    for kind in KINDS:
        if kind not in {Hardware, Node}:
            for part in model.of(kind).values():
                for premises, conclusion in part.clauses():
                    yield _rule([-ab(part.name), *premises], conclusion, f"kind {kind.what}", part.line)


def publishers_of(model: ComponentModel) -> Mapping[str, list[Node]]:
    """Return topic -> the nodes that publish it."""
    found: dict[str, list[Node]] = {}
    for node in model.nodes.values():
        for topic in node.publishes:
            found.setdefault(topic, []).append(node)
    return found


def outputs(model: ComponentModel) -> dict[str, tuple[Output, ...]]:
    """Return component -> what it silences by failing: of a device, the topics of all whom it powers."""
    found: dict[str, list[Output]] = {}
    atoms: dict[str, Atom] = {}

    def ok(topic: str) -> Atom:
        """Return one atom for all who name a topic: large models travel."""
        return atoms.get(topic) or atoms.setdefault(topic, Atom("ok", (topic,)))

    for node in model.nodes.values():
        inputs_count = not node.drives or node.inputs_matter
        powered = [model.hardware[name] for name in node.drives]
        names = dict.fromkeys(
            name for device in powered for name in (device.name, *model.feeders(device.name))
        )
        for topic, inputs in _heard(model, node):
            rests_on = tuple(map(ok, inputs)) if inputs_count else ()
            rests_on += tuple(literal.atom for literal in _load(model, node))
            output = Output(ok(topic), node.name, rests_on)
            for name in (node.name, *names):
                found.setdefault(name, []).append(output)
    return {name: tuple(each) for name, each in found.items()}


def _heard(model: ComponentModel, node: Node) -> list[tuple[str, tuple[str, ...]]]:
    """Return what a node publishes, and what that rests on, but for topics that are silent by design."""
    return [
        (topic, inputs)
        for topic, inputs in node.publishes.items()
        if topic not in model.topics or not model.topics[topic].silent
    ]


def _load(model: ComponentModel, node: Node) -> list[Literal]:
    """Return what a node's output needs of the computer that it runs on."""
    return [holds("ok", LOAD, node.host)] if node.host is not None and node.host in model.computers else []


def _working(model: ComponentModel, device: Hardware) -> list[Literal]:
    """Return what a driver's output needs of a device."""
    blamed = device.channel is not None or device.blame
    return [
        *([-ab(device.name)] if blamed else []),
        *([holds("on", device.name)] if device.fed_by else []),
        *(-ab(name) for name in model.feeders(device.name)),
    ]


def _rule(
    premises: list[Literal], conclusion: Literal, source: str, line: int | None
) -> tuple[Formula, Rule]:
    left: Formula = (
        Leaf(premises[0]) if len(premises) == 1 else And(tuple(Leaf(premise) for premise in premises))
    )
    text = f"{' and '.join(map(str, premises))} -> {conclusion}"
    return Implies(left, Leaf(conclusion)), Rule(text, source, line)
