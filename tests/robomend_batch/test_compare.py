"""Which logs show the same, and what a second run tells differently."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.robomend_batch.running import TEDUSAR, batch_run, ndjson

from robomend.cli.commands import run
from robomend_batch.commands import batch
from robomend_client.observers.base import SECOND

SILENT = (0, "ok(odom)"), (2, "not ok(odom)"), (5, "ok(odom)"), (9, "ok(odom)")


def lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, object]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_logs_with_the_same_faults_are_a_group(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [
        ndjson(tmp_path / "a.ndjson", *SILENT),
        ndjson(tmp_path / "b.ndjson", (0, "not ok(odom)"), (1, "ok(odom)"), (2, "not ok(odom)")),
        ndjson(tmp_path / "c.ndjson", *SILENT, (10, "not on(hokuyo)")),
        ndjson(tmp_path / "d.ndjson", (0, "ok(odom)")),
    ]
    assert batch_run(tmp_path / "out", *files) == 0
    assert run(["compare", str(tmp_path / "out"), "--format", "ndjson"], batch) == 0
    jaguar, hokuyo = [["jaguar"], ["jaguar_node"]], [["hokuyo"]]
    found = [(group["faults"], len(list(str(group["logs"]).split(",")))) for group in lines(capsys)]
    assert found == [([jaguar], 2), ([hokuyo, jaguar], 1), ([], 1)]
    assert run(["compare", str(tmp_path / "out")], batch) == 0
    assert "jaguar, or jaguar_node: 2 logs" in capsys.readouterr().out


def test_where_another_model_changes_the_verdict_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [ndjson(tmp_path / f"{name}.ndjson", *SILENT) for name in "ab"]
    other = tmp_path / "other.yaml"
    text = Path(TEDUSAR).read_text().replace("jaguar_node: {drives: [jaguar], ", "jaguar_node: {")
    other.write_text(text)
    assert other.read_text() != Path(TEDUSAR).read_text()
    assert batch_run(tmp_path / "one", *files) == 0
    assert batch_run(tmp_path / "two", files[0], model=other) == 0
    asked = ["diff", str(tmp_path / "one"), str(tmp_path / "two")]
    assert run([*asked, "--format", "ndjson", "--fail-on-difference"], batch) == 1
    found = lines(capsys)
    assert found[0] == {
        "log": str(files[0]),
        "segment": 0,
        "start_ns": 2 * SECOND,
        "end_ns": 5 * SECOND,
        "before": {"state": "faulty", "bad": [["jaguar"], ["jaguar_node"]]},
        "after": {"state": "faulty", "bad": [["jaguar_node"]]},
    }
    assert {line["log"] for line in found[1:]} == {str(files[1])}
    assert all(line["after"] is None for line in found[1:])
    assert run(asked, batch) == 0
    first = capsys.readouterr().out.splitlines()[0]
    at, verdicts = "1970-01-01 00:00:02.000 UTC for 3.0 s", "jaguar, or jaguar_node -> jaguar_node"
    assert first == f"{files[0]}  {at}: {verdicts}"


def test_a_run_does_not_differ_from_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert batch_run(tmp_path / "out", ndjson(tmp_path / "a.ndjson", *SILENT)) == 0
    out = str(tmp_path / "out")
    assert run(["diff", out, out, "--fail-on-difference"], batch) == 0
    assert capsys.readouterr().out == ""


def test_runs_without_a_log_in_common_are_refused(tmp_path: Path) -> None:
    for name in ("one", "two"):
        assert batch_run(tmp_path / name, ndjson(tmp_path / f"{name}.ndjson", *SILENT)) == 0
    assert run(["diff", str(tmp_path / "one"), str(tmp_path / "two")], batch) == 2
