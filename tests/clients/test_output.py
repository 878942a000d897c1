"""What processes print, in files with a bound."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from robomend_client.agent.processes import OutputFile


def size(output: OutputFile) -> int:
    return sum(file.stat().st_size for file in (output.file, output.before) if file.exists())


def test_the_newest_output_is_kept_within_the_bound(tmp_path: Path) -> None:
    output = OutputFile(tmp_path / "logs", "ns/laser", 1000)
    for number in range(500):
        output.write(b"line %d\n" % number)
        assert size(output) <= 1000
    assert output.file.name == "ns%2Flaser.log"
    kept = output.before.read_bytes() + output.file.read_bytes()
    assert kept.endswith(b"line 499\n")
    assert len(kept) > 500
    assert output.tail(9) == b"line 499\n"


def test_one_piece_larger_than_the_bound_is_cut(tmp_path: Path) -> None:
    output = OutputFile(tmp_path, "a", 100)
    output.write(b"x" * 1000 + b"end")
    assert size(output) <= 100
    assert output.tail(3) == b"end"


def test_a_process_that_writes_by_itself_is_cut_back_while_it_writes(tmp_path: Path) -> None:
    output = OutputFile(tmp_path, "a", 1000)
    descriptor = output.open()
    assert descriptor is not None
    try:
        for number in range(200):
            subprocess.run(
                ["echo", f"line {number}"], stdout=descriptor, check=True
            ) if number < 5 else os.write(descriptor, b"line %d\n" % number)
            if number % 10 == 0:
                output.trim()
                assert size(output) <= 1000
    finally:
        os.close(descriptor)
    assert output.tail(9) == b"line 199\n"
    output.trim()
    assert size(output) <= 1000


def test_a_disk_that_cannot_be_written_is_told_once_and_stops_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "logs").write_text("a file where the folder should be")
    output = OutputFile(tmp_path / "logs", "a", 1000)
    for _ in range(3):
        output.write(b"x")
    assert len(caplog.records) == 1
    assert output.open() is None
    assert output.tail(10) == b""
