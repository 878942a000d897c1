"""compile, model check and init, as a user calls them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from robomend.cli.commands import run
from robomend.model.loading import load_model, load_text
from robomend.resources import resource

TEDUSAR = str(resource("examples", "tedusar.yaml"))
Capture = pytest.CaptureFixture[str]


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
