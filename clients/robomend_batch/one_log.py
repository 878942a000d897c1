"""One file, from its rows to its intervals. Runs in a worker process as well: what it needs pickles."""

from __future__ import annotations

import hashlib
import math
import re
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic, thread_time
from types import TracebackType
from typing import Any

from robomend.diagnosis.result import Options
from robomend.model.system import System
from robomend.observations.language import Unknown
from robomend_batch.answers import Answers
from robomend_batch.logs.blocks import Advance, Opened, Place, Restart, Shown
from robomend_batch.logs.compressed import is_compressed, plain_log
from robomend_batch.logs.kinds import READERS, RECORDINGS, kind_of
from robomend_batch.observing import Observing, load_observers
from robomend_batch.parts import PartFiles, PartFolder, Parts, Windows
from robomend_batch.problems import LogRefused, Problems
from robomend_batch.track import Stretch, Track
from robomend_batch.unfinished import ENDING, Unfinished, stamp
from robomend_batch.words import Words
from robomend_client.literals import Atom
from robomend_client.observers.base import SECOND

RESULTS = "results"
"""The folder of the parts, in OUT."""

SHARES_S = 0.5
"""Between two times that it is said how much of a file is read."""

LEAST_S, SECONDS_A_MB = 600.0, 5.0
"""Of a processor's time, what a log may take: so long in any case, and so much for each of its megabytes. A
gigabyte of messages takes some minutes.
"""

OnShare = Callable[[float], None]
"""Told how much of the file in hand is read, from 0 to 1."""

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
    log_timeout_s: float | None = None  # of a processor's time, for one file; None: by its size


class TookTooLong(BaseException):
    """A log has used up its time. No Exception, as readers take those for damage."""


class _Allowance:
    """The processor time that a file may take: TookTooLong when it is used up.

    That is raised wherever it happens in a main thread, in an observer's endless loop as well; in another
    thread, which gets no signals, where somebody looks.
    """

    def __init__(self, left_s: float) -> None:
        self._left_s = left_s
        self._open = False
        self._began_s = 0.0

    def __enter__(self) -> _Allowance:
        self._began_s = thread_time()
        self._open = True
        if math.isfinite(self._left_s) and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGPROF, self._over)
            signal.setitimer(signal.ITIMER_PROF, max(self._left_s, 1e-3), 1.0)  # again: it may go unheard
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """It counts no more."""
        self._open = False
        if threading.current_thread() is threading.main_thread():
            signal.setitimer(signal.ITIMER_PROF, 0)

    def _over(self, number: int, frame: object) -> None:
        if self._open:
            raise TookTooLong

    @property
    def used_s(self) -> float:
        """How much was used."""
        return thread_time() - self._began_s

    def look(self) -> None:
        """Raise TookTooLong if it is used up."""
        if self.used_s > self._left_s:
            raise TookTooLong


class Diagnoser:
    """Diagnoses one file after another, with one set of solvers."""

    def __init__(self, setup: Setup, on_share: OnShare = lambda share: None) -> None:
        self.setup = setup
        self.on_share = on_share
        self._observing = (
            None if setup.observers is None else load_observers(setup.observers, code=setup.code)
        )
        self._folder = PartFolder(setup.out / RESULTS, setup.ndjson)
        self._begin()

    def _begin(self) -> None:
        setup = self.setup
        self._answers = Answers(setup.system, setup.options)
        self._stays = {
            "setup": setup,
            "vocabulary": setup.system.vocabulary,
            "answers": self._answers,
            "observing": self._observing,
            "folder": self._folder,
        }

    def close(self) -> None:
        """Free the solvers."""
        self._answers.close()

    def diagnose(self, name: str) -> list[Record]:
        """Diagnose the logs of a file, write their parts, and say what became of them."""
        records = self.diagnose_for(name, math.inf)
        assert records is not None
        return records

    def diagnose_for(self, name: str, span_s: float) -> list[Record] | None:
        """Do the same for so long; None: it is to be asked again, and goes on where it was left."""
        path = Path(name)
        if is_compressed(path):  # to go on it would have to be unpacked again
            span_s = math.inf
        until_s = monotonic() + span_s
        next_s = 0.0
        unfinished = Unfinished(state_file(self.setup.out, name), stamp(name), self._stays, span_s)
        logs = unfinished.load() or _Logs(name, self.setup, self._answers, self._observing, self._folder)
        kind = None
        allowed, most_s, size_mb, spent_s = _Allowance(math.inf), math.inf, 0.0, logs.spent_s
        try:
            with plain_log(path, unpacked_folder(self.setup.out, name)) as plain:
                logs.opened.problems.called = str(plain.path), name
                size_mb = stamp(str(plain.path))[0] / 1e6
                most_s = self.setup.log_timeout_s or LEAST_S + SECONDS_A_MB * size_mb
                allowed = _Allowance(most_s - spent_s)
                with allowed:
                    kind = kind_of(plain.path)
                    logs.opened.checked = plain.checked or kind not in RECORDINGS
                    for log, what in READERS[kind](plain.path, logs.opened):
                        allowed.look()
                        if not isinstance(what, Place):
                            logs.log(log).take(what)
                            continue
                        if monotonic() >= next_s:
                            self.on_share(what.share)
                            next_s = monotonic() + SHARES_S
                        if not unfinished.due:
                            continue
                        logs.opened.begun = what.state
                        logs.spent_s = spent_s + allowed.used_s
                        unfinished.save(logs)
                        if unfinished.kept and monotonic() >= until_s:
                            return None
                    if plain.problem:
                        logs.opened.problems.add(name, f"ended early: {plain.problem}", bad=True)
                        logs.opened.ended_early = True
                    return logs.finish(kind)
        except LogRefused as error:
            logs.drop()
            problems = logs.opened.problems
            problems.add(error.place or name, error.reason, bad=True)
            return [refused(name, kind, problems)]
        except TookTooLong:
            allowed.close()
            logs.drop()
            self.close()  # wherever its solvers were
            self._begin()
            problems = logs.opened.problems
            problems.add(
                name,
                f"it took more than {most_s:,.0f} s of a processor's time, which {size_mb:,.1f} MB never do: "
                "--log-timeout gives it more",
                bad=True,
            )
            return [refused(name, kind, problems)]
        except BaseException:  # Ctrl-C as well: whoever asked says what it was
            if not unfinished.kept:  # no part stays that nobody goes on from
                logs.drop()
            raise


class _Logs:
    """The logs of a file, and what is open of it while it is read."""

    spent_s = 0.0
    """Of a processor's time, before its state was written."""

    def __init__(
        self, name: str, setup: Setup, answers: Answers, observing: Observing | None, folder: PartFolder
    ) -> None:
        self.opened = Opened(self.words, observing, setup.by_header)
        self._name = name
        self._setup = setup
        self._answers = answers
        self._folder = folder
        self._logs: dict[str, _Log] = {}

    def log(self, log: str) -> _Log:
        found = self._logs.get(log)
        if found is None:
            name = f"{self._name}#{log}" if log else self._name
            words = Words(self._setup.system.vocabulary, self._setup.unknown, self.opened.problems)
            files = PartFiles(self._folder, file_name(name))
            found = self._logs[log] = _Log(name, words, files, self._answers, self._setup.together_s)
        return found

    def words(self, log: str) -> Words:
        return self.log(log).words

    def drop(self) -> None:
        """Remove what was written: the file is refused as a whole."""
        for log in self._logs.values():
            log.files.drop()

    def finish(self, kind: str) -> list[Record]:
        for log in self._logs.values():
            log.parts.finish()
        told = [log for log in self._logs.values() if log.parts.intervals]
        if not told:
            raise LogRefused("an empty log: nothing was observed", self._name)
        if not self.opened.checked:
            reason = "neither its compression nor what it holds has a checksum: damage may not show"
            self.opened.problems.add(self._name, reason, bad=False)
        problems = self.opened.problems.json()
        whole = "ok" if self.opened.checked else "unchecked"
        state = "ended-early" if self.opened.ended_early else "bad" if self.opened.problems.bad else whole
        return [log.record(self._name, kind, state, problems) for log in told]


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
        given = self.name, self.answers, self._sensors, self.files.write
        if self.together_s is None:
            self.parts = Parts(*given)
        else:
            window_ns = None if math.isinf(self.together_s) else round(self.together_s * SECOND)
            self.parts = Windows(*given, window_ns=window_ns)

    def _sensors(self) -> tuple[Atom, ...]:
        return self.words.sensors

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
            "readings": self.words.readings,
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
        "readings": [],
        "problems": problems.json(),
        "parts": [],
    }


def state_file(out: Path, name: str) -> Path:
    """Return where the state of a file in hand is kept."""
    return out / RESULTS / f"{file_name(name)}{ENDING}"


def unpacked_folder(out: Path, name: str) -> Path:
    """Return where a file that is compressed is unpacked for as long as it is read."""
    return out / RESULTS / f"{file_name(name)}.tmp"


def file_name(log: str) -> str:
    """Return the beginning of the names of a log's parts: readable, and its own."""
    digest = hashlib.sha256(log.encode("utf-8", "surrogateescape")).hexdigest()[:12]
    return f"{re.sub(r'[^A-Za-z0-9_-]+', '_', log)[-60:].strip('_')}-{digest}"
