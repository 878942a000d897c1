"""Logs over HTTP: handed in or named, diagnosed, read; and what is refused."""

from __future__ import annotations

import gzip
import json
from io import BytesIO
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from tests.api.conftest import TEDUSAR, Service, StartService
from tests.batches.conftest import SCAN, ended, form, left
from tests.robomend_batch.running import batch_run
from tests.waiting import until


def lines(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def test_uploaded_logs_are_diagnosed_as_by_the_command(batching: Service, tmp_path: Path) -> None:
    made = batching.api("POST", "/batches", **form(("a.ndjson", SCAN), ("b.ndjson", ""), reason="night"))
    assert made.status_code == 202, made.text
    batch = made.json()["id"]
    assert made.headers["Location"].endswith(f"/batches/{batch}")
    found = ended(batching, batch)
    assert (found["state"], found["done"], found["logs"], found["faulty"]) == ("done", 2, 2, 1)
    assert found["log_states"] == {"ok": 1, "refused": 1}
    assert "b.ndjson" in found["message"]
    model = tmp_path / "model.yaml"
    model.write_text(TEDUSAR)
    (tmp_path / "a.ndjson").write_text(SCAN)
    assert batch_run(tmp_path / "out", tmp_path / "a.ndjson", model=model) == 0
    expected = lines((tmp_path / "out" / "results.ndjson").read_text().replace(f"{tmp_path}/", ""))
    read = f"/batches/{batch}/result"
    assert lines(batching.api("GET", read).text) == expected
    assert [one["log"] for one in lines(batching.api("GET", read, params={"format": "logs"}).text)] == [
        "a.ndjson",
        "b.ndjson",
    ]
    table = pl.read_parquet(BytesIO(batching.api("GET", read, params={"format": "parquet"}).content))
    assert table["state"].to_list() == [one["state"] for one in expected]
    report = batching.api("GET", read, params={"format": "report"})
    assert "a.ndjson" in report.text
    assert report.headers["Content-Security-Policy"].startswith("sandbox; default-src 'none'")
    folder = batching.runtime.settings.data / "batches" / batch
    until(lambda: not (folder / "logs").exists(), "what was read is removed")


def test_a_log_may_be_uploaded_compressed(batching: Service) -> None:
    made = batching.api("POST", "/batches", **form(("a.ndjson.gz", gzip.compress(SCAN.encode()))))
    assert made.status_code == 202, made.text
    found = ended(batching, made.json()["id"])
    assert (found["state"], found["log_states"], found["faulty"]) == ("done", {"ok": 1}, 1)


def test_logs_of_the_folder_are_named_by_pattern(batching: Service, logs: Path) -> None:
    asked = {
        "model": "tedusar",
        "logs": ["night/**/*.ndjson", "night", "in.ndjson"],
        "minimal": "cardinality",
    }
    made = batching.api("POST", "/batches", json=asked)
    assert made.status_code == 202, made.text
    assert made.json()["logs"] == 2
    found = ended(batching, made.json()["id"])
    assert (found["state"], found["done"]) == ("done", 2), found["message"]
    text = batching.api("GET", f"/batches/{found['id']}/result", params={"format": "logs"}).text
    assert [one["log"] for one in lines(text)] == ["in.ndjson", "night/b.csv"]  # the link's file is read once
    assert not (logs.parent / "outside" / "run").exists()  # nothing of the folder is imported


@pytest.mark.parametrize(
    ("named", "status"),
    [
        ("../outside/secret.ndjson", 403),
        ("/etc/passwd", 403),
        ("out.ndjson", 403),
        ("away/secret.ndjson", 403),
        ("*.ndjson", 403),  # the link is among them
        ("night/none.ndjson", 404),
        ("**/*.mcap", 404),
        ("a\0b", 422),
        ("**/a/**/b/**/c/**/*.csv", 422),
    ],
)
def test_what_is_not_below_the_folder_is_refused(batching: Service, named: str, status: int) -> None:
    before = left(batching)
    answer = batching.api("POST", "/batches", json={"model": "tedusar", "logs": [named]})
    assert answer.status_code == status, answer.text
    assert left(batching) == before


@pytest.mark.parametrize(
    ("given", "status"),
    [
        (form(("../a.ndjson", SCAN)), 403),
        (form(("C:\\a.ndjson", SCAN), ("a\\b.ndjson", SCAN)), 403),
        (form(("-o.ndjson", SCAN)), 422),
        (form(("größe∪.ndjson", SCAN)), 422),
        (form(("a.ndjson", SCAN), **{"größe∪": "3"}), 422),
        (form(("polars.py", SCAN)), 422),
        (form(("a.ndjson", SCAN), ("a.ndjson", SCAN)), 422),
        (form(("a.ndjson", "x" * (1 << 20))), 413),
        (form(("a.ndjson", SCAN), observers="x" * (600 << 10)), 413),
        (form(("a.ndjson", SCAN), model=""), 422),
        (form(("a.ndjson", SCAN), max="3"), 422),
        (form(("a.ndjson", SCAN), model="", source="nonsense: 1"), 422),
        ({"files": {"logs": (None, "a.ndjson"), "model": (None, "tedusar")}}, 422),
        (
            {"content": b"--x\r\nnonsense", "headers": {"Content-Type": "multipart/form-data; boundary=x"}},
            400,
        ),
        ({"content": b"x", "headers": {"Content-Type": "multipart/form-data"}}, 400),
        ({"content": b"x", "headers": {"Content-Type": "text/plain"}}, 415),
        ({"json": {"model": "tedusar", "logs": []}}, 422),
        ({"json": {"model": "tedusar", "logs": ["night"], "workers": 9}}, 422),
    ],
)
def test_what_is_wrong_with_a_request_leaves_nothing_behind(
    batching: Service, given: dict[str, Any], status: int
) -> None:
    before = left(batching)
    answer = batching.api("POST", "/batches", **given)
    assert answer.status_code == status, answer.text
    assert left(batching) == before


def test_observers_that_are_somebodys_code_are_not_run(batching: Service) -> None:
    observers = "observers:\n  x: {kind: 'evil.py:Run', source: a}\n"
    made = batching.api("POST", "/batches", **form(("a.ndjson", SCAN), observers=observers))
    found = ended(batching, made.json()["id"])
    assert found["state"] == "failed"
    assert "is not run here" in found["message"]
    assert "/" not in found["message"].replace("evil.py", ""), "it says where things are on this computer"
    answer = batching.api("GET", f"/batches/{found['id']}/result")
    assert (answer.status_code, answer.json()["code"]) == (404, "not-found")


def test_without_a_folder_logs_are_taken_by_upload_only(start: StartService) -> None:
    service = start()
    service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    answer = service.api("POST", "/batches", json={"model": "tedusar", "logs": ["a.ndjson"]})
    assert (answer.status_code, answer.json()["code"]) == (403, "refused")
    assert "batch_folder" in answer.json()["detail"]


def test_no_more_wait_than_the_settings_say_and_each_can_be_cancelled(start: StartService) -> None:
    service = start(batches_waiting=2)
    service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    service.run(service.runtime.batches.close())  # nobody carries them out
    made = [service.api("POST", "/batches", **form(("a.ndjson", SCAN))) for _ in range(3)]
    assert [answer.status_code for answer in made] == [202, 202, 503]
    batch = made[0].json()["id"]
    assert service.api("GET", f"/batches/{batch}/result").status_code == 409
    done = service.api("DELETE", f"/batches/{batch}", params={"reason": "enough"})
    assert (done.status_code, done.json()["state"]) == (200, "cancelled")
    assert service.api("DELETE", f"/batches/{batch}").status_code == 409
    assert service.api("POST", "/batches", **form(("a.ndjson", SCAN))).status_code == 202
    listed = service.api("GET", "/batches").json()["items"]
    assert [one["state"] for one in listed] == ["waiting", "waiting", "cancelled"]
    told = service.api("GET", "/audit", params={"action": "batch.cancel"}).json()["items"]
    assert [(one["actor"], one["subject"], one["reason"]) for one in told] == [("local", batch, "enough")]


def test_what_ended_is_kept_as_long_as_the_settings_say(start: StartService) -> None:
    service = start(batches_kept=1, batch_nice=0)
    service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    made = [service.api("POST", "/batches", **form(("a.ndjson", SCAN))).json()["id"] for _ in range(2)]
    for batch in made:
        ended(service, batch)
    stray = service.runtime.settings.data / "batches" / "b-stray"
    stray.mkdir()
    another = start(batches_kept=1)  # it tidies up when it begins, and from time to time
    until(lambda: left(another) == [made[1]], "the folders of what is forgotten, and of nobody, are gone")
    assert another.api("GET", f"/batches/{made[0]}").status_code == 404
    assert another.api("GET", f"/batches/{made[1]}/result").status_code == 200
