"""docs/repair.md, followed: an executor of one's own is added by the listed places, and used over HTTP."""

from __future__ import annotations

import json
import re
import textwrap
import tomllib
from pathlib import Path

import pytest
from tests.distributions import install
from tests.repairs.remote import ended, latest, remote_robot, services
from tests.waiting import eventually

pytestmark = pytest.mark.anyio

PAGE = (Path(__file__).parents[2] / "docs" / "repair.md").read_text(encoding="utf-8")
RECIPE = PAGE.partition("### An executor of your own\n")[2].partition("\n## ")[0]


def block(language: str) -> str:
    """Return the recipe's code of a language."""
    [found] = re.findall(rf"^ *```{language}\n(.*?)^ *```$", RECIPE, re.DOTALL | re.MULTILINE)
    return textwrap.dedent(found)


async def test_an_executor_that_is_added_as_the_page_says_repairs_a_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    [(group, points)] = tomllib.loads(block("toml"))["project"]["entry-points"].items()
    [(kind, value)] = points.items()
    module, _, attribute = value.partition(":")
    installed = install(tmp_path / "site", module, block("python"), {group: {kind: attribute}})
    monkeypatch.setenv("PYTHONPATH", str(installed))
    line = tmp_path / "line"
    shown = json.loads(block("json"))
    [executor] = [action["executor"] for action in shown["actions"].values()]
    assert executor["kind"] == kind
    executor["options"] = {name: str(line) for name in executor["options"]}

    async with (
        services(("--data", str(tmp_path / "data"))) as running,
        remote_robot(running, actions=shown["actions"]) as robot,
    ):
        robot.running["mapping"] = False
        await eventually(lambda: line.exists() and line.read_text() == "1", "it was pulsed")
        robot.running["mapping"] = True
        repair = await latest(running, ended)
    assert repair["state"] == "repaired", repair["reason"]
    [step] = repair["plan"]
    assert (step["text"], step["message"]) == ("start_node(mapping)", "pulsed for start_node(mapping)")
    assert robot.done == []  # the agent was not asked
