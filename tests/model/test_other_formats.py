"""Files of other programs are called by their names, wherever a model, observations or a log is expected."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.robomend_batch.running import TEDUSAR, batch_run, logs

from robomend.cli.commands import run
from robomend.errors import ModelError
from robomend.model.loading import load_model, load_text
from robomend.model.other_formats import named

SAMPLES = {
    "a ROS 1 bag": "#ROSBAG V2.0\nE\x00\x00",
    "a ULog of PX4": "ULog\x01\x125",
    "a bag of an old ROS": "#ROSRECORD V1.1\n",
    "a zip archive": "PK\x03\x04\x14",
    "metadata of rosbag2": "rosbag2_bagfile_information:\n  version: 5\n",
    "a URDF robot description": "<?xml version='1.0'?>\n<!-- <launch> -->\n<robot name='r'><link/></robot>",
    "an SDF world": "<?xml version='1.0'?>\n<sdf version='1.6'></sdf>",
    "a launch file in XML": "<!-- the <robot> -->\n<launch>\n  <node pkg='p' type='t' name='n'/>\n</launch>",
    "a launch file in Python": "from launch import LaunchDescription\n\ndef generate_launch_description():\n"
    "    ld = LaunchDescription([])\n    return ld\n",
    "a launch file in YAML": "launch:\n- node:\n    pkg: p\n    exec: e\n",
    "an XML file": "<?xml version='1.0'?>\n<svg/>",
    "analyzers of diagnostic_aggregator": "pub_rate: 1.0\nanalyzers:\n  power:\n"
    "    type: diagnostic_aggregator/GenericAnalyzer\n    path: Power\n",
    "a graph of Graphviz": "digraph graphname {\n  a -> b;\n}\n",
    "a clause list in DIMACS (WCNF, CNF)": "c one\np wcnf 3 2 10\n10 1 -2 0\n1 3 0\n",
    "a circuit in AIGER": "aag 3 2 0 1 1\n2\n4\n6\n6 2 4\n",
    "a circuit in BLIF": ".model c17\n.inputs a b\n.outputs c\n.names a b c\n11 1\n.end\n",
    "a circuit in Verilog": "// c17\nmodule c17 (N1, N2);\ninput N1;\nnot n (N2, N1);\nendmodule\n",
    "a circuit in VHDL": "library ieee;\nentity c17 is\nend c17;\n",
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
