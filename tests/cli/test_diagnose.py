"""`robomend diagnose`: its answer as JSON and in words, what is refused, several snapshots of a robot."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest

from robomend.cli.commands import run
from robomend.resources import resource

TEDUSAR = str(resource("examples", "tedusar.yaml"))
MANIPULATOR = str(resource("examples", "mobile_manipulator.yaml"))
Capture = pytest.CaptureFixture[str]

TWO_INVERTERS = """\
c mutated gates: 3
o 1 -2 0
o -1 2 0
p wcnf 5 6 3
1 4 0
1 5 0
3 -4 1 3 0
3 -4 -1 -3 0
3 -5 3 2 0
3 -5 -3 -2 0
"""
"""Net 1 through gates 4 and 5 to net 2, which shows the opposite of what it should, twice."""


def answer(capsys: Capture, *arguments: str) -> dict[str, Any]:
    assert run(["diagnose", *arguments, "--format", "json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def bad(found: dict[str, Any]) -> list[list[str]]:
    return [diagnosis["bad"] for diagnosis in found["diagnoses"]]


def lines(capsys: Capture, *arguments: str) -> list[str]:
    """Return what the command shows."""
    assert run(["diagnose", *arguments]) == 0
    return capsys.readouterr().out.splitlines()


def test_a_healthy_robot_is_no_fault_and_another_exits_with_1(capsys: Capture) -> None:
    found = answer(capsys, TEDUSAR, "--observe", "ok(scan) and ok(odom)", "--fail-on-fault")
    assert bad(found) == [[]]
    assert lines(capsys, TEDUSAR)[0] == "healthy, for all we know: nothing was observed"
    assert run(["diagnose", TEDUSAR, "-o", "not ok(scan)", "--fail-on-fault"]) == 1
    assert "hokuyo_node" in capsys.readouterr().out


def test_what_if(capsys: Capture) -> None:
    assert bad(answer(capsys, TEDUSAR, "-o", "not ok(scan)", "--assume-healthy", "hokuyo")) == [
        ["hokuyo_node"]
    ]
    assert bad(answer(capsys, TEDUSAR, "-o", "not ok(scan)", "--assume-abnormal", "/hokuyo")) == [["hokuyo"]]
    assert bad(answer(capsys, TEDUSAR, "-o", "not running(rviz)", "--expect-stopped", "rviz")) == [[]]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-o", "not ok(scam)"], "did you mean scan"),
        (["-o", "ok(scan"], "position 7"),
        (["--timeout", "-1"], "--timeout"),
        (["--observations", "-", "-o", "ok(scan)"], "either"),
        (["--assume-abnormal", "rviz", "--assume-healthy", "rviz"], "rviz"),
        (["--assume-healthy", "rvis"], "did you mean 'rviz'"),
    ],
)
def test_wrong_observations_and_options_exit_with_2(arguments: list[str], said: str, capsys: Capture) -> None:
    assert run(["diagnose", TEDUSAR, *arguments]) == 2
    assert said in capsys.readouterr().err


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


# --- as a person reads it


def test_many_alike_are_counted_and_the_next_step_is_said(capsys: Capture) -> None:
    shown = lines(capsys, MANIPULATOR, "-o", "not ok(cmd_vel)")
    assert shown[0] == "18 diagnoses, any one of which explains what was seen:"
    assert shown[2:8] == [
        "   13.2%  head_camera_driver",
        "    9.8%  head_camera",
        "    9.8%  localization",
        "    6.5%  usb_hub",
        "    6.5%  front_lidar",
        "  … and 13 more, 54.4% together",
    ]
    assert shown[shown.index("look next at") + 1].startswith("  ok(head_depth)  16 of 18 diagnoses left if")
    assert len(shown) < 25


def test_what_is_cut_short_says_by_what_and_how_to_get_more(capsys: Capture) -> None:
    shown = lines(capsys, TEDUSAR, "-o", "not ok(scan)", "--limit", "1")
    assert shown[:4] == [
        "2 diagnoses, any one of which explains what was seen:",
        "",
        "  hokuyo",
        "  … and 1 more",
    ]
    assert shown[-1].startswith("incomplete: stopped by limit (see --limit); ")
    shown = lines(capsys, MANIPULATOR, "-o", "not ok(cmd_vel)", "--timeout", "1e-9")
    assert shown[0] == "no diagnosis found: the search was stopped by time"


def test_without_a_way_to_tell_them_apart_the_reason_is_said(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "twins.yaml").write_text(
        "robomend: 1\nhardware: {a: {}, b: {}}\nproperties: [p]\n"
        "rules: ['not ab(a) and not ab(b) -> ok(p)']\n"
    )
    shown = lines(capsys, str(tmp_path / "twins.yaml"), "-o", "not ok(p)")
    assert "nothing to look at: everything that can be observed is observed already" in shown


def test_no_line_is_wider_than_a_terminal(tmp_path: Path, capsys: Capture) -> None:
    names = [f"{'x' * 70}_{number}" for number in range(20)]
    (tmp_path / "long.yaml").write_text(f"robomend: 1\nnodes: [{', '.join(names)}]\n")
    down = [word for name in names for word in ("-o", f"not running({name})")]
    silent = [word for topic in ("cmd_vel", "objects", "joint_states") for word in ("-o", f"not ok({topic})")]
    for model, seen in ((MANIPULATOR, silent), (str(tmp_path / "long.yaml"), down)):
        for more in ([], ["--all"]):
            assert max(map(len, lines(capsys, model, *seen, *more))) <= 80


# --- several snapshots, what was learned, and bounds


def test_each_observation_says_what_it_taught_and_each_diagnosis_what_it_resolves(capsys: Capture) -> None:
    found = answer(capsys, TEDUSAR, "-o", "not ok(scan)", "-o", "not ok(odom)", "-o", "ok(joy)")
    assert found["learned"] == {
        "not ok(scan)": "one of hokuyo and hokuyo_node is abnormal",
        "not ok(odom)": "one of jaguar and jaguar_node is abnormal",
    }
    assert {*found["cleared"]} == {"hokuyo_node", "jaguar_node"}
    assert all(sorted(diagnosis["resolves"]) == [0, 1] for diagnosis in found["diagnoses"])
    assert [*found][-1] == "elapsed_s"


def test_snapshots_of_one_robot_have_one_answer(tmp_path: Path, capsys: Capture) -> None:
    sets = tmp_path / "sets"
    sets.write_text('["not ok(scan)"]\n\nnot ok(odom), ok(scan)\n')
    found = answer(capsys, TEDUSAR, "--observations", str(sets), "--together")
    assert len(bad(found)) == 4
    assert all(len(one) == 2 for one in bad(found))
    narrowed = answer(
        capsys, TEDUSAR, "--observations", str(sets), "--together", "--assume-healthy", "hokuyo"
    )
    assert bad(narrowed) == [["jaguar", "hokuyo_node"], ["jaguar_node", "hokuyo_node"]]
    assert run(["diagnose", TEDUSAR, "--observations", str(sets), "--together", "--fail-on-fault"]) == 1
    assert "4 diagnoses, any one of which explains what was seen" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["two.wcnf", "two.wcnf.gz"])
def test_a_file_of_several_observations_is_a_model(name: str, tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / name
    data = TWO_INVERTERS.encode()
    path.write_bytes(gzip.compress(data) if name.endswith("gz") else data)
    assert bad(answer(capsys, str(path))) == [["4"], ["5"]]
    assert bad(answer(capsys, str(path), "--assume-healthy", "4")) == [["5"]]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--together"], "--together needs --observations"),
        (["--observations", "SETS", "--together", "--engine", "asp"], "'asp' cannot be asked"),
        (["--observations", "SETS", "--together", "--factored"], "not available for several snapshots"),
        (["--observations", "WRONG", "--together"], "snapshot 2: "),
        (["--observations", "RICH", "--together"], "snapshot 1: snapshots are literals only"),
    ],
)
def test_what_snapshots_cannot_do_is_refused(
    arguments: list[str], said: str, tmp_path: Path, capsys: Capture
) -> None:
    for name, text in {
        "SETS": '["not ok(scan)"]\n',
        "WRONG": '["ok(scan)"]\n["ok(scam)"]\n',
        "RICH": "ok(scan) or ok(odom)\n",
    }.items():
        (tmp_path / name).write_text(text)
    given = [str(tmp_path / word) if word.isupper() else word for word in arguments]
    assert run(["diagnose", TEDUSAR, *given]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "more", "said"),
    [
        ("two.wcnf", ["-o", "v(1)"], "has its observations in it"),
        ("two.wcnf", ["--expect-stopped", "4"], "is for robots"),
        ("missing.wcnf", [], "cannot be read"),
    ],
)
def test_what_a_file_of_snapshots_cannot_take_is_refused(
    name: str, more: list[str], said: str, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "two.wcnf").write_text(TWO_INVERTERS)
    assert run(["diagnose", str(tmp_path / name), *more]) == 2
    assert said in capsys.readouterr().err


CHAIN = "INPUT(a)\nOUTPUT(g9)\ng0 = NOT(a)\n" + "".join(f"g{i} = NOT(g{i - 1})\n" for i in range(1, 10))


def test_a_list_that_is_cut_short_says_how_to_count_the_rest(tmp_path: Path, capsys: Capture) -> None:
    circuit = tmp_path / "chain.bench"
    circuit.write_text(CHAIN)
    least = ["diagnose", str(circuit), "-o", "v(a) and not v(g9)", "--minimal", "cardinality"]
    assert run([*least, "--limit", "3"]) == 0
    captured = capsys.readouterr()
    assert "incomplete: stopped by limit" in captured.out
    assert "more than 3 diagnoses; --minimal cardinality --factored counts" in captured.err
    assert run([*least, "--factored"]) == 0
    captured = capsys.readouterr()
    assert "10 diagnoses, any one of which explains what was seen" in captured.out
    assert not captured.err


def test_all_minimal_conflicts_are_told_where_they_are_asked_for(tmp_path: Path, capsys: Capture) -> None:
    circuit = tmp_path / "two.bench"
    circuit.write_text("INPUT(a)\nOUTPUT(y)\nn = NOT(a)\nm = NOT(a)\ny = AND(n, m)\n")
    for more, whole in (["--no-conflicts"], 0), ([], 1), (["--all-conflicts"], 2):
        asked = ["diagnose", str(circuit), "-o", "v(a) and v(y)", "--limit", "1", "--format", "json", *more]
        assert run(asked) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["conflicts_all"] == (whole == 2)
        assert len(told["conflicts"]) == whole
    sets = ["--observations", str(tmp_path / "sets"), "--together", "--all-conflicts"]
    (tmp_path / "sets").write_text('["not v(a)"]\n')
    assert run(["diagnose", str(circuit), *sets]) == 2
    assert "all minimal conflicts" in capsys.readouterr().err


CIRCLE = """
robomend: 1
nodes:
  ctl: {publishes: {cmd: [state]}}
  est: {publishes: {state: [cmd], odom: [state]}}
"""


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (
            "not ok(odom)",
            "topic odom: waits for itself, in a circle (cmd ← state ← cmd), so that silence alone",
        ),
        ("ok(odom)", ""),
    ],
)
def test_a_silence_that_blames_nobody_is_said_to_be_one(
    seen: str, said: str, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "circle.yaml").write_text(CIRCLE)
    assert run(["diagnose", str(tmp_path / "circle.yaml"), "-o", seen]) == 0
    told = capsys.readouterr()
    assert "healthy" in told.out
    assert (said in told.err) if said else told.err == ""
