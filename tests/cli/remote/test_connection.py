"""What the commands say when the service is away, refuses them, or is none."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from tests.api.conftest import Service, running
from tests.cli.remote.conftest import Say, Shared

from robomend.cli.commands import run
from robomend.settings import Settings

NOBODY = "http://127.0.0.1:1"

QUESTIONS = [
    ["status"],
    ["status", "r1"],
    ["watch"],
    ["watch", "r1"],
    ["repairs"],
    ["repairs", "r-1"],
    ["approve", "r-1"],
    ["cancel", "r-1"],
    ["stop", "show"],
    ["probes", "r1"],
    ["observe", "r1", "ok(scan)"],
    ["robot", "get", "r1"],
    ["drill", "r1", "--plan"],
]


@pytest.mark.parametrize("arguments", QUESTIONS, ids=" ".join)
def test_where_nobody_answers_the_remedy_is_told(arguments: list[str], say: Say) -> None:
    code, out, err = say(*arguments, "--url", NOBODY)
    assert (code, out) == (3, "")
    assert err.startswith(f"error: nobody answers at {NOBODY}: `robomend serve` starts a service there")


def test_whoever_asks_for_tls_where_there_is_none_is_told_so(say: Say, shared: Shared) -> None:
    code, out, err = say("status", "--url", shared.url.replace("http:", "https:"))
    assert (code, out) == (3, "")
    assert "what is there speaks no TLS: a service without a certificate is at http://" in err


@pytest.mark.parametrize("url", ["localhost:8600", "http://127.0.0.1:port", "ftp://127.0.0.1"])
def test_what_is_no_address_is_refused(url: str, say: Say) -> None:
    code, out, err = say("status", "--url", url)
    assert (code, out) == (2, "")
    assert err.startswith(f"error: --url {url}: ")


def test_a_web_server_that_is_none_of_ours_is_told_from_the_service(say: Say) -> None:
    class Hello(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"<p>hello")

        def log_message(self, *_: object) -> None: ...

    server = ThreadingHTTPServer(("127.0.0.1", 0), Hello)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        code, _, err = say("status", "--url", f"http://127.0.0.1:{server.server_port}")
    finally:
        server.shutdown()
        server.server_close()
    assert code == 3
    assert "is no robomend service" in err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["status", "bill#"], "no robot is named 'bill#'; did you mean 'bill-#'?"),
        (["observe", "bill#", "ok(scan)"], "did you mean 'bill-#'?"),
        (["probes", "bill#"], "did you mean 'bill-#'?"),
        (["robot", "get", "bill#"], "did you mean 'bill-#'?"),
        (["repairs", "--robot", "bill#"], "did you mean 'bill-#'?"),
        (["watch", "bill#"], "did you mean 'bill-#'?"),
        (["drill", "bill#", "--plan"], "did you mean 'bill-#'?"),
        (["status", "nobody-like-it"], "no robot is named 'nobody-like-it': `robomend status` lists them"),
        (["repairs", "nothing"], "no repair is named 'nothing': `robomend repairs` lists them"),
        (["approve", "nothing"], "no repair is named 'nothing': `robomend repairs` lists them"),
    ],
)
def test_an_unknown_name_is_answered_with_the_one_that_was_meant(
    arguments: list[str], said: str, say: Say, shared: Shared, robot: str
) -> None:
    shared.robot(f"bill-{robot}")
    code, out, err = say(*(one.replace("#", robot) for one in arguments))
    assert (code, out) == (2, "")
    assert said.replace("#", robot) in err


def test_a_repair_s_id_that_was_mistyped_is_named_as_well(say: Say, shared: Shared, robot: str) -> None:
    repair = shared.awaiting_approval(robot)
    code, _, err = say("cancel", f"{repair[:-1]}_")
    assert code == 2
    assert f"did you mean {repair!r}?" in err


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service that asks for keys, with one robot."""
    with running(Settings(port=0, data=tmp_path_factory.mktemp("guarded"))) as service:
        service.with_robot()
        yield service


def test_without_a_key_and_with_a_wrong_one_it_is_said_how_to_give_one(
    guarded: Service, say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer = guarded.key("viewer")
    code, _, err = say("status", "--url", guarded.url)
    assert code == 2
    assert "asks for a key: give it by ROBOMEND_KEY or --key" in err
    monkeypatch.setenv("ROBOMEND_KEY", f"{viewer[:-1]}!")
    code, _, err = say("status", "--url", guarded.url)
    assert code == 2
    assert "does not know this key" in err
    monkeypatch.setenv("ROBOMEND_KEY", viewer)
    assert say("status", "--url", guarded.url)[0] == 0


@pytest.mark.parametrize("arguments", [["stop"], ["observe", "r1", "ok(scan)"], ["approve", "r-1"]])
def test_a_viewer_is_told_that_its_role_may_not(arguments: list[str], guarded: Service, say: Say) -> None:
    code, _, err = say(*arguments, "--url", guarded.url, "--key", guarded.key("viewer"))
    assert code == 2
    assert "a key of role viewer may not" in err


def test_a_robot_s_key_is_for_its_robot_only(guarded: Service, say: Say) -> None:
    key = guarded.key("robot", "r1")
    assert say("observe", "r1", "ok(scan)", "--url", guarded.url, "--key", key)[0] == 0
    code, _, err = say("observe", "r2", "ok(scan)", "--url", guarded.url, "--key", key)
    assert code == 2
    assert "this key is for robot 'r1' only" in err


def test_a_file_that_is_not_there_never_reaches_a_service(tmp_path: Path) -> None:
    assert run(["robot", "put", "r1", str(tmp_path / "robot.yaml"), "--url", NOBODY]) == 2
