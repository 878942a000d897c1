"""Logs to measure on: the states of a random robot as Parquet, and a recording with messages of all sizes."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import numpy as np
import polars as pl
import yaml
from mcap.writer import Writer

from robomend_bench.generator import make_robot
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
