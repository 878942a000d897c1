"""`robomend diagnose`: several snapshots of one robot, what was learned, and bounds."""

from __future__ import annotations

import gzip
import io
import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from robomend.cli.commands import run
from robomend.resources import resource

TEDUSAR = str(resource("examples", "tedusar.yaml"))
Capture = pytest.CaptureFixture[str]

ROOT = Path(__file__).parents[2]
EXAMPLES = re.findall(
    r"^```console\n\$ (.*)\n([^`]*)^```", (ROOT / "docs" / "diagnosis.md").read_text(), re.MULTILINE
)

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


@pytest.mark.parametrize(("line", "shown"), EXAMPLES)
def test_the_examples_in_the_docs_show_what_is_answered(
    line: str, shown: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(ROOT)
    words = shlex.split(line)
    if "|" in words:
        at = words.index("|")
        monkeypatch.setattr("sys.stdin", io.StringIO(words[1].replace(r"\n", "\n")))
        words = words[at + 1 :]
    assert run(words[1:]) == 0
    told = [said.rstrip() for said in capsys.readouterr().out.rstrip().splitlines()]
    assert told[:-1] == shown.rstrip().splitlines()[:-1]  # the last line tells the time it took


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
