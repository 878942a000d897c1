"""A batch on its way into OBS: how far one POST reaches from room to room."""

from __future__ import annotations

import sys
from pathlib import Path
from types import CodeType, FrameType

import pytest
from tests.repairs.robot import MODEL, service

from robomend.robots.batches import Batch

pytestmark = pytest.mark.anyio


async def test_a_batch_crosses_from_the_robots_to_their_diagnosing_once(tmp_path: Path) -> None:
    crossings: set[tuple[CodeType, CodeType]] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        before = frame.f_back
        if event == "call" and before is not None:
            crossings.add((before.f_code, frame.f_code))

    async with service(tmp_path) as runtime:
        robots = runtime.robots
        await robots.models.put("small", MODEL, format=None, expected=None, by="test")
        await robots.put_robot("r1", {"model": "small", "policy": "observe"}, expected=None, by="test")
        sys.setprofile(note)
        try:
            taken = await robots.observe("r1", Batch(["not ok(scan)"]))
        finally:
            sys.setprofile(None)
        assert taken.changed == ["not ok(scan)"]
    between = {
        (one.co_name, other.co_name)
        for one, other in crossings
        if one.co_filename.endswith("robots/robots.py") and other.co_filename.endswith("robots/diagnosing.py")
    }
    assert between == {("_keep", "write")}
