"""`robomend export` and `import`, as a user calls them."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path

import pytest
from tests.store.examples import entry, observe, with_robots

from robomend.cli.commands import run
from robomend.store import Store, robots
from robomend.store.records import AuditEntry

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A data folder with a robot that was observed."""
    folder = tmp_path / "data"

    async def fill() -> None:
        store = Store(f"sqlite:///{folder}/robomend.db")
        await store.start()
        await with_robots(store, "r1")
        await observe(store, "r1", entry("scan"))
        await store.close()

    asyncio.run(fill())
    return folder


def exported(capsys: Capture, folder: Path) -> list[str]:
    assert run(["export", "--data", str(folder)]) == 0
    return capsys.readouterr().out.splitlines()


def test_what_is_exported_can_be_imported_elsewhere(data: Path, tmp_path: Path, capsys: Capture) -> None:
    file, other = tmp_path / "all.ndjson", tmp_path / "other"
    assert run(["export", "--data", str(data), "--output", str(file)]) == 0
    assert file.stat().st_mode & 0o077 == 0
    assert run(["import", str(file), "--data", str(other)]) == 0
    assert "records into sqlite://" in capsys.readouterr().err
    assert exported(capsys, other) == exported(capsys, data)


def test_a_copy_of_sqlite_takes_the_place_of_the_database(
    data: Path, tmp_path: Path, capsys: Capture
) -> None:
    copy = tmp_path / "copied" / "robomend.db"
    copy.parent.mkdir()
    assert run(["export", "--data", str(data), "--format", "sqlite", "--output", str(copy)]) == 0
    assert [line for line in exported(capsys, copy.parent) if '"events"' in line]


def test_secrets_are_covered_unless_they_are_asked_for(data: Path, capsys: Capture) -> None:
    hook = {"url": "https://example.org/a?token=s3cr3t", "secret": "t0p"}
    actions = {"call": {"executor": {"kind": "webhook", "options": hook}}}

    async def configure() -> None:
        store = Store(f"sqlite:///{data}/robomend.db")
        await store.start()
        config = {**(await store.read(robots.get, "r1")).config, "actions": actions}
        await store.write(lambda tx: robots.put(tx, "r1", config, expected="*"))
        # As an older version may have noted it.
        await store.write(lambda tx: tx.note(AuditEntry("ann", "robot.put", "r1", "r1", after=config)))
        await store.close()

    asyncio.run(configure())
    shown = "\n".join(exported(capsys, data))
    assert "https://example.org/a?**********" in shown
    assert "s3cr3t" not in shown
    assert "t0p" not in shown
    assert run(["export", "--data", str(data), "--with-secrets"]) == 0
    asked = capsys.readouterr().out
    assert asked.count("s3cr3t") == asked.count("t0p") == 2


def test_nothing_is_overwritten(data: Path, tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "precious"
    file.write_text("precious")
    for format_ in ("ndjson", "sqlite"):
        assert run(["export", "--data", str(data), "--format", format_, "-o", str(file)]) == 2
    assert run(["import", str(file), "--data", str(data)]) == 2
    assert "not empty" in capsys.readouterr().err
    assert file.read_text() == "precious"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"revision":1', '"revision":9223372036854775808', "number of 64 bits"),
        ('"revision":1', '"revision":"1"', "number of 64 bits"),
        ('"id":"r1"', '"id":"../../x"', "no name"),
        ('"robot":"r1"', '"robot":"r1\\n"', "no name"),
        ('{"end":true', '{"end":true}\n{"end":true', "cut off|rows were exported"),
    ],
)
def test_what_no_database_of_ours_holds_is_refused_with_its_line(
    data: Path, tmp_path: Path, capsys: Capture, old: str, new: str, said: str
) -> None:
    lines = exported(capsys, data)
    at = next(number for number, line in enumerate(lines) if old in line)
    lines[at] = lines[at].replace(old, new, 1)
    file, other = tmp_path / "all.ndjson", tmp_path / "new"
    file.write_text("\n".join(lines))
    assert run(["import", str(file), "--data", str(other)]) == 2
    err = capsys.readouterr().err
    assert re.search(said, err)
    assert f"line {at + 1}: " in err
    assert run(["import", str(tmp_path / "none"), "--data", str(other)]) == 2  # nothing of it was taken


def test_bad_input_is_named(data: Path, tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "bad"
    file.write_bytes(b"\xff\xfe")
    assert run(["import", str(file), "--data", str(tmp_path / "new")]) == 2
    assert run(["import", str(tmp_path / "none"), "--data", str(tmp_path / "new")]) == 2
    assert run(["export", "--data", str(data), "--format", "sqlite"]) == 2
    assert run(["export", "--database", "mysql://x/y"]) == 2
    err = capsys.readouterr().err
    assert "none" in err
    assert "--output" in err
    assert "mysql" in err
