"""A client that is generated from our OpenAPI document speaks with the service, with types and all."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.api.conftest import TEDUSAR, Service

PACKAGE = "generated_robomend"


@pytest.fixture
def generated(service: Service, tmp_path: Path) -> Iterator[str]:
    """The name of a package that was generated from the service's own document."""
    (tmp_path / "openapi.json").write_text(service.http.get("/openapi.json").text)
    (tmp_path / "config.json").write_text(json.dumps({"post_hooks": []}))  # they would only format
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "openapi_python_client",
            "generate",
            *("--path", "openapi.json", "--config", "config.json"),
            *("--meta", "none", "--output-path", PACKAGE),
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    told = re.findall(r"^WARNING.*\n+(.+)", done.stdout, re.MULTILINE)
    # A generator of JSON clients leaves our other content types out; everything else it must understand.
    assert all(line.startswith("Unsupported content type") for line in told), done.stdout
    sys.path.insert(0, str(tmp_path))
    try:
        yield PACKAGE
    finally:
        sys.path.remove(str(tmp_path))
        for name in [name for name in sys.modules if name.split(".")[0] == PACKAGE]:
            del sys.modules[name]


def test_every_operation_has_a_short_name_of_its_own(service: Service) -> None:
    paths = service.http.get("/openapi.json").json()["paths"]
    names = [operation["operationId"] for operations in paths.values() for operation in operations.values()]
    assert len(names) == len(set(names))
    assert not any("api_v1" in name for name in names)


def test_a_generated_client_goes_from_model_to_diagnosis(service: Service, generated: str) -> None:
    def part(name: str) -> Any:
        return importlib.import_module(f"{generated}.{name}")

    models = part("models")
    with part("client").Client(base_url=service.url) as client:
        made = part("api.models.put_model").sync(
            "tedusar", client=client, body=models.PutModelJsonModelBody(source=TEDUSAR)
        )
        assert (made.name, made.number) == ("tedusar", 1)
        robot = part("api.robots.put_robot").sync(
            "r1", client=client, body=models.RobotBody(model="tedusar", policy=models.RobotBodyPolicy.OBSERVE)
        )
        assert robot.id == "r1"
        accepted = part("api.observations.post_observations").sync(
            "r1",
            client=client,
            body=models.PostObservationsJsonObservationsBody(observations=["not on(jaguar)"]),
            idempotency_key="once",
        )
        assert accepted.revision == 1
        found = part("api.diagnosis.get_diagnosis").sync("r1", client=client, wait_s=10.0)
        assert [one.bad for one in found.result.diagnoses] == [["jaguar"]]
        missing = part("api.robots.get_robot").sync_detailed("nobody", client=client)
    assert (missing.status_code, missing.parsed.code) == (404, "not-found")
