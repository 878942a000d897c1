"""The component model: what a user writes of a robot, as values.

`robomend.model.loading` reads it from YAML and checks it; `robomend.model.schemes` turns it into clauses.
The kinds are the paper's (section IV-D): SH switchable hardware, H other hardware, SN drivers of switchable
hardware, HN drivers of other hardware only, N nodes that drive nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from robomend.model.cnf import PARTIAL


@dataclass(frozen=True, slots=True)
class Hardware:
    """A device; with a channel it is switchable."""

    name: str
    channel: int | None = None
    fed_by: tuple[str, ...] = ()
    blame: bool = False  # H joins its driver's clause
    protected: bool = False  # nothing ever shuts it down
    prior: float | None = None  # P(AB), 0 < p < 1
    cost: float | None = None  # of its repair actions, relative to the domain's own
    modes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Fault mode -> sentences that hold in it."""
    exhaustive_modes: bool = False  # no other way to fail than these modes
    host: str | None = None
    line: int | None = None


@dataclass(frozen=True, slots=True)
class Node:
    """A process; what it publishes rests on its inputs and on the hardware it drives."""

    name: str
    drives: tuple[str, ...] = ()
    publishes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Topic -> the input topics that it rests on."""
    inputs_matter: bool = False  # a driver's inputs count too
    restartable: bool = True
    tied_to: tuple[str, ...] = ()  # this node must restart after one of these restarts
    protected: bool = False
    prior: float | None = None
    cost: float | None = None
    modes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    exhaustive_modes: bool = False
    host: str | None = None  # the agent that runs it
    line: int | None = None


@dataclass(frozen=True, slots=True)
class Topic:
    """A channel of messages; rate and tolerance are for the observers."""

    name: str
    rate_hz: float | None = None
    tolerance_hz: float | None = None
    cost: float | None = None  # of observing it, seconds


@dataclass(frozen=True, slots=True)
class Value:
    """A field of a topic's messages, whose trend is observed."""

    name: str
    topic: str
    field: str


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
    partial_failure: float = PARTIAL  # P(a component that fails does so in part only), for weighing

    @property
    def components(self) -> tuple[str, ...]:
        """COMPS: hardware, then nodes, in the order of the model."""
        return (*self.hardware, *self.nodes)

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
