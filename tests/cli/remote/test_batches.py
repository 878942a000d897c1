"""`robomend batches` on a real service: logs handed in, their results fetched, one of them cancelled."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from tests.api.conftest import TEDUSAR, Service, StartService, start
from tests.cli.remote.conftest import Say, Shared, Told, answer, narrow
from tests.waiting import until

from robomend.cli.commands import run

SECOND = 1_000_000_000

__all__ = ["start"]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log with a fault."""
    file = tmp_path / "night.ndjson"
    said = enumerate(("ok(scan)", "not ok(scan)", "ok(scan)"), 1)
    file.write_text(
        "".join(json.dumps({"time": at * SECOND, "literal": literal}) + "\n" for at, literal in said)
    )
    return file


@pytest.fixture
def idle(start: StartService, log: Path, monkeypatch: pytest.MonkeyPatch) -> Service:
    """A service with a folder of logs that carries out no batch."""
    service = start(batch_folder=log.parent)
    service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    service.run(service.runtime.batches.close())
    monkeypatch.setenv("ROBOMEND_URL", service.url)
    monkeypatch.setenv("COLUMNS", "80")
    return service


@pytest.fixture
def ask(say: Say) -> Say:
    """As `say`, without what the service, which is of this process, logs to stderr."""

    def command(*arguments: str) -> Told:
        code, out, err = say(*arguments)
        return code, out, re.sub(r"^\d{4}-\d\d-\d\d .*\n", "", err, flags=re.MULTILINE)

    return command


def test_logs_are_handed_in_looked_after_and_their_report_is_fetched(
    say: Say, robot: str, log: Path, tmp_path: Path
) -> None:
    given = ("--model", "tedusar", "--minimal", "cardinality", "--wait")
    code, out, err = say("batches", "post", str(log), *given)
    assert code == 0, err
    batch = err.split()[-1]
    assert out.startswith(f"batch {batch}: done, 1 of 1 file done\n  logs: 1 ok; 1 with faults\n")
    assert say("batches", "get", batch)[1] == out
    assert narrow(out)
    options = answer(say("batches", "get", batch, "--format", "json"))["options"]
    assert (options["minimal"], options["limit"]) == ("cardinality", 100)

    code, listed, _ = say("batches", "list")
    assert code == 0
    assert narrow(listed)
    assert batch in listed

    report = tmp_path / "report.html"
    assert say("batches", "result", batch, "--format", "report", "-o", str(report)) == (0, "", "")
    assert b"hokuyo_node" in report.read_bytes()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["night.ndjson", "report.html"]
    code, _, err = say("batches", "cancel", batch)
    assert code == 1
    assert err.startswith("too late: ")


def test_a_result_goes_to_stdout_as_the_service_has_it(
    shared: Shared, robot: str, log: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    with log.open("rb") as file:
        batch = shared.client.upload_batch([("night.ndjson", file)], model="tedusar")["id"]
    until(lambda: shared.client.batch(batch)["state"] == "done", "the batch is done", 90)
    assert run(["batches", "result", batch]) == 0
    lines = [json.loads(line) for line in capfdbinary.readouterr().out.splitlines()]
    assert [one["state"] for one in lines] == ["healthy", "faulty", "healthy"]


def test_a_batch_that_has_not_ended_has_no_results_and_can_be_cancelled(ask: Say, idle: Service) -> None:
    """Its logs are named below the service's folder, its model comes as a file."""
    code, out, err = ask("batches", "post", "*.ndjson", "--below", "-m", "tedusar", "--format", "json")
    assert code == 0, err
    waiting = json.loads(out)
    assert (waiting["state"], waiting["uploaded"], waiting["logs"]) == ("waiting", False, 1)
    code, out, err = ask("batches", "result", waiting["id"])
    assert (code, out) == (1, "")
    assert err.startswith(f"too early: batch {waiting['id']} is waiting")
    code, out, _ = ask("batches", "cancel", waiting["id"], "--reason", "enough")
    assert (code, out) == (0, f"batch {waiting['id']}: cancelled, 0 of 1 file done\n")
    told = idle.api("GET", "/audit", params={"action": "batch.cancel"}).json()["items"]
    assert [one["reason"] for one in told] == ["enough"]


def test_a_model_may_be_a_file_and_what_is_not_there_is_named(
    say: Say, ask: Say, idle: Service, log: Path, tmp_path: Path
) -> None:
    model = tmp_path / "robot.yaml"
    model.write_text(TEDUSAR)
    observers = tmp_path / "agent.yaml"
    observers.write_text("topics: {scan: {rate_hz: 10}}\n")
    more = ("--observers", str(observers), "--timeout", "2.5", "--format", "json")
    made = answer(ask("batches", "post", str(log), "-m", str(model), *more))
    assert (made["uploaded"], made["options"]["timeout_s"]) == (True, 2.5)

    for arguments, said in (
        (("post", str(log), "-m", "robto.yaml"), "--model robto.yaml: there is no such file"),
        (("post", str(log), "-m", "tedusra"), "tedusra"),
        (("post", "nowhere.bag", "-m", "tedusar"), "nowhere.bag cannot be read: No such file"),
        (("get", "b-0000000000"), "b-0000000000"),
    ):
        code, out, err = say("batches", *arguments)  # a log line of the service may stand before it
        assert (code, out) == (2, "")
        assert said in err
