"""Secrets are cut out of whatever is logged."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator

import pytest
import structlog

from robomend.logs import configure
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
