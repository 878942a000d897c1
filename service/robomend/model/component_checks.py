"""What no entry of a component model can see by itself: names that refer to others, channels, feeds."""

from __future__ import annotations

from collections.abc import Collection
from typing import NoReturn

from robomend.errors import ModelError
from robomend.model.clauses import UNKNOWN_MODE
from robomend.model.components import KINDS, ComponentModel
from robomend.model.sentences import plain
from robomend_client.near import did_you_mean
from robomend_client.yaml_tree import Mapping

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
