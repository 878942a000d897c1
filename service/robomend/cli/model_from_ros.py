"""`robomend model from-ros`: a first model, from a live ROS 1 graph or from a bag."""

from __future__ import annotations

from pathlib import Path

import click

from robomend.errors import BackendError, InputError


@click.command("from-ros")
@click.option("--ros1", metavar="URI", help="The master of a running robot, e.g. http://localhost:11311.")
@click.option(
    "--bag", type=click.Path(path_type=Path, exists=True), help="A recording of ROS 1 (.bag): no inputs."
)
@click.option("--name", default="robot", show_default=True, help="The model's name.")
def command(ros1: str | None, bag: Path | None, name: str) -> None:
    """Propose a model from a live ROS graph, as commented YAML on standard output.

    \b
    robomend model from-ros --ros1 http://localhost:11311 > robot.yaml
    robomend model from-ros --bag run.bag --name tedusar
    """
    from robomend.model.from_graph import model_from_graph

    if (ros1 is None) == (bag is None):
        raise click.UsageError("give one of --ros1 and --bag")
    if ros1 is not None:
        from robomend_client.bridges.ros1.master import read_graph
        from robomend_client.bridges.ros1.xmlrpc import OutOfReach, PeerError, address_of

        try:
            address_of(ros1)
        except OutOfReach as error:
            raise InputError(str(error)) from error
        try:
            graph, source = read_graph(ros1), f"the master at {ros1}"
        except PeerError as error:
            raise BackendError(f"the master at {ros1}: {error}") from error
    else:
        assert bag is not None
        try:
            from robomend_client.bridges.ros1.bag import UnreadableBag, bag_graph
        except ImportError as error:
            why = "reading bags needs what is installed with: pip install 'robomend-client[ros1]'"
            raise BackendError(why) from error
        try:
            graph, source = bag_graph(bag), f"the recording {bag.name}, which does not say who listens"
        except UnreadableBag as error:
            raise InputError(str(error)) from error
    click.echo(model_from_graph(graph, name, source), nl=False)
