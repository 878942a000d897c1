"""One name, one thing: no class of the service or of the client has the name of another."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "robomend": ROOT / "service" / "robomend",
    "robomend_client": ROOT / "clients" / "robomend_client",
}

BRIDGES = "robomend_client.bridges"
JSON = "robomend_client.rest.types"
ERRORS = "robomend_client.rest.errors"
SHARED = {
    # what the client reads is the JSON of what the service's class holds
    "Accepted": {JSON, "robomend.api.schemas.observations"},
    "CurrentDiagnosis": {JSON, "robomend.api.schemas.diagnosis"},
    "Diagnosis": {JSON, "robomend.diagnosis.result"},
    "FirstResult": {JSON, "robomend.api.schemas.repair"},
    "Ingested": {JSON, "robomend.api.schemas.observations"},
    "Obs": {JSON, "robomend.observations.obs"},
    "ObservedLiteral": {JSON, "robomend.api.schemas.observations"},
    "Page": {JSON, "robomend.store.records"},
    "Probe": {JSON, "robomend.diagnosis.probes"},
    "RefusedSentence": {JSON, "robomend.api.schemas.observations"},
    "Stop": {JSON, "robomend.store.records"},
    # each bridge has its own, for the same
    "Liveness": {f"{BRIDGES}.{over}" for over in ("ros1.liveness", "ros2.liveness", "zenoh.node")},
    "MessageReaders": {f"{BRIDGES}.ros1.messages", f"{BRIDGES}.ros2.messages"},
    # what the client raises is the answer that the service's error became
    "NotFound": {ERRORS, "robomend.errors"},
    "PreconditionFailed": {ERRORS, "robomend.errors"},
    "PreconditionRequired": {ERRORS, "robomend.errors"},
    "StateConflict": {ERRORS, "robomend.errors"},
}
"""A name -> the modules that mean the same by it, as the comments say."""


def classes() -> dict[str, set[str]]:
    """Return each class's name -> the modules that define one so named."""
    found: dict[str, set[str]] = defaultdict(set)
    for package, folder in PACKAGES.items():
        for file in folder.rglob("*.py"):
            module = ".".join((package, *file.relative_to(folder).with_suffix("").parts))
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef):
                    found[node.name].add(module)
    return found


def test_a_name_that_two_classes_have_means_one_thing() -> None:
    twice = {name: modules for name, modules in classes().items() if len(modules) > 1}
    assert twice == SHARED
