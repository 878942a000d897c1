"""The observers of a run: those of an agent's file, the same ones as on the robot.

`agent.yaml` itself will do: its sections `topics:` (with `rate:`), `observers:` and `lenient:` are read, and
what `ros1:`, `ros2:` and `zenoh:` say of names; the rest is the agent's. A file with nothing but observers,
with or without `observers:` above them, will do.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from robomend.errors import InputError, ObservationError
from robomend.model.vocabulary import Vocabulary
from robomend.observations.language import Unknown
from robomend_client.bridges.names import Names
from robomend_client.literals import Atom, Literal
from robomend_client.observers.kinds import ObserverSpec, read_lenient, read_observers, read_topics
from robomend_client.yaml_reader import ConfigError, Section, read
from robomend_client.yaml_tree import Mapping, read_tree

SECTIONS = ("observers", "topics", "lenient", "rate")
BRIDGES = ("ros1", "ros2", "zenoh")


@dataclass(frozen=True, slots=True)
class Observing:
    """What is made fresh for each log."""

    specs: tuple[ObserverSpec, ...]
    lenient: frozenset[Atom]
    names: tuple[Names, ...] = ()
    """What ROS calls the topics, by each bridge."""


def load_observers(file: Path, *, code: bool = True) -> Observing:
    """Return the observers of a file.

    Args:
        file: see the module.
        code: whether it may name kinds of a FILE.py, which is run.

    Raises:
        InputError: with file, line and key.
    """
    try:
        top = read(file)
        if not any(name in top for name in SECTIONS):
            tree = read_tree(file.read_text("utf-8-sig"), aliases=True)
            top = Section(Mapping({"observers": tree}, 1), str(file), "")
        if not code:
            _refuse_code(top)
        specs = (*(topic.observer for topic in read_topics(top)), *read_observers(top, file.resolve().parent))
        lenient = read_lenient(top)
        bridges = [top.section(name) for name in BRIDGES if name in top]
        names = tuple(
            Names(bridge.text("namespace", "/"), bridge.section("names").words()) for bridge in bridges
        )
    except ConfigError as error:
        raise InputError(str(error)) from error
    if not specs:
        raise InputError(f"{file}: it names no observers, neither in `topics:` nor in `observers:`")
    return Observing(specs, lenient, names)


def _refuse_code(top: Section) -> None:
    for _, section in top.sections("observers"):
        if ":" in section.text("kind"):
            raise section.error("kind", "a FILE.py is not run here: name a kind that is installed")


def check_declared(observing: Observing, vocabulary: Vocabulary, unknown: Unknown, file: Path) -> None:
    """Refuse observers of what the model does not declare, unless that is to be kept."""
    if unknown == "keep":
        return
    for spec in observing.specs:
        for atom in spec.atoms:
            try:
                vocabulary.check(Literal(atom))
            except ObservationError as error:
                raise InputError(f"{file}: observers.{spec.name}: {error.message}") from error


def digest(file: Path | None) -> str | None:
    """Return by what a file is known in the manifest."""
    return None if file is None else sha256(file.read_bytes()).hexdigest()
