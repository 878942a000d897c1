"""Every call of the HTTP interface as a value: method, path, body and how to read the answer. No sockets.

Client and AsyncClient send the same calls; a new route is one function here and one line in each of them.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO, Any, Generic, TypeVar, cast
from urllib.parse import quote

import httpx

from robomend_client.actions import Action, ActionResult, Orders, Settle
from robomend_client.literals import Atom, Literal
from robomend_client.readings import Reading
from robomend_client.rest.errors import NotTheService
from robomend_client.rest.types import Accepted, CurrentDiagnosis, FirstResult, Ingested, Page

T = TypeVar("T")

BASE = "/api/v1"
Sentences = Iterable[str | Literal]
BatchFields = Mapping[str, str | float | None]

MOST_TEXT = 4000
"""Characters of a message that the service takes."""


@dataclass(frozen=True, slots=True)
class Call(Generic[T]):
    """One request, not sent yet."""

    method: str
    path: str
    read: Callable[[httpx.Response], T]
    params: Mapping[str, str | int | float] = field(default_factory=dict)
    json: Any = None
    content: bytes | None = None
    form: Mapping[str, str] | None = None
    files: Sequence[tuple[str, IO[bytes]]] = ()  # of the form's field `logs`: name, and the open file
    headers: Mapping[str, str] = field(default_factory=dict)
    wait_s: float = 0.0  # the service may hold its answer back for this long (long poll)
    repeatable: bool = True  # sending it twice is the same as sending it once


def path(*parts: str | int) -> str:
    """Return the path below /api/v1; ids are percent-encoded, as action ids hold a colon."""
    return BASE + "".join("/" + quote(str(part), safe="") for part in parts)


def new_key() -> str:
    """Return a fresh Idempotency-Key: one per intent, the same for every try."""
    return uuid.uuid4().hex


def body(response: httpx.Response) -> Any:
    """Return the JSON of a success."""
    try:
        return response.json()
    except ValueError as error:
        raise NotTheService(f"{response.request.url} answered {response.status_code} without JSON") from error


def nothing(response: httpx.Response) -> None:
    """Read an answer whose body says nothing."""


def given(**values: str | float | int | None) -> dict[str, str | int | float]:
    """Return the query parameters that were given."""
    return {name: value for name, value in values.items() if value is not None}


def get(*parts: str | int, wait_s: float | None = None, **params: str | float | int | None) -> Call[Any]:
    """`wait_s` goes to the service, and stretches our own time-out by as much."""
    return Call("GET", path(*parts), body, params=given(wait_s=wait_s, **params), wait_s=wait_s or 0.0)


def page(
    *parts: str | int, cursor: str | None = None, limit: int | None = None, **params: str | None
) -> Call[Page[dict[str, Any]]]:
    return get(*parts, wait_s=None, cursor=cursor, limit=limit, **params)


def post(*parts: str | int, json: Any = None, repeatable: bool = False) -> Call[Any]:
    """A POST; repeatable where the service promises so, by an Idempotency-Key or by its nature."""
    return Call("POST", path(*parts), body, json={} if json is None else json, repeatable=repeatable)


def delete(*parts: str | int, version: str | None = None) -> Call[None]:
    return Call("DELETE", path(*parts), nothing, headers=_if_match(version))


def _if_match(version: str | None) -> dict[str, str]:
    return {} if version is None else {"If-Match": version}


# --- models and robots ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Versioned:
    """A resource and its ETag, which the next change of it hands back."""

    value: dict[str, Any]
    version: str


def versioned(response: httpx.Response) -> Versioned:
    return Versioned(body(response), response.headers.get("etag", ""))


def get_versioned(kind: str, name: str) -> Call[Versioned]:
    return Call("GET", path(kind, name), versioned)


def put_robot(robot: str, value: Mapping[str, Any], version: str | None) -> Call[Versioned]:
    return Call("PUT", path("robots", robot), versioned, json=dict(value), headers=_if_match(version))


def put_model(name: str, source: str, format: str | None, version: str | None) -> Call[Versioned]:
    value = {"source": source, "format": format}
    return Call("PUT", path("models", name), versioned, json=value, headers=_if_match(version))


# --- observations and diagnosis ---------------------------------------------------------------------


def observe(
    robot: str,
    observations: Sentences,
    *,
    assertions: Mapping[str, str] | None = None,
    time_ns: int | None = None,
    source: str | None = None,
    lifetime_s: float | None = None,
    together: bool = True,
    key: str | None = None,
    since: Sequence[int | None] | None = None,
    onset: Sequence[int | None] | None = None,
    unknown: Iterable[str | Atom] | None = None,
    settled: int | None = None,
    readings: Sequence[Reading | Mapping[str, Any] | None] | None = None,
) -> Call[Accepted]:
    """Report one batch. `since`, `onset` and `readings` run parallel to the observations: what each rests on,
    and what was measured.
    """
    values: dict[str, Any] = {
        "observations": [str(sentence) for sentence in observations],
        "assertions": dict(assertions) if assertions else None,
        "time": time_ns,
        "source": source,
        "lifetime_s": lifetime_s,
        "together": None if together else False,
        "since": None if since is None else list(since),
        "onset": None if onset is None else list(onset),
        "unknown": None if unknown is None else [str(atom) for atom in unknown],
        "settled": settled,
        "readings": None if readings is None else [_reading(reading) for reading in readings],
    }
    return Call(
        "POST",
        path("robots", robot, "observations"),
        body,
        json={name: value for name, value in values.items() if value is not None},
        headers={"Idempotency-Key": key or new_key()},
    )


def _reading(reading: Reading | Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    return reading.as_json() if isinstance(reading, Reading) else reading


def observe_lines(robot: str, batches: Iterable[Mapping[str, Any]], key: str | None = None) -> Call[Ingested]:
    """Many batches in one request, as NDJSON: each line is what `observe` sends as its body."""
    lines = "".join(json.dumps(dict(batch), separators=(",", ":")) + "\n" for batch in batches)
    return Call(
        "POST",
        path("robots", robot, "observations"),
        body,
        content=lines.encode(),
        headers={"Content-Type": "application/x-ndjson", "Idempotency-Key": key or new_key()},
    )


def diagnosis(robot: str, wait_s: float | None, after: int | None) -> Call[CurrentDiagnosis]:
    return get("robots", robot, "diagnosis", wait_s=wait_s, after=after)


# --- moments of faults --------------------------------------------------------------------------------


def keep_moment(robot: str, moment: Mapping[str, Any]) -> Call[Any]:
    """Hand in what an agent kept; by its agent and key it is the same moment each time."""
    return post("robots", robot, "moments", json=dict(moment), repeatable=True)


def keep_recording(robot: str, moment: str, at: int, size: int, data: bytes) -> Call[Any]:
    """Hand in a piece of a recording; one that came before changes nothing."""
    place = path("robots", robot, "moments", moment, "recording")
    kind = {"Content-Type": "application/octet-stream"}
    return Call("PUT", place, body, params={"at": at, "size": size}, content=data, headers=kind)


# --- the agent's side of actions ----------------------------------------------------------------------


def poll(
    robot: str,
    agent: str,
    host: str | None,
    can: Sequence[str],
    observes: Sequence[Mapping[str, Any]],
    wait_s: float,
    settled: int | None = None,
    takes_s: Mapping[str, float] | None = None,
    starved_ns: int | None = None,
) -> Call[Orders]:
    """Ask what there is to do. The body says what the agent can do, and how long that may take, and what it
    observes how fast; the query since when its computer is starved: older services read over that.
    """
    params = {} if starved_ns is None else {"starved_ns": starved_ns}
    value = {
        "agent": agent,
        "host": host,
        "can": list(can),
        "observes": list(observes),
        "settled": settled,
        "wait_s": wait_s,
        **({"takes_s": dict(takes_s)} if takes_s else {}),
    }
    place = path("robots", robot, "actions", "next")
    return Call("POST", place, read_orders, params=params, json=value, wait_s=wait_s)


def read_orders(response: httpx.Response) -> Orders:
    if response.status_code == 204:
        return Orders()
    value = body(response)
    try:
        settle = value.get("settle")
        return Orders(
            action=read_action(response) if "id" in value else None,
            settle=None if settle is None else Settle(int(settle["n"]), tuple(map(str, settle["atoms"]))),
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise NotTheService(f"{response.request.url} gave no orders: {cast('object', value)!r}") from error


def next_action(robot: str, agent: str, host: str | None, wait_s: float) -> Call[Action | None]:
    """Ask for an action, without saying what the agent can do; see `poll`.

    `host` asks for the actions of that host only; without it the agent is the robot's only one.
    """
    value = {"agent": agent, "host": host, "wait_s": wait_s}
    return Call("POST", path("robots", robot, "actions", "next"), read_action, json=value, wait_s=wait_s)


def read_action(response: httpx.Response) -> Action | None:
    if response.status_code == 204:
        return None
    value = body(response)
    try:
        return Action(
            id=str(value["id"]),
            name=str(value["name"]),
            parameters=tuple(str(parameter) for parameter in value["parameters"]),
            timeout_s=float(value["timeout_s"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise NotTheService(f"{response.request.url} gave no action: {cast('object', value)!r}") from error


def feedback(action_id: str, number: int, message: str) -> Call[None]:
    value = {"code": number, "message": message[:MOST_TEXT]}
    return Call("POST", path("actions", action_id, "feedback"), nothing, json=value)


def result(action_id: str, outcome: ActionResult) -> Call[FirstResult]:
    """The first report of an action counts, so that this may be sent again and again."""
    value = {"code": outcome.code, "message": outcome.message[:MOST_TEXT]}
    return Call("POST", path("actions", action_id, "result"), body, json=value)


def kept(repair: str) -> str:
    """Return where a repair is kept, or a change of configuration."""
    return "changes" if repair.startswith("c-") else "repairs"


# --- batches --------------------------------------------------------------------------------------------


def start_batch(logs: Iterable[str], fields: BatchFields) -> Call[Any]:
    """Have logs diagnosed that are below the service's `batch_folder`; `fields` are those of the body."""
    return post("batches", json={**given(**fields), "logs": list(logs)})


def upload_batch(
    logs: Sequence[tuple[str, IO[bytes]]], fields: Mapping[str, str | float | None]
) -> Call[Any]:
    """Hand in logs, which are read as they are sent, and have them diagnosed."""
    form = {name: str(value) for name, value in given(**fields).items()}
    return Call("POST", path("batches"), body, form=form, files=logs, repeatable=False)


def cancel_batch(batch: str, reason: str) -> Call[Any]:
    return Call("DELETE", path("batches", batch), body, params=given(reason=reason or None))


# --- the board and the brakes -------------------------------------------------------------------------


def resume(reason: str) -> Call[Any]:
    return Call("DELETE", path("stop"), body, params=given(reason=reason or None))


def put_channel(robot: str, channel: int, on: bool, reason: str) -> Call[None]:
    value = {"on": on, "reason": reason}
    return Call("PUT", path("robots", robot, "board", "channels", channel), nothing, json=value)


def release(robot: str, component: str, reason: str) -> Call[None]:
    place = path("robots", robot, "quarantine", component, "release")
    return Call("POST", place, nothing, json={"reason": reason}, repeatable=False)
