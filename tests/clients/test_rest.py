"""Both REST clients against a real HTTP server on a socket: calls, errors, retries, streams."""

from __future__ import annotations

import asyncio
import json
import pickle
import socket
import threading
import time
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from tests.clients.service_double import ServiceDouble

from robomend_client.actions import Action, ActionResult
from robomend_client.events import Event
from robomend_client.literals import fails
from robomend_client.rest import NEVER, AsyncClient, Client, Retry, errors

FAST = Retry(times=3, first_s=0.001, longest_s=0.01)


@pytest.fixture(params=["sync", "asyncio"])
def call(request: pytest.FixtureRequest, service: ServiceDouble) -> Callable[..., Any]:
    """Call a method of the client by name: `call("observe", "r", […])`, on either client."""

    def sync(name: str, *arguments: Any, **options: Any) -> Any:
        with Client(service.url, "s3cret", retry=FAST, timeout_s=5) as client:
            return getattr(client, name)(*arguments, **options)

    def asynchronous(name: str, *arguments: Any, **options: Any) -> Any:
        async def run() -> Any:
            async with AsyncClient(service.url, "s3cret", retry=FAST, timeout_s=5) as client:
                method: Callable[..., Awaitable[Any]] = getattr(client, name)
                return await method(*arguments, **options)

        return asyncio.run(run())

    return sync if request.param == "sync" else asynchronous


def answering(service: ServiceDouble, *answers: tuple[int, Any]) -> list[tuple[str, str]]:
    """Answer the next requests so, then as usual; return the list that collects them."""
    left, asked = list(answers), list[tuple[str, str]]()

    def answer(method: str, path: str) -> tuple[int, Any] | None:
        asked.append((method, path))
        return left.pop(0) if left else None

    service.answers = answer
    return asked


# --- calls ------------------------------------------------------------------------------------------------


def test_observations_go_out_as_text_with_key_and_bearer(
    service: ServiceDouble, call: Callable[..., Any]
) -> None:
    accepted = call(
        "observe", "tedusar", [fails("ok", "scan"), "on(hokuyo)"], time_ns=5, source="gobs", lifetime_s=2
    )
    assert accepted["revision"] == 1
    (posted,) = service.posted
    assert posted.path == "/api/v1/robots/tedusar/observations"
    assert posted.body == {
        "observations": ["not ok(scan)", "on(hokuyo)"],
        "time": 5,
        "source": "gobs",
        "lifetime_s": 2,
    }
    assert posted.key
    assert service.headers[-1]["authorization"] == "Bearer s3cret"


def test_many_batches_go_out_as_ndjson(service: ServiceDouble, call: Callable[..., Any]) -> None:
    call("observe_lines", "tedusar", [{"observations": ["ok(a)"]}, {"observations": ["ok(b)"]}])
    assert service.headers[-1]["content-type"] == "application/x-ndjson"
    assert service.posted[0].body == '{"observations":["ok(a)"]}\n{"observations":["ok(b)"]}\n'


def test_action_ids_survive_their_way_through_paths(service: ServiceDouble, call: Callable[..., Any]) -> None:
    service.ask("repair-7:2", "power_up", "jaguar", timeout_s=10)
    action = call("next_action", "tedusar", "onboard", wait_s=1)
    assert action == Action("repair-7:2", "power_up", ("jaguar",), 10.0)
    call("give_feedback", action.id, 1, "on its way")
    call("give_result", action.id, ActionResult(0, "on"))
    assert [(p.path, p.body) for p in service.posted] == [
        ("/api/v1/actions/repair-7:2/feedback", {"code": 1, "message": "on its way"}),
        ("/api/v1/actions/repair-7:2/result", {"code": 0, "message": "on"}),
    ]


def test_a_version_comes_back_with_the_resource_and_goes_out_with_its_change(
    service: ServiceDouble, call: Callable[..., Any]
) -> None:
    answering(service, (200, {"id": "r", "headers": {"ETag": '"v7"'}}))
    robot = call("robot", "r")
    assert robot.version == '"v7"'
    call("put_robot", "r", {"model": "tedusar"}, version=robot.version)
    assert service.headers[-1]["if-match"] == '"v7"'


ROUTES: list[tuple[str, tuple[Any, ...], str, str]] = [
    ("models", (), "GET", "/models"),
    ("put_model", ("m", "robomend: 1"), "PUT", "/models/m"),
    ("delete_robot", ("r", '"1"'), "DELETE", "/robots/r"),
    ("withdraw", ("r", "a/b"), "DELETE", "/robots/r/assertions/a/b"),
    ("start_repair", ("r",), "POST", "/robots/r/repairs"),
    ("release", ("r", "c"), "POST", "/robots/r/quarantine/c/release"),
    ("resume", (), "DELETE", "/stop"),
    ("switch_channel", ("r", 7, False), "PUT", "/robots/r/board/channels/7"),
]


def test_each_call_has_its_route(service: ServiceDouble, call: Callable[..., Any]) -> None:
    for name, arguments, method, path in ROUTES:
        asked = answering(service, (200, {}))
        call(name, *arguments)
        assert asked == [(method, f"/api/v1{path}")]


# --- errors -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("status", "error"),
    [
        (401, errors.Unauthorized),
        (403, errors.Forbidden),
        (404, errors.NotFound),
        (409, errors.StateConflict),
        (412, errors.PreconditionFailed),
        (422, errors.InvalidRequest),
        (428, errors.PreconditionRequired),
        (507, errors.ServiceFailed),
    ],
)
def test_each_status_has_its_exception_with_the_problems_code(
    service: ServiceDouble, call: Callable[..., Any], status: int, error: type[errors.ApiError]
) -> None:
    answering(service, (status, {"code": "some-code", "detail": "because", "extra": 1}))
    with pytest.raises(error) as raised:
        call("observations", "r")
    assert type(raised.value) is error
    assert (raised.value.code, raised.value.detail, raised.value.problem["extra"]) == (
        "some-code",
        "because",
        1,
    )
    assert str(raised.value) == f"{status} some-code: because"


def test_an_answer_without_json_is_not_the_services(service: ServiceDouble, call: Callable[..., Any]) -> None:
    answering(service, (200, None))
    with pytest.raises(errors.NotTheService, match="without JSON"):
        call("observations", "r")


def test_a_redirect_names_the_address_to_use(service: ServiceDouble, call: Callable[..., Any]) -> None:
    answering(service, (307, {"headers": {"Location": "https://elsewhere/"}}))
    with pytest.raises(errors.NotTheService, match="https://elsewhere/"):
        call("observations", "r")


def test_nobody_there_is_unreachable(service: ServiceDouble, call: Callable[..., Any]) -> None:
    service.down()
    with pytest.raises(errors.Unreachable, match="is the service running"):
        call("observe", "r", ["ok(a)"])


def test_a_service_that_hangs_times_out() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        with Client(url, timeout_s=0.1, retry=NEVER) as client, pytest.raises(errors.AnswerTimedOut):
            client.observations("r")


def test_the_documented_tree_is_the_tree_of_classes() -> None:
    drawn = [
        line.split("── ")[-1].split()[0] for line in (errors.__doc__ or "").splitlines() if "── " in line
    ]
    real = [
        name
        for name, value in vars(errors).items()
        if isinstance(value, type)
        and issubclass(value, errors.ClientError)
        and value is not errors.ClientError
    ]
    assert sorted(drawn) == sorted(real)


def test_errors_pickle() -> None:
    error = errors.NotFound(404, "not-found", "no robot r", {"code": "not-found"}, 1.5)
    copy = pickle.loads(pickle.dumps(error))
    assert (type(copy), str(copy), copy.retry_after_s) == (errors.NotFound, str(error), 1.5)


# --- retries ------------------------------------------------------------------------------------------------


def test_a_lost_answer_is_asked_for_again_with_the_same_key(
    service: ServiceDouble, call: Callable[..., Any]
) -> None:
    answering(service, (503, {}), (502, {}))
    call("observe", "r", ["ok(a)"])
    keys = [headers["idempotency-key"] for headers in service.headers]
    assert len(keys) == 3
    assert len(set(keys)) == 1


def test_what_might_act_twice_is_not_sent_twice(service: ServiceDouble, call: Callable[..., Any]) -> None:
    asked = answering(service, (503, {}))
    with pytest.raises(errors.Unavailable):
        call("start_repair", "r")
    assert len(asked) == 1


def test_a_refusal_is_not_repeated(service: ServiceDouble, call: Callable[..., Any]) -> None:
    asked = answering(service, (422, {"code": "bad-observation"}))
    with pytest.raises(errors.InvalidRequest):
        call("observe", "r", ["ok("])
    assert len(asked) == 1


def test_retries_end(service: ServiceDouble, call: Callable[..., Any]) -> None:
    asked = answering(service, *[(503, {})] * 10)
    with pytest.raises(errors.Unavailable):
        call("observations", "r")
    assert len(asked) == 1 + FAST.times


def test_retry_after_is_waited_for_unless_it_is_too_long(
    service: ServiceDouble, call: Callable[..., Any]
) -> None:
    answering(service, (429, {"headers": {"Retry-After": "0.05"}}))
    began = time.monotonic()
    call("start_repair", "r")  # refused before anything was done: may be sent again
    assert time.monotonic() - began >= 0.05
    answering(service, (429, {"headers": {"Retry-After": "3600"}}))
    with pytest.raises(errors.TooManyRequests):
        call("start_repair", "r")


# --- event streams ----------------------------------------------------------------------------------------


class Streams:
    """A server of event streams: each connection gets the next script, then is cut."""

    def __init__(self, *scripts: str) -> None:
        self.asked: list[str] = []
        self._scripts = list(scripts)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._server.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        for script in self._scripts:
            connection, _ = self._server.accept()
            with connection:
                request = connection.recv(65536).decode()
                lines = [line for line in request.splitlines() if line.lower().startswith("last-event-id:")]
                self.asked.append(lines[0].partition(":")[2].strip() if lines else "")
                connection.sendall(script.encode())

    def close(self) -> None:
        self._server.close()
        self._thread.join(60)


HEAD = "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nConnection: close\r\n\r\nretry: 1\n\n"
BROKEN = "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nContent-Length: 9999\r\n\r\n"


def frame(number: int, kind: str = "robot") -> str:
    data = json.dumps({"time_ns": number, "robot": "r", "data": {}})
    return f"id: {number}\nevent: {kind}\ndata: {data}\n\n"


async def _take(client: AsyncClient, count: int, **options: Any) -> list[Event]:
    found: list[Event] = []
    async for event in client.events("r", **options):
        found.append(event)
        if len(found) == count:
            break
    return found


@pytest.fixture(params=["sync", "asyncio"])
def follow(request: pytest.FixtureRequest) -> Callable[..., list[Event]]:
    def sync(url: str, count: int, **options: Any) -> list[Event]:
        with Client(url, timeout_s=5) as client:
            events = client.events("r", **options)
            return [next(events) for _ in range(count)]

    def asynchronous(url: str, count: int, **options: Any) -> list[Event]:
        async def run() -> list[Event]:
            async with AsyncClient(url, timeout_s=5) as client:
                return await _take(client, count, **options)

        return asyncio.run(run())

    return sync if request.param == "sync" else asynchronous


def test_a_stream_that_was_cut_goes_on_after_its_last_event(follow: Callable[..., list[Event]]) -> None:
    cut = BROKEN + frame(3) + frame(4, "stop").rstrip("\n")
    streams = Streams(HEAD + frame(1) + frame(2), cut, HEAD + frame(4, "stop") + frame(5))
    assert [event.id for event in follow(streams.url, 5, after=0)] == [1, 2, 3, 4, 5]
    # The id of the half event 4 had come, its end had not: only what was complete counts.
    assert streams.asked == ["0", "2", "3"]
    streams.close()


def test_a_stream_that_may_not_be_read_says_so(
    service: ServiceDouble, follow: Callable[..., list[Event]]
) -> None:
    answering(service, (403, {"code": "refused", "detail": "role viewer of another robot"}))
    with pytest.raises(errors.Forbidden, match="another robot"):
        follow(service.url, 1)
