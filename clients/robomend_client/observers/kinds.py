"""The kinds of observers by name, and the section `observers:` of a file, for the agent and for batch alike.

    observers:
      scan: {kind: general, rate_hz: 10}
      odom_yaw: {kind: qualitative, source: "odom:twist.twist.angular.z", slope: 0.1}
      motor: {kind: too_hot.py:NotTooHot, source: "motor:temperature", limit: 70}

A kind is a class with the shape of base.Observer, or a function that judges a reading: by its name in
KINDS, by the entry points `robomend.observers` of other distributions, or by `FILE.py:NAME`, relative to
the file that names it. What is made here is a recipe: batch makes fresh observers of it for every log.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from robomend_client.literals import Atom, parse_atom
from robomend_client.observers.base import Observer
from robomend_client.observers.general import GeneralObserver
from robomend_client.observers.parameters import (
    UnreadableParameter,
    made,
    read_arguments,
    read_dataclass,
)
from robomend_client.observers.rate import Rate
from robomend_client.observers.reading import FunctionObserver
from robomend_client.paths import BadPath, several, steps
from robomend_client.registry import BrokenKind, Registry, UnknownKind, load_of_file
from robomend_client.yaml_reader import Section

BUS = "bus"
"""Where samples come from unless `from:` says otherwise."""

ROOM = "robomend_client.observers"

FIRST_S = 2.0
"""A robot may boot for so long after its agent before a topic of `topics:` that nobody has heard of counts as
silent.
"""


KINDS = Registry[Callable[..., Observer]](
    "kind of observer",
    "robomend.observers",
    {
        "general": f"{ROOM}.general:GeneralObserver",
        "node": f"{ROOM}.node:NodeObserver",
        "diagnostic": f"{ROOM}.diagnostic:DiagnosticObserver",
        "multiple": f"{ROOM}.multiple:MultipleObserver",
        "qualitative": f"{ROOM}.qualitative:QualitativeObserver",
        "binary_qualitative": f"{ROOM}.binary_qualitative:BinaryQualitativeObserver",
        "hardware": f"{ROOM}.hardware:HardwareObserver",
        "property": f"{ROOM}.property:PropertyObserver",
        "goals": f"{ROOM}.goals:GoalsObserver",
        "rosout": f"{ROOM}.rosout:RosoutObserver",
        "lifecycle": f"{ROOM}.lifecycle:LifecycleObserver",
        "changing": f"{ROOM}.freshness:ChangingObserver",
        "age": f"{ROOM}.freshness:AgeObserver",
        "publishers": f"{ROOM}.meeting:PublishersObserver",
        "qos": f"{ROOM}.meeting:QosObserver",
        "restarts": f"{ROOM}.node:RestartsObserver",
    },
)


@dataclass(frozen=True)
class ObserverSpec:
    """An observer that a file describes."""

    name: str
    kind: str
    origin: str  # the `from:`: who feeds it
    make: Callable[[], Observer]  # a fresh one each time
    sources: frozenset[str]
    atoms: tuple[Atom, ...]


def read_observers(top: Section, base: Path) -> tuple[ObserverSpec, ...]:
    """Return the observers in the section `observers:` of a file in the folder `base`.

    Raises:
        ConfigError: with file, line and key.
    """
    return tuple(_read_observer(name, section, base) for name, section in top.sections("observers"))


@dataclass(frozen=True)
class TopicSpec:
    """A topic of the section `topics:`, with its general observer."""

    name: str
    rate: Rate
    observer: ObserverSpec


def read_topics(top: Section) -> tuple[TopicSpec, ...]:
    """Return the topics of an agent's file; what `topics:` does not say of one is in `rate:`.

    Raises:
        ConfigError: with file, line and key.
    """
    shared = top.section("rate")
    common = asdict(_read_rate(shared, {}))
    origin = shared.text("from", BUS)
    shared.finish()
    found = []
    for name, section in top.sections("topics"):
        topic, rate = name.removeprefix("/"), _read_rate(section, common)
        judged = replace(rate, first_s=FIRST_S) if rate.first_s is None else rate
        make = partial(GeneralObserver, topic, judged)
        spec = observer_spec(topic, "general", section.text("from", origin), make)
        found.append(TopicSpec(topic, rate, spec))
        section.finish()
    return tuple(found)


def _read_rate(section: Section, common: Mapping[str, Any]) -> Rate:
    """Return what is expected of a topic; what its section does not say is as for all of them."""
    preset = section.choice("preset", ("none", *Rate.PRESETS), "none")
    rate = read_dataclass(section, Rate, {**common, **Rate.PRESETS.get(preset, {})})
    assert isinstance(rate, Rate)
    return rate


def read_lenient(top: Section) -> frozenset[Atom]:
    """Return the atoms of the list `lenient:`, of which good news wins where observers disagree."""
    try:
        return frozenset(map(parse_atom, top.texts("lenient")))
    except ValueError as error:
        raise top.error("lenient", str(error)) from error


def observer_spec(name: str, kind: str, origin: str, make: Callable[[], Observer]) -> ObserverSpec:
    """Return the recipe of observers that `make` makes; it is tried once, so that mistakes come out now."""
    observer = make()
    return ObserverSpec(name, kind, origin, make, observer.sources, observer.atoms)


def _read_observer(name: str, section: Section, base: Path) -> ObserverSpec:
    kind = section.text("kind")
    origin = section.text("from", BUS)
    preset = section.optional("preset")
    try:
        found = load_kind(kind, base)
        is_class = inspect.isclass(found)
        make = cast("Callable[..., Observer]", found) if is_class else FunctionObserver
        given: frozenset[str] = frozenset() if is_class else frozenset({"function"})
        arguments = read_arguments(section, make, preset, name, given)
        if given:
            arguments["function"] = _bound(section, found)
        section.finish()
        made(section, make, **arguments)
    except (UnknownKind, BrokenKind, UnreadableParameter) as error:
        raise section.error("kind", str(error.args[0])) from error
    spec = observer_spec(name, kind, origin, lambda: make(**arguments))
    for source in spec.sources:
        _check_path(section, source)
    return spec


def _check_path(section: Section, source: str) -> None:
    """Refuse a source whose path (paths.py) cannot be read, at the key that names it."""
    path = source.partition(":")[2]
    try:
        for one in several(path) if path else ():
            steps(one)
    except BadPath as error:
        raise section.error("source" if "source" in section else "", f"{source}: {error}") from error


def load_kind(kind: str, base: Path) -> Callable[..., Any]:
    """Return the class or function that a kind stands for.

    Raises:
        UnknownKind, BrokenKind: there is none, or it cannot be imported, or a method of it is missing.
    """
    found = load_of_file(KINDS, kind, base)
    missing: frozenset[str] = getattr(found, "__abstractmethods__", frozenset())
    if missing:
        raise BrokenKind(f"{kind} has no {', '.join(sorted(missing))}")
    return found


def _bound(section: Section, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of one value: its other parameters are keys of the file."""
    value, *_ = inspect.signature(function).parameters
    more = read_arguments(section, function, None, "", frozenset({value}))
    return (lambda reading: function(reading, **more)) if more else function
