"""The component model: what a user writes of a robot, as values.

`robomend.model.loading` reads it from YAML and checks it; `robomend.model.schemes` turns it into clauses.
The kinds are the paper's (section IV-D): SH switchable hardware, H other hardware, SN drivers of switchable
hardware, HN drivers of other hardware only, N nodes that drive nothing.

To add a kind of component: 1. its class here, and in KINDS: keys (and what they are, under `Attributes:` of
its docstring, which editors show), state, clauses; 2. in pddl/repair.pddl
its type, the predicates of its state, its actions; 3. in docs/models.md, where one is shown whole:
its section of a model with its keys, its state among what is observed, and its sort among those that
quantifiers range over. The format, the vocabulary, diagnosis and planning follow from these, and the
schema in examples/, which `./dev check --fix` writes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum
from typing import ClassVar

from robomend.model.cnf import PARTIAL
from robomend_client.literals import Literal, holds


class Criticality(StrEnum):
    """How much the robot needs something; from most to least."""

    ESSENTIAL = "essential"
    NORMAL = "normal"
    OPTIONAL = "optional"


@dataclass(frozen=True, slots=True)
class Component:
    """What every component has. A kind is a class of it, with keys of its own as fields."""

    section: ClassVar[str]  # of the model's text; also the sort that quantifiers range over
    what: ClassVar[str]  # one of them, in words; also its type in PDDL
    state: ClassVar[str]  # the predicate that is observed of a good one …
    lost: ClassVar[tuple[str, ...]]  # … and its opposites in PDDL

    name: str
    _: KW_ONLY
    protected: bool = False  # nothing ever shuts it down
    prior: float | None = None  # P(AB), 0 < p < 1
    cost: float | None = None  # of its repair actions, relative to the domain's own
    modes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Fault mode -> sentences that hold in it."""
    exhaustive_modes: bool = False  # no other way to fail than these modes
    host: str | None = None  # the computer that it runs on or hangs on
    criticality: Criticality = Criticality.NORMAL
    helps: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Act -> fault mode ("": any) -> P(it cures the component | it is what is wrong)."""
    line: int | None = None

    def clauses(self) -> Iterable[tuple[Iterable[Literal], Literal]]:
        """Yield (premises, conclusion) of what holds if it is healthy; the paper's kinds have schemes.py."""
        yield (), holds(self.state, self.name)


@dataclass(frozen=True, slots=True)
class Hardware(Component):
    """A device; with a channel it is switchable."""

    section = "hardware"
    what = "hardware"
    state = "on"
    lost = ("off", "not_on")

    channel: int | None = None
    fed_by: tuple[str, ...] = ()
    blame: bool = False  # H joins its driver's clause
    boot_s: float | None = None  # from its power to its answering
    computer: bool = False  # what runs on it comes late when it is overloaded


@dataclass(frozen=True, slots=True)
class Node(Component):
    """A process; what it publishes rests on its inputs and on the hardware it drives."""

    section = "nodes"
    what = "node"
    state = "running"
    lost = ("stopped", "not_running")

    drives: tuple[str, ...] = ()
    publishes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Topic -> the input topics that it rests on."""
    inputs_matter: bool = False  # a driver's inputs count too
    restartable: bool = True
    tied_to: tuple[str, ...] = ()  # this node must restart after one of these restarts
    start_s: float | None = None  # from its beginning to its topics, its inputs and devices being there
    reconnects: bool = False  # it finds its device again by itself, once that has its power back


KINDS: tuple[type[Component], ...] = (Hardware, Node)
"""In the order of COMPS."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A channel of messages; rate and tolerance are for the observers."""

    name: str
    rate_hz: float | None = None
    tolerance_hz: float | None = None
    cost: float | None = None  # of observing it, seconds
    silent: bool = False  # by design, if need be: its silence blames nobody
    latched: bool = False  # the last message is kept for those who come later


@dataclass(frozen=True, slots=True)
class Value:
    """A field of a topic's messages, whose trend is observed."""

    name: str
    topic: str
    field: str


@dataclass(frozen=True, slots=True)
class Remedy:
    """An act that somebody is configured for, an agent mostly, and what it mends."""

    name: str  # as the agent has it: clear_costmap
    parameters: tuple[str, ...]
    mends: tuple[str, ...]  # components
    cost: float | None = None  # about seconds; None: the domain's
    symptoms: tuple[str, ...] = ()  # it helps against these only (robomend_client.readings.Symptom)
    needs: tuple[str, ...] = ()  # components that must be good before, besides those that the model knows
    restarts: tuple[str, ...] = ()  # nodes that must restart after it
    starts: bool = False  # the nodes that it mends need not run: it starts them
    line: int | None = None

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.parameters)})"


LOAD = "load"
"""The property of a computer that it is not overloaded: ok(load,pc)."""

DWELL_S = 5.0
CHANGES_PER_HOUR = 60


@dataclass(frozen=True, slots=True)
class Variant:
    """One way in which a function of the robot can work."""

    name: str
    when: str | None = None  # a sentence that OBS must show; may compare readings: `visibility >= 3.25 ± 0.1`
    needs: tuple[str, ...] = ()  # components, functions, or one variant of a function as `function.variant`
    do: tuple[tuple[str, tuple[str, ...]], ...] = ()  # acts that make it active, in order: name, parameters
    line: int | None = None
    when_line: int | None = None


@dataclass(frozen=True, slots=True)
class Function:
    """What the robot does in one of several variants; which one is active is observed."""

    name: str
    variants: Mapping[str, Variant]  # the preferred first
    dwell_s: float = DWELL_S  # a better variant must be admissible for so long before it is changed to
    adapt: str | None = None  # observe, approve or auto; None: the robot's policy
    changes_per_hour: int = CHANGES_PER_HOUR  # then it stays with the safer one
    criticality: Criticality = Criticality.NORMAL
    notify: bool = False  # whether people are told of changes
    line: int | None = None


@dataclass(frozen=True)
class ComponentModel:
    """A robot: hardware, nodes, topics, and the user's own rules."""

    name: str
    hardware: Mapping[str, Hardware]
    nodes: Mapping[str, Node]
    topics: Mapping[str, Topic]
    properties: tuple[str, ...] = ()
    values: Mapping[str, Value] = field(default_factory=dict)
    related: tuple[tuple[str, str], ...] = ()
    rules: tuple[str, ...] = ()
    channels: int = 10  # of the robot's power board
    protected_channels: tuple[int, ...] = ()  # never shut down, e.g. the one that feeds the robot's computer
    property_costs: Mapping[str, float] = field(default_factory=dict)  # of observing, in seconds
    rule_lines: tuple[int | None, ...] = ()  # parallel to rules where known
    act_when: str | None = None  # nothing is sent to the robot unless OBS shows this sentence
    act_when_line: int | None = None
    others: Mapping[str, Mapping[str, Component]] = field(default_factory=dict)  # section -> of other kinds
    partial_failure: float = PARTIAL  # P(a component that fails does so in part only), for weighing
    remedies: tuple[Remedy, ...] = ()  # besides restarts and power
    functions: Mapping[str, Function] = field(default_factory=dict)

    @property
    def components(self) -> tuple[str, ...]:
        """COMPS: hardware, then nodes, then the other kinds, in the order of the model."""
        return (*self.hardware, *self.nodes, *(name for named in self.others.values() for name in named))

    @property
    def parts(self) -> Mapping[str, Component]:
        """The components by name, in the order of COMPS."""
        return {name: part for kind in KINDS for name, part in self.of(kind).items()}

    @property
    def acts(self) -> tuple[str, ...]:
        """The names of the acts of all variants."""
        variants = (one for function in self.functions.values() for one in function.variants.values())
        return tuple(dict.fromkeys(name for variant in variants for name, _ in variant.do))

    def of(self, kind: type[Component]) -> Mapping[str, Component]:
        """Return the components of a kind, by name."""
        if kind is Hardware:
            return self.hardware
        return self.nodes if kind is Node else self.others.get(kind.section, {})

    @property
    def computers(self) -> tuple[str, ...]:
        """The devices whose load counts for what runs on them."""
        return tuple(name for name, device in self.hardware.items() if device.computer)

    def feeders(self, name: str) -> tuple[str, ...]:
        """Return what a device gets its power from, all the way up, nearest first."""
        found = dict.fromkeys(self.hardware[name].fed_by)
        pending = list(found)
        for feeder in pending:  # grows on the way
            new = [other for other in self.hardware[feeder].fed_by if other not in found]
            found.update(dict.fromkeys(new))
            pending += new
        return tuple(found)

    def switchable(self, name: str) -> bool:
        """Whether this is hardware on a board channel (the paper's SH)."""
        hardware = self.hardware.get(name)
        return hardware is not None and hardware.channel is not None
