"""Files of other programs, called by their names where a model, observations or a log was expected.

A row: what the format is called, how its text (or its first bytes) is told, and what one can do with it here.
"""

from __future__ import annotations

import re

LOOKED_AT = 20_000
"""Characters; whoever writes longer comments is told what is wrong in general words."""


XML = r"\A\s*(?:<!--[\s\S]*?-->\s*|<[?!][^>]*>\s*)*"
"""What stands before the first element."""

OURS = r"^robomend\s*:"

FROM_ROS = "`robomend model from-ros` drafts a model of a running robot, or of its launch files"
FROM_LAUNCH = "`robomend model from-ros --launch FILE` drafts a model of it"
RECORDING = (
    "a recording is read by `robomend-batch run`, and a first model made of it by `robomend-batch learn`"
)
CIRCUIT = "write it as a .bench netlist (abc and yosys convert: `write_bench`)"

FORMATS: tuple[tuple[str, str, str], ...] = (
    ("a ROS 1 bag", r"\A#ROSBAG V", RECORDING),
    ("an MCAP recording", r"\A\x89MCAP0", RECORDING),
    ("an SQLite file, as .db3 of rosbag2", r"\ASQLite format 3", RECORDING),
    ("a ULog of PX4", r"\AULog\x01", "convert it to CSV or a bag first (pyulog: `ulog2csv`, `ulog2rosbag`)"),
    ("a bag of an old ROS", r"\A#ROS(?:RECORD|BAG V1)", "convert it first: `rosbag fix`"),
    ("a zip archive", r"\APK\x03\x04", "unpack it first"),
    ("an xz archive", r"\A\ufffd7zXZ", "unpack it first (xz -d)"),
    ("an lz4 file", r"\A\x04\"M\x18", "unpack it first (lz4 -d)"),
    ("a PDF", r"\A%PDF-", "it is none that is read"),
    (
        "metadata of rosbag2",
        r"^rosbag2_bagfile_information:",
        "name the folder that it is in, or the .mcap or .db3 beside it",
    ),
    ("a URDF robot description", XML + r"<robot\b", f"it has links and joints, no nodes. {FROM_ROS}"),
    ("an SDF world", XML + r"<sdf\b", f"it has links and joints, no nodes. {FROM_ROS}"),
    ("a launch file in XML", XML + r"<launch\b", FROM_LAUNCH),
    ("a launch file in Python", r"\bLaunchDescription\s*\(|def generate_launch_description", FROM_LAUNCH),
    ("a launch file in YAML", r"^launch:\s*$", FROM_LAUNCH),
    ("a package manifest of ROS", XML + r"<package\b", FROM_ROS),
    ("an XML file", r"\A\s*<\?xml", "it is none that is read"),
    (
        "analyzers of diagnostic_aggregator",
        r"type:\s*['\"]?diagnostic_aggregator/",
        "`robomend model from-ros --analyzers FILE` drafts a model of its groups",
    ),
    (
        "a graph of Graphviz",
        r"\A\s*(?:strict\s+)?(?:di)?graph\b[^{]*\{",
        "of one that rqt_graph has saved, `robomend model from-ros --dump FILE` drafts a model",
    ),
    (
        "a clause list in DIMACS (WCNF, CNF)",
        r"^p\s+w?cnf\s",
        "it names no components. A system with several observations has a name that ends in .wcnf; else take "
        "the circuit or model that it was made of",
    ),
    ("a circuit in AIGER", r"\Aa[ai]g \d+ \d+", CIRCUIT),
    ("a circuit in BLIF", r"^\.model\b", CIRCUIT),
    ("a circuit in Verilog", r"^\s*module\s+\\?\w+\s*[(;#]", CIRCUIT),
    ("a circuit in VHDL", r"(?i)^\s*entity\s+\w+\s+is\b", CIRCUIT),
    (
        "a LyDiA model",
        r"^\s*system\s+\w+\s*\(|^\s*attribute\s+\w+.*;|^\s*type\s+\w+\s*=\s*enum\b",
        "write its components and rules as a component model (`robomend init model`); of circuits a .bench "
        "netlist will do",
    ),
    (
        "PDDL",
        r"^\s*\(\s*define\s*\(\s*(?:domain|problem)\b",
        "it is for repairs: `robomend plan --domain FILE`, beside a model",
    ),
    (
        "an SMT-LIB script",
        r"^\s*\((?:set-logic|declare-fun|assert)\b",
        "write its rules as a five-key model",
    ),
    (
        "an answer set program (or Prolog)",
        r"^\s*(?:[a-z_]\w*(?:\([^()]*\))?\s*\.|(?:[a-z\d{][^%\n:]*)?:-(?:[^\n]*\.)?|#(?:show|const|program|minimize|include)\b.*\.)\s*(?:%.*)?$",
        "write components and rules as a component model (`robomend init model`) or a five-key model",
    ),
    ("a file of Python", r"^(?:from|import)\s+\w|^def\s+\w+\(", "a model is YAML or a .bench netlist"),
)


def named(text: str) -> str | None:
    """Return what a text is and what to do with it; None if nobody here knows it."""
    head = text[:LOOKED_AT].removeprefix("\ufeff")
    if re.search(OURS, head, re.MULTILINE):
        return None
    return next(
        (
            f"this is {name}: {advice}"
            for name, pattern, advice in FORMATS
            if re.search(pattern, head, re.MULTILINE)
        ),
        None,
    )


def named_bytes(data: bytes) -> str | None:
    """Return the same of the beginning of a file, whatever its encoding."""
    return named(data[:LOOKED_AT].decode("utf-8", errors="replace"))
