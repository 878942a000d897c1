"""`robomend-bench faults`: which trials a run has, what it prints and writes, and a short one for real."""

from __future__ import annotations

import json
import logging
import re
import shlex
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.robomend_bench.test_main import run as bench

from robomend_bench.faults.classes import CLASSES
from robomend_bench.faults.command import Kept, OtherTerms, choose, command, judge, names_in
from robomend_bench.faults.record import Record, Trial
from robomend_bench.faults.report import Report
from robomend_bench.faults.robot import robot_names
from robomend_bench.faults.scoring import Score
from robomend_bench.faults.standins import IN_USE
from robomend_bench.faults.stretches import STRETCHES

ALL = list(names_in("usual"))
USUAL_STRETCHES = [each.name for each in STRETCHES if each.world == "usual"]


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    return bench(monkeypatch, "faults", *arguments)


# --- which trials ----------------------------------------------------------------------------------------


def test_a_run_has_the_shares_exactly_and_the_stretches_besides() -> None:
    found = list(choose(220, 3, 1, robot_names(), ALL))
    counts = Counter(trial.cls for trial in found)
    assert counts == {each.name: 2 * each.share for each in CLASSES} | dict.fromkeys(USUAL_STRETCHES, 3)
    assert found == list(choose(220, 3, 1, robot_names(), ALL))
    assert len(set(found)) == len(found)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--robots", "base,bass"), "there is no robot 'bass'"),
        (("--classes", "node"), "there is no class 'node'"),
        (("--only-trial", "base/hung-node"), "is no trial"),
        (("--only-trial", "bass/hung-node/1.1"), "is no trial"),
        (("--only-trial", "drone/spare/1.1"), "drone has nothing for spare"),
        (("--robots", "drone", "--classes", "spare"), "none of these robots takes part"),
    ],
)
def test_what_cannot_be_run_is_named(
    arguments: tuple[str, ...],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(monkeypatch, *arguments) == 2
    # click wraps its messages in a frame
    assert message in " ".join(capsys.readouterr().err.replace("│", " ").split())


# --- what is told ----------------------------------------------------------------------------------------


def test_a_stand_in_s_run_is_told_and_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    few = ("--trials", "6", "--stretches", "1", "--robots", "base,loops", "--observers", "fast")
    said = logging.getLogger("robomend_client").getEffectiveLevel()
    assert run(monkeypatch, *few, "--agent", "idle", "--out", str(tmp_path)) == 0
    assert logging.getLogger("robomend_client").getEffectiveLevel() == said, "others log in this process, too"
    shown = capsys.readouterr().out
    assert "### Faults" in shown
    assert "### Nothing is broken (5 stretches)" in shown
    written = json.loads((tmp_path / "faults-fast.json").read_text())
    assert (tmp_path / "faults-fast.md").read_text() == shown
    assert written["figures"]["faults"]["right"]["value"] == 0
    assert {score["trial"].split("/")[0] for score in written["scores"]} == {"base", "loops"}
    wrong = [score["trial"] for score in written["scores"] if score["group"] != "healthy"]
    records = {path.stem for path in (tmp_path / "faults-fast-records").iterdir()}
    assert records == {trial.replace("/", "-") for trial in wrong}
    # What went wrong comes with the command that plays it again.
    again = f"robomend-bench faults --only-trial {wrong[0]} --observers fast --agent idle"
    assert f"`{again}`" in shown
    command.make_context("robomend-bench faults", shlex.split(again)[2:])


def test_beside_what_people_use_all_have_the_same_faults(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    classes = ("--robots", "base", "--classes", "dead-node,hung-device,off,for-ever")
    few = ("--trials", "8", *classes, "--observers", "fast", "--beside", "--agent")
    assert run(monkeypatch, *few, "perfect") == 0
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[0].removeprefix("| ") for row in rows] == ["perfect", *IN_USE.values()]
    assert len({row[1].partition(" of ")[2] for row in rows}) == 1
    assert rows[0][1] == "7 of 7"
    # The last two: where both repaired it, each one's times and those of the first.
    assert rows[0][6] == rows[0][8] == rows[0][9].removesuffix(" |")
    assert rows[1][6] == rows[1][8] != "–"
    assert rows[1][9] != rows[0][9]
    assert run(monkeypatch, *few, "idle") == 0
    assert {line[-9:] for line in capsys.readouterr().out.splitlines()[2:]} == {"| – | – |"}
    assert run(monkeypatch, *few, "idle", "--format", "json") == 0
    told = json.loads(capsys.readouterr().out)["beside"]
    wrong = {
        name: figures["wrong_acts"]["value"] for name, figures in told.items() if "wrong_acts" in figures
    }
    assert wrong[IN_USE["lifecycle"]] > wrong[IN_USE["upstream"]] >= wrong[IN_USE["respawn"]]
    assert told[IN_USE["respawn"]]["repaired"]["value"] < told[IN_USE["upstream"]]["repaired"]["value"]


def test_a_trial_by_itself_tells_all_that_happened(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "--only-trial", "base/hung-node/1.1", "--agent", "perfect") == 0
    shown = capsys.readouterr().out
    for word in ("fault", "truth", "seen", "diagnosis", "repair", "ACT", '"right": true'):
        assert word in shown


def test_what_is_no_measurement_is_named_and_never_scored() -> None:
    report = Report("", "published", "the service", 0, 1, [], [], [])
    died = Record(Trial("base", "hung-node", 1, 1), "published", error="the service died: out of memory")
    late = Record(Trial("base", "hung-node", 1, 2), "published", late_s=1.5)
    starved = Record(Trial("base", "hung-node", 1, 3), "published", starved_s=0.4)
    judge([died, late, starved], report)
    assert (report.scores, report.late) == ([], [("base/hung-node/1.2", 1.5), ("base/hung-node/1.3", 0.4)])
    assert report.errors == [("base/hung-node/1.1", "the service died: out of memory")]
    shown = report.markdown()
    assert "2 left out as the bench was late, 1 errors" in shown
    assert "base/hung-node/1.1`: the service died" in shown


def test_lists_name_what_went_wrong_and_nothing_else() -> None:
    well = Score("base/off/1.1", "off", "faults", repairable=True, repaired=True, detected=True)
    acted = replace(well, trial="base/off/1.2", wrong=["1.00 s: stop_node(x)"] * 6)
    false = replace(well, trial="base/off/1.3", false_repaired=["2.00 s: not ok(x) still wrong"])
    lost = replace(well, trial="base/off/1.4", repaired=False, escalated=True)
    needless = Score("base/boot/1.5", "boot", "healthy", acts=1, wrong=["1.00 s: stop_node(y)"])
    report = Report("", "published", "the service", 0, 1, [well, acted, false, lost, needless], [], [])
    sections = {part.split("\n")[0]: part for part in report.markdown().split("### ")}
    listed = {title: set(re.findall(r"base/\w+/1\.\d", part)) for title, part in sections.items()}
    assert {title: trials for title, trials in listed.items() if trials} == {
        "Called repaired that were not (1 trials)": {"base/off/1.3"},
        "Wrong acts (1 trials)": {"base/off/1.2"},
        "Needless acts (1 trials)": {"base/boot/1.5"},
        "Neither repaired nor escalated with its cause (1 trials)": {"base/off/1.4"},
    }
    assert "; and 2 more" in sections["Wrong acts (1 trials)"]


# --- a run in pieces ------------------------------------------------------------------------------------

TERMS = {"observers": "fast", "agent": "service", "load": 0}
WELL = Score(
    "base/off/1.1", "off", "faults", repairable=True, repaired=True, repaired_s=1.5, parts={"acts": 0.3}
)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (
            json.dumps({"terms": {**TERMS, "observers": "published"}}),
            "observers: 'published' there, 'fast' now",
        ),
        (json.dumps({"terms": {**TERMS, "boots": True}}), "boots: True there, None now"),
        ("a list of purchases", "is no file of scores"),
        ("[1]", "is no file of scores"),
        (json.dumps({"terms": TERMS}) + "\n{}\n" + json.dumps(WELL.as_json()), "line 2: no score"),
    ],
)
def test_what_is_of_another_kind_is_refused(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "scores"
    path.write_text(text)
    with pytest.raises(OtherTerms, match=why):
        Kept(path, TERMS)
    assert path.read_text() == text


def test_pieces_come_to_the_same_as_one_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    few = ("--robots", "base", "--observers", "fast", "--agent", "perfect", "--classes", "off,dead-node,boot")
    one = (*few, "--trials", "4", "--stretches", "1", "--format", "json")
    kept = ("--keep", str(tmp_path / "scores"))

    def told(*arguments: str) -> dict[str, Any]:
        assert run(monkeypatch, *arguments) == 0
        found: dict[str, Any] = json.loads(capsys.readouterr().out)
        return found

    whole = told(*one)
    nothing = told(*one, *kept, "--minutes", "1e-9")
    assert (nothing["scores"], nothing["not_begun"]) == ([], 5)
    assert len(told(*few, *kept, "--trials", "2", "--stretches", "0", "--format", "json")["scores"]) == 2
    pieces = told(*one, *kept)
    assert (pieces["scores"], pieces["figures"]) == (whole["scores"], whole["figures"])
    lines = (tmp_path / "scores").read_text()
    assert told(*one, *kept)["scores"] == whole["scores"]
    assert (tmp_path / "scores").read_text() == lines  # nothing was played


# --- for real --------------------------------------------------------------------------------------------


def test_real_trials_against_the_real_service(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, long: bool
) -> None:
    few = ("--robots", "base", "--classes", "off,dead-node,hung-node", "--trials", "3")
    many = ("--trials", "40", "--stretches", "2")
    chosen = many if long else few
    code = run(monkeypatch, *chosen, "--observers", "fast", "--format", "json", "--out", str(tmp_path))
    told = json.loads(capsys.readouterr().out)
    assert (code, told["errors"]) == (0, [])
    assert len(told["scores"]) + len(told["late"]) == (50 if long else 3)
    for score in told["scores"]:
        if score["group"] == "faults" and score["cls"] in ("off", "dead-node", "hung-node"):
            # What it is about: the fault was planted, seen, and acted upon, all through the real parts.
            assert score["detected"], score
            assert score["acts"] >= 1, score
            assert score["detection_s"] < score["first_act_s"]


def test_stretches_for_real(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], long: bool
) -> None:
    if not long:
        pytest.skip("a stretch takes 15 to 30 s: run with --long")
    assert (
        run(monkeypatch, "--classes", ",".join(USUAL_STRETCHES), "--stretches", "1", "--format", "json") == 0
    )
    told = json.loads(capsys.readouterr().out)
    assert {score["cls"] for score in told["scores"]} == set(USUAL_STRETCHES)
    for score in told["scores"]:
        if score["cls"] in ("jitter", "service-restart", "agent-restart"):
            assert score["acts"] == 0, score
