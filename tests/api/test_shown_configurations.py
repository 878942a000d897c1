"""docs/repair.md: every configuration of a robot on the page is one that the service takes."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from robomend.api.schemas.robots import RobotBody

PAGE = (Path(__file__).parents[2] / "docs" / "repair.md").read_text()
BLOCKS: list[dict[str, Any]] = [json.loads(text) for text in re.findall(r"```json\n(.*?)```", PAGE, re.S)]
CONFIGURATIONS = [block for block in BLOCKS if "actions" in block]


@pytest.mark.parametrize("shown", CONFIGURATIONS, ids=lambda shown: "-".join(shown))
def test_a_configuration_on_the_page_is_taken_and_kept(shown: dict[str, Any]) -> None:
    kept = RobotBody.model_validate({"model": "m", **shown}).model_dump()
    for name, action in shown["actions"].items():
        assert {
            key: value for key, value in kept["actions"][name].items() if key in action
        }.keys() == action.keys()
    assert kept.keys() >= shown.keys()


def test_the_page_shows_some() -> None:
    assert len(CONFIGURATIONS) == 4
    assert any(action.get("idempotent") for one in CONFIGURATIONS for action in one["actions"].values())
