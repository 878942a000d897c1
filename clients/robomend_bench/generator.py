"""Random robots of any size, and faults in circuits, the same for the same seed: `robots-v1`.

A third of the components is hardware, half of that on a power channel. Each device has a driver that
publishes a topic or two; the other nodes rest on one to three topics that came shortly before them, as the
stages of a perception or planning pipeline do, so that faults cascade through several stages.

What is seen follows from 1-4 broken components: a topic is ok when its publisher, the devices that it
drives and all topics that it rests on are. Broken devices may be off, broken nodes may have stopped. Three
topics of ten are not observed.

Results are compared across versions: do not change this generator, write `robots-v2` beside it.

In circuits some gates give the opposite of what they should, or compute another function. Only runs whose
outputs differ from the healthy ones are kept, so that every question has a minimum cardinality of at least
one. Inputs and outputs are observed, a net that is both only once.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from robomend.errors import ModelError
from robomend.model.cnf import HealthCnf
from robomend.model.compiling import compile_robot
from robomend.model.components import ComponentModel, Hardware, Node, Topic
from robomend_client.literals import Atom, Literal, fails, holds

GATE = re.compile(r"\s*([^\s(),=#]+)\s*=\s*(\w+)\s*\(([^()]*)\)")
PORT = re.compile(r"\s*(INPUT|OUTPUT)\s*\(\s*([^\s(),=#]+)\s*\)", re.IGNORECASE)
ATTEMPTS = 1000
"""Runs that are thrown away at most, because nothing was to be seen of their faults, until one is kept."""

RUNS = 1_500
FEW_IN = (60, 5)
"""Runs with the same gates broken, until enough are kept; others are taken when of the first 60 not 5 are."""

FUNCTIONS: dict[str, Callable[[Sequence[bool]], bool]] = {
    "AND": all,
    "NAND": lambda values: not all(values),
    "OR": any,
    "NOR": lambda values: not any(values),
    "XOR": lambda values: sum(values) % 2 == 1,
    "XNOR": lambda values: sum(values) % 2 == 0,
    "NOT": lambda values: not values[0],
    "BUF": lambda values: values[0],
    "BUFF": lambda values: values[0],
}
OF_MANY = ("AND", "NAND", "OR", "NOR", "XOR", "XNOR")


@dataclass(frozen=True)
class Circuit:
    """A combinational netlist; `gates` is net -> (function, nets read), in topological order."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    gates: Mapping[str, tuple[str, tuple[str, ...]]]

    def simulate(self, inputs: Mapping[str, bool], faults: Mapping[str, str]) -> dict[str, bool]:
        """Return the value of each net. `faults`: gate -> "flipped", or the function it computes instead."""
        values = dict(inputs)
        for net, (kind, reads) in self.gates.items():
            fault = faults.get(net)
            read = [values[other] for other in reads]
            if fault == "flipped":
                values[net] = not FUNCTIONS[kind](read)
            else:
                values[net] = FUNCTIONS[fault or kind](read)
        return values


def read_circuit(text: str) -> Circuit:
    """Read a .bench text that robomend.model.bench has already accepted."""
    inputs: list[str] = []
    outputs: list[str] = []
    gates: dict[str, tuple[str, tuple[str, ...]]] = {}
    for line in text.splitlines():
        if match := GATE.match(line):
            kind = match[2].upper()
            if kind not in FUNCTIONS:
                raise ModelError(f"gate {match[1]} is {kind}: only combinational circuits take faults")
            gates[match[1]] = (kind, tuple(net.strip() for net in match[3].split(",")))
        elif match := PORT.match(line):
            (inputs if match[1].upper() == "INPUT" else outputs).append(match[2])
    ordered: dict[str, tuple[str, tuple[str, ...]]] = {}
    done = set(inputs)
    while gates:
        ready = [net for net, (_, reads) in gates.items() if done.issuperset(reads)]
        if not ready:
            raise ModelError(f"gate {next(iter(gates))} reads a net that nothing drives, or itself")
        for net in ready:
            ordered[net] = gates.pop(net)
        done.update(ready)
    return Circuit(tuple(inputs), tuple(outputs), ordered)


def observe_faulty(circuit: Circuit, faults: int, chance: random.Random) -> tuple[Literal, ...]:
    """Return what is seen at inputs and outputs of a run with so many faults that show.

    Raises:
        ModelError: after ATTEMPTS runs nothing was to be seen of any fault.
    """
    gates = list(circuit.gates)
    for _ in range(ATTEMPTS):
        inputs = {net: chance.random() < 0.5 for net in circuit.inputs}
        broken = {
            net: fault_of(circuit.gates[net], chance) for net in chance.sample(gates, min(faults, len(gates)))
        }
        seen = circuit.simulate(inputs, broken)
        meant = circuit.simulate(inputs, {})
        if any(seen[net] != meant[net] for net in circuit.outputs):
            observed = dict.fromkeys((*circuit.inputs, *circuit.outputs))
            return tuple(Literal(Atom("v", (net,)), seen[net]) for net in observed)
    raise ModelError(f"{faults} faults in this circuit are never seen at its outputs")


def observe_mutated(
    circuit: Circuit, faults: int, runs: int, chance: random.Random
) -> tuple[tuple[Literal, ...], ...]:
    """Return what is seen at inputs and outputs in so many runs with the same gates broken; in each it shows.

    Raises:
        ModelError: after ATTEMPTS choices of gates there were none whose faults are seen often enough.
    """
    gates = list(circuit.gates)
    nets = tuple(dict.fromkeys((*circuit.inputs, *circuit.outputs)))
    first, least = FEW_IN
    for _ in range(ATTEMPTS):
        broken = {net: fault_of(circuit.gates[net], chance) for net in chance.sample(gates, faults)}
        kept: list[tuple[Literal, ...]] = []
        for tried in range(RUNS):
            inputs = {net: chance.random() < 0.5 for net in circuit.inputs}
            seen, meant = circuit.simulate(inputs, broken), circuit.simulate(inputs, {})
            if any(seen[net] != meant[net] for net in circuit.outputs):
                kept.append(tuple(Literal(Atom("v", (net,)), seen[net]) for net in nets))
            if len(kept) == runs:
                return tuple(kept)
            if tried == first and len(kept) < least:
                break
    raise ModelError(f"{faults} faults in this circuit are hardly ever seen at its outputs")


def fault_of(gate: tuple[str, tuple[str, ...]], chance: random.Random) -> str:
    """Return what a broken gate does: "flipped", or the function that it computes instead."""
    kind, reads = gate
    if len(reads) < 2 or chance.random() < 0.5:
        return "flipped"
    return chance.choice([other for other in OF_MANY if other != kind])


HARDWARE_SHARE = 1 / 3
REACH = 12
"""A node rests on some of so many topics before its own."""

OBSERVED_SHARE = 0.7


@dataclass(frozen=True)
class Robot:
    """A model and its clauses."""

    model: ComponentModel
    cnf: HealthCnf


def make_robot(components: int, seed: int) -> Robot:
    """Return a robot with so many components, at least 3."""
    chance = random.Random(f"robots-v1 {components} {seed}")
    devices = max(1, round(components * HARDWARE_SHARE))
    hardware: dict[str, Hardware] = {}
    nodes: dict[str, Node] = {}
    topics: list[str] = []

    def publish(node: str, inputs: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
        names = [f"{node}/t{index}" for index in range(1 + (chance.random() < 0.2))]
        topics.extend(names)
        return dict.fromkeys(names, inputs)

    for index in range(devices):
        name = f"device{index}"
        hardware[name] = Hardware(name, channel=index if chance.random() < 0.5 else None)
        driver = f"driver{index}"
        if len(nodes) < components - devices:
            nodes[driver] = Node(driver, drives=(name,), publishes=publish(driver, ()))
    for index in range(components - devices - len(nodes)):
        name = f"node{index}"
        reachable = topics[-REACH:]
        inputs = tuple(chance.sample(reachable, min(len(reachable), chance.randint(1, 3))))
        nodes[name] = Node(name, publishes=publish(name, inputs))
    model = ComponentModel(
        name=f"robot{components}",
        hardware=hardware,
        nodes=nodes,
        topics={name: Topic(name) for name in topics},
        channels=max(10, devices),
    )
    return Robot(model, compile_robot(model).cnf)


def observe(robot: Robot, faults: int, chance: random.Random) -> tuple[Literal, ...]:
    """Return what is seen of a robot with so many broken components; 0: of a healthy one."""
    model = robot.model
    switchable = [name for name, device in model.hardware.items() if device.channel is not None]
    blamable = [*switchable, *model.nodes]
    broken = frozenset(chance.sample(blamable, min(faults, len(blamable))))
    seen: list[Literal] = []
    for name, device in model.hardware.items():
        if device.channel is not None:
            off = name in broken and chance.random() < 0.5
            seen.append(fails("on", name) if off else holds("on", name))
    ok: dict[str, bool] = {}
    for name, node in model.nodes.items():
        stopped = name in broken and chance.random() < 0.5
        seen.append(fails("running", name) if stopped else holds("running", name))
        works = name not in broken and broken.isdisjoint(node.drives)
        for topic, inputs in node.publishes.items():
            ok[topic] = works and all(ok[other] for other in inputs)
            if chance.random() < OBSERVED_SHARE:
                seen.append(holds("ok", topic) if ok[topic] else fails("ok", topic))
    return tuple(seen)
