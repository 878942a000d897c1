"""One file, from its rows to its intervals. Runs in a worker process as well: what it needs pickles."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robomend.diagnosis.result import Options
from robomend.model.packed import opened
from robomend.model.system import System
from robomend.observations.language import Unknown
from robomend_batch.answers import Answers
from robomend_batch.logs.blocks import Advance, Opened, Restart, Shown
from robomend_batch.logs.kinds import READERS, kind_of
from robomend_batch.observing import Observing, load_observers
from robomend_batch.parts import PartFiles, Parts, write_piece
from robomend_batch.problems import LogRefused, Problems
from robomend_batch.track import Stretch, Track
from robomend_batch.windows import Windows
from robomend_batch.words import Words
from robomend_client.observers.base import SECOND

RESULTS = "results"
"""The folder of the parts, in OUT."""

Record = dict[str, Any]
"""What the manifest and logs.ndjson say of a log; docs/batch.md has its keys."""


@dataclass(frozen=True)
class Setup:
    """What is the same for all logs of a run."""

    system: System
    options: Options
    out: Path
    unknown: Unknown = "refuse"
    observers: Path | None = None
    by_header: bool = False
    together_s: float | None = None  # one explanation for so long; inf: for a segment; None: for each state
    ndjson: bool = False  # the lines of results.ndjson are written beside the parts
    code: bool = True  # whether observers may be those of a FILE.py


class Diagnoser:
    """Diagnoses one file after another, with one set of solvers."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self._answers = Answers(opened(setup.system.cnf), setup.options)
        self._observing = (
            None if setup.observers is None else load_observers(setup.observers, code=setup.code)
        )

    def close(self) -> None:
        """Free the solvers."""
        self._answers.close()

    def diagnose(self, name: str) -> list[Record]:
        """Diagnose the logs of a file, write their parts, and say what became of them."""
        path = Path(name)
        logs = _Logs(name, self.setup, self._answers, self._observing)
        kind = None
        try:
            kind = kind_of(path)
            for log, what in READERS[kind](path, logs.opened):
                logs.log(log).take(what)
            return logs.finish(kind)
        except LogRefused as error:
            logs.drop()
            logs.opened.problems.add(error.place or name, error.reason, bad=True)
            return [refused(name, kind, logs.opened.problems)]
        except BaseException:  # Ctrl-C as well: no half-written part stays; whoever asked says what it was
            logs.drop()
            raise


class _Logs:
    """The logs of a file that is open."""

    def __init__(self, name: str, setup: Setup, answers: Answers, observing: Observing | None) -> None:
        self.opened = Opened(lambda log: self.log(log).words, observing, setup.by_header)
        self._name = name
        self._setup = setup
        self._answers = answers
        self._logs: dict[str, _Log] = {}

    def log(self, log: str) -> _Log:
        found = self._logs.get(log)
        if found is None:
            name = f"{self._name}#{log}" if log else self._name
            words = Words(self._setup.system.vocabulary, self._setup.unknown, self.opened.problems)
            files = PartFiles(self._setup.out / RESULTS, file_name(name), ndjson=self._setup.ndjson)
            found = self._logs[log] = _Log(name, words, files, self._answers, self._setup.together_s)
        return found

    def drop(self) -> None:
        """Remove what was written: the file is refused as a whole."""
        for log in self._logs.values():
            for part in log.files.written:
                file = self._setup.out / RESULTS / part
                write_piece(file, ())
                file.unlink(missing_ok=True)

    def finish(self, kind: str) -> list[Record]:
        for log in self._logs.values():
            log.parts.finish()
        told = [log for log in self._logs.values() if log.parts.intervals]
        if not told:
            raise LogRefused("an empty log: nothing was observed", self._name)
        problems = self.opened.problems
        state = "ended-early" if self.opened.ended_early else "bad" if problems.bad else "ok"
        return [log.record(self._name, kind, state, problems.json()) for log in told]


@dataclass
class _Log:
    """One log of a file."""

    name: str
    words: Words
    files: PartFiles
    answers: Answers
    together_s: float | None
    track: Track = field(default_factory=Track)

    def __post_init__(self) -> None:
        given = self.name, self.answers, lambda: self.words.sensors, self.files.write
        if self.together_s is None:
            self.parts = Parts(*given)
        else:
            window_ns = None if math.isinf(self.together_s) else round(self.together_s * SECOND)
            self.parts = Windows(*given, window_ns=window_ns)

    def take(self, what: Any) -> None:
        for stretch in self._stretches(what):
            self.parts.add(stretch)

    def _stretches(self, what: Any) -> Iterator[Stretch]:
        if isinstance(what, Restart):
            return iter([self.track.begun(what.time_ns)])
        if isinstance(what, Advance):
            return self.track.advance(what.time_ns)
        if isinstance(what, Shown):
            return self.track.show(what.time_ns, what.codes)
        return self.track.add(what)

    def record(self, file: str, kind: str, state: str, problems: list[dict[str, Any]]) -> Record:
        return {
            "log": self.name,
            "file": file,
            "kind": kind,
            "state": state,
            "start_ns": self.parts.start_ns,
            "end_ns": self.parts.end_ns,
            "segments": self.track.segment + 1,
            "intervals": dict(sorted(self.parts.intervals.items())),
            "span_ns": dict(sorted(self.parts.span_ns.items())),
            "problems": problems,
            "parts": list(self.files.written),
        }


def refused(name: str, kind: str | None, problems: Problems, state: str = "refused") -> Record:
    """Return the record of a file that cannot be diagnosed."""
    return {
        "log": name,
        "file": name,
        "kind": kind,
        "state": state,
        "start_ns": None,
        "end_ns": None,
        "segments": 0,
        "intervals": {},
        "span_ns": {},
        "problems": problems.json(),
        "parts": [],
    }


def file_name(log: str) -> str:
    """Return the beginning of the names of a log's parts: readable, and its own."""
    digest = hashlib.sha256(log.encode("utf-8", "surrogateescape")).hexdigest()[:12]
    return f"{re.sub(r'[^A-Za-z0-9_-]+', '_', log)[-60:].strip('_')}-{digest}"
