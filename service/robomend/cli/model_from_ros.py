"""`robomend model from-ros`: a first model, from a live graph of ROS 1 or ROS 2, a bag, or files of ROS."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import click

from robomend.errors import BackendError, InputError

if TYPE_CHECKING:  # the command's help needs no client
    from robomend_client.bridges.hearing import Hearing
    from robomend_client.ros_graph import Heard, RosGraph

FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
FOUND_S = 3.0
"""Who is there is found within so long, before the listening begins."""


@click.command("from-ros")
@click.option("--ros1", metavar="URI", help="The master of a running robot, e.g. http://localhost:11311.")
@click.option(
    "--ros2", metavar="DOMAIN", type=click.IntRange(0, 232), help="The domain of a running robot with ROS 2."
)
@click.option(
    "--bag", type=click.Path(path_type=Path, exists=True), help="A recording of ROS 1 (.bag): no inputs."
)
@click.option("--dump", type=FILE, help="Output of rosnode info or ros2 node info, a .dot of rqt_graph.")
@click.option(
    "--launch", type=FILE, multiple=True, help="A launch file: XML, YAML or Python (which is not run)."
)
@click.option(
    "--analyzers", type=FILE, multiple=True, help="Of diagnostic_aggregator: which statuses there are."
)
@click.option("--name", default="robot", show_default=True, help="The model's name.")
@click.option(
    "--seconds",
    type=click.FloatRange(0, 86400),
    default=0,
    show_default=True,
    help="Listen for so long, for rates and for what rests on what.",
)
def command(
    ros1: str | None,
    ros2: int | None,
    bag: Path | None,
    dump: Path | None,
    launch: tuple[Path, ...],
    analyzers: tuple[Path, ...],
    name: str,
    seconds: float,
) -> None:
    """Propose a model from a ROS graph, as commented YAML on standard output.

    Launch files and analyzers are put on top of a live graph, a recording or a dump, or stand alone. What
    they do not say is a question in a comment.

    \b
    robomend model from-ros --ros1 http://localhost:11311 > robot.yaml
    robomend model from-ros --ros2 0 > robot.yaml
    robomend model from-ros --bag run.bag --name tedusar
    robomend model from-ros --launch bringup.launch.py --analyzers analyzers.yaml
    """
    from robomend.model.from_graph import first_model
    from robomend.model.graph_sources import model_of_groups, read_dump
    from robomend_client.ros_graph import Heard, RosGraph

    graphs = [ros1, ros2, bag, dump]
    if graphs.count(None) < 3 or (graphs.count(None) == 4 and not launch and not analyzers):
        raise click.UsageError("give one of --ros1, --ros2 and --bag, or --dump, --launch or --analyzers")
    if dump is not None:
        heard = Heard(read_dump(_text(dump), str(dump)), f"the dump {dump.name}")
    elif graphs.count(None) == 3:
        heard = heard_from(ros1, ros2, bag, seconds)
    else:
        heard = Heard(RosGraph(), ", ".join(file.name for file in (*launch, *analyzers)))
    heard = with_files(heard, launch, analyzers)
    if heard.graph.nodes or heard.launched:
        click.echo(first_model(heard, name).text, nl=False)
    elif launch and not analyzers:
        open_ = "; ".join(heard.remarks)
        why = f"; it leaves open: {open_}" if open_ else ": give the files that start nodes"
        raise InputError(f"{heard.source}: no node is started there{why}")
    else:
        groups = {status: group for file in analyzers for status, group in _groups(file).items()}
        click.echo(model_of_groups(groups, name, heard.source), nl=False)


def with_files(heard: Heard, launch: Iterable[Path], analyzers: Iterable[Path]) -> Heard:
    """Return what was heard with what launch files and analyzers say; InputError if one cannot be read."""
    from robomend.model.graph_sources import with_launched, with_statuses
    from robomend.model.launch_files import read_launch

    for file in launch:
        launched = read_launch(_text(file), file.name, partial(_included, file))
        heard = with_launched(heard, launched)
    for file in analyzers:
        heard = with_statuses(heard, _groups(file))
    return heard


def _groups(file: Path) -> dict[str, str]:
    from robomend.model.graph_sources import read_analyzers

    return read_analyzers(_text(file), str(file))


def _included(file: Path, name: str) -> str | None:
    """Return a file that a launch file includes, if it is of the same package, or beside it."""
    rest = name.removeprefix("./")
    if found := re.match(r"\[([\w-]+)\]/(.+)", rest):  # a package: the folder that is called so
        above = next((one for one in file.resolve().parents if one.name == found[1]), None)
        path = None if above is None else above / found[2]
    else:
        path = file.parent / rest
    if path is None or not path.is_file():
        path = file.parent / Path(rest).name
    return _text(path) if path.is_file() else None


def _text(file: Path) -> str:
    try:
        return file.read_text("utf-8-sig")
    except OSError as error:
        raise InputError(f"{file} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{file} is not UTF-8 text") from error


def heard_from(ros1: str | None, ros2: int | None, bag: Path | None, seconds: float) -> Heard:
    """Return what was heard of a running robot in so many seconds; of 0, and of a recording, the graph alone.

    Raises:
        InputError, BackendError: it cannot be read; with what to install where that is why.
    """
    from robomend_client.ros_graph import Heard

    if not seconds or bag is not None:
        return Heard(*graph_of(ros1, ros2, bag))
    if ros1 is not None:
        graph_of(ros1, None, None)  # whether it is there
    try:
        if ros2 is not None:
            import_module("robomend_client.bridges.ros2.dds")
        from robomend_client.bridges.hearing import Ros1Hearing, Ros2Hearing
    except ImportError as error:
        extra = "ros1" if ros2 is None else "ros2"
        why = f"listening needs what is installed with: pip install 'robomend-client[{extra}]'"
        raise BackendError(why) from error
    return asyncio.run(_listened(Ros2Hearing(ros2) if ros2 is not None else Ros1Hearing(ros1 or ""), seconds))


async def _listened(hearing: Hearing, seconds: float) -> Heard:
    task = asyncio.create_task(hearing.run())
    try:
        await asyncio.wait({task}, timeout=FOUND_S)
        hearing.begin()
        await asyncio.wait({task}, timeout=seconds)
        if task.done():
            task.result()
        return hearing.heard()
    except Exception as error:
        raise BackendError(f"it cannot be listened to: {error}") from error
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def graph_of(ros1: str | None, ros2: int | None, bag: Path | None) -> tuple[RosGraph, str]:
    """Return the graph of a running robot or a recording, and where it is from, for people.

    Raises:
        InputError, BackendError: it cannot be read; with what to install where that is why.
    """
    if ros2 is not None:
        return _ros2_graph(ros2), f"domain {ros2} of ROS 2"
    if ros1 is not None:
        from robomend_client.bridges.ros1.master import read_graph
        from robomend_client.bridges.ros1.xmlrpc import OutOfReach, PeerError, address_of

        try:
            address_of(ros1)
        except OutOfReach as error:
            raise InputError(str(error)) from error
        try:
            return read_graph(ros1), f"the master at {ros1}"
        except PeerError as error:
            raise BackendError(f"the master at {ros1}: {error}") from error
    assert bag is not None
    try:
        from robomend_client.bridges.ros1.bag import UnreadableBag, bag_graph
    except ImportError as error:
        why = "reading bags needs what is installed with: pip install 'robomend-client[ros1]'"
        raise BackendError(why) from error
    try:
        return bag_graph(bag), f"the recording {bag.name}, which does not say who listens"
    except UnreadableBag as error:
        raise InputError(str(error)) from error


def _ros2_graph(domain: int) -> RosGraph:
    try:
        from robomend_client.bridges.ros2.dds import NoDds
        from robomend_client.bridges.ros2.graph import read_graph
    except ImportError as error:
        why = "reading ROS 2 needs what is installed with: pip install 'robomend-client[ros2]'"
        raise BackendError(why) from error
    try:
        return read_graph(domain)
    except NoDds as error:
        raise BackendError(str(error)) from error
