"""`robomend model from-ros`: a first model, from a live graph of ROS 1 or ROS 2, or from a bag."""

from __future__ import annotations

import asyncio
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import click

from robomend.errors import BackendError, InputError

if TYPE_CHECKING:  # the command's help needs no client
    from robomend_client.bridges.hearing import Hearing
    from robomend_client.ros_graph import Heard, RosGraph

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
@click.option("--name", default="robot", show_default=True, help="The model's name.")
@click.option(
    "--seconds",
    type=click.FloatRange(0, 86400),
    default=0,
    show_default=True,
    help="Listen for so long, for rates and for what rests on what.",
)
def command(ros1: str | None, ros2: int | None, bag: Path | None, name: str, seconds: float) -> None:
    """Propose a model from a live ROS graph, as commented YAML on standard output.

    \b
    robomend model from-ros --ros1 http://localhost:11311 > robot.yaml
    robomend model from-ros --ros2 0 > robot.yaml
    robomend model from-ros --bag run.bag --name tedusar
    """
    from robomend.model.from_graph import first_model

    if [ros1, ros2, bag].count(None) != 2:
        raise click.UsageError("give one of --ros1, --ros2 and --bag")
    click.echo(first_model(heard_from(ros1, ros2, bag, seconds), name).text, nl=False)


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
