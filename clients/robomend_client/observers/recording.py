"""What a driver took in, as lines of JSON, and its replay: the same literals at the same times.

    {"start": 1764000000000000000}
    {"source": "scan", "time": 1764000000100000000}
    {"source": "odom:twist.twist.linear.x", "time": …, "at": …, "value": 0.31}
                                                      └ when it was taken in, if later
    {"sight": "lost", "of": "scan", "at": …}   {"publishers": ["/laser"], "of": "scan", "at": …}
    {"lapse": …, "at": …}   {"starved": true, "at": …}
    {"settle": 7, "atoms": ["ok(scan)"], "at": …}   {"restart": …}   {"end": …}

A recording has a bound; when it is full, it says so at its end and stays as it is.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from robomend_client.literals import Atom
from robomend_client.observers.base import Contact, Listener
from robomend_client.observers.combining import Change
from robomend_client.observers.driver import Driver

LOOKS = "/robomend/looks"
"""In a recording of messages (.mcap), the topic that has the lines that are no samples."""


class Looks(Listener, ABC):
    """Writes down all that a driver takes in beside samples: whether, and at what, anybody looked."""

    @abstractmethod
    def write(self, line: dict[str, Any]) -> None:
        """Take down a line."""

    def lapse(self, now_ns: int, until_ns: int) -> None:
        self.write({"lapse": until_ns, "at": now_ns})

    def starved(self, now_ns: int, yes: bool) -> None:
        self.write({"starved": yes, "at": now_ns})

    def sight(self, now_ns: int, source: str, sight: Contact) -> None:
        self.write({"sight": sight.value, "of": source, "at": now_ns})

    def publishers(self, now_ns: int, source: str, nodes: Sequence[str]) -> None:
        self.write({"publishers": list(nodes), "of": source, "at": now_ns})

    def settle(self, now_ns: int, n: int, atoms: Collection[Atom]) -> None:
        self.write({"settle": n, "atoms": [[atom.predicate, *atom.args] for atom in atoms], "at": now_ns})

    def restart(self, now_ns: int) -> None:
        self.write({"restart": now_ns})


class Recording(Looks):
    """Writes down what a driver takes in."""

    def __init__(self, file: Path, start_ns: int, most_bytes: int) -> None:
        """
        Raises:
            OSError: the file cannot be written.
        """
        self._file = file.open("w", encoding="utf-8", buffering=1 << 16)
        self._left = most_bytes
        self.write({"start": start_ns})

    def sample(self, source: str, time_ns: int, value: object, now_ns: int) -> None:
        line: dict[str, Any] = {"source": source, "time": time_ns}
        if now_ns != time_ns:
            line["at"] = now_ns
        if value is not None:
            line["value"] = value
        self.write(line)

    def close(self, now_ns: int) -> None:
        """End the recording at this time; what is taken in after it is not in there."""
        self.write({"end": now_ns})
        self._left = 0
        self._file.close()

    def write(self, line: dict[str, Any]) -> None:
        if self._left <= 0:
            return
        text = json.dumps(line, separators=(",", ":"), default=_plain) + "\n"
        self._left -= len(text)
        if self._left <= 0:
            at_ns = line.get("at", line.get("time", next(iter(line.values()))))
            text = json.dumps({"end": at_ns, "full": True}) + "\n"
        self._file.write(text)


def replay(lines: Iterable[str], make: Callable[[int], Driver]) -> Iterator[Change]:
    """Yield the changes of a recording.

    Args:
        lines: of the file; a torn last one, of an agent that was killed, is left out.
        make: makes the driver, with fresh observers, for a time to start at.

    Raises:
        ValueError: this is no recording.
    """
    driver: Driver | None = None
    for text in lines:
        line = line_of(text)
        if line is None:
            return
        if driver is None:
            driver = make(int(line["start"]))
        else:
            yield from replay_line(driver, line)


def line_of(text: str) -> dict[str, Any] | None:
    """Return a line of a recording; None if it is torn. ValueError if it is none."""
    try:
        line = json.loads(text)
    except ValueError:
        if not text.endswith("\n"):
            return None
        line = None
    if not isinstance(line, dict):
        raise ValueError(f"not a line of a recording: {text[:80]!r}")
    return line


def replay_line(driver: Driver, line: dict[str, Any]) -> Iterator[Change]:
    """Yield the changes of a line behind the first one."""
    at_ns = line.get("at")
    if "source" in line:
        time_ns = line["time"]
        yield from driver.sample(
            line["source"], time_ns, line.get("value"), time_ns if at_ns is None else at_ns
        )
        return
    if at_ns is not None:
        yield from driver.advance(at_ns)
    if "lapse" in line:
        yield from driver.lapse(line["lapse"])
    elif "starved" in line:
        yield from driver.starved(line["starved"], line["at"])
    elif "sight" in line:
        yield from driver.look(line["of"], Contact(line["sight"]), line["at"])
    elif "publishers" in line:
        yield from driver.publishers(line["of"], line["publishers"], line["at"])
    elif "settle" in line:
        atoms = [Atom(predicate, tuple(args)) for predicate, *args in line["atoms"]]
        yield from driver.settle(line["settle"], atoms)
    elif "restart" in line:
        yield from driver.restart(line["restart"])
    elif "end" in line:
        yield from driver.advance(line["end"])


def _plain(value: object) -> object:
    """Return what JSON has for a value that it does not know: tables of nodes are sets."""
    if isinstance(value, set | frozenset):
        return sorted(value)
    raise TypeError(f"{value!r} cannot be recorded")
