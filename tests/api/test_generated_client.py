"""A client that is generated from our OpenAPI document speaks with the service, with types and all."""

from __future__ import annotations

import importlib
import json
import pkgutil
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.api.conftest import TEDUSAR, Service

PACKAGE = "generated_robomend"


@pytest.fixture(scope="module")
def generated(service: Service, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The name of a package that was generated from the service's own document."""
    folder = tmp_path_factory.mktemp("generated")
    (folder / "openapi.json").write_text(service.http.get("/openapi.json").text)
    (folder / "config.json").write_text(json.dumps({"post_hooks": []}))  # they would only format
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "openapi_python_client",
            "generate",
            *("--path", "openapi.json", "--config", "config.json"),
            *("--meta", "none", "--output-path", PACKAGE),
        ],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    told = re.findall(r"^WARNING.*\n+(.+)", done.stdout, re.MULTILINE)
    # A generator of JSON clients leaves our other content types out; everything else it must understand.
    assert all(line.startswith("Unsupported content type") for line in told), done.stdout
    sys.path.insert(0, str(folder))
    try:
        yield PACKAGE
    finally:
        sys.path.remove(str(folder))
        for name in [name for name in sys.modules if name.split(".")[0] == PACKAGE]:
            del sys.modules[name]


def test_every_module_of_a_generated_client_can_be_imported(generated: str) -> None:
    package = importlib.import_module(generated)
    names = [found.name for found in pkgutil.walk_packages(package.__path__, f"{generated}.")]
    assert f"{generated}.api.batches.create_batch" in names
    for name in names:
        importlib.import_module(name)


CALLS = """
import createClient from "openapi-fetch";
import type { paths } from "./api";

const client = createClient<paths>({ baseUrl: "http://127.0.0.1:8600" });

export async function calls(): Promise<string> {
  const path = { robot: "r1" };
  await client.PUT("/api/v1/robots/{robot}", { params: { path }, body: { model: "tedusar" } });
  await client.POST("/api/v1/robots/{robot}/observations", {
    params: { path },
    body: { observations: ["not on(jaguar)"] },
  });
  await client.POST("/api/v1/batches", { body: { model: "tedusar", logs: ["night/*.bag"] } });
  const { data, error } = await client.GET("/api/v1/robots/{robot}/diagnosis", { params: { path } });
  return error ? error.code : (data.result?.diagnoses ?? []).map((one) => one.bad.join(" ")).join("; ");
}
"""

PACKAGES = ("openapi-typescript@7.13.0", "openapi-fetch@0.17.0", "typescript@5.9.3")


@pytest.fixture(scope="module")
def typescript(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the generator and the compiler."""
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("npm is not installed: TypeScript is neither generated nor compiled")
    folder = tmp_path_factory.mktemp("typescript")
    asked = [npm, "install", "--no-audit", "--no-fund", "--prefer-offline", *PACKAGES]
    done = subprocess.run(asked, cwd=folder, capture_output=True, text=True, timeout=240)
    if done.returncode:
        pytest.skip(f"npm cannot install the generator here: {done.stderr[-200:]}")
    return folder


@pytest.mark.long
def test_a_client_in_typescript_is_generated_and_compiles(service: Service, typescript: Path) -> None:
    (typescript / "openapi.json").write_text(service.http.get("/openapi.json").text)
    (typescript / "calls.ts").write_text(CALLS)
    tools = typescript / "node_modules" / ".bin"
    checked = ("--target", "es2022", "--module", "nodenext", "api.d.ts", "calls.ts")
    for line in (
        ["openapi-typescript", "openapi.json", "-o", "api.d.ts"],
        ["tsc", "--strict", "--noEmit", "--skipDefaultLibCheck", *checked],
    ):
        asked = [str(tools / line[0]), *line[1:]]
        done = subprocess.run(asked, cwd=typescript, capture_output=True, text=True, timeout=240)
        assert done.returncode == 0, done.stdout + done.stderr


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
        found = part("api.diagnosis.get_diagnosis").sync("r1", client=client, after=0, wait_s=60.0)
        assert [one.bad for one in found.result.diagnoses] == [["jaguar"]]
        missing = part("api.robots.get_robot").sync_detailed("nobody", client=client)
    assert (missing.status_code, missing.parsed.code) == (404, "not-found")
