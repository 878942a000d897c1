"""`robomend model check --isolability`: what is at hand, asked, and told as a table, JSON and a figure."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from robomend.errors import InputError

if TYPE_CHECKING:
    from robomend.diagnosis.isolability.analysis import Isolability
    from robomend.model.system import System
    from robomend_client.literals import Atom

MOST_COLUMNS = 40
"""Faults of a matrix that is written in the terminal."""


def report(
    system: System,
    *,
    robot: Path | None,
    agents: Sequence[Path],
    observe: Sequence[str],
    double: bool,
    timeout_s: float | None,
    svg: Path | None,
    as_json: bool,
) -> None:
    """Compute and write the answer."""
    from robomend.diagnosis.isolability.analysis import isolability
    from robomend.model.packed import opened
    from robomend.oneshots.solvers import isolability_json
    from robomend.web.isolability_matrix import isolability_matrix

    observed = at_hand(system, robot, agents, observe)
    found = isolability(opened(system.cnf), observed, double=double, timeout_s=timeout_s)
    if svg is not None:
        figure = isolability_matrix(f"{system.name}: faults", found.faults, found.matrix, found.detectable)
        svg.write_text(figure, encoding="utf-8")
    answer = isolability_json(found, system)
    if as_json:
        click.echo(json.dumps(answer, ensure_ascii=False, separators=(",", ":")))
        return
    first, *rest = answer["text"]
    click.echo(first)
    if len(found.faults) <= MOST_COLUMNS:
        click.echo("\n".join(table(found)))
    for sentence in rest:
        click.echo(sentence)
    how = "signatures" if found.exact_by == "signatures" else "search"
    whole = "complete" if found.complete else "not complete"
    click.echo(f"{whole}, by {how}; {found.elapsed_s * 1000:.1f} ms")


def table(found: Isolability) -> list[str]:
    """Return the matrix as lines of text, with its legend."""
    names = [" with ".join(fault) for fault in found.faults]
    wide = max(map(len, names))
    lines = [
        "",
        "can the fault of the row be told from that of the column?   - never   ~ by some symptoms only   "
        "+ always",
    ]
    for name, row, detectable in zip(names, found.matrix, found.detectable, strict=True):
        note = "   cannot be detected" if detectable is False else ""
        lines.append(f"  {name:<{wide}}  {' '.join(row)}{note}")
    return [*lines, ""]


def at_hand(
    system: System, robot: Path | None, agents: Sequence[Path], observe: Sequence[str]
) -> tuple[Atom, ...] | None:
    """Return the observables that were named; None: all that the rules speak of.

    Raises:
        InputError: a file cannot be read, or says something that the model does not have.
    """
    if robot is None and not agents and not observe:
        return None
    from robomend.observations.language import parse
    from robomend.robots.configuration import RobotConfig
    from robomend.robots.declared import observables_at_hand

    found: set[Atom] = set()
    if robot is not None:
        config = RobotConfig.from_json("robot", _configuration(robot))
        found.update(observables_at_hand(config, system))
    for file in agents:
        found.update(_of_agent(file, system))
    for sentence in observe:
        found.update(literal.atom for literal in parse(sentence, system.vocabulary))
    return tuple(sorted(found))


def _configuration(file: Path) -> dict[str, Any]:
    """Return a robot's configuration: the body of its PUT, or what its GET answers."""
    from pydantic import ValidationError

    from robomend.api.schemas.robots import RobotBody
    from robomend.cli.robot_file import read_robot

    values = read_robot(file)
    if isinstance(values.get("config"), dict):
        values = values["config"]
    try:
        return RobotBody.model_validate(values).model_dump(mode="json")
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(f"{file}: {where}: {first['msg']}") from error


def _of_agent(file: Path, system: System) -> list[Atom]:
    """Return what an agent's observers may speak of, in the words of the model."""
    from robomend_client.agent.config import load
    from robomend_client.agent.feeds import MissingExtra
    from robomend_client.literals import Literal
    from robomend_client.yaml_reader import ConfigError

    try:
        observers = [spec.make() for spec in load(file).observers]
    except (ConfigError, MissingExtra) as error:
        raise InputError(str(error)) from error
    vocabulary = system.vocabulary
    atoms = [vocabulary.canonical(Literal(atom)).atom for observer in observers for atom in observer.atoms]
    return [atom for atom in atoms if vocabulary.declares(atom)]
