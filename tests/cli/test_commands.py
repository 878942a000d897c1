"""compile, model check, init and diagnose, as a user calls them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from robomend.cli.commands import run
from robomend.model.loading import load_model, load_text
from robomend.resources import resource

TEDUSAR = str(resource("examples", "tedusar.yaml"))
Capture = pytest.CaptureFixture[str]


def answer(capsys: Capture, *arguments: str) -> dict[str, Any]:
    assert run(["diagnose", *arguments, "--format", "json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


# --- compile, model check, init
# ------------------------------------------------------------------------------------


def test_compile_shows_each_clause_with_its_rule(capsys: Capture) -> None:
    assert run(["compile", TEDUSAR]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 18
    assert lines[8].startswith("ab(hector_mapping) or not ok(scan) or ok(map)    # scheme 4, line 24: ")


def test_compile_writes_dimacs_that_a_solver_reads(capsys: Capture) -> None:
    from pysat.formula import CNF

    assert run(["compile", TEDUSAR, "--format", "dimacs"]) == 0
    out = capsys.readouterr().out
    assert "p cnf 32 18" in out
    assert "c 1 not ab(jaguar)" in out
    assert [tuple(clause) for clause in CNF(from_string=out).clauses] == [*load_model(TEDUSAR).cnf.clauses]


def test_compile_writes_five_keys_that_load_again(capsys: Capture) -> None:
    assert run(["compile", TEDUSAR, "--format", "five-key"]) == 0
    assert len(load_text(capsys.readouterr().out).cnf.clauses) == 18


def test_model_check_says_what_no_rule_can_blame(capsys: Capture) -> None:
    assert run(["model", "check", TEDUSAR]) == 0
    out = capsys.readouterr().out
    assert "14 components, 18 clauses" in out
    assert "no rule can blame imu" in out
    assert "no rule can blame joystick" in out
    assert run(["model", "check", TEDUSAR, "--strict", "--format", "json"]) == 1
    assert len(json.loads(capsys.readouterr().out)["warnings"]) == 2
    assert run(["model", "check", str(resource("examples", "mobile_manipulator.yaml")), "--strict"]) == 0


def test_model_check_names_unused_names_and_shared_topics(tmp_path: Path, capsys: Capture) -> None:
    model = tmp_path / "robot.yaml"
    model.write_text(
        "robomend: 1\nhardware: {lamp: {channel: 1}}\ntopics: [idle]\nproperties: [temp]\n"
        "values: {v: {topic: t, field: x}}\n"
        "nodes: {a: {publishes: {t: []}, prior: 0.1}, b: {publishes: {t: []}}}\n"
    )
    assert run(["model", "check", str(model)]) == 0
    out = capsys.readouterr().out
    for part in (
        "topic t has 2 publishers (a, b)",
        "topic idle: no node publishes it",
        "property temp: no rule mentions",
        "value v: no related pair",
        "hardware lamp: no node drives it, and no rule mentions it",
        "2 of 3 components have no prior (lamp, b)",
    ):
        assert part in out


def test_model_check_names_topics_whose_silence_blames_nobody(tmp_path: Path, capsys: Capture) -> None:
    model = tmp_path / "robot.yaml"
    model.write_text(
        "robomend: 1\nhardware: {base: {channel: 1}, lamp: {channel: 2}}\ntopics: [scan]\nnodes:\n"
        "  driver: {drives: [base], inputs_matter: true, publishes: {odom: [cmd]}}\n"
        "  planner: {publishes: {cmd: [odom], plan: [cmd]}}\n"
        "  mapper: {publishes: {map: [scan]}}\n"
        "  clock: {publishes: {time: []}}\n"
        'rules: ["not ab(lamp) -> ok(light)"]\n'
    )
    assert run(["model", "check", str(model)]) == 0
    out = capsys.readouterr().out
    assert "topics odom, cmd, plan: waits for itself, in a circle (cmd ← odom ← cmd)" in out
    assert "topic map: waits for scan, which no node publishes" in out
    assert "time" not in out
    assert "lamp: no node drives it" not in out  # a rule blames it


def test_init_writes_a_model_without_doubts(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "my robot.yaml"
    assert run(["init", str(path)]) == 0
    assert load_model(path).name == "my robot"
    assert run(["model", "check", str(path), "--strict"]) == 0
    assert run(["init", str(path)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert run(["init", str(path), "--force", "--name", 'x "y"']) == 0
    assert load_model(path).name == 'x "y"'


# --- diagnose
# --------------------------------------------------------------------------------------------------------


def test_diagnose_answers_in_the_agreed_shape(capsys: Capture) -> None:
    found = answer(capsys, TEDUSAR, "--observe", "not ok(scan)")
    keys = ["diagnoses", "complete", "stopped_by", "conflicts", "elapsed_s"]
    assert [key for key in found if key in keys] == keys
    assert [d["bad"] for d in found["diagnoses"]] == [["hokuyo"], ["hokuyo_node"]]
    assert all(len(d["bad"]) + len(d["good"]) == 14 for d in found["diagnoses"])
    assert [d["probability"] for d in found["diagnoses"]] == [None, None]
    assert (found["complete"], found["stopped_by"]) == (True, None)
    (conflict,) = found["conflicts"]
    assert set(conflict) == {"components", "observations", "rules", "text", "unmet", "minimal"}
    assert conflict["components"] == ["hokuyo", "hokuyo_node"]
    assert conflict["observations"] == ["not ok(scan)"]


def test_diagnose_a_healthy_robot(capsys: Capture) -> None:
    found = answer(capsys, TEDUSAR, "--observe", "ok(scan) and ok(odom)", "--fail-on-fault")
    assert [d["bad"] for d in found["diagnoses"]] == [[]]
    assert run(["diagnose", TEDUSAR]) == 0
    assert "healthy" in capsys.readouterr().out


def test_fail_on_fault_exits_with_1(capsys: Capture) -> None:
    assert run(["diagnose", TEDUSAR, "-o", "not ok(scan)", "--fail-on-fault"]) == 1
    assert "hokuyo_node" in capsys.readouterr().out


def test_what_if(capsys: Capture) -> None:
    found = answer(capsys, TEDUSAR, "-o", "not ok(scan)", "--assume-healthy", "hokuyo")
    assert [d["bad"] for d in found["diagnoses"]] == [["hokuyo_node"]]
    found = answer(capsys, TEDUSAR, "-o", "not ok(scan)", "--assume-abnormal", "/hokuyo")
    assert [d["bad"] for d in found["diagnoses"]] == [["hokuyo"]]
    both = ["--assume-abnormal", "rviz", "--assume-healthy", "rviz"]
    assert run(["diagnose", TEDUSAR, *both]) == 2
    assert run(["diagnose", TEDUSAR, "--assume-healthy", "rvis"]) == 2
    assert "did you mean 'rviz'" in capsys.readouterr().err


def test_nodes_that_are_meant_to_be_stopped(capsys: Capture) -> None:
    found = answer(capsys, TEDUSAR, "-o", "not running(rviz)", "--expect-stopped", "rviz")
    assert [d["bad"] for d in found["diagnoses"]] == [[]]


def test_wrong_observations_and_options_exit_with_2(capsys: Capture) -> None:
    for arguments, message in [
        (["-o", "not ok(scam)"], "did you mean scan"),
        (["-o", "ok(scan"], "position 7"),
        (["--engine", "guess"], "no engine is named"),
        (["--timeout", "-1"], "--timeout"),
        (["--observations", "/nowhere"], "cannot be read"),
        (["--observations", "-", "-o", "ok(scan)"], "either"),
    ]:
        assert run(["diagnose", TEDUSAR, *arguments]) == 2
        assert message in capsys.readouterr().err


def test_a_contradiction_names_the_rule(tmp_path: Path, capsys: Capture) -> None:
    model = tmp_path / "robot.yaml"
    model.write_text("robomend: 1\nnodes: [a]\nproperties: [p]\nrules: ['ok(p)']\n")
    assert run(["diagnose", str(model), "-o", "not ok(p)"]) == 2
    assert "whatever is abnormal" in capsys.readouterr().err


def test_a_file_of_sets_is_answered_line_by_line(tmp_path: Path, capsys: Capture) -> None:
    sets = tmp_path / "sets.jsonl"
    sets.write_text('["not ok(scan)"]\n\n["ok(scan)"]\nnot ok(odom), running(rviz)\n["not ok(scan)"]\n')
    assert run(["diagnose", TEDUSAR, "--observations", str(sets)]) == 0
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [[d["bad"] for d in one["diagnoses"]] for one in found] == [
        [["hokuyo"], ["hokuyo_node"]],
        [[]],
        [["jaguar"], ["jaguar_node"]],
        [["hokuyo"], ["hokuyo_node"]],
    ]
    assert {**found[3], "elapsed_s": 0} == {**found[0], "elapsed_s": 0}
    assert run(["diagnose", TEDUSAR, "--observations", str(sets), "--fail-on-fault"]) == 1
    sets.write_text('["not ok(scan)"]\n["ok(scan)"]\n')
    assert run(["diagnose", TEDUSAR, "--observations", str(sets), "--fail-on-fault"]) == 1
    sets.write_text('["ok(scan)"]\n')
    assert run(["diagnose", TEDUSAR, "--observations", str(sets), "--fail-on-fault"]) == 0


def test_a_line_that_is_refused_keeps_its_place(tmp_path: Path, capsys: Capture) -> None:
    sets = tmp_path / "sets.jsonl"
    sets.write_text('["ok(scan)"]\n["ok(scam)"]\n["ok(scan)", 3]\n[ok(scan)]\n["ok(map)"]\n')
    assert run(["diagnose", TEDUSAR, "--observations", str(sets)]) == 2
    captured = capsys.readouterr()
    found = [json.loads(line) for line in captured.out.splitlines()]
    assert [one.get("error", {}).get("code") for one in found] == [None, *["bad-observation"] * 3, None]
    assert "refused 3 of 5 sets" in captured.err


def test_sets_come_from_stdin_too(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    import io

    monkeypatch.setattr("sys.stdin", io.StringIO('["not ok(scan)"]\n'))
    assert run(["diagnose", TEDUSAR, "--observations", "-"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1


def test_a_circuit_is_diagnosed(tmp_path: Path, capsys: Capture) -> None:
    bench = tmp_path / "two.bench"
    bench.write_text("INPUT(a)\nOUTPUT(z)\ny = NOT(a)\nz = NOT(y)\n")
    found = answer(capsys, str(bench), "-o", "v(a) and not v(z)")
    assert [d["bad"] for d in found["diagnoses"]] == [["y"], ["z"]]
