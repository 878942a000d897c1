"""How often the audit log is told who reports."""

from __future__ import annotations

import time

import pytest

from robomend.entry import Entry
from robomend.robots.batches import Update
from robomend.robots.reporters import AGAIN_S, OTHERS_AGAIN_S, Reporter, Reports
from robomend_client.literals import Atom, Literal

LASER = Update([Entry(Literal(Atom("ok", ("scan",)), True), "laser", 1)])
CAMERA = Update([Entry(Literal(Atom("ok", ("scan",)), True), "camera", 1)])


@pytest.mark.parametrize(("own", "again_s"), [(True, AGAIN_S), (False, OTHERS_AGAIN_S)])
def test_a_key_is_told_again_after_a_while(
    monkeypatch: pytest.MonkeyPatch, own: bool, again_s: float
) -> None:
    now = 1000.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    reports, key = Reports(), Reporter("key", own)
    assert reports.due("r1", key, LASER)
    assert reports.due("r1", key, LASER)  # not written yet
    reports.noted("r1", key, LASER)
    assert not reports.due("r1", key, LASER)
    assert reports.due("r2", key, LASER)
    assert reports.due("r1", key, CAMERA)
    assert reports.due("r1", Reporter("another", own), LASER)
    now += again_s
    assert reports.due("r1", key, LASER)
