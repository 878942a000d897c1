"""The component model as users write it: YAML to checked values (design, section 3).

Everything wrong is refused with its file and line, and with what is allowed there. The tables of keys below
are the whole format; docs and the starter model of `robomend init` follow them.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import fields
from typing import Any, NoReturn, TypeVar

from robomend.errors import ModelError, ObservationError
from robomend.model.clauses import UNKNOWN_MODE
from robomend.model.cnf import PARTIAL
from robomend.model.components import (
    CHANGES_PER_HOUR,
    DWELL_S,
    KINDS,
    Component,
    ComponentModel,
    Criticality,
    Function,
    Hardware,
    Node,
    Remedy,
    Topic,
    Value,
    Variant,
)
from robomend.model.sentences import plain, tokens
from robomend_client import yaml_tree
from robomend_client.near import did_you_mean
from robomend_client.readings import Symptom
from robomend_client.yaml_tree import Mapping, Scalar, Sequence, Tree

OTHER_KINDS = KINDS[2:]
MODEL_KEYS = (
    "robomend", "name", "channels", "protected_channels", *(kind.section for kind in KINDS), "topics",
    "properties", "values", "related", "rules", "functions", "remedies", "act_when", "blame_hardware",
    "inputs_matter", "partial_failure",
)  # fmt: skip
PART_KEYS = ("prior", "cost", "modes", "exhaustive_modes", "host", "protected", "criticality", "helps")
HARDWARE_KEYS = ("channel", "fed_by", "blame_hardware", "boot_s", "computer", *PART_KEYS)
NODE_KEYS = (
    "drives", "publishes", "inputs_matter", "restartable", "tied_to", "start_s", "reconnects", *PART_KEYS,
)  # fmt: skip
TOPIC_KEYS = ("rate_hz", "tolerance_hz", "silent", "latched", "cost")
PROPERTY_KEYS = ("cost",)
VALUE_KEYS = ("topic", "field")
REMEDY_KEYS = ("mends", "cost", "symptoms", "needs", "restarts", "starts")
SYMPTOMS = tuple(str(one) for one in Symptom)
FUNCTION_KEYS = ("prefer", "variants", "dwell_s", "adapt", "changes_per_hour", "criticality", "notify")
VARIANT_KEYS = ("when", "needs", "do")
ADAPT = ("observe", "approve", "auto")
ACT = re.compile(r"x(\((x(,x)*)?\))?")
"""An act, each of its words an x."""

COMMON_FIELDS = frozenset(one.name for one in fields(Component))

FORMAT = 1
MAX_NAME = 200
MAX_CHANNELS = 255
MAX_WHOLE = 999_999_999
MOST_S = 3600
"""Of a boot or a start: what takes longer is waited for by a person."""

TRUE, FALSE = ("true", "True", "yes", "on"), ("false", "False", "no", "off")

T = TypeVar("T")


def read_model(tree: Tree, name: str | None = None, file: str | None = None) -> ComponentModel:
    """Return the component model that a YAML document describes.

    Args:
        name: used when the document gives none.

    Raises:
        ModelError: with file and line, and what is allowed there.
    """
    return _Reader(file).model(tree, name)


class _Reader:
    """Reads entries; holds the file's name for the errors."""

    def __init__(self, file: str | None) -> None:
        self.file = file

    def fail(self, message: str, line: int) -> NoReturn:
        raise ModelError(message, self.file, line)

    # --- the whole --------------------------------------------------------------------------------------

    def model(self, tree: Tree, name: str | None) -> ComponentModel:
        top = self.mapping(tree, "a model", MODEL_KEYS)
        version = top.items.get("robomend")
        if not isinstance(version, Scalar) or version.text != str(FORMAT):
            self.fail(f"`robomend: {FORMAT}` is the only format known", version.line if version else 1)
        read_name = self.optional(top, "name", self.text)
        channels = self.optional(top, "channels", self.whole(1, MAX_CHANNELS)) or 10
        protected = self.optional(top, "protected_channels", self.list_of(self.whole(0, channels - 1))) or ()
        blame = self.optional(top, "blame_hardware", self.flag) or False
        inputs_matter = self.optional(top, "inputs_matter", self.flag) or False
        hardware = {
            key: self.hardware(key, entry, line, channels, blame, protected)
            for key, entry, line in self.named(top, "hardware")
        }
        nodes = {
            key: self.node(key, entry, line, inputs_matter) for key, entry, line in self.named(top, "nodes")
        }
        others = {
            kind.section: {
                key: self.other(kind, key, entry, line) for key, entry, line in self.named(top, kind.section)
            }
            for kind in OTHER_KINDS
        }
        topics = {key: self.topic(key, entry) for key, entry, _ in self.named(top, "topics")}
        properties: list[str] = []
        property_costs: dict[str, float] = {}
        for key, entry, _ in self.named(top, "properties"):
            properties.append(key)
            cost = self.optional(
                self.mapping(entry, f"property {key}", PROPERTY_KEYS), "cost", self.number(0)
            )
            if cost is not None:
                property_costs[key] = cost
        values = {key: self.value(key, entry, line) for key, entry, line in self.named(top, "values")}
        rules = self.optional(top, "rules", self.list_of(self.with_line)) or ()
        act_when = self.optional(top, "act_when", self.with_line)
        model = ComponentModel(
            name=read_name or name or "model",
            hardware=hardware,
            nodes=nodes,
            topics=topics,
            properties=tuple(properties),
            values=values,
            related=tuple(pair for pair, _ in self.related(top)),
            rules=tuple(text for text, _ in rules),
            channels=channels,
            protected_channels=tuple(dict.fromkeys(protected)),
            property_costs=property_costs,
            rule_lines=tuple(line for _, line in rules),
            act_when=None if act_when is None else act_when[0],
            act_when_line=None if act_when is None else act_when[1],
            others=others,
            partial_failure=self.optional(top, "partial_failure", self.probability) or PARTIAL,
            remedies=tuple(self.remedies(top)),
            functions={
                key: self.function(key, entry, line) for key, entry, line in self.named(top, "functions")
            },
        )
        if not model.components:
            sections = " or ".join(f"`{kind.section}:`" for kind in KINDS)
            self.fail(f"the model has no component: give it {sections}", tree.line)
        Checks(self.file, top, model).all()
        return model

    # --- its entries ------------------------------------------------------------------------------------

    def hardware(
        self, name: str, tree: Tree, line: int, channels: int, blame: bool, protected: Collection[int]
    ) -> Hardware:
        entry = self.mapping(tree, f"hardware {name}", HARDWARE_KEYS)
        channel = self.optional(entry, "channel", self.whole(0, channels - 1))
        own_blame = self.optional(entry, "blame_hardware", self.flag)
        return Hardware(
            name=name,
            channel=channel,
            fed_by=self.optional(entry, "fed_by", self.names) or (),
            blame=blame if own_blame is None else own_blame,
            boot_s=self.optional(entry, "boot_s", self.seconds),
            computer=self.optional(entry, "computer", self.flag) or False,
            **self.common(entry, line, protected=channel in protected),
        )

    def node(self, name: str, tree: Tree, line: int, inputs_matter: bool) -> Node:
        entry = self.mapping(tree, f"node {name}", NODE_KEYS)
        own = self.optional(entry, "inputs_matter", self.flag)
        restartable = self.optional(entry, "restartable", self.flag)
        return Node(
            name=name,
            drives=self.optional(entry, "drives", self.names) or (),
            publishes={
                topic: self.names(inputs) for topic, inputs, _ in self.named(entry, "publishes", default=())
            },
            inputs_matter=inputs_matter if own is None else own,
            restartable=True if restartable is None else restartable,
            tied_to=self.optional(entry, "tied_to", self.names) or (),
            start_s=self.optional(entry, "start_s", self.seconds),
            reconnects=self.optional(entry, "reconnects", self.flag) or False,
            **self.common(entry, line),
        )

    def other(self, kind: type[Component], name: str, tree: Tree, line: int) -> Component:
        """Return a component of a kind whose keys are the fields of its class, read by their types."""
        own = {one.name: one for one in fields(kind) if one.name not in COMMON_FIELDS}
        entry = self.mapping(tree, f"{kind.what} {name}", (*own, *PART_KEYS))
        readers: dict[str, Callable[[Tree], Any]] = {
            "bool": self.flag,
            "int": self.whole(0, MAX_WHOLE),
            "float": self.number(0),
            "str": self.text,
            "tuple[str, ...]": self.names,
        }
        given = {key: entry.items[key] for key in own if key in entry.items and not _empty(entry.items[key])}
        read = {
            key: readers[str(own[key].type).removesuffix(" | None")](value) for key, value in given.items()
        }
        return kind(name, **self.common(entry, line), **read)

    def common(self, entry: yaml_tree.Mapping, line: int, *, protected: bool = False) -> dict[str, Any]:
        """Return what every component has."""
        return {
            "protected": self.optional(entry, "protected", self.flag) or protected,
            "prior": self.optional(entry, "prior", self.probability),
            "cost": self.optional(entry, "cost", self.number(0)),
            "modes": self.optional(entry, "modes", self.modes) or {},
            "exhaustive_modes": self.optional(entry, "exhaustive_modes", self.flag) or False,
            "host": self.optional(entry, "host", self.name),
            "criticality": self.criticality(entry),
            "helps": self.optional(entry, "helps", self.helps) or {},
            "line": line,
        }

    def criticality(self, entry: yaml_tree.Mapping) -> Criticality:
        said = self.optional(entry, "criticality", self.one_of(tuple(Criticality)))
        return Criticality.NORMAL if said is None else Criticality(said)

    def helps(self, tree: Tree) -> dict[str, dict[str, float]]:
        """Return act -> fault mode -> probability; one number counts for every mode."""
        found: dict[str, dict[str, float]] = {}
        for act, said, _ in self.entries(self.mapping(tree, "helps")):
            if isinstance(said, yaml_tree.Mapping):
                found[act] = {mode: self.probability(one) for mode, one, _ in self.entries(said)}
            else:
                found[act] = {"": self.probability(said)}
        return found

    def function(self, name: str, tree: Tree, line: int) -> Function:
        entry = self.mapping(tree, f"function {name}", FUNCTION_KEYS)
        variants = {
            key: self.variant(name, key, one, place) for key, one, place in self.named(entry, "variants")
        }
        if not variants:
            self.fail(f"function {name} needs `variants:`, at least one", line)
        prefer = self.optional(entry, "prefer", self.names) or tuple(variants)
        for key in prefer:
            if key not in variants:
                self.fail(
                    f"function {name} has no variant {shown(key)}{near(key, variants)}", entry.lines["prefer"]
                )
        left = [key for key in variants if key not in prefer]
        if left:
            self.fail(
                f"function {name}: `prefer` does not name {', '.join(left)}; it lists all variants, the best "
                "first",
                entry.lines["prefer"],
            )
        dwell_s = self.optional(entry, "dwell_s", self.seconds)
        most = self.optional(entry, "changes_per_hour", self.whole(1, MAX_WHOLE))
        return Function(
            name,
            {key: variants[key] for key in prefer},
            DWELL_S if dwell_s is None else dwell_s,
            self.optional(entry, "adapt", self.one_of(ADAPT)),
            CHANGES_PER_HOUR if most is None else most,
            self.criticality(entry),
            self.optional(entry, "notify", self.flag) or False,
            line,
        )

    def variant(self, function: str, name: str, tree: Tree, line: int) -> Variant:
        entry = self.mapping(tree, f"variant {name} of {function}", VARIANT_KEYS)
        when = self.optional(entry, "when", self.with_line)
        return Variant(
            name,
            None if when is None else when[0],
            self.optional(entry, "needs", self.names) or (),
            self.optional(entry, "do", self.list_of(self.act)) or (),
            line,
            None if when is None else when[1],
        )

    def act(self, tree: Tree) -> tuple[str, tuple[str, ...]]:
        """Return the name and the parameters of an act, which is written like an observation."""
        return self.act_of(
            self.scalar(tree, 'an act in quotes, e.g. "set_mode(spiral, high)"').text, tree.line
        )

    def act_of(self, text: str, line: int) -> tuple[str, tuple[str, ...]]:
        """Return the name and the parameters of an act as it is written."""
        try:
            *read, _ = tokens(text)
        except ObservationError as error:
            self.fail(f"{shown(text)} is no act: {error}", line)
        marks = "".join(one.text if one.kind in {"(", ",", ")"} else "x" for one in read)
        words = tuple(one.text for one in read if one.kind not in {"(", ",", ")"})
        if not ACT.fullmatch(marks) or not all(words):
            self.fail(
                f"{shown(text)} is no act: that is a name with its parameters, e.g. set_mode(spiral, high)",
                line,
            )
        return words[0], words[1:]

    def one_of(self, words: tuple[str, ...]) -> Callable[[Tree], str]:
        def reader(tree: Tree) -> str:
            text = self.scalar(tree, f"one of {', '.join(words)}").text
            if text not in words:
                self.fail(f"expected one of {', '.join(words)}, not {shown(text)}", tree.line)
            return text

        return reader

    def topic(self, name: str, tree: Tree) -> Topic:
        entry = self.mapping(tree, f"topic {name}", TOPIC_KEYS)
        return Topic(
            name=name,
            rate_hz=self.optional(entry, "rate_hz", self.number(0)),
            tolerance_hz=self.optional(entry, "tolerance_hz", self.number(0)),
            silent=self.optional(entry, "silent", self.flag) or False,
            latched=self.optional(entry, "latched", self.flag) or False,
            cost=self.optional(entry, "cost", self.number(0)),
        )

    def value(self, name: str, tree: Tree, line: int) -> Value:
        entry = self.mapping(tree, f"value {name}", VALUE_KEYS)
        for key in VALUE_KEYS:
            if key not in entry.items:
                self.fail(f"value {name} needs `{key}:`", line)
        return Value(name, self.name(entry.items["topic"]), self.text(entry.items["field"]))

    def remedies(self, top: yaml_tree.Mapping) -> Iterator[Remedy]:
        for key, tree, line in self.named(top, "remedies"):
            name, parameters = self.act_of(key, line)
            entry = self.mapping(tree, f"remedy {key}", REMEDY_KEYS)
            mends = self.optional(entry, "mends", self.names)
            if not mends:
                self.fail(f"remedy {key} needs `mends:`, the component that it makes good again", line)
            symptoms = self.optional(entry, "symptoms", self.names) or ()
            for one in symptoms:
                if one not in SYMPTOMS:
                    self.fail(
                        f"no symptom is named {shown(one)}{near(one, SYMPTOMS)}; there are "
                        f"{', '.join(SYMPTOMS)}",
                        entry.items["symptoms"].line,
                    )
            more: dict[str, Any] = {
                "cost": self.optional(entry, "cost", self.number(0)),
                "symptoms": symptoms,
                "needs": self.optional(entry, "needs", self.names) or (),
                "restarts": self.optional(entry, "restarts", self.names) or (),
                "starts": self.optional(entry, "starts", self.flag) or False,
                "line": line,
            }
            if "(" not in key:
                yield from (Remedy(name, (each,), (each,), **more) for each in mends)
            else:
                yield Remedy(name, parameters, mends, **more)

    def modes(self, tree: Tree) -> dict[str, tuple[str, ...]]:
        found: dict[str, tuple[str, ...]] = {}
        for mode, sentences, line in self.entries(self.mapping(tree, "modes")):
            if mode == UNKNOWN_MODE:
                self.fail(
                    f"mode `{UNKNOWN_MODE}` is there by itself; say `exhaustive_modes: true` to rule it out",
                    line,
                )
            found[mode] = self.list_of(self.text)(sentences)
        return found

    def related(self, top: yaml_tree.Mapping) -> list[tuple[tuple[str, str], int]]:
        found = []
        tree = top.items.get("related")
        if tree is None or _empty(tree):
            return []
        if not isinstance(tree, Sequence):
            self.fail("`related` is a list of pairs of values, e.g. [[odom_yaw, imu_yaw]]", tree.line)
        for item in tree.items:
            names = self.names(item)
            if len(names) != 2 or names[0] == names[1]:
                self.fail("a related pair is two different values, e.g. [odom_yaw, imu_yaw]", item.line)
            found.append(((names[0], names[1]), item.line))
        return found

    # --- shapes -----------------------------------------------------------------------------------------

    def mapping(self, tree: Tree, what: str, allowed: Collection[str] | None = None) -> yaml_tree.Mapping:
        if _empty(tree):
            return yaml_tree.Mapping({}, tree.line)
        if not isinstance(tree, yaml_tree.Mapping):
            keys = f" with the keys {', '.join(allowed)}" if allowed else ""
            self.fail(f"{what} is a mapping{keys}, not {_shape(tree)}", tree.line)
        if allowed is not None:
            for key in tree.items:
                if key not in allowed:
                    self.fail(
                        f"{what} has no key {shown(key)}{near(key, allowed)}; "
                        f"allowed are {', '.join(allowed)}",
                        tree.lines[key],
                    )
        return tree

    def named(
        self, parent: yaml_tree.Mapping, key: str, default: Iterable[tuple[str, Tree, int]] = ()
    ) -> Iterable[tuple[str, Tree, int]]:
        """Return (name, entry, line) of a section; a list of bare names counts as names with empty
        entries."""
        tree = parent.items.get(key)
        if tree is None or _empty(tree):
            return default
        if isinstance(tree, Sequence):
            names = self.names(tree)
            return [
                (name, Scalar("", item.line, True), item.line)
                for name, item in zip(names, tree.items, strict=True)
            ]
        return self.entries(self.mapping(tree, f"`{key}`"))

    def entries(self, tree: yaml_tree.Mapping) -> list[tuple[str, Tree, int]]:
        found: dict[str, tuple[str, Tree, int]] = {}
        for key, entry in tree.items.items():
            line = tree.lines[key]
            name = self.checked_name(key, line)
            if name in found:
                self.fail(f"{shown(name)} is written twice (first in line {found[name][2]})", line)
            found[name] = (name, entry, line)
        return list(found.values())

    def optional(self, entry: yaml_tree.Mapping, key: str, read: Callable[[Tree], T]) -> T | None:
        tree = entry.items.get(key)
        return None if tree is None or _empty(tree) else read(tree)

    def scalar(self, tree: Tree, what: str) -> Scalar:
        if not isinstance(tree, Scalar):
            self.fail(f"expected {what}, not {_shape(tree)}", tree.line)
        return tree

    def text(self, tree: Tree) -> str:
        return self.scalar(tree, "text").text

    def with_line(self, tree: Tree) -> tuple[str, int]:
        return self.scalar(tree, "a sentence in quotes").text, tree.line

    def name(self, tree: Tree) -> str:
        return self.checked_name(self.scalar(tree, "a name").text, tree.line)

    def checked_name(self, text: str, line: int) -> str:
        name = plain(text)
        if not name or name == "/":
            self.fail("a name is empty", line)
        if len(name) > MAX_NAME:
            self.fail(f"the name {shown(name)} has {len(name)} characters; at most {MAX_NAME}", line)
        if not name.isprintable():
            self.fail(f"the name {shown(name)} holds a control character", line)
        return name

    def names(self, tree: Tree) -> tuple[str, ...]:
        """Return a list of names; a single name counts as a list of one, and none may come twice."""
        if _empty(tree):
            return ()
        if isinstance(tree, Scalar):
            return (self.name(tree),)
        names = self.list_of(self.name)(tree)
        if len(set(names)) < len(names):
            twice = next(name for name, times in Counter(names).items() if times > 1)
            self.fail(f"{shown(twice)} is in the list twice", tree.line)
        return names

    def list_of(self, read: Callable[[Tree], T]) -> Callable[[Tree], tuple[T, ...]]:
        def reader(tree: Tree) -> tuple[T, ...]:
            if _empty(tree):
                return ()
            if not isinstance(tree, Sequence):
                self.fail(f"expected a list, not {_shape(tree)}", tree.line)
            return tuple(read(item) for item in tree.items)

        return reader

    def flag(self, tree: Tree) -> bool:
        text = self.scalar(tree, "true or false").text
        if text not in TRUE + FALSE:
            self.fail(f"expected true or false, not {shown(text)}", tree.line)
        return text in TRUE

    def whole(self, low: int, high: int) -> Callable[[Tree], int]:
        def reader(tree: Tree) -> int:
            text = self.scalar(tree, f"a whole number from {low} to {high}").text
            if not (
                text.isascii() and text.lstrip("-").isdigit() and len(text) < 10 and low <= int(text) <= high
            ):
                self.fail(f"{shown(text)} is out of range: a whole number from {low} to {high}", tree.line)
            return int(text)

        return reader

    def number(self, above: float) -> Callable[[Tree], float]:
        def reader(tree: Tree) -> float:
            text = self.scalar(tree, f"a number above {above}").text
            try:
                number = float(text)
            except ValueError:
                number = math.nan
            if not (number > above and math.isfinite(number)):
                self.fail(f"expected a number above {above}, not {shown(text)}", tree.line)
            return number

        return reader

    def seconds(self, tree: Tree) -> float:
        """Return how long something takes that a repair waits for."""
        text = self.scalar(tree, f"seconds from 0 to {MOST_S}").text
        try:
            given = float(text)
        except ValueError:
            given = math.nan
        if not 0 <= given <= MOST_S:
            self.fail(f"expected seconds from 0 to {MOST_S}, not {shown(text)}", tree.line)
        return given

    def probability(self, tree: Tree) -> float:
        number = self.scalar(tree, "a probability").text
        try:
            prior = float(number)
        except ValueError:
            prior = math.nan
        if not 0 < prior < 1:
            self.fail(
                f"a probability lies between 0 and 1, both excluded; {shown(number)} does not",
                tree.line,
            )
        return prior


def _empty(tree: Tree) -> bool:
    return isinstance(tree, Scalar) and tree.empty


def _shape(tree: Tree) -> str:
    if isinstance(tree, Scalar):
        return shown(tree.text)
    return "a list" if isinstance(tree, Sequence) else "a mapping"


# --- what no entry of a component model can see by itself: names that refer to others, channels, feeds.

SHOWN = 60

BUILT_IN = frozenset({"power_up", "shutdown", "start_node", "stop_node", "mend"})
"""The actions of pddl/repair.pddl."""


class Checks:
    """What no entry can see by itself: names that refer to others, channels, feeds."""

    def __init__(self, file: str | None, top: Mapping, model: ComponentModel) -> None:
        self.file = file
        self.top = top
        self.model = model

    def fail(self, message: str, line: int) -> NoReturn:
        raise ModelError(message, self.file, line)

    def all(self) -> None:
        self.distinct()
        self.channels()
        self.feeds()
        self.nodes()
        self.values()
        self.helps()
        self.remedies()

    def distinct(self) -> None:
        first: dict[str, str] = {}
        for kind in KINDS:
            for name, part in self.model.of(kind).items():
                if name in first:
                    self.fail(
                        f"{shown(name)} is {first[name]} already; a {kind.what} needs a name of its own",
                        part.line or 1,
                    )
                first[name] = kind.what if kind.what == kind.section else f"a {kind.what}"
        topics = {t for node in self.model.nodes.values() for t in node.publishes} | set(self.model.topics)
        for name in self.model.properties:
            if name in topics:
                self.fail(
                    f"{shown(name)} is a topic already; ok({name}) would mean both",
                    self.line("properties", name),
                )

    def channels(self) -> None:
        used: dict[int, str] = {}
        for device in self.model.hardware.values():
            if device.channel is not None:
                if device.channel in used:
                    names = f"{used[device.channel]}, {device.name}"
                    self.fail(
                        f"channel {device.channel} is used twice ({names}); give each its own",
                        device.line or 1,
                    )
                used[device.channel] = device.name

    def feeds(self) -> None:
        hardware = self.model.hardware
        for device in hardware.values():
            for feeder in device.fed_by:
                self.known(feeder, hardware, "hardware", device.line)
        # Peel off what is fed by nothing that is left; a cycle never peels.
        left = {name: set(device.fed_by) for name, device in hardware.items()}
        free = [name for name, feeders in left.items() if not feeders]
        feeds: dict[str, list[str]] = {}
        for device in hardware.values():
            for feeder in device.fed_by:
                feeds.setdefault(feeder, []).append(device.name)
        while free:
            name = free.pop()
            del left[name]
            for fed in feeds.get(name, ()):
                left[fed].discard(name)
                if not left[fed]:
                    free.append(fed)
        if left:
            path = [next(iter(left))]
            while path[-1] not in path[:-1]:
                path.append(min(left[path[-1]]))
            cycle = path[path.index(path[-1]) :]
            self.fail(
                f"the feeds go round in a circle: {' fed by '.join(cycle)}; power has to come from somewhere",
                hardware[cycle[0]].line or 1,
            )

    def nodes(self) -> None:
        model = self.model
        topics = {t for node in model.nodes.values() for t in node.publishes} | set(model.topics)
        for node in model.nodes.values():
            for device in node.drives:
                self.known(device, model.hardware, "hardware", node.line)
            if node.reconnects and not node.drives:
                self.fail(f"{node.name} drives nothing that it could reconnect to", node.line or 1)
            for other in node.tied_to:
                self.known(other, model.nodes, "node", node.line)
                if other == node.name:
                    self.fail(f"{node.name} cannot be tied to itself", node.line or 1)
            for topic, inputs in node.publishes.items():
                for source in inputs:
                    if source not in topics:
                        self.fail(
                            f"{node.name} reads {shown(source)}, which no node publishes"
                            f"{near(source, topics)}; a topic from outside is declared under `topics:`",
                            node.line or 1,
                        )
                if inputs and node.drives and not node.inputs_matter:
                    self.fail(
                        f"{node.name} drives hardware, so the inputs of {topic} are in no clause: "
                        "say `inputs_matter: true`, or drop them",
                        node.line or 1,
                    )

    def values(self) -> None:
        model = self.model
        topics = {t for node in model.nodes.values() for t in node.publishes} | set(model.topics)
        for value in model.values.values():
            self.known(value.topic, topics, "topic", self.line("values", value.name))
        for pair in model.related:
            for name in pair:
                self.known(name, model.values, "value", self.top.lines["related"])

    def remedies(self) -> None:
        components, seen = self.model.components, set[str]()
        for remedy in self.model.remedies:
            if remedy.name in BUILT_IN:
                self.fail(
                    f"`{remedy.name}` is an act of every robot; a remedy needs a name of its own",
                    remedy.line or 1,
                )
            if str(remedy) in seen:
                self.fail(f"the remedy {shown(str(remedy))} is there twice", remedy.line or 1)
            seen.add(str(remedy))
            for name in (*remedy.mends, *remedy.needs):
                self.known(name, components, "component", remedy.line)
            for name in remedy.restarts:
                self.known(name, self.model.nodes, "node", remedy.line)
                if name in remedy.mends:
                    self.fail(
                        f"{shown(str(remedy))} cannot mend {name} and have it restarted", remedy.line or 1
                    )

    def helps(self) -> None:
        for part in self.model.parts.values():
            for act, by_mode in part.helps.items():
                for mode in by_mode:
                    if mode and mode not in part.modes and mode != UNKNOWN_MODE:
                        self.fail(
                            f"{part.name}: {shown(act)} helps against {shown(mode)}, which is none of its "
                            f"modes{near(mode, part.modes)}",
                            part.line or 1,
                        )

    def known(self, name: str, names: Collection[str], what: str, line: int | None) -> None:
        if name not in names:
            some = ", ".join(sorted(names)[:12]) or "none"
            self.fail(
                f"no {what} is named {shown(name)}{near(name, names) or f'; there are {some}'}", line or 1
            )

    def line(self, section: str, name: str) -> int:
        tree = self.top.items[section]
        if isinstance(tree, Mapping):
            return next((line for key, line in tree.lines.items() if plain(key) == name), tree.line)
        return tree.line


def shown(text: str) -> str:
    """Return a name for an error, cut where somebody wrote a novel."""
    return f"`{text}`" if len(text) <= SHOWN else f"`{text[:SHOWN]}…`"


def near(name: str, names: Collection[str]) -> str:
    """Return a hint at the nearest of the names, or nothing."""
    return did_you_mean(name, names, shown)
