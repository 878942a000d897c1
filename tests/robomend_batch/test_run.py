"""From logs of literals to intervals: the formats, the folder of results, exit codes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from tests.robomend_batch.running import PROGRAM, TEDUSAR, batch_run, intervals, logs, ndjson, spans, tree

from robomend.cli.commands import run
from robomend.diagnosis.result import Options
from robomend.model.loading import load_model
from robomend.oneshots.warm_model import WarmModel, question
from robomend_batch.commands import batch
from robomend_batch.parts import schema
from robomend_client.observers.base import SECOND

DRIVE = (0.0, "on(jaguar)"), (0.0, "ok(odom)"), (2.0, "not ok(odom)"), (5.0, "ok(odom)"), (6.0, "ok(odom)")
TOLD = [
    (0.0, 2.0, "healthy", [[]]),
    (2.0, 5.0, "faulty", [["jaguar"], ["jaguar_node"]]),
    (5.0, 6.0, "healthy", [[]]),
]


def test_a_log_becomes_intervals(tmp_path: Path) -> None:
    log = ndjson(tmp_path / "a.ndjson", *DRIVE)
    assert batch_run(tmp_path / "out", log) == 0
    assert spans(tmp_path / "out") == TOLD
    fault = intervals(tmp_path / "out")[1]
    assert fault["conflicts"] == [["jaguar", "jaguar_node"]]
    assert fault["observations"] == ["not ok(odom)"]
    assert (fault["complete"], fault["stopped_by"]) == (True, None)
    (told,) = logs(tmp_path / "out")
    assert told["span_ns"] == {"faulty": 3 * SECOND, "healthy": 3 * SECOND}


def test_a_lifetime_that_runs_out_is_unknown_and_not_healthy(tmp_path: Path) -> None:
    lines = [
        {"time": 0, "literal": "not ok(odom)", "lifetime": 1.5},
        {"time": 4 * SECOND, "literal": "ok(odom)", "lifetime": None},
    ]
    (tmp_path / "a.ndjson").write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert batch_run(tmp_path / "out", tmp_path / "a.ndjson") == 0
    assert [span[:3] for span in spans(tmp_path / "out")] == [
        (0.0, 1.5, "faulty"),
        (1.5, 4.0, "unknown"),
        (4.0, 4.0, "healthy"),
    ]
    assert intervals(tmp_path / "out")[1]["bad"] is None


def test_what_the_model_cannot_explain_is_told_and_the_log_goes_on(tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    model.write_text("robomend: 1\nname: m\nhardware: {a: {}}\nproperties: {p: {}}\nrules: ['ok(p)']\n")
    log = ndjson(tmp_path / "a.ndjson", (0, "ok(p)"), (1, "not ok(p)"), (2, "ok(p)"))
    assert batch_run(tmp_path / "out", log, "--fail-on-fault", model=model) == 1
    assert [span[2:] for span in spans(tmp_path / "out")] == [
        ("healthy", [[]]),
        ("contradictory", []),
        ("healthy", [[]]),
    ]
    assert intervals(tmp_path / "out")[1]["observations"] == ["not ok(p)"]


ROVER = """\
robomend: 1
name: rover
hardware: {lidar: {}, lamp: {channel: 4, criticality: optional}}
nodes:
  lidar_node: {drives: [lidar], publishes: {scan: []}}
  wheels_node: {publishes: {odom: []}}
functions:
  localisation:
    variants:
      lidar: {needs: [lidar_node], do: [localise(lidar)]}
      markers: {when: ok(markers_seen), do: [localise(markers)]}
      odometry: {needs: [wheels_node], do: [localise(odometry)]}
"""


@pytest.mark.parametrize("whole", [False, True])
def test_a_robot_that_does_without_what_is_blamed_is_degraded(tmp_path: Path, whole: bool) -> None:
    model = tmp_path / "rover.yaml"
    model.write_text(ROVER)
    by = {name: f"active(localisation, {name})" for name in ("lidar", "markers", "odometry")}
    drives = {
        "bridged": [by["odometry"], "not ok(scan)"],
        "blind": [by["lidar"], "not ok(scan)"],
        "unsaid": ["not ok(scan)"],
        "both": [by["odometry"], "not ok(scan)", "not ok(odom)"],
        "unlit": [by["lidar"], "not on(lamp)"],
        "lost": [by["markers"], "not ok(scan)"],  # that its condition does not hold is not known
        "found": [by["markers"], "ok(markers_seen)", "not ok(scan)"],
        "gone": [by["markers"], "not ok(markers_seen)", "not ok(scan)"],
        "well": [by["odometry"], "ok(scan)"],
    }
    for name, said in drives.items():
        ndjson(tmp_path / f"{name}.ndjson", *((0.0, one) for one in said), (1.0, said[0]))
    files = [tmp_path / f"{name}.ndjson" for name in drives]
    assert batch_run(tmp_path / "out", *files, *(["--together", "log"] if whole else []), model=model) == 0
    told = {Path(one["log"]).name: (one["state"], one["bad"]) for one in intervals(tmp_path / "out")}
    assert {name: told[f"{name}.ndjson"][0] for name in drives} == {
        "bridged": "degraded", "blind": "faulty", "unsaid": "faulty", "both": "faulty",
        "unlit": "degraded", "lost": "degraded", "found": "degraded", "gone": "faulty", "well": "healthy",
    }  # fmt: skip
    assert told["bridged.ndjson"][1] == told["blind.ndjson"][1] == [["lidar_node"]]
    assert run(["report", str(tmp_path / "out")], batch) == 0
    report = (tmp_path / "out" / "report.html").read_text()
    assert "<h3>lidar_node</h3>" in report
    assert ">degraded</span>" in report
    assert "background:#e0a030'></i></div>" in report  # of a log that was degraded
    assert re.search("<b>8</b>show a fault", report)


def formats(folder: Path) -> dict[str, Path]:
    """Write one log in every format."""
    times = [0, 2 * SECOND, 5 * SECOND, 6 * SECOND]
    odom, jaguar = [True, False, True, True], [True] * 4
    long = pl.DataFrame(
        {
            "time": [round(time * SECOND) for time, _ in DRIVE],
            "literal": [said for _, said in DRIVE],
        }
    )
    wide = pl.DataFrame({"time": times, "ok(/odom)": odom, "not on(jaguar)": [not on for on in jaguar]})
    epoch = datetime(1970, 1, 1, tzinfo=UTC)
    stamped = wide.with_columns(
        pl.Series("time", [epoch + timedelta(microseconds=time // 1000) for time in times]),
        pl.col("ok(/odom)").cast(pl.Int8),
    )
    files = {name: folder / name for name in ("a.ndjson", "b.csv", "c.csv", "d.parquet", "e.parquet")}
    files |= {name: folder / name for name in ("f.parquet", "g.ndjson", "h.jsonl", "i.parquet")}
    ndjson(files["a.ndjson"], *DRIVE)
    long.write_csv(files["b.csv"])
    wide.with_columns(pl.col("time") / SECOND).write_csv(files["c.csv"])
    long.write_parquet(files["d.parquet"])
    wide.write_parquet(files["e.parquet"])
    stamped.write_parquet(files["f.parquet"])
    files["g.ndjson"].write_text("".join(json.dumps(row) + "\n" for row in wide.to_dicts()))
    both = [["on(jaguar)", "ok(odom)"], ["not ok(odom)"], ["ok(odom)"], ["ok(odom)"]]
    lines = [{"time": at, "observations": said} for at, said in zip(times, both, strict=True)]
    files["h.jsonl"].write_text("".join(json.dumps(line) + "\n" for line in lines))
    long.with_columns(time=pl.col("time") / SECOND, lifetime=pl.lit(None, pl.Float64)).write_parquet(
        files["i.parquet"]
    )
    return files


def test_every_format_says_the_same(tmp_path: Path) -> None:
    for name, file in formats(tmp_path).items():
        assert batch_run(tmp_path / f"out-{name}", file) == 0, name
        assert spans(tmp_path / f"out-{name}") == TOLD, name


def test_a_column_log_tells_the_logs_of_a_file_apart(tmp_path: Path) -> None:
    rows = [(time, said, log) for time, said in DRIVE for log in ("r1", "r2")]
    rows = [row for row in rows if row[2] == "r1" or "not" not in row[1]]
    frame = pl.DataFrame(rows, schema=["time", "literal", "log"], orient="row")
    frame.write_parquet(tmp_path / "a.parquet")
    frame.write_csv(tmp_path / "a.csv")
    wide = pl.DataFrame({"time": [0, 1, 2], "ok(odom)": [True, False, False], "log": ["r2", "r1", "r2"]})
    wide.write_parquet(tmp_path / "w.parquet")
    for name in ("a.parquet", "a.csv"):
        assert batch_run(tmp_path / "out", tmp_path / name, "--overwrite") == 0
        found = [(one["log"].rpartition("#")[2], one["state"]) for one in intervals(tmp_path / "out")]
        assert found == [("r1", "healthy"), ("r1", "faulty"), ("r1", "healthy"), ("r2", "healthy")]
    assert batch_run(tmp_path / "out", tmp_path / "w.parquet", "--overwrite") == 0
    found = [(one["log"].rpartition("#")[2], one["state"]) for one in intervals(tmp_path / "out")]
    assert found == [("r1", "faulty"), ("r2", "healthy"), ("r2", "faulty")]


def test_trends_of_a_wide_table_deny_one_another(tmp_path: Path) -> None:
    model = tmp_path / "m.yaml"
    rule = '"not ab(a) -> not dec(v)"'
    values = "values: {v: {topic: t, field: f}}"
    model.write_text(
        f"robomend: 1\nname: m\nhardware: {{a: {{}}}}\ntopics: {{t: {{}}}}\n{values}\nrules: [{rule}]\n"
    )
    wide = pl.DataFrame(
        {"time": [0, 1, 2, 3], "dec(v)": [True, None, True, None], "inc(v)": [None, True, True, None]}
    )
    wide.write_parquet(tmp_path / "a.parquet")
    assert batch_run(tmp_path / "out", tmp_path / "a.parquet", model=model) == 0
    # In the third row both hold: the later column counts, as the later literal does in OBS.
    assert [one["state"] for one in intervals(tmp_path / "out")] == ["faulty", "healthy", "unknown"]


def test_each_row_is_told_what_an_engine_says_of_it(tmp_path: Path) -> None:
    """The whole way against a model asked row by row."""
    system = load_model(TEDUSAR)
    atoms = sorted(map(str, system.cnf.atom_variable))
    random = np.random.default_rng(7)
    states = random.choice(3, size=(300, len(atoms)), p=[0.7, 0.15, 0.15]).tolist()
    states = [[(True, False, None)[shown] for shown in row] for row in states]
    states = [states[number // 3] if number % 2 else states[number] for number in range(300)]
    columns = {atom: [row[place] for row in states] for place, atom in enumerate(atoms)}
    frame = pl.DataFrame(
        {"time": list(range(300)), **columns}, schema_overrides=dict.fromkeys(atoms, pl.Boolean)
    )
    frame.write_parquet(tmp_path / "a.parquet")
    assert batch_run(tmp_path / "out", tmp_path / "a.parquet") == 0
    told = intervals(tmp_path / "out")
    assert [one["start_ns"] for one in told[1:]] == [one["end_ns"] for one in told[:-1]]
    with WarmModel(system, options=Options(timeout_s=None)) as model:
        for time, row in enumerate(states):
            seen = [
                f"{'' if on else 'not '}{atom}" for atom, on in zip(atoms, row, strict=True) if on is not None
            ]
            result = model.ask(question(seen, system.vocabulary)).result
            (one,) = [
                one for one in told if one["start_ns"] <= time < max(one["end_ns"], one["start_ns"] + 1)
            ]
            assert one["bad"] == [list(diagnosis.bad) for diagnosis in result.diagnoses]
            assert sorted(one["conflicts"]) == sorted(list(c.components) for c in result.conflicts)
            needed = {str(literal) for c in result.conflicts for literal in c.observations}
            if time == one["start_ns"]:
                assert needed <= set(one["observations"]) <= set(seen)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ((), (True, None, True, 1, 1)),
        (("--limit", "1"), (False, "limit", True, 1, 1)),
        (("--max-size", "0"), (False, "size", False, 1, None)),
        (("--minimal", "cardinality"), (True, None, True, 1, 1)),
        (("--together", "log", "--limit", "1"), (False, "limit", True, 1, 1)),
    ],
)
def test_a_search_that_was_stopped_says_what_it_knows_as_the_service_does(
    given: tuple[str, ...], told: tuple[object, ...], tmp_path: Path
) -> None:
    log = ndjson(tmp_path / "a.ndjson", (0, "not ok(odom)"), (1, "not ok(odom)"))
    assert batch_run(tmp_path / "out", log, *given) == 0
    (one,) = intervals(tmp_path / "out")
    keys = ("complete", "stopped_by", "smallest_proved", "size_at_least", "size_at_most")
    assert tuple(one[key] for key in keys) == told
    options = {given[n].strip("-").replace("-", "_"): given[n + 1] for n in range(0, len(given), 2)}
    if "together" in options:
        return
    asked = Options(
        minimal="cardinality" if "minimal" in options else "subset",
        limit=int(options.get("limit", 100)),
        max_size=int(options["max_size"]) if "max_size" in options else None,
    )
    system = load_model(TEDUSAR)
    with WarmModel(system, options=asked) as model:
        answer = model.ask(question(["not ok(odom)"], system.vocabulary)).result
    assert tuple(getattr(answer, key) for key in keys) == told


def test_the_files_have_the_columns_that_the_page_describes(tmp_path: Path) -> None:
    assert batch_run(tmp_path / "out", ndjson(tmp_path / "a.ndjson", *DRIVE)) == 0
    (part,) = (tmp_path / "out" / "results").iterdir()
    assert pl.read_parquet_schema(part) == schema()
    page = (Path(__file__).parents[2] / "docs" / "batch.md").read_text()
    for name in schema():
        assert f"\n| `{name}` |" in page


def test_equal_logs_give_equal_bytes_and_the_order_given_does_not_matter(tmp_path: Path) -> None:
    files = list(formats(tmp_path).values())
    assert batch_run(tmp_path / "one", *files) == 0
    assert batch_run(tmp_path / "two", *reversed(files)) == 0
    assert tree(tmp_path / "one") == tree(tmp_path / "two")


def test_a_long_log_is_written_in_parts_and_merged_across_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(3)
    said = ["ok(odom)", "not ok(odom)", "not on(jaguar)", "on(jaguar)", "ok(scan)", "not ok(scan)"]
    lines = [(time, said[which]) for time, which in enumerate(random.integers(0, 6, 500).tolist())]
    log = ndjson(tmp_path / "a.ndjson", *lines)
    assert batch_run(tmp_path / "one", log) == 0
    monkeypatch.setattr("robomend_batch.parts.PART", 7)
    monkeypatch.setattr("robomend_batch.parts.GROUP", 3)
    monkeypatch.setattr("robomend_batch.parts.TAILS", 5)
    monkeypatch.setattr("robomend_batch.parts.SLICE", 2)
    monkeypatch.setattr("robomend_batch.parts.DECODED", 1)
    monkeypatch.setattr("robomend_batch.parts.SPREAD", 3)
    monkeypatch.setattr("robomend_batch.logs.text.TOGETHER", 5)
    assert batch_run(tmp_path / "many", log) == 0
    assert len(list((tmp_path / "many" / "results").iterdir())) > 20
    assert intervals(tmp_path / "many") == intervals(tmp_path / "one")


# --- bad input ------------------------------------------------------------------------------------------

WHOLE = '{"time": 0, "literal": "ok(odom)"}\n'
BAD = {
    "undeclared.ndjson": ('{"time": 0, "literal": "ok(odm)"}\n', "undeclared.ndjson:1", "did you mean odom"),
    "sentence.ndjson": (WHOLE + '{"time": 1, "literal": "ok(("}\n', "sentence.ndjson:2", "position"),
    "time.ndjson": ('{"time": "noon", "literal": "ok(odom)"}\n', "time.ndjson:1", "no time: 'noon'"),
    "nan.ndjson": ('{"time": NaN, "literal": "ok(odom)"}\n', "nan.ndjson:1", "no time"),
    "lifetime.ndjson": ('{"time": 0, "literal": "ok(odom)", "lifetime": -1}\n', ":1", "no lifetime"),
    "json.ndjson": (WHOLE + "{\n" + WHOLE, "json.ndjson:2", "not a line of JSON"),
    "neither.ndjson": ('{"time": 0}\n', "neither.ndjson:1", "neither"),
    "cells.csv": ("time,ok(odom)\n0,true\n1\n", "cells.csv:3", "1 cells, and 2 columns"),
    "value.csv": ("time,ok(odom)\n0,maybe\n", "value.csv:2", "'maybe'"),
    "empty.ndjson": ("", "empty.ndjson", "an empty file"),
    "header.csv": ("time,ok(odom)\n", "header.csv", "nothing was observed"),
    "other.txt": ("hello", "other.txt", "no log that is known"),
    "cut.parquet": ("PAR1garbage", "cut.parquet", "not a whole Parquet file"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_log_is_named_with_its_place_and_the_others_go_on(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, place, reason = BAD[name]
    (tmp_path / name).write_text(text)
    good = ndjson(tmp_path / "good.ndjson", *DRIVE)
    assert batch_run(tmp_path / "out", tmp_path / name, good) == 2
    assert spans(tmp_path / "out") == TOLD
    (bad,) = [log for log in logs(tmp_path / "out") if log["state"] != "ok"]
    assert bad["state"] == "refused"
    (problem,) = bad["problems"]
    assert place in problem["place"]
    assert reason in problem["reason"]
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        ({"t": [0], "literal": ["ok(odom)"]}, "no column `time`, but t, literal"),
        ({"time": [0], "literal": ["ok(odom)"], "mood": ["good"]}, "mood"),
        ({"time": [0], "ok(odom)": ["yes"]}, "`ok(odom)` holds String"),
        ({"time": [0], "ok(odom)": [3]}, "other numbers than 0 and 1"),
        ({"time": [0], "odo": [True]}, "no predicate is named odo"),
        ({"time": [0, None], "ok(odom)": [True, True]}, "no time"),
        ({"time": [0, 1], "literal": ["ok(odom)", None]}, "no literal"),
        ({"time": [0]}, "neither"),
    ],
)
def test_a_parquet_with_other_columns_is_refused_by_name(
    columns: dict[str, list[object]], reason: str, tmp_path: Path
) -> None:
    pl.DataFrame(columns).write_parquet(tmp_path / "a.parquet")
    assert batch_run(tmp_path / "out", tmp_path / "a.parquet") == 2
    (told,) = logs(tmp_path / "out")
    assert reason in told["problems"][0]["reason"]


def test_a_log_whose_writer_died_is_diagnosed_up_to_there(tmp_path: Path) -> None:
    whole = ndjson(tmp_path / "whole.ndjson", *DRIVE).read_bytes()
    for cut in range(len(whole) - 20, len(whole) - 1):
        log = tmp_path / "cut.ndjson"
        log.write_bytes(whole[:cut])
        assert batch_run(tmp_path / "out", log, "--overwrite") == 2
        (told,) = logs(tmp_path / "out")
        assert told["state"] == "ended-early"
        assert "cut off" in told["problems"][0]["reason"]
        assert spans(tmp_path / "out")[1][3] == [["jaguar"], ["jaguar_node"]]


def test_undeclared_names_can_be_kept(tmp_path: Path) -> None:
    log = ndjson(tmp_path / "a.ndjson", *DRIVE, (7, "ok(the_moon)"), (8, "ok(the_moon)"))
    assert batch_run(tmp_path / "out", log, "--unknown", "keep") == 0
    assert spans(tmp_path / "out")[-1][1] == 8
    (told,) = logs(tmp_path / "out")
    assert told["problems"][0]["reason"] == "the model has no ok(the_moon)"


def test_a_log_that_is_given_twice_is_diagnosed_once_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = ndjson(tmp_path / "a.ndjson", *DRIVE)
    assert batch_run(tmp_path / "out", log, tmp_path / "*.ndjson") == 2
    assert "diagnosed once" in capsys.readouterr().err
    assert spans(tmp_path / "out") == TOLD


def test_logs_that_are_not_there_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ndjson(tmp_path / "drive.ndjson", *DRIVE)
    assert batch_run(tmp_path / "out", tmp_path / "drve.ndjson") == 2
    assert "did you mean" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# --- the folder of results ------------------------------------------------------------------------------


def test_faults_decide_the_exit_code_only_if_asked_for(tmp_path: Path) -> None:
    sick = ndjson(tmp_path / "sick.ndjson", *DRIVE)
    well = ndjson(tmp_path / "well.ndjson", (0, "ok(odom)"))
    assert batch_run(tmp_path / "one", sick, "--fail-on-fault") == 1
    assert batch_run(tmp_path / "two", well, "--fail-on-fault") == 0


def test_a_folder_of_another_run_is_refused_until_it_may_be_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, log = tmp_path / "out", ndjson(tmp_path / "a.ndjson", *DRIVE)
    other, observers = tmp_path / "other.yaml", tmp_path / "agent.yaml"
    other.write_text(Path(TEDUSAR).read_text() + "# changed\n")
    observers.write_text("topics: {scan: {rate_hz: 10}}")
    given = log, "--observers", observers
    assert batch_run(out, *given) == 0
    before = tree(out)
    for more, model, named in (
        (["--minimal", "cardinality"], TEDUSAR, "minimal (was 'subset')"),
        (["--together", "1min"], TEDUSAR, "together"),
        (["--time", "header"], TEDUSAR, "time"),
        ([], other, "model"),
    ):
        assert batch_run(out, *given, *more, model=model) == 2
        assert named in capsys.readouterr().err
    observers.write_text("topics: {scan: {rate_hz: 11}}")
    assert batch_run(out, *given) == 2
    assert "observers" in capsys.readouterr().err
    assert tree(out) == before
    assert batch_run(out, *given, "--minimal", "cardinality", "--overwrite") == 0
    assert tree(out) != before


def test_further_logs_join_and_logs_that_are_left_out_are_asked_about(tmp_path: Path) -> None:
    one, two = ndjson(tmp_path / "a.ndjson", *DRIVE), ndjson(tmp_path / "b.ndjson", *DRIVE)
    assert batch_run(tmp_path / "out", one) == 0
    assert batch_run(tmp_path / "out", one, two) == 0
    assert batch_run(tmp_path / "whole", one, two) == 0
    assert tree(tmp_path / "out") == tree(tmp_path / "whole")
    assert batch_run(tmp_path / "out", two) == 2


def test_a_log_that_has_changed_is_diagnosed_anew(tmp_path: Path) -> None:
    log = ndjson(tmp_path / "a.ndjson", *DRIVE)
    assert batch_run(tmp_path / "out", log) == 0
    ndjson(log, (0, "ok(odom)"), (9, "ok(odom)"))
    assert batch_run(tmp_path / "out", log) == 0
    assert spans(tmp_path / "out") == [(0.0, 9.0, "healthy", [[]])]


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path: Path) -> None:
    mine = tmp_path / "out" / "thesis.tex"
    mine.parent.mkdir()
    mine.write_text("years of work")
    assert batch_run(tmp_path / "out", ndjson(tmp_path / "a.ndjson", *DRIVE), "--overwrite") == 2
    assert tree(tmp_path / "out") == {"thesis.tex": b"years of work"}


def test_it_starts_without_web_framework_and_database(tmp_path: Path) -> None:
    blocked = (
        "import sys; names = ['fastapi', 'starlette', 'sqlalchemy', 'pydantic', 'uvicorn'];"
        "sys.modules.update(dict.fromkeys(names));"
        "from robomend_batch.main import main; main()"
    )
    log = ndjson(tmp_path / "a.ndjson", *DRIVE)
    line = [sys.executable, "-c", blocked, "run", log, "--model", TEDUSAR, "-o", tmp_path / "out"]
    done = subprocess.run(list(map(str, line)), capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert "1 log, 1 with faults" in done.stderr


def test_one_parquet_of_all_logs_says_so_when_there_is_no_room_for_it(tmp_path: Path) -> None:
    said = ("ok(odom)", "not ok(odom)", "ok(scan)", "not ok(scan)", "not on(jaguar)", "on(jaguar)")
    log = [(at * (1 + at % 7) / 3 + at * 9, said[at * at % 17 % 6]) for at in range(3000)]
    line = [str(ndjson(tmp_path / "a.ndjson", *log)), "--no-ndjson"]
    out = tmp_path / "out"
    assert batch_run(out, *line) == 0
    program = [*PROGRAM, "run", *line, "--model", TEDUSAR, "--out", str(out), "--quiet", "--parquet"]
    part = next((out / "results").glob("*.parquet"))
    room = part.stat().st_size // 1024 - 1  # no file may be larger, as on a disk that is full
    assert room > (out / "manifest.json").stat().st_size // 1024 + 1
    limited = ["bash", "-c", 'ulimit -f "$0"; exec "$@"', str(room), *program]
    full = subprocess.run(limited, capture_output=True, text=True, timeout=60)
    assert (full.returncode, "make room" in full.stderr) == (3, True), full.stderr
    assert subprocess.run(program, capture_output=True, timeout=60).returncode == 0
    whole = pl.read_parquet(out / "results.parquet")
    assert whole.equals(pl.read_parquet(part))


@pytest.mark.parametrize("workers", ["0", "2"])
def test_a_log_that_takes_more_time_than_its_size_allows_costs_itself_only(
    workers: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The worst is an observer of somebody's own that never comes back, and catches what it can."""
    (tmp_path / "own.py").write_text(
        "def never(value: str):\n"
        "    while value == 'bad':\n"
        "        try:\n"
        "            sum(range(1000))\n"
        "        except Exception:\n"
        "            pass\n"
        "    return value == 'good'\n"
    )
    observers = tmp_path / "agent.yaml"
    observers.write_text('observers: {odom: {kind: "own.py:never", source: "odom:how"}}\n')
    names = []
    for number, how in enumerate(("good", "bad", "worn", "good")):
        lines = [
            {"start": 0},
            *({"source": "odom:how", "time": at * SECOND, "value": how} for at in range(3)),
        ]
        lines.append({"end": 3 * SECOND})
        names.append(tmp_path / f"{number}.jsonl")
        names[-1].write_text("".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines))
    given = ["--observers", str(observers), "--log-timeout", "3", "--workers", workers]
    assert batch_run(tmp_path / "out", *names, *given) == 2
    good, bad, worn, again = logs(tmp_path / "out")
    assert [one["state"] for one in (good, bad, worn, again)] == ["ok", "refused", "ok", "ok"]
    assert (list(good["intervals"]), list(worn["intervals"])) == (["healthy"], ["faulty"])
    assert not bad["parts"]
    said = "it took more than 3 s of a processor's time, which 0.0 MB never do: --log-timeout gives it more"
    assert bad["problems"][0]["reason"] == said
    assert f"refused: {names[1]}: {said}" in capsys.readouterr().err
