"""Which format a text is in: it decides by itself, unless somebody says so."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import pytest
from tests.robomend_batch.running import TEDUSAR, batch_run, logs

from robomend.cli.commands import run
from robomend.errors import ModelError
from robomend.model.loading import FORMATS, load_model, load_text
from robomend.model.other_formats import named

TEXTS = {
    "component": "robomend: 1\nnodes: [a]\n",
    "five-key": 'ab: AB\nnab: NAB\nneg_prefix: not_\nprops: [ok(t)]\nrules: ["NAB(a) -> ok(t)"]\n',
    "bench": "# a comment\n\n z = NOT(a)\nINPUT(a)\nOUTPUT(z)\n",
}


@pytest.mark.parametrize("format", FORMATS)
def test_a_text_says_by_itself_what_it_is_and_may_be_told(format: str) -> None:
    assert load_text(TEXTS[format]).format == format
    assert load_text(TEXTS[format], format=format).format == format


@pytest.mark.parametrize(("format", "other"), [*permutations(FORMATS, 2)])
def test_what_it_is_said_to_be_it_must_be(format: str, other: str) -> None:
    with pytest.raises(ModelError):
        load_text(TEXTS[format], format=other)


def test_what_is_no_model_is_told_what_models_begin_with() -> None:
    with pytest.raises(ModelError, match=r"begins with `robomend: 1`.*INPUT"):
        load_text("a: 1\n", file="x.yaml")
    with pytest.raises(ModelError, match="begins with `robomend: 1`"):  # not a five-key model with odd keys
        load_text("nodes: {n: {}}\nrules: []\n")
    with pytest.raises(ModelError, match="no model format is named `yaml`; there are component, five-key"):
        load_text("robomend: 1\n", format="yaml")


# --- files of other programs are called by their names

SAMPLES = {
    "a ROS 1 bag": "#ROSBAG V2.0\nE\x00\x00",
    "a ULog of PX4": "ULog\x01\x125",
    "a zip archive": "PK\x03\x04\x14",
    "metadata of rosbag2": "rosbag2_bagfile_information:\n  version: 5\n",
    "a URDF robot description": "<?xml version='1.0'?>\n<!-- <launch> -->\n<robot name='r'><link/></robot>",
    "an SDF world": "<?xml version='1.0'?>\n<sdf version='1.6'></sdf>",
    "a launch file in XML": "<!-- the <robot> -->\n<launch>\n  <node pkg='p' type='t' name='n'/>\n</launch>",
    "a launch file in Python": "from launch import LaunchDescription\n\ndef generate_launch_description():\n"
    "    ld = LaunchDescription([])\n    return ld\n",
    "a launch file in YAML": "launch:\n- node:\n    pkg: p\n    exec: e\n",
    "analyzers of diagnostic_aggregator": "pub_rate: 1.0\nanalyzers:\n  power:\n"
    "    type: diagnostic_aggregator/GenericAnalyzer\n    path: Power\n",
    "a graph of Graphviz": "digraph graphname {\n  a -> b;\n}\n",
    "a clause list in DIMACS (WCNF, CNF)": "c one\np wcnf 3 2 10\n10 1 -2 0\n1 3 0\n",
    "a circuit in Verilog": "// c17\nmodule c17 (N1, N2);\ninput N1;\nnot n (N2, N1);\nendmodule\n",
    "a LyDiA model": "system inverter(bool i, o)\n{\n  bool h;\n  h => (o = !i);\n}\n",
    "PDDL": "; a domain\n(define (domain robot)\n  (:requirements :strips))\n",
    "an SMT-LIB script": "(set-logic QF_UF)\n(declare-fun a () Bool)\n",
    "an answer set program (or Prolog)": "% a diagnosis\n{ ab(C) } :- component(C).\n",
    "a file of Python": "import os\n\nprint(os.name)\n",
}


@pytest.mark.parametrize("name", SAMPLES)
def test_a_model_in_another_format_is_called_by_its_name(name: str, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=f"^.*this is {name}: ".replace("(", "\\(").replace(")", "\\)")):
        load_text(SAMPLES[name])
    file = tmp_path / "model"
    file.write_text(SAMPLES[name])
    with pytest.raises(ModelError) as caught:
        load_model(file)
    assert f"this is {name}: " in str(caught.value)


@pytest.mark.parametrize("name", ["a graph of Graphviz", "a ULog of PX4"])  # the same table as for models
def test_a_log_in_another_format_is_called_by_its_name(name: str, tmp_path: Path) -> None:
    log = tmp_path / "some.log"
    log.write_text(SAMPLES[name])
    assert batch_run(tmp_path / "out", log) == 2
    (record,) = logs(tmp_path / "out")
    assert record["problems"][0]["reason"].startswith(f"this is {name}: ")


def test_observations_in_another_format_are_called_by_their_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "observations.txt"
    file.write_text(SAMPLES["a launch file in XML"].split("\n", 1)[1])
    assert run(["diagnose", TEDUSAR, "--observations", str(file)]) == 2
    assert "this is a launch file in XML: " in capsys.readouterr().err


def test_what_is_ours_is_never_called_something_else() -> None:
    broken = "robomend: 1\nname: x\nrules: [\n# as in <launch>, and p cnf 1 2\np cnf 1 2\n"
    assert named(broken) is None
    with pytest.raises(ModelError, match="agent's file"):
        load_text("service: {url: 'http://127.0.0.1'}\nobservers: {}\n")
