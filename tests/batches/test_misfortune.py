"""Service, program or client end in the middle; the disk is full; several processes have one folder."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.api.conftest import TEDUSAR, Service, StartService
from tests.api.test_process import alive, command, served
from tests.batches.conftest import ENDS, SCAN, ended, form, left
from tests.robomend_batch.running import batch_run
from tests.robomend_batch.test_kill import many_logs
from tests.waiting import until

from robomend.batches import one_batch


def processes(batch: str) -> list[int]:
    """Return the processes of a batch: whose command line names its folder, and their groups."""
    mine = []
    groups: dict[int, list[int]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            pid = int(folder.name)
            groups.setdefault(os.getpgid(pid), []).append(pid)
            if batch.encode() in (folder / "cmdline").read_bytes():
                mine.append(pid)
    return [pid for leader in mine for pid in groups.get(leader, ()) if alive(pid)]


def running(batch: str) -> list[int]:
    """Wait until the program of a batch runs, and return its processes."""
    found: list[int] = []

    def runs() -> bool:
        found[:] = processes(batch)
        return bool(found)

    until(runs, "its program runs", 60)
    return found


def uploads(folder: Path) -> dict[str, Any]:
    return form(*((log.name, log.read_bytes()) for log in sorted(folder.iterdir())), minimal="cardinality")


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs that take some seconds together."""
    return many_logs(tmp_path_factory.mktemp("many") / "logs", 4000)


def one_long(many: Path) -> str:
    """Return a log as long as `batching` takes one."""
    return "".join(log.read_text() for log in sorted(many.iterdir()))[: 900 << 10]


def test_a_service_that_is_killed_goes_on_where_it_was(
    many: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOMEND_BATCH_NICE", "0")
    data = tmp_path / "data"
    data.mkdir()
    with (
        served(data) as (process, url),
        httpx.Client(base_url=f"{url}/api/v1", timeout=60) as http,
    ):
        http.put("/models/tedusar", json={"source": TEDUSAR})
        batch = http.post("/batches", **uploads(many)).json()["id"]
        parts = data / "batches" / batch / "out" / "results"
        until(lambda: len(list(parts.glob("*.parquet"))) >= 2, "the first logs are done", 90)
        was = processes(batch)
        os.kill(process.pid, signal.SIGKILL)
        process.wait(60)
        until(lambda: not any(map(alive, was)), "its program ends with it")
        assert was
    with (
        served(data) as (process, url),
        httpx.Client(base_url=f"{url}/api/v1", timeout=60) as http,
    ):
        until(lambda: http.get(f"/batches/{batch}").json()["state"] in ENDS, "it is finished", 90)
        assert http.get(f"/batches/{batch}").json()["state"] == "done"
        found = http.get(f"/batches/{batch}/result").text
    model = tmp_path / "model.yaml"
    model.write_text(TEDUSAR)
    assert batch_run(tmp_path / "out", many, "--minimal", "cardinality", model=model) == 0
    assert found == (tmp_path / "out" / "results.ndjson").read_text().replace(f"{many}/", "")


def test_a_program_that_is_killed_is_started_again_and_given_up_in_the_end(
    batching: Service, many: Path
) -> None:
    batch = batching.api("POST", "/batches", **form(("a.ndjson", one_long(many)))).json()["id"]
    killed: set[int] = set()

    def over() -> bool:
        for pid in set(processes(batch)) - killed:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
                killed.add(pid)
        return batching.api("GET", f"/batches/{batch}").json()["state"] in ENDS

    until(over, "it is given up", 90)
    found = batching.api("GET", f"/batches/{batch}").json()
    assert found["state"] == "failed"
    assert "killed 3 times, by signal 9" in found["message"]
    assert len(killed) >= 3


def test_cancelling_ends_its_processes(batching: Service, many: Path) -> None:
    batch = batching.api("POST", "/batches", **form(("a.ndjson", one_long(many)))).json()["id"]
    was = running(batch)
    assert batching.api("DELETE", f"/batches/{batch}").json()["state"] == "cancelled"
    until(lambda: not any(map(alive, was)), "its program ends")
    assert not processes(batch)
    assert not (batching.runtime.settings.data / "batches" / batch / "logs").exists()


def test_a_batch_that_runs_longer_than_it_may_has_failed_and_says_so(start: StartService, many: Path) -> None:
    service = start(batch_hours=1e-6, batch_nice=0)  # a few milliseconds: less than any program takes
    service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    batch = service.api("POST", "/batches", **uploads(many)).json()["id"]
    found = ended(service, batch)
    assert (found["state"], found["done"]) == ("failed", 0)
    assert "it ran longer than 1e-06 hours (batch_hours)" in found["message"]
    until(lambda: not processes(batch), "its program ends")
    assert service.api("GET", f"/batches/{batch}/result").status_code == 404
    until(lambda: not (service.runtime.settings.data / "batches" / batch / "logs").exists(), "uploads go")


def test_a_batch_that_runs_longer_than_its_size_needs_has_failed(
    start: StartService, many: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(one_batch, "LEAST_S", 0.01)
    monkeypatch.setattr(one_batch, "SECONDS_A_MB", 0.0)
    service = start(batch_nice=0)
    service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    found = ended(service, service.api("POST", "/batches", **uploads(many)).json()["id"])
    assert found["state"] == "failed"
    assert "MB never take" in found["message"]


def test_a_batch_that_takes_long_holds_up_no_other_and_gets_on(
    start: StartService, many: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(one_batch, "FIRST_TURN_S", 0.1)
    monkeypatch.setattr(one_batch, "TELL_S", 0.1)
    service = start(batch_nice=0)
    service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    long = service.api("POST", "/batches", **uploads(many)).json()["id"]
    running(long)
    short = service.api("POST", "/batches", **form(("a.ndjson", SCAN))).json()["id"]
    assert ended(service, short)["state"] == "done"
    entries = service.api("GET", "/audit").json()["items"]
    assert [one["action"] for one in entries if one["subject"] == long].count("batch.interrupted") >= 1
    assert ended(service, long)["state"] == "done"
    model = tmp_path / "model.yaml"
    model.write_text(TEDUSAR)
    assert batch_run(tmp_path / "out", many, "--minimal", "cardinality", model=model) == 0
    found = service.api("GET", f"/batches/{long}/result").text
    assert found == (tmp_path / "out" / "results.ndjson").read_text().replace(f"{many}/", "")


def test_an_upload_that_is_cut_off_leaves_nothing(batching: Service) -> None:
    before = left(batching)
    address = httpx.URL(batching.url)
    with socket.create_connection((address.host, address.port or 80)) as line:
        part = b'--x\r\nContent-Disposition: form-data; name="logs"; filename="a.ndjson"\r\n\r\nabc'
        head = "POST /api/v1/batches HTTP/1.1\r\nHost: localhost\r\nContent-Length: 500000\r\n"
        line.sendall(head.encode() + b"Content-Type: multipart/form-data; boundary=x\r\n\r\n" + part)
        until(lambda: left(batching) != before, "it comes in")
    until(lambda: left(batching) == before, "nothing of it is left")


def test_a_full_disk_is_said_and_leaves_nothing(tmp_path: Path) -> None:
    # No file of this service may be larger than 3 MiB: what a full disk says, without one.
    serve = command("serve", "--port", "0", "--announce", "--data", str(tmp_path))
    limited = ["bash", "-c", 'ulimit -f 3072; exec "$@"', "bash", *serve]
    with subprocess.Popen(limited, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            url = json.loads(process.stdout.readline())["url"]
            with httpx.Client(base_url=f"{url}/api/v1", timeout=60) as http:
                http.put("/models/tedusar", json={"source": TEDUSAR})
                # So much that all of it is read before the disk refuses the last of it: a service that
                # answers earlier closes the connection, and the client may see that only.
                answer = http.post("/batches", **form(("a.ndjson", "x" * ((3 << 20) + 100_000))))
                assert (answer.status_code, answer.json()["code"]) == (507, "store-full")
                assert not [path for path in (tmp_path / "batches").iterdir() if path.is_dir()]
                assert http.post("/batches", **form(("a.ndjson", SCAN))).status_code == 202
        finally:
            process.kill()


def test_processes_of_one_service_carry_out_each_batch_once(start: StartService, many: Path) -> None:
    first, second = start(batch_nice=0), start(batch_nice=0)
    first.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    made = [first.api("POST", "/batches", **form(("a.ndjson", SCAN))).json()["id"] for _ in range(2)]
    slow = second.api("POST", "/batches", **uploads(many)).json()["id"]
    for batch in made:
        assert ended(second, batch)["state"] == "done"
        said = (first.runtime.settings.data / "batches" / batch / "said.txt").read_text()
        assert said.count("1 log") == 1
    was = running(slow)
    assert first.api("DELETE", f"/batches/{slow}").json()["state"] == "cancelled"
    until(lambda: not any(map(alive, was)), "whoever carries it out ends it")


def test_an_instance_with_another_folder_says_where_a_batch_is(start: StartService, tmp_path: Path) -> None:
    database = f"sqlite:///{tmp_path / 'shared.db'}"
    first, second = (start(database=database, data=tmp_path / name, batch_nice=0) for name in ("one", "two"))
    first.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    batch = first.api("POST", "/batches", **form(("a.ndjson", SCAN))).json()["id"]
    assert ended(second, batch)["state"] == "done"
    assert first.api("GET", f"/batches/{batch}/result").status_code == 200
    answer = second.api("GET", f"/batches/{batch}/result")
    assert answer.status_code == 409
    assert f"on {socket.gethostname()}" in answer.json()["detail"]
