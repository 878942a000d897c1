"""`robomend robot`: what is configured of a robot on a running service."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.files import ExistingFile
from robomend.cli.remote.connection import asking, format_option, service_options
from robomend.cli.remote.names import RobotName
from robomend.cli.tables import at, show_paragraph, show_table

if TYPE_CHECKING:
    from robomend_client.rest.errors import InvalidRequest

PAGE = 1000
"""Robots in one answer of the service."""


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
        except InvalidRequest as error:
            raise InputError(_refused(error, file)) from error
        except NotFound as error:
            known = [one["name"] for one in client.models()["items"]]
            raise InputError(_no_model(error, name, known)) from error
    if format_ == "json":
        click.echo(json.dumps(now.value, ensure_ascii=False))
        return
    click.echo(f"robot {robot}: {_what(before, now.version, 'changed')}")
    for finding in now.value.get("findings", ()):
        show_paragraph(f"note: {finding}")


@command.command("list", short_help="List the robots that are configured.")
@service_options("viewer")
@format_option()
def list_robots(url: str, key: str | None, format_: str) -> None:
    """List the robots that are configured, by id; how they are says `robomend status`."""
    items: list[dict[str, Any]] = []
    with asking(url, key) as client:
        page = client.robots(limit=PAGE)
        items += page["items"]
        while page["next"] is not None:
            page = client.robots(page["next"], PAGE)
            items += page["items"]
    if format_ == "json":
        click.echo(json.dumps({"items": items, "next": None}, ensure_ascii=False))
    elif not items:
        click.echo("no robots yet: `robomend robot put ID FILE` configures one")
    else:
        show_table(
            ("robot", "model", "policy", "configured"),
            ((one["id"], one["model"], one["policy"], at(one["updated_ns"])) for one in items),
        )


@command.command("delete", short_help="Delete ROBOT; its history stays.")
@click.argument("robot", type=RobotName())
@click.option("--yes", is_flag=True, help="Do not ask whether it is meant.")
@service_options("operator")
def delete(robot: str, yes: bool, url: str, key: str | None) -> None:
    """Delete ROBOT from a running service: nothing is diagnosed or repaired any more.

    Its history stays as long as the retention says. Refused while a repair or a drill of it is open.
    """
    with asking(url, key, robot=robot) as client:
        version = client.robot(robot).version
        if not yes:
            click.confirm(f"delete robot {robot}", abort=True, err=True)
        client.delete_robot(robot, version)
    click.echo(f"robot {robot}: deleted")


@command.command("release", short_help="Let a component of ROBOT be tried again.")
@click.argument("robot", type=RobotName())
@click.argument("component", required=False)
@click.option("--reason", default="", help="Why; it goes to the audit log.")
@service_options("operator")
@format_option()
def release(robot: str, component: str | None, reason: str, url: str, key: str | None, format_: str) -> None:
    """Let COMPONENT of ROBOT, which is in quarantine, be tried again; without it, list those that are."""
    from robomend.errors import InputError
    from robomend_client.near import did_you_mean

    with asking(url, key, robot=robot) as client:
        held = client.quarantine(robot)
        if component is not None:
            if component not in held:
                others = did_you_mean(component, list(held)) or f"; there are: {', '.join(held) or 'none'}"
                raise InputError(f"{component!r} of {robot} is not in quarantine{others}")
            client.release(robot, component, reason)
    if component is not None:
        click.echo(f"{component} of {robot} may be tried again")
    elif format_ == "json":
        click.echo(json.dumps(held, ensure_ascii=False))
    elif not held:
        click.echo(f"nothing of {robot} is in quarantine")
    else:
        show_table(("component", "why it is not tried again"), held.items())


def _what(before: str | None, after: str, changed: str) -> str:
    """Return what became of a resource, by its versions."""
    if before is None:
        return "created"
    return "as it was" if before == after else changed


def _refused(error: InvalidRequest, file: Path) -> str:
    """Return what the service says of a configuration, with the line of each field in its file."""
    from robomend.cli.robot_file import place_in

    faults = [one for one in error.problem.get("errors") or () if one["place"].startswith("body.")]
    if not faults:
        return f"{file}: {error.detail}"
    places = ((one["place"].removeprefix("body."), one["message"]) for one in faults)
    return "\n".join(f"{place_in(file, place)}: `{place}`: {message}" for place, message in places)


def _no_model(error: Exception, name: str, known: list[str]) -> str:
    """Return that the service does not have the model, and which was meant."""
    from robomend_client.near import did_you_mean

    if name in known:
        return str(error)
    meant = did_you_mean(name, known)
    return f"the service has no model {name!r}{meant}; --model FILE stores one with the robot"
