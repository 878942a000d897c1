"""`robomend watch`: what happens on a running service, line by line, as it happens."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.remote.connection import asking, format_option, service_options
from robomend.cli.remote.names import RobotName
from robomend.cli.tables import at, diagnoses, printable, some
from robomend.planning.plan import action_title, in_prose
from robomend.repairs.headline import observed
from robomend.repairs.states import STEP_ENDS, ChangeState, RepairState, StepState

if TYPE_CHECKING:
    from robomend_client.events import Event
    from robomend_client.rest import ClientError

NO_FAULT = "no fault: nothing that is observed points to one"
"""Not that it is healthy: whether enough was observed for that, the robot's state says."""

MOST_ACTIONS = 1000
"""Actions under way that are remembered."""


@click.command("watch")
@click.argument("robot", type=RobotName(), required=False)
@click.option("--after", type=click.IntRange(min=0), metavar="EVENT", help="Begin behind this event's id.")
@click.option("--count", type=click.IntRange(min=1), help="End after so many lines; by default with Ctrl-C.")
@service_options("viewer")
@format_option()
def command(
    robot: str | None, after: int | None, count: int | None, url: str, key: str | None, format_: str
) -> None:
    """Show what happens, of ROBOT alone or of all: observations, diagnoses, repairs, actions, the stop.

    A lost connection is taken up again, and nothing is missed that the service still keeps. With --format
    json one event is written per line. Times are UTC.
    """
    shown, teller = 0, Teller()
    with asking(url, key, robot=robot) as client:
        if robot is not None:
            client.robot(robot)
        else:
            client.stopped()  # whether a service with this key is there: the stream would wait for one
        for event in client.events(robot, after=after, on_gap=_gap, on_connection=_Connection(url)):
            line = _json(event) if format_ == "json" else teller.told(event)
            if line is None:
                continue
            click.echo(line if format_ == "json" else printable(line))
            shown += 1
            if shown == count:
                return


class _Connection:
    """Tells on stderr when the stream is lost and when it stands again."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._lost = False

    def __call__(self, failure: ClientError | None) -> None:
        if failure is not None:
            self._lost = True
            click.echo(f"connection lost: waiting for {self._url}", err=True)
        elif self._lost:
            click.echo("connected again", err=True)
        else:
            click.echo(f"watching {self._url}; Ctrl-C ends", err=True)


def _gap(data: Mapping[str, Any]) -> None:
    click.echo(f"the service does not keep what was before event {data.get('oldest', '…')}", err=True)


def _json(event: Event) -> str:
    value = {
        "id": event.id,
        "time_ns": event.time_ns,
        "kind": str(event.kind),
        "robot": event.robot,
        "data": dict(event.data),
    }
    return json.dumps(value, ensure_ascii=False)


class Teller:
    """Tells events to people; each action once for each thing that is new of it."""

    def __init__(self) -> None:
        self._last: dict[str, str] = {}  # of the actions under way

    def told(self, event: Event) -> str | None:
        """Return an event as a line; None where it would tell nothing, or nothing new of an action."""
        line, action = told(event), event.data.get("id") if event.kind == "action" else None
        if line is None or action is None:
            return line
        words = line.partition(" ")[2]
        if self._last.get(action) == words:
            return None
        self._last.pop(action, None)
        if event.data.get("state") not in STEP_ENDS:
            if len(self._last) >= MOST_ACTIONS:
                self._last.clear()
            self._last[action] = words
        return line


def told(event: Event) -> str | None:
    """Return an event as a line for people; None where it would tell nothing."""
    words = WORDS[event.kind](event.data)
    if words is None:
        return None
    where = f"{event.robot} " if event.robot else ""
    return f"{at(event.time_ns)} {where}{words}"


def _observations(data: Mapping[str, Any]) -> str | None:
    changed, forgotten = data.get("changed", ()), data.get("forgotten", ())
    if not changed and not forgotten:
        return None
    readings = data.get("readings", {})
    seen = [observed({"literal": one, "reading": readings.get(one)}) for one in changed]
    words = [f"seen: {some(seen)}"] if changed else []
    words += [f"unknown now: {some(forgotten)}"] if forgotten else []
    return "; ".join(words)


def _diagnosis(data: Mapping[str, Any]) -> str:
    result = data.get("result")
    if result is None:
        return f"no diagnosis: {(data.get('fault') or {}).get('detail', 'not known why')}"
    found = result["diagnoses"]
    if any(not one["bad"] for one in found):
        return NO_FAULT
    return f"bad: {diagnoses([one['bad'] for one in found])}" if found else "no diagnosis within the limits"


def _repair(data: Mapping[str, Any]) -> str:
    words = f"repair {data.get('id')}: {data.get('state')}"
    if data.get("state") == RepairState.AWAITING_APPROVAL and data.get("headline"):
        return f"{words}: {data['headline']}"
    return words + (f": {in_prose(data['reason'])}" if data.get("reason") else "")


def _configuration(data: Mapping[str, Any]) -> str:
    said = ", ".join(in_prose(str(one["text"])) for one in data.get("changes", ()))
    words = f"change {data.get('id')}: {data.get('state')}: {said}"
    failed = data.get("state") == ChangeState.FAILED and data.get("reason")
    return words + (f": {in_prose(data['reason'])}" if failed else "")


def _action(data: Mapping[str, Any]) -> str | None:
    if "repair" not in data:
        return None  # the queue of the agents; the step of the repair says the same
    state = str(data.get("state"))
    if state == StepState.RUNNING and data.get("result") is not None:
        state = "answered"  # and its effect is awaited
    words = f"{action_title(str(data.get('name')), data.get('parameters', ()))}: {state}"
    message = data.get("message") or (data.get("feedback") or {}).get("message")
    return words + (f": {in_prose(message)}" if message else "")


def _board(data: Mapping[str, Any]) -> str | None:
    if "link" not in data:
        return None  # channels are seen as observations
    return f"board: {data['link']}" + (f": {data['reason']}" if data.get("reason") else "")


def _drill(data: Mapping[str, Any]) -> str:
    words = f"drill {data.get('id')}: {data.get('state')}: {data.get('act')}"
    return words + (f": {data['reason']}" if data.get("reason") else "")


def _batch(data: Mapping[str, Any]) -> str:
    return f"batch {data.get('batch')}: {data.get('state')}"


def _robot(data: Mapping[str, Any]) -> str:
    what = data.get("what", "changed")
    if what == "health":
        unknown = data.get("unknown", ())
        if data.get("reported") is False:
            return "is unknown: nothing has been reported yet"
        return f"is {data.get('state')}" + (f": {some(unknown)}" if unknown else "")
    if data.get("quarantine"):
        until = at(data["until_ns"])
        return f"{data['quarantine']} is left alone until {until}: {in_prose(str(data.get('reason')))}"
    rest = {name: value for name, value in data.items() if name not in {"what", "etag"} and value}
    if rest.keys() == {"by"}:
        return f"robot: {what} by {rest['by']}"
    return f"robot: {what}" + (f" {json.dumps(rest, ensure_ascii=False)}" if rest else "")


def _model(data: Mapping[str, Any]) -> str:
    return f"model {data.get('name', data.get('model', ''))}: {data.get('what', 'new version')}"


def _moment(data: Mapping[str, Any]) -> str:
    return f"moment {data['moment']} of a fault is kept" + (
        "" if data.get("complete", True) else ", its recording is still coming"
    )


def _stop(data: Mapping[str, Any]) -> str:
    if not data.get("active"):
        return f"the stop is lifted by {data.get('by')}"
    return f"STOPPED by {data.get('by')}" + (f": {data['reason']}" if data.get("reason") else "")


WORDS = {
    "observations": _observations,
    "diagnosis": _diagnosis,
    "repair": _repair,
    "configuration": _configuration,
    "action": _action,
    "board": _board,
    "robot": _robot,
    "model": _model,
    "drill": _drill,
    "moment": _moment,
    "batch": _batch,
    "stop": _stop,
}
"""A line for each kind of event."""
