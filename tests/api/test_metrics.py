"""Dashboard, alerts and docs name metrics that the service has."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import yaml
from prometheus_client.parser import text_string_to_metric_families
from tests.api.conftest import StartService

from robomend.board.link import LinkState
from robomend.repairs.states import ChangeState, RepairState
from robomend.robots.health import HealthState

DOCS = Path(__file__).resolve().parents[2] / "docs"
STATES = {
    "robomend_robots_health": HealthState,
    "robomend_repair_changes_total": RepairState,
    "robomend_configuration_changes_total": ChangeState,
    "robomend_board_link": LinkState,
}
SELECTED = re.compile(r"(robomend_[a-z_]+)(?:\{([^}]*)\})?")
LABEL = re.compile(r'(\w+)\s*(?:=~|!=|=)\s*"([^"]*)"')


def dashboard() -> dict[str, Any]:
    found: dict[str, Any] = json.loads((DOCS / "deploy" / "grafana.json").read_text(encoding="utf-8"))
    return found


def expressions() -> list[str]:
    panels = [target["expr"] for panel in dashboard()["panels"] for target in panel.get("targets", ())]
    groups = yaml.safe_load((DOCS / "deploy" / "alerts.yaml").read_text(encoding="utf-8"))["groups"]
    return panels + [rule["expr"] for group in groups for rule in group["rules"]]


def documented() -> dict[str, tuple[str, set[str]]]:
    """Return kind and labels of each metric of the table."""
    rows = re.findall(
        r"^\| `(robomend_\w+)` \| (\w+) \|(.*?)\| .+ \|$", (DOCS / "metrics.md").read_text(), re.MULTILINE
    )
    return {name: (kind, set(re.findall(r"`(\w+)`", labels))) for name, kind, labels in rows}


def exposed(text: str) -> dict[str, str]:
    """Return the kind of each metric, as it is asked for in Prometheus."""
    return {
        family.name + "_total" * (family.type == "counter"): family.type
        for family in text_string_to_metric_families(text)
        if not family.name.endswith("_created")
    }


def test_the_table_of_metrics_is_what_the_service_says(start: StartService) -> None:
    service = start()
    service.with_robot("r1")
    service.observe("not ok(scan)")
    service.diagnosis(after=0, wait_s=60)
    text, known = service.http.get("/metrics").text, documented()
    assert exposed(text) == {name: kind for name, (kind, _) in known.items()}
    labelled = {
        (family.name + "_total" * (family.type == "counter"), frozenset(sample.labels.keys() - {"le"}))
        for family in text_string_to_metric_families(text)
        for sample in family.samples
        if not sample.name.endswith("_created")
    }
    assert {(name, labels) for name, labels in labelled if labels != known[name][1]} == set()
    assert len([labels for _, labels in labelled if labels]) > 5


def test_dashboard_and_alerts_ask_for_metrics_labels_and_states_that_exist() -> None:
    known = documented()
    for expression in expressions():
        for name, selector in SELECTED.findall(expression):
            family = re.sub("_bucket$", "", name)
            assert family in known, expression
            for label, value in LABEL.findall(selector or ""):
                assert label in known[family][1] | {"job"}, expression
                if label == "state":
                    assert set(value.split("|")) <= set(STATES[family]), expression
        grouped = re.findall(r"\bby \(([^)]*)\)", expression)
        labels = {label.strip() for group in grouped for label in group.split(",")}
        names = [re.sub("_bucket$", "", name) for name, _ in SELECTED.findall(expression)]
        assert labels <= {"le", "job", "instance"}.union(*(known[name][1] for name in names)), expression


def test_the_first_escalation_is_an_increase(start: StartService) -> None:
    assert 'robomend_repair_changes_total{state="escalated"} 0.0' in start().http.get("/metrics").text
