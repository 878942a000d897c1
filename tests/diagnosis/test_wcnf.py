"""Files of several observations, good and bad."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from robomend.diagnosis.snapshots import diagnose_snapshots
from robomend.diagnosis.wcnf import parse_wcnf, read_wcnf
from robomend.errors import ModelError
from robomend_client.literals import fails, holds

INVERTERS = """\
c mutated gates: second
c # observ: 2
o 1 -3 0
o -1 -3 0
p wcnf 5 6 3
1 4 0
1 5 0
3 -4 1 2 0
3 -4 -1 -2 0
3 -5 2 3 0
3 -5 -2 -3 0
"""


def test_components_observations_and_the_rest_are_numbered_in_turn() -> None:
    read = parse_wcnf(INVERTERS.splitlines(), "inverters")
    assert read.cnf.components == ("4", "5")
    assert [str(atom) for atom in read.cnf.atoms] == ["v(1)", "v(3)"]
    assert read.cnf.clauses[0] == (-1, 3, 5)
    assert read.cnf.variables == 5
    assert read.cnf.weak
    assert read.snapshots == ((holds("v", "1"), fails("v", "3")), (fails("v", "1"), fails("v", "3")))


def test_plain_and_packed_files_read_alike(tmp_path: Path) -> None:
    plain, packed = tmp_path / "inverters.wcnf", tmp_path / "inverters.wcnf.gz"
    plain.write_text(INVERTERS)
    packed.write_bytes(gzip.compress(INVERTERS.encode()))
    assert read_wcnf(plain) == read_wcnf(packed)
    assert read_wcnf(plain).cnf.name == "inverters"


def test_its_diagnoses_speak_of_the_files_variables() -> None:
    read = parse_wcnf(INVERTERS.splitlines(), "inverters")
    result = diagnose_snapshots(read.cnf, read.snapshots)
    assert [diagnosis.bad for diagnosis in result.diagnoses] == [("4",), ("5",)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no line 'p wcnf"),
        ("1 4 0\n", "f:1: a clause before"),
        ("p wcnf 5 6\n", "f:1: expected 'p wcnf"),
        ("p wcnf 5 6 3\n3 x 0\n", "f:2: expected integers"),
        ("p wcnf 5 6 3\n3 1 2\n", "f:2: expected integers"),
        ("p wcnf 5 6 3\n1 1 2 0\n", "f:2: a soft clause must be one positive"),
        ("p wcnf 5 6 3\n1 -1 0\n", "f:2: a soft clause must be one positive"),
        ("p wcnf 5 6 3\n1 1 0\n1 1 0\n", "two soft clauses"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(text: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        parse_wcnf(text.splitlines(), "f", "f")


def test_a_broken_archive_is_a_model_error(tmp_path: Path) -> None:
    path = tmp_path / "cut.wcnf.gz"
    path.write_bytes(gzip.compress(INVERTERS.encode())[:-20])
    with pytest.raises(ModelError, match="gzip"):
        read_wcnf(path)
