"""Secrets are cut out of whatever is logged."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterator
from contextvars import copy_context

import pytest
import structlog

from robomend.logs import MOST_A_SECOND, PRINCIPAL, REQUEST, configure
from robomend.security import new_key


@pytest.fixture(autouse=True)
def _restored() -> Iterator[None]:
    root = logging.getLogger()
    handlers, level = root.handlers, root.level
    yield
    root.handlers, root.level = handlers, level
    structlog.reset_defaults()


def test_keys_and_passwords_never_reach_a_log(capsys: pytest.CaptureFixture[str]) -> None:
    configure("info", "json")
    key = new_key()
    structlog.get_logger().info("seen", header=f"Bearer {key}", url="postgresql://u:secret@h/d")
    logging.getLogger("elsewhere").error("failed with %s", key)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert json.loads(lines[0])["url"] == "postgresql://u:***@h/d"
    assert key not in "".join(lines)
    assert "secret" not in "".join(lines)


def test_a_level_leaves_out_what_is_below(capsys: pytest.CaptureFixture[str]) -> None:
    configure("warning", "text")
    structlog.get_logger().info("quiet")
    structlog.get_logger().warning("loud")
    shown = capsys.readouterr().err
    assert "loud" in shown
    assert "quiet" not in shown


def test_an_entry_names_the_request_and_the_principal_that_it_is_about(
    capsys: pytest.CaptureFixture[str],
) -> None:
    configure("info", "json")
    log = structlog.get_logger()

    def answer() -> None:
        REQUEST.set("7f-1")
        log.info("nobody yet")
        PRINCIPAL.set("anna")
        log.info("somebody")
        log.info("somebody else", principal="bob", request="7f-2")
        logging.getLogger("elsewhere").error("another library's")

    copy_context().run(answer)
    log.info("outside")
    told = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [(one.get("request"), one.get("principal")) for one in told] == [
        ("7f-1", None),
        ("7f-1", "anna"),
        ("7f-2", "bob"),
        ("7f-1", "anna"),
        (None, None),
    ]


def test_of_a_crowd_of_entries_a_few_are_written_and_the_rest_is_told_by_number(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [7.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    configure("info", "json")
    log = structlog.get_logger()
    for _ in range(500):
        log.info("request", status=401, principal=None)
    log.info("request", status=403, principal="anna")  # of another kind: it does not go under
    log.error("unforeseen")
    now[0] = 8.0
    log.info("request", status=401, principal=None)
    log.info("request", status=401, principal=None)
    told = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [entry.get("status") for entry in told] == [401] * MOST_A_SECOND + [403, None, 401, 401]
    assert [entry.get("left_out", 0) for entry in told[-2:]] == [500 - MOST_A_SECOND, 0]


def test_what_was_asked_for_is_written_however_much_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    configure("debug", "json")
    for _ in range(5 * MOST_A_SECOND):
        structlog.get_logger().debug("request", status=200)
    assert len(capsys.readouterr().err.splitlines()) == 5 * MOST_A_SECOND
