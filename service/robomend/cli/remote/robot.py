"""`robomend robot`: what is configured of a robot on a running service."""

from __future__ import annotations

import json
from pathlib import Path

import click

from robomend.cli.files import ExistingFile
from robomend.cli.remote.connection import asking, format_option, service_options
from robomend.cli.remote.names import RobotName
from robomend.cli.tables import show_paragraph


@click.group("robot")
def command() -> None:
    """Configure a robot on a running service."""


@command.command("get", short_help="Write the configuration of ROBOT as a file.")
@click.argument("robot", type=RobotName())
@service_options("viewer")
@format_option("json", default="yaml")
def get(robot: str, url: str, key: str | None, format_: str) -> None:
    """Write the configuration of ROBOT as a file that `robot put` takes; secrets are covered."""
    from robomend.cli.robot_file import robot_text

    with asking(url, key, robot=robot) as client:
        config = client.robot(robot).value["config"]
    click.echo(json.dumps(config, ensure_ascii=False) if format_ == "json" else robot_text(config), nl=False)
    if format_ == "json":
        click.echo()


@command.command("put", short_help="Configure ROBOT as FILE says.")
@click.argument("robot", type=RobotName())
@click.argument("file", type=ExistingFile())
@click.option("--model", type=ExistingFile(), help="Store this model first, by the name that FILE says.")
@service_options("operator")
@format_option()
def put(robot: str, file: Path, model: Path | None, url: str, key: str | None, format_: str) -> None:
    """Configure ROBOT as FILE says (YAML or JSON), whether it is new or not; what was observed stays.

    The fields of FILE are those of docs/http.md: `model: tedusar` is all that it needs. With --model the
    model comes with it: a new version, where the service has one of that name.
    """
    from robomend.cli.robot_file import read_robot
    from robomend.errors import InputError
    from robomend_client.rest import Client
    from robomend_client.rest.errors import InvalidRequest, NotFound

    config = read_robot(file)
    name = config.get("model")
    if not isinstance(name, str):
        raise InputError(f"{file}: `model` names the model that the robot follows")

    def version(client: Client, kind: str, name: str) -> str | None:
        """Return the version to be replaced, None where there is none."""
        try:
            return (client.robot if kind == "robot" else client.model)(name).version
        except NotFound:
            return None

    with asking(url, key) as client:
        if model is not None:
            before = version(client, "model", name)
            try:
                after = client.put_model(name, model.read_text(encoding="utf-8"), version=before).version
            except InvalidRequest as error:  # the place in it is a line: of which file, only we know
                raise InputError(f"{model}:{error.detail}") from error
            click.echo(f"model {name}: {_what(before, after, 'a new version')}", err=True)
        before = version(client, "robot", robot)
        try:
            now = client.put_robot(robot, config, before)
        except NotFound as error:
            known = [one["name"] for one in client.models()["items"]]
            raise InputError(_no_model(error, name, known)) from error
    if format_ == "json":
        click.echo(json.dumps(now.value, ensure_ascii=False))
        return
    click.echo(f"robot {robot}: {_what(before, now.version, 'changed')}")
    for finding in now.value.get("findings", ()):
        show_paragraph(f"note: {finding}")


def _what(before: str | None, after: str, changed: str) -> str:
    """Return what became of a resource, by its versions."""
    if before is None:
        return "created"
    return "as it was" if before == after else changed


def _no_model(error: Exception, name: str, known: list[str]) -> str:
    """Return that the service does not have the model, and which was meant."""
    from robomend_client.near import did_you_mean

    if name in known:
        return str(error)
    meant = did_you_mean(name, known)
    return f"the service has no model {name!r}{meant}; --model FILE stores one with the robot"
