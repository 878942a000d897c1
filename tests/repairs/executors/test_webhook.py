"""The webhook executor against a real HTTP server on loopback."""

from __future__ import annotations

import hashlib
import hmac
import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from tests.repairs.executors.test_board import lost, quiet

from robomend.errors import Fenced
from robomend.repairs.executors.webhook import WebhookExecutor
from robomend.webhooks import Webhook, allowed_address, outside
from robomend_client.actions import FAILED, OK, REFUSED, TIMED_OUT, UNREACHABLE, Action

pytestmark = pytest.mark.anyio


class Receiver(BaseHTTPRequestHandler):
    """Answers with the next of `answers`, the last one for ever."""

    answers: list[tuple[int, bytes]]
    calls: list[tuple[dict[str, str], bytes]]

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.calls.append((dict(self.headers), body))
        status, answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        self.send_response(status)
        self.send_header("Content-Length", str(len(answer)))
        self.end_headers()
        self.wfile.write(answer)

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def receiver() -> Iterator[tuple[str, type[Receiver]]]:
    class Mine(Receiver):
        answers = [(200, b'{"code": 0, "message": "done"}')]  # noqa: RUF012  # a class per test
        calls = []  # noqa: RUF012  # likewise

    server = ThreadingHTTPServer(("127.0.0.1", 0), Mine)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/hook", Mine
    server.shutdown()
    server.server_close()
    thread.join()


ACTION = Action("r-1:2", "reset_usb", ("usb1",), 60.0)
IN_VAIN = Action("r-1:2", "reset_usb", ("usb1",), 3.0)
"""It is called until its time is over."""


def executor(url: str, *, allow_private: bool = True) -> WebhookExecutor:
    return WebhookExecutor({"reset_usb": Webhook(url, "a secret", allow_private)})


async def test_the_call_is_signed_and_carries_the_action(receiver: tuple[str, type[Receiver]]) -> None:
    url, server = receiver
    done = await executor(url).execute(ACTION, quiet)
    assert (done.code, done.message) == (OK, "done")
    [(headers, body)] = server.calls
    assert json.loads(body) == {"id": "r-1:2", "name": "reset_usb", "parameters": ["usb1"], "timeout_s": 60.0}
    assert headers["Idempotency-Key"] == "r-1:2"
    signed = headers["X-Robomend-Timestamp"].encode() + b"." + body
    expected = hmac.new(b"a secret", signed, hashlib.sha256).hexdigest()
    assert headers["X-Robomend-Signature"] == f"sha256={expected}"


async def test_a_busy_receiver_is_called_again_with_the_same_id(receiver: tuple[str, type[Receiver]]) -> None:
    url, server = receiver
    server.answers[:0] = [(503, b"")]
    assert (await executor(url).execute(ACTION, quiet)).code == OK
    assert [headers["Idempotency-Key"] for headers, _ in server.calls] == ["r-1:2", "r-1:2"]


@pytest.mark.parametrize(
    ("status", "answer", "code"),
    [
        (404, b"{}", FAILED),
        (302, b"", FAILED),
        (200, b"fine", TIMED_OUT),  # it took the call: what must not be repeated is not sent again
        (200, b'{"code": true}', TIMED_OUT),
        (200, b'{"code": "0"}', TIMED_OUT),
        (200, b"[]", TIMED_OUT),
    ],
)
async def test_an_answer_without_an_integer_result_is_no_success(
    receiver: tuple[str, type[Receiver]], status: int, answer: bytes, code: int
) -> None:
    url, server = receiver
    server.answers[:] = [(status, answer)]
    done = await executor(url).execute(ACTION, quiet)
    assert done.code == code
    assert len(server.calls) == 1


@pytest.mark.parametrize(("status", "code"), [(502, TIMED_OUT), (429, UNREACHABLE)])
async def test_a_gateway_that_fails_leaves_the_outcome_unknown_and_one_that_is_busy_does_not(
    receiver: tuple[str, type[Receiver]], status: int, code: int
) -> None:
    url, server = receiver
    server.answers[:] = [(status, b"")]
    done = await executor(url).execute(IN_VAIN, quiet)
    assert (done.code, f"{url} answered {status}" in done.message) == (code, True)
    assert len(server.calls) > 1


async def test_where_nobody_listens_nothing_can_have_acted() -> None:
    done = await executor("http://127.0.0.1:9/").execute(IN_VAIN, quiet)
    assert done.code == UNREACHABLE


async def test_who_has_lost_the_robot_calls_nobody(receiver: tuple[str, type[Receiver]]) -> None:
    url, server = receiver
    with pytest.raises(Fenced):
        await WebhookExecutor({"reset_usb": Webhook(url, "a secret", True)}, lost).execute(ACTION, quiet)
    assert server.calls == []


async def test_an_endless_answer_is_cut_off(receiver: tuple[str, type[Receiver]]) -> None:
    url, server = receiver
    server.answers[:] = [(200, b" " * (1 << 20))]
    assert (await executor(url).execute(IN_VAIN, quiet)).code != OK


@pytest.mark.parametrize(
    "url",
    [
        "http://127.0.0.1/",
        "http://[::1]/",
        "http://169.254.169.254/latest/meta-data",
        "http://10.0.0.1/",
        "http://[::ffff:10.0.0.1]/",
        "http://localhost/",
        "http://[64:ff9b::169.254.169.254]/",
        "http://[2002:a9fe:a9fe::1]/",
        "http://[::169.254.169.254]/",
        "http://[fe80::1]/",
        "http://[ff0e::1]/",
        "http://224.0.0.1/",
        "http://0.0.0.0/",
        "http://168.63.129.16/",
        "http://192.88.99.1/",
        "http://[::ffff:0:127.0.0.1]/",
        "http://[3fff::1]/",
        "http://192.0.0.192/",
    ],
)
async def test_addresses_inside_are_refused_unless_allowed(url: str) -> None:
    assert await allowed_address(Webhook(url, "s")) is None
    assert (await executor(url, allow_private=False).execute(ACTION, quiet)).code == REFUSED


@pytest.mark.parametrize("address", ["1.1.1.1", "2606:4700::1111", "::ffff:1.1.1.1", "64:ff9b::1.1.1.1"])
async def test_addresses_of_the_internet_are_called(address: str) -> None:
    assert outside(address)
