"""`robomend init robot`: asks what a robot is made of, or takes it from options or from a ROS graph."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from robomend.errors import InputError

if TYPE_CHECKING:
    from robomend.cli.init.described import Described

T = TypeVar("T")

ROBOT = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}\Z")


@click.command("robot")
@click.argument("robot", required=False)
@click.option("--folder", type=click.Path(path_type=Path, file_okay=False), default=".", help="Write here.")
@click.option("--device", "devices", multiple=True, metavar="NAME[=CHANNEL]", help="A device; repeatable.")
@click.option("--node", "nodes", multiple=True, metavar="NAME[=TOPIC,…]", help="A node, what it publishes.")
@click.option("--needs", multiple=True, metavar="TOPIC=TOPIC,…", help="What a topic rests on.")
@click.option("--drives", multiple=True, metavar="NODE=DEVICE,…", help="What a node drives.")
@click.option("--command", "commands", multiple=True, metavar="NODE=COMMAND", help="What the agent starts.")
@click.option("--rate", "rates", multiple=True, metavar="TOPIC=HZ", help="Messages per second [10].")
@click.option("--board", metavar="HOST:PORT", help="The power board.")
@click.option("--url", help="The service.  [default: http://127.0.0.1:8600]")
@click.option("--ros1", metavar="URI", help="Read the graph of a ROS 1 master instead.")
@click.option("--ros2", metavar="DOMAIN", type=click.IntRange(0, 232), help="Read a ROS 2 domain instead.")
@click.option("--bag", type=click.Path(path_type=Path, exists=True), help="Read a recording (.bag) instead.")
@click.option(
    "--seconds",
    type=click.FloatRange(0, 86400),
    default=20,
    show_default=True,
    help="Listen for so long to --ros1 or --ros2; 0: its graph alone.",
)
def command(
    robot: str | None,
    folder: Path,
    devices: tuple[str, ...],
    nodes: tuple[str, ...],
    needs: tuple[str, ...],
    drives: tuple[str, ...],
    commands: tuple[str, ...],
    rates: tuple[str, ...],
    board: str | None,
    url: str | None,
    ros1: str | None,
    ros2: int | None,
    bag: Path | None,
    seconds: float,
) -> None:
    """Write the model, the agent's file and the configuration of ROBOT, which fit together.

    Without --node it asks. With --ros1, --ros2 or --bag the model comes from there; `robomend attach` does
    the rest as well.

    \b
    robomend init robot walker
    robomend init robot walker --node camera=image \\
        --node detector=people --needs people=image
    robomend init robot rover --ros2 0
    """
    from robomend.cli.init.described import Described, files_of, model_file
    from robomend.cli.init.writing import write_new
    from robomend.cli.schema import FILES, schema_name, schema_text
    from robomend.model.checking import check
    from robomend.model.loading import load_text

    graph = [ros1, ros2, bag].count(None) < 3
    given = nodes or devices
    if [ros1, ros2, bag].count(None) < 2 or (graph and given):
        raise click.UsageError("give --node and --device, or one of --ros1, --ros2 and --bag")
    asks = not given and not graph
    if asks and not sys.stdin.isatty():
        raise click.UsageError("give --node, or one of --ros1, --ros2 and --bag: here is nobody to ask")
    if robot is None:
        if not asks:
            raise click.UsageError("say the robot's name first, e.g. robomend init robot walker …")
        robot = click.prompt("The robot's name", default="my_robot")
    if not ROBOT.match(robot):
        raise InputError(f"{robot!r} is no robot's name: letters, digits and . _ - (64 at most)")
    said = Described(robot)
    if graph:
        _from_ros(said, ros1, ros2, bag, seconds)
    elif asks:
        _ask(said)
    else:
        said.devices = {name: _channel(value) for name, value in _pairs(devices)}
        said.nodes = {name: _words(value) for name, value in _pairs(nodes)}
        said.rests_on = {name: _words(value) for name, value in _pairs(needs)}
        said.drives = {name: _words(value) for name, value in _pairs(drives)}
        said.rates_hz = {name: _rate(value) for name, value in _pairs(rates)}
        said.commands = {name: tuple(shlex.split(value)) for name, value in _pairs(commands)}
    if board is not None:
        said.board = _address(board)
    if url is not None:
        said.url = url
    if not graph:
        _check_names(said)
    files = files_of(said)
    schemas = {schema_name(file): schema_text(file) for file in FILES if file != "observers"}
    # Schemas are of this installation, not of the robot: those of another one beside it do as well.
    missing = {name: text for name, text in schemas.items() if not (folder / name).exists()}
    write_new(folder, {**files, **missing})
    model = model_file(robot)
    for doubt in check(load_text(files[model], file=model)):
        click.echo(f"{model}: {doubt}", err=True)
    click.echo(
        f"next, while `robomend serve` runs: robomend robot put {robot} robot.yaml --model {model}\n"
        "then on the robot: robomend-agent agent.yaml",
        err=True,
    )


def _from_ros(said: Described, ros1: str | None, ros2: int | None, bag: Path | None, seconds: float) -> None:
    from robomend.cli.model_from_ros import heard_from

    said.heard = heard_from(ros1, ros2, bag, seconds)
    said.origin = (
        {"ros2": {"domain": ros2}} if ros2 is not None else {"ros1": {"master": ros1} if ros1 else {}}
    )


def _ask(said: Described) -> None:
    """Ask a person, who may answer with names between spaces, or with nothing."""
    click.echo("Names stand between spaces; nothing is an answer, too.", err=True)
    said.devices = _asked("Devices (lidar=3 is on channel 3 of a power board)", _devices)
    while not said.nodes:
        said.nodes = dict.fromkeys(_asked("Nodes, the programs of the robot", _names), ())
    for node in said.nodes:
        said.nodes[node] = _asked(f"{node} publishes the topics", _names)
        if said.devices and (driven := _asked(f"{node} drives the devices", _of("device", said.devices))):
            said.drives[node] = driven
        question = f"{node} is started by the agent with the command (nothing: not by it)"
        if program := _asked(question, shlex.split):
            said.commands[node] = tuple(program)
    topics = [topic for published in said.nodes.values() for topic in published]
    for topic in topics:
        said.rates_hz[topic] = _asked(f"{topic} comes how often, in Hz", _rate, "10")
        if len(topics) > 1 and (inputs := _asked(f"{topic} rests on the topics", _of("topic", topics))):
            said.rests_on[topic] = inputs
    if any(channel is not None for channel in said.devices.values()):
        said.board = _asked("The power board, HOST:PORT (nothing: later)", _address_or_none)
    said.url = _asked("The service", _url, said.url)


def _asked(question: str, read: Callable[[str], T], default: str = "") -> T:
    """Return what is read of an answer; asked again until it can be read."""

    def checked(answer: str) -> T:
        try:
            return read(answer.strip())
        except (InputError, ValueError) as error:  # ValueError: a quote that is not closed
            raise click.UsageError(str(error)) from error

    answer: T = click.prompt(
        question, default=default, show_default=bool(default), value_proc=checked, err=True
    )
    return answer


def _names(text: str) -> tuple[str, ...]:
    for name in text.split():
        if "=" in name or "," in name:
            raise InputError(f"{name!r} is no name; names stand between spaces")
    return tuple(text.split())


def _devices(text: str) -> dict[str, int | None]:
    return {name: _channel(value) for name, value in _pairs(text.split())}


def _of(what: str, known: Iterable[str]) -> Callable[[str], tuple[str, ...]]:
    """Return a reader of names of which each was named before."""
    there = list(known)

    def read(text: str) -> tuple[str, ...]:
        for name in (names := _names(text)):
            _known(what, name, there)
        return names

    return read


def _known(what: str, name: str, known: list[str]) -> None:
    from robomend_client.near import did_you_mean

    if name not in known:
        raise InputError(f"no {what} is named {name!r}{did_you_mean(name, known)}")


def _url(text: str) -> str:
    if not text.startswith(("http://", "https://")):
        raise InputError(f"{text!r} is no address of a service, as http://127.0.0.1:8600")
    return text


def _check_names(said: Described) -> None:
    """Refuse what speaks of something that was not named, with the nearest that was."""
    topics = [topic for published in said.nodes.values() for topic in published]
    for what, used, known in (
        ("node", [*said.drives, *said.commands], list(said.nodes)),
        ("device", [device for driven in said.drives.values() for device in driven], list(said.devices)),
        (
            "topic",
            [*said.rests_on, *said.rates_hz, *(t for ts in said.rests_on.values() for t in ts)],
            topics,
        ),
    ):
        for name in used:
            _known(what, name, known)


def _pairs(texts: Iterable[str]) -> list[tuple[str, str]]:
    return [(name.strip(), value.strip()) for name, _, value in (text.partition("=") for text in texts)]


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _channel(text: str) -> int | None:
    if text and not text.isdecimal():
        raise InputError(f"{text!r} is no channel of a power board: a number from 0")
    return int(text) if text else None


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0 < rate < 1e6:
        raise InputError(f"{text!r} is no rate: messages per second, above 0")
    return rate


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal():
        raise InputError(f"{text!r} is no address of a power board, as 127.0.0.1:10001")
    return host, int(port)


def _address_or_none(text: str) -> tuple[str, int] | None:
    return _address(text) if text else None
