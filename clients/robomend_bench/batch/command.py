"""The command `robomend-bench batch`: how fast logs are diagnosed by robomend-batch, start-up included, and
how good the observers are that it learns.

The logs are the states of a random robot as Parquet, and a recording with messages of all sizes.
"""

from __future__ import annotations

import os
import random
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import click
import numpy as np
import polars as pl
import yaml
from mcap.writer import Writer

from robomend.errors import BackendError
from robomend_bench.batch import drives, edited, learning
from robomend_bench.generator import make_robot
from robomend_bench.parts import Figures, only, report
from robomend_client.observers.base import SECOND

COMPONENTS, SENSORS = 50, 20

BLOCK = 1 << 20
"""Rows that are written together."""

CHANGES = 0.05
"""Share of rows that differ from the one before."""


def write_model(file: Path, seed: int) -> list[str]:
    """Write the model of a robot; return atoms that are observed of it."""
    robot = make_robot(COMPONENTS, seed)
    model = robot.model
    description = {
        "robomend": 1,
        "name": model.name,
        "channels": model.channels,
        "hardware": {
            name: {} if device.channel is None else {"channel": device.channel}
            for name, device in model.hardware.items()
        },
        "nodes": {
            name: {
                "drives": list(node.drives),
                "publishes": {topic: list(inputs) for topic, inputs in node.publishes.items()},
            }
            for name, node in model.nodes.items()
        },
    }
    file.write_text(yaml.safe_dump(description, sort_keys=False))
    return random.Random(seed).sample(sorted(map(str, robot.cnf.atom_variable)), SENSORS)


def write_states(file: Path, atoms: list[str], rows: int, distinct: int, seed: int) -> None:
    """Write a wide log of so many rows with so many distinct states of noise, in blocks."""
    chance = np.random.default_rng(seed)
    codes = (
        chance.permutation(1 << SENSORS)[:distinct]
        if distinct > 1 << (SENSORS - 4)
        else noise(chance, distinct)
    )
    distinct = len(codes)
    frames = []
    newest = 0
    used = 0
    for start in range(0, rows, BLOCK):
        count = min(BLOCK, rows - start)
        if distinct >= rows:
            which = np.arange(start, start + count) % distinct
        else:
            changed = chance.random(count) < CHANGES
            fresh = np.flatnonzero(changed)
            states = np.empty(count, dtype=np.int64)
            states[fresh] = [(used + place) % distinct for place in range(len(fresh))]  # each of them occurs
            used += len(fresh)
            last = np.maximum.accumulate(np.where(changed, np.arange(count), -1))
            which = np.where(last < 0, newest, states[np.maximum(last, 0)])
            newest = int(which[-1])
        seen = codes[which]
        columns = {atom: (seen >> place & 1).astype(bool) for place, atom in enumerate(atoms)}
        time = np.arange(start, start + count, dtype=np.int64) * 10_000_000
        part = file.with_name(f"{file.stem}-{start}.part")
        pl.DataFrame({"time": time, **columns}).write_parquet(part)
        frames.append(part)
    pl.scan_parquet(frames).sink_parquet(file)
    for part in frames:
        part.unlink()


def noise(chance: np.random.Generator, distinct: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return different states in which each sensor is mostly as it should be."""
    drawn = chance.random((4 * distinct, SENSORS)) < 0.7
    codes = np.unique(drawn @ (1 << np.arange(SENSORS, dtype=np.int64)))
    return chance.permutation(codes)[:distinct]


SIZES = (("camera", 9_000, 30), ("state", 64, 100))

TOPICS = {f"{name}{number}": (size, hz) for name, size, hz in SIZES for number in range(5)}
"""Topic -> bytes of a message, messages a second."""

NOISE = 1 << 23
"""Bytes of noise that messages are cut from: many chunks, so that none holds the same twice."""


def write_recording(file: Path, megabytes: int) -> int:
    """Write an .mcap of this size with 10 topics; return the number of messages.

    Their data are noise, as those of cameras and scanners nearly are: of zeros, a packed file would be
    a hundredth of the size.
    """
    definition = (
        "std_msgs/Header header\nfloat64 value\nuint8[] data\n" + "=" * 80 + "\nMSG: std_msgs/Header\n"
    )
    definition += "builtin_interfaces/Time stamp\nstring frame_id\n" + "=" * 80
    definition += "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    second = sorted(
        (number / hz, topic, size) for topic, (size, hz) in TOPICS.items() for number in range(hz)
    )
    noise = random.Random(megabytes).randbytes(NOISE + max(size for size, _ in TOPICS.values()))
    count = written = 0
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 20)
        writer.start(profile="ros2", library="robomend-bench")
        schema = writer.register_schema("bench_msgs/msg/Sample", "ros2msg", definition.encode())
        channels = {topic: writer.register_channel(f"/{topic}", "cdr", schema) for topic in TOPICS}
        seconds = 0
        while written < megabytes * 1_000_000:
            for offset, topic, size in second:
                at_ns = seconds * SECOND + round(offset * SECOND)
                head = (
                    b"\0\1\0\0" + struct.pack("<iII", seconds, round(offset * SECOND), 5) + b"base" + bytes(8)
                )
                head += struct.pack("<dI", float(seconds), size)
                begin = written % NOISE
                data = head + noise[begin : begin + size]
                writer.add_message(channels[topic], at_ns, data, at_ns)
                written += len(data)
                count += 1
            seconds += 1
        writer.finish()  # type: ignore[no-untyped-call]  # the library's
    return count


COMMAND = [sys.executable, "-c", "from robomend_batch.main import main; main()"]
READ_ALL = (
    "import sys; from pathlib import Path; from rosbags.highlevel import AnyReader\n"
    "with AnyReader([Path(sys.argv[1])]) as reader: print(sum(1 for _ in reader.messages()))"
)
RATES = "topics:\n" + "".join(f"  state{n}: {{rate_hz: 100, tolerance_hz: 20}}\n" for n in range(3))
VALUES = "observers:\n" + "".join(
    f'  "ok(state{n}_value)": {{kind: property, source: "state{n}:value", high: 1.0e9}}\n' for n in (3, 4)
)


ONCE = ("--workers", "0", "--minimal", "cardinality")


class BatchFailed(BackendError):
    """The command did not end well."""

    code = "batch-failed"


def took(line: list[str], clock: str) -> tuple[float, float]:
    """Run a command; return seconds, of the clock on the wall or of the processor, and megabytes at most."""
    began = perf_counter()
    pid = os.posix_spawn(
        line[0],
        line,
        {**os.environ, "POLARS_MAX_THREADS": "1"},
        file_actions=[(os.POSIX_SPAWN_OPEN, fd, os.devnull, os.O_WRONLY, 0) for fd in (1, 2)],
    )
    _, status, used = os.wait4(pid, 0)
    code = os.waitstatus_to_exitcode(status)
    if code:
        raise BatchFailed(f"{' '.join(line[3:])} ended with {code}")
    spent = used.ru_utime + used.ru_stime if clock == "cpu" else perf_counter() - began
    return spent, used.ru_maxrss / 1024


@contextmanager
def on_cores(count: int) -> Iterator[None]:
    """What is started meanwhile has so many cores, at most; where that cannot be, as many as there are."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    all_ = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(all_)[:count])
    try:
        yield
    finally:
        os.sched_setaffinity(0, all_)


def batch(clock: str, folder: Path, model: Path, logs: list[Path], *more: str) -> tuple[float, float]:
    """Run robomend-batch over logs; return seconds and megabytes at most."""
    out = tempfile.mkdtemp(dir=folder)
    line = [*COMMAND, "run", *map(str, logs), "-m", str(model), "-o", out, "--quiet", *more]
    return took(line, clock)


def median(measure: Callable[[], tuple[float, float]], repeats: int) -> tuple[float, float]:
    """Return the median of the times, and the most memory."""
    found = [measure() for _ in range(repeats)]
    return sorted(seconds for seconds, _ in found)[repeats // 2], max(megabytes for _, megabytes in found)


def _literals(wish: dict[str, Any], folder: Path) -> Figures:
    model = folder / "model.yaml"
    atoms = write_model(model, wish["seed"])
    found = {}
    count = wish["rows"]
    for share in (0.001, 0.01):
        log = folder / "states.parquet"
        write_states(log, atoms, count, max(1, round(count * share)), wish["seed"])
        seconds, megabytes = median(
            partial(batch, wish["clock"], folder, model, [log], *ONCE), wish["repeats"]
        )
        found[f"{share:.1%}"] = {"rows_s": round(count / seconds), "mb": round(megabytes)}
    return found


def _distinct(wish: dict[str, Any], folder: Path) -> Figures:
    model = folder / "model.yaml"
    atoms = write_model(model, wish["seed"])
    count = min(wish["rows"] // 100, 100_000)
    log = folder / "distinct.parquet"
    write_states(log, atoms, count, count, wish["seed"])
    seconds, megabytes = median(
        partial(batch, wish["clock"], folder, model, [log], *ONCE, "--limit", "0"), wish["repeats"]
    )
    return {"rows_s": round(count / seconds), "mb": round(megabytes)}


def _recording(wish: dict[str, Any], folder: Path) -> Figures:
    model, rates, both = (folder / name for name in ("robot.yaml", "rates.yaml", "both.yaml"))
    nodes = "".join(f"  node{n}: {{publishes: {{state{n}: []}}}}\n" for n in range(5))
    properties = "properties: {state3_value: {}, state4_value: {}}\n"
    model.write_text(f"robomend: 1\nname: r\nnodes:\n{nodes}{properties}")
    rates.write_text(RATES)
    both.write_text(RATES + VALUES)
    log, small = folder / "log.mcap", folder / "small.mcap"
    count = write_recording(log, wish["megabytes"])
    write_recording(small, 1)
    clock, repeats = wish["clock"], wish["repeats"]

    def with_observers(file: Path, observers: Path) -> tuple[float, float]:
        more = ("--workers", "0", "--observers", str(observers))
        return median(partial(batch, clock, folder, model, [file], *more), repeats)

    start_s, _ = with_observers(small, rates)
    index_s, _ = with_observers(log, rates)
    both_s, megabytes = with_observers(log, both)
    raw = [sys.executable, "-c", READ_ALL, str(log)]
    raw_s, _ = median(partial(took, raw, clock), repeats)
    return {
        "messages": count,
        "start_s": round(start_s, 2),
        "index_s": round(index_s - start_s, 2),
        "both_s": round(both_s, 2),
        "rosbags_s": round(raw_s, 2),
        "share": round(raw_s / both_s, 3),
        "mb": round(megabytes),
    }


def _workers(wish: dict[str, Any], folder: Path) -> Figures:
    model = folder / "model.yaml"
    atoms = write_model(model, wish["seed"])
    count = wish["rows"]
    logs = [folder / f"part{number}.parquet" for number in range(4)]
    for number, log in enumerate(logs):
        write_states(log, atoms, count, max(1, count // 100), wish["seed"] + number)
    found = {}
    for workers in ("1", "2"):
        measured = partial(batch, wish["clock"], folder, model, logs, "--workers", workers)
        with on_cores(int(workers)):  # a worker alone would use the other core too, for a part
            found[workers], _ = median(measured, wish["repeats"])
    ratio = found["1"] / found["2"]
    if wish["clock"] == "cpu":  # both cores at work, at most: what the second worker costs beside is lost
        ratio *= 2
    return {"ratio": round(ratio, 2), "seconds": found}


def _memory(wish: dict[str, Any], folder: Path) -> Figures:
    model = folder / "model.yaml"
    atoms = write_model(model, wish["seed"])
    found = {}
    for count in (wish["rows"] // 10, wish["rows"], 3 * wish["rows"]):
        log = folder / "long.parquet"
        write_states(log, atoms, count, 1000, wish["seed"])
        _, found[f"{count:,}"] = batch("wall", folder, model, [log], "--workers", "0")
    return {f"{rows} rows, MB": round(megabytes) for rows, megabytes in found.items()}


def _learn(wish: dict[str, Any], folder: Path) -> Figures:
    first = wish["seed"]
    return learning.measure(COMMAND, folder, range(first, first + wish["robots"]), wish["minutes"]).json()


def _edited(wish: dict[str, Any], folder: Path) -> Figures:
    first = wish["seed"]
    if wish["bags"] is None:
        seeds, length_s = range(first, first + min(wish["robots"], 2)), 60 * wish["minutes"]
        bags = [
            drives.write(folder / f"drive{seed}.bag", drives.robot(seed), seed, length_s) for seed in seeds
        ]
    else:
        bags = sorted(wish["bags"].glob("*.bag"))
    return edited.measure(COMMAND, folder, bags).json()


PARTS: dict[str, Callable[[dict[str, Any], Path], Figures]] = {
    "literals": _literals,
    "distinct": _distinct,
    "recording": _recording,
    "workers": _workers,
    "memory": _memory,
    "learn": _learn,
    "edited": _edited,
}


@click.command("batch", context_settings={"help_option_names": ["-h", "--help"]})
@only(PARTS)
@click.option(
    "--rows", type=click.IntRange(100), default=10_000_000, show_default=True, help="Of a log of literals."
)
@click.option("--megabytes", type=click.IntRange(1), default=1000, show_default=True, help="Of a recording.")
@click.option("--robots", type=click.IntRange(1), default=20, show_default=True, help="To learn from.")
@click.option("--minutes", type=float, default=30.0, show_default=True, help="Of each of their drives.")
@click.option(
    "--bags",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder of recordings (ROS 1 .bag) of healthy robots, for `edited`; default: drives of our own.",
)
@click.option("--repeats", type=click.IntRange(1, 100), default=3, show_default=True)
@click.option(
    "--clock", type=click.Choice(["wall", "cpu"]), default="wall", help="cpu: for a machine that others use."
)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--format", "output", type=click.Choice(["markdown", "json"]), default="markdown")
def command(parts: tuple[str, ...], output: str, **wish: Any) -> None:
    """Measure how fast logs are diagnosed: each figure is a run of robomend-batch, start-up included.

    And how good what it learns is: false alarms over healthy drives, planted faults found.

    \b
    robomend-bench batch
    robomend-bench batch --only literals,distinct --repeats 5
    robomend-bench batch --only recording --megabytes 200 --format json
    robomend-bench batch --only learn --robots 4 --seed 5
    robomend-bench batch --only edited --bags healthy/
    """

    def measure(part: str) -> Figures:
        with tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
            return PARTS[part](wish, Path(folder))

    report(parts, measure, output)
