"""docs/demo.md against the command and what it prints; what the command refuses."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import click
import pytest
from tests.robomend_demo.records import restarted

from robomend_demo.cast import GENERAL_OBSERVERS
from robomend_demo.command import ALL, chosen, command
from robomend_demo.figures import figures
from robomend_demo.report import scenario_json
from robomend_demo.scenarios import POWER_UP, SCENARIOS

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "demo.md").read_text(encoding="utf-8")


def test_every_option_is_described() -> None:
    for parameter in command.params:
        for option in (*parameter.opts, *parameter.secondary_opts):
            assert option in PAGE


def test_every_key_of_demo_json_is_described() -> None:
    told = scenario_json(restarted(), figures(restarted(), from_plan=False))
    keys = {*told, *told["figures"], *told["figures"]["observation_to_diagnosis_ms"]}
    assert [key for key in keys if f'"{key}"' not in PAGE] == []
    assert ", ".join(GENERAL_OBSERVERS) in PAGE


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_pictures_are_those_of_the_demo(name: str) -> None:
    assert f"]({name}.svg)" in PAGE
    text = "".join(ET.parse(DOCS / f"{name}.svg").getroot().itertext())
    assert "All good and verified" in text


def test_the_page_names_every_scenario() -> None:
    assert [name for name in SCENARIOS if f"`{name}`" not in PAGE] == []


def test_what_the_papers_domain_cannot_repair_is_refused_by_name() -> None:
    assert chosen(("power-up",), paper=True) == (POWER_UP,)
    with pytest.raises(click.UsageError, match="cannot repair hung-device and dead-lidar"):
        chosen((ALL,), paper=True)
