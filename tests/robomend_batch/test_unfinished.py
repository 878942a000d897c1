"""A log in hand is gone on with where it was left, and what it leaves is what an undisturbed run leaves."""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from tests.robomend_batch.recordings import EPOCH_NS, Sample, write
from tests.robomend_batch.rover import MODEL, OBSERVERS, drive, drive_in_chunks
from tests.robomend_batch.running import TEDUSAR, tree

from robomend.diagnosis.result import Options
from robomend.model.loading import load_model
from robomend_batch import parts, unfinished
from robomend_batch.logs import export, parquet, recorded, samples, text
from robomend_batch.one_log import Diagnoser, Record, Setup, state_file
from robomend_client.observers import Driver
from robomend_client.observers.base import SECOND
from robomend_client.observers.kinds import read_observers, read_topics
from robomend_client.observers.recording import Recording
from robomend_client.yaml_reader import read

SAID = ("ok(scan)", "not ok(scan)", "ok(odom)", "not ok(odom)", "on(jaguar)", "not on(jaguar)", "ok(map)")


@pytest.fixture(autouse=True)
def in_small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many places to go on from, and every one of them is kept."""
    for module in (text, export, samples, parquet):
        monkeypatch.setattr(module, "TOGETHER", 64)
    monkeypatch.setattr(recorded, "SLICE", 50)
    monkeypatch.setattr(parts, "PART", 70)
    monkeypatch.setattr(unfinished, "EVERY_S", 0.0)
    monkeypatch.setattr(unfinished, "SHARE", 0)


def rows(count: int = 600) -> list[tuple[int, str, float | None]]:
    """Times, some of them late and one far back; literals; lifetimes."""
    chance = random.Random(5)
    found: list[tuple[int, str, float | None]] = []
    for number in range(count):
        time_ns = (number - (400 if number >= 400 else 0)) * SECOND // 5 - chance.randrange(3) * SECOND // 9
        lifetime_s = chance.choice([None, None, 0.5, 3.0])
        found.append((EPOCH_NS + max(time_ns, 0), chance.choice(SAID), lifetime_s))
    return found


def ndjson(file: Path) -> None:
    keys = "time", "literal", "lifetime"
    file.write_text("".join(json.dumps(dict(zip(keys, row, strict=True))) + "\n" for row in rows()))


def several(file: Path) -> None:
    """Three logs in one file."""
    lines = [
        {"time": time, "literal": said, "log": "abc"[number % 3]}
        for number, (time, said, _) in enumerate(rows(400))
    ]
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))


def csv(file: Path) -> None:
    """A wide table, whose later columns are known from its head only."""
    chance = random.Random(7)
    cells = "".join(
        f"{time},{','.join(chance.choice(['true', 'false', '']) for _ in range(3))}\n"
        for time, _, _ in rows()
    )
    file.write_text("time,ok(scan),ok(odom),on(jaguar)\n" + cells)


def long_parquet(file: Path) -> None:
    times, said, lifetimes = zip(*rows(), strict=True)
    pl.DataFrame({"time": times, "literal": said, "lifetime": lifetimes}).write_parquet(
        file, row_group_size=100
    )


def wide_parquet(file: Path) -> None:
    chance = random.Random(9)
    table: dict[str, list[Any]] = {"time": sorted(time for time, _, _ in rows())}
    for atom in ("ok(scan)", "ok(odom)", "on(jaguar)"):
        table[atom] = [chance.choice([True, False, None]) for _ in table["time"]]
    pl.DataFrame(table).write_parquet(file, row_group_size=150)


def history(file: Path, table: str = "events", text: str = "batch") -> None:
    """As `robomend export` writes it."""
    lines: list[dict[str, Any]] = [{"robomend_export": 1, "schema": "0009"}]
    lines.append({"table": table, "row": {"robot": "r1", text: None, "kind": "robot"}})
    for number, (time_ns, said, lifetime_s) in enumerate(rows(500)):
        predicate, _, name = said.removeprefix("not ").removesuffix(")").partition("(")
        expires_ns = None if lifetime_s is None else time_ns + round(lifetime_s * SECOND)
        entry = [predicate, [name], not said.startswith("not"), "", time_ns, expires_ns]
        row = {"robot": f"r{number % 2}", text: json.dumps({"e": [entry]})}
        lines.append({"table": table, "row": row})
    lines.append({"end": True, "rows": 501})
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))


def old_history(file: Path) -> None:
    """As it was written up to schema 0008."""
    history(file, "observations", "data")


def agents(file: Path) -> None:
    """What an agent's observers were fed with."""
    observers = file.with_name("agent.yaml")
    top = read(observers)
    specs = (*(topic.observer for topic in read_topics(top)), *read_observers(top, file.parent))
    written = Recording(file, EPOCH_NS, 1 << 22)
    driver = Driver([spec.make() for spec in specs], EPOCH_NS, listeners=(written,))
    for time_s, topic, value in sorted(drive(), key=lambda one: one[0]):
        at_ns = EPOCH_NS + round(time_s * SECOND)
        if topic != "diagnostics":
            driver.sample(topic, at_ns, None, at_ns)
        if topic == "odom":
            driver.sample("odom:twist.twist.angular.z", at_ns, value, at_ns)
    driver.restart(EPOCH_NS + SECOND)
    driver.sample("scan", EPOCH_NS + 2 * SECOND, None, EPOCH_NS + 2 * SECOND)
    written.close(EPOCH_NS + 5 * SECOND)


def recording(file: Path) -> None:
    write(file, drive(), chunk_bytes=20_000)


def cut(file: Path) -> None:
    """The robot died."""
    recording(file)
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 4 // 5])


def twice(file: Path) -> None:
    """A bag in whose middle time goes back, so that it is not in the order of time."""
    again: list[Sample] = [(time + 8.0, topic, value) for time, topic, value in drive(4.0)]
    write(file, [*drive(), *again], stamp_s=0.0, chunk_bytes=20_000)


def chunks(file: Path) -> None:
    with file.open("wb") as written:
        drive_in_chunks(written, drive(20.0))


def overlapping(file: Path) -> None:
    """Chunks whose times overlap, so that some messages always wait for the next chunk."""
    with file.open("wb") as written:
        late: list[Sample] = [
            (time, topic, value) for time, topic, value in drive(20.0) if topic in ("odom", "scan")
        ]
        order = sorted(late, key=lambda one: one[0] - (1.3 if one[1] == "scan" else 0))
        drive_in_chunks(written, order, in_order=False)


def streamed(file: Path) -> None:
    with file.open("wb") as written:
        drive_in_chunks(written, drive(20.0), use_chunking=False)


LOGS: dict[str, Callable[[Path], None]] = {
    "long.ndjson": ndjson,
    "several.ndjson": several,
    "wide.csv": csv,
    "long.parquet": long_parquet,
    "wide.parquet": wide_parquet,
    "history.ndjson": history,
    "old_history.ndjson": old_history,
    "agent.jsonl": agents,
    "whole.bag": recording,
    "whole.db3": recording,
    "cut.bag": cut,
    "cut.db3": cut,
    "twice.bag": twice,
    "chunks.mcap": chunks,
    "overlapping.mcap": overlapping,
    "streamed.mcap": streamed,
}


def setup_for(log: Path, out: Path, **more: Any) -> Setup:
    """Return a set-up whose parts have their lines beside them, so that these are compared as well."""
    (out / "results").mkdir(parents=True)
    model, observers = log.with_name("rover.yaml"), log.with_name("agent.yaml")
    literals = log.suffix in (".ndjson", ".csv", ".parquet")
    system = load_model(TEDUSAR if literals else model)
    return Setup(
        system, Options(conflicts=False), out, observers=None if literals else observers, ndjson=True, **more
    )


def in_steps(setup: Setup, log: Path) -> tuple[list[Record], int]:
    """Diagnose a log, stopped at every place and gone on with by another process's solvers and observers."""
    shares: list[float] = []
    for step in range(300):
        diagnoser = Diagnoser(setup, shares.append)
        try:
            records = diagnoser.diagnose_for(str(log), 0.0)
        finally:
            diagnoser.close()
        if records is not None:
            state_file(setup.out, str(log)).unlink(missing_ok=True)
            assert shares == sorted(shares)
            assert all(0 <= share <= 1 for share in shares)
            assert step < 3 or shares[0] < shares[-1]
            return records, step
    raise AssertionError("it does not end")


@pytest.mark.parametrize(
    ("name", "together_s"), [*((name, None) for name in LOGS), ("long.ndjson", 2.0), ("whole.bag", 2.0)]
)
def test_a_log_that_is_stopped_at_every_place_leaves_the_same_bytes(
    name: str, together_s: float | None, tmp_path: Path
) -> None:
    (tmp_path / "rover.yaml").write_text(MODEL)
    (tmp_path / "agent.yaml").write_text(OBSERVERS)
    log = tmp_path / name
    LOGS[name](log)
    undisturbed = setup_for(log, tmp_path / "once", together_s=together_s)
    diagnoser = Diagnoser(undisturbed)
    expected = diagnoser.diagnose(str(log))
    diagnoser.close()
    state_file(undisturbed.out, str(log)).unlink(missing_ok=True)
    assert expected[0]["state"] in ("ok", "ended-early"), expected[0]["problems"]
    found, steps = in_steps(setup_for(log, tmp_path / "steps", together_s=together_s), log)
    assert steps >= 4
    assert found == expected
    assert tree(tmp_path / "steps") == tree(tmp_path / "once")


@pytest.mark.parametrize(("write", "key"), [(history, "robot"), (history, "batch"), (old_history, "data")])
def test_a_row_of_a_history_that_lacks_something_is_refused_with_its_line(
    write: Callable[[Path], None], key: str, tmp_path: Path
) -> None:
    log = tmp_path / "history.ndjson"
    write(log)
    lines = log.read_text().splitlines(keepends=True)
    lines[7] = lines[7].replace(f'"{key}"', '"x"')
    log.write_text("".join(lines))
    (record,) = in_steps(setup_for(log, tmp_path / "out"), log)[0]
    assert record["state"] == "refused"
    assert record["problems"][0]["place"] == f"{log}:8"


def test_a_log_that_has_changed_is_read_from_its_beginning(tmp_path: Path) -> None:
    log = tmp_path / "long.ndjson"
    ndjson(log)
    setup = setup_for(log, tmp_path / "out")
    first = Diagnoser(setup)
    assert first.diagnose_for(str(log), 0.0) is None
    first.close()
    log.write_text('{"time": 5, "literal": "ok(scan)"}\n')
    (record,) = in_steps(setup, log)[0]
    assert (record["start_ns"], record["state"]) == (5, "ok")


@pytest.mark.parametrize("damage", [b"", b"no pickle", b"\x80\x05K\x01."])
def test_a_state_that_cannot_be_read_costs_time_and_nothing_else(damage: bytes, tmp_path: Path) -> None:
    log = tmp_path / "long.ndjson"
    ndjson(log)
    setup = setup_for(log, tmp_path / "out")
    state_file(setup.out, str(log)).write_bytes(damage)
    (record,) = in_steps(setup, log)[0]
    assert record["state"] == "ok"


def test_a_state_that_somebody_else_wrote_is_not_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "x.state"
    unfinished.Unfinished(file, (1, 2), {}).save("known")
    assert unfinished.Unfinished(file, (1, 2), {}).load() == "known"
    me = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: me + 1)
    assert unfinished.Unfinished(file, (1, 2), {}).load() is None


@pytest.mark.parametrize(("own", "goes_on"), [("", True), (", most: float = 90", False)])
def test_an_observer_that_cannot_be_written_costs_the_state_and_not_the_log(
    own: str, goes_on: bool, tmp_path: Path
) -> None:
    """A function of somebody's own is found again; one that takes parameters beside the reading is not."""
    (tmp_path / "own.py").write_text(f"def cool(reading: float{own}) -> bool:\n    return reading < 90\n")
    (tmp_path / "rover.yaml").write_text(MODEL)
    (tmp_path / "agent.yaml").write_text(
        'hokuyo: {kind: "own.py:cool", source: "odom:twist.twist.angular.z"}\n'
    )
    log = tmp_path / "whole.bag"
    recording(log)
    setup = setup_for(log, tmp_path / "out")
    records, steps = in_steps(setup, log)
    assert (records[0]["state"], steps > 0) == ("ok", goes_on)


def test_the_parts_of_a_log_in_hand_are_there_until_it_is_gone_on_with(tmp_path: Path) -> None:
    log = tmp_path / "long.ndjson"
    ndjson(log)
    setup = setup_for(log, tmp_path / "out")
    diagnoser = Diagnoser(setup)
    for _ in range(4):
        assert diagnoser.diagnose_for(str(log), 0.0) is None
    diagnoser.close()
    before = {part.name: part.stat().st_mtime_ns for part in (setup.out / "results").glob("*.parquet")}
    assert before
    in_steps(setup, log)
    after = {part.name: part.stat().st_mtime_ns for part in (setup.out / "results").glob("*.parquet")}
    assert len(after) > len(before)
    assert before.items() <= after.items()
