"""OUT/manifest.json: what a folder of results was made of, and which files are done.

It is written beside and renamed, when files are done and a second has passed: the same command goes on after
a run that was killed, and in the middle of the logs that it had in hand (unfinished.py). A folder that was
made by another model, other observers or options is refused.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Any

from robomend.errors import InputError
from robomend_batch.one_log import RESULTS, Record, state_file
from robomend_batch.parts import PIECE, SCHEMA_VERSION
from robomend_batch.unfinished import ENDING, stamp

NAME = "manifest.json"
OURS = (NAME, "logs.ndjson", "results.ndjson", "results.parquet", "report.html")
"""The files of a folder of results, beside the parts."""

EVERY_S = 1.0


class AnotherRun(InputError):
    """The folder holds the results of something else."""

    code = "another-run"


class Manifest:
    """See the module."""

    def __init__(
        self, out: Path, settings: dict[str, Any], source: str, files: dict[str, dict[str, Any]]
    ) -> None:
        self.out = out
        self.settings = settings
        self.source = source
        """Of the model."""
        self.files = files
        self._written_s = -EVERY_S
        self._finished: list[str] = []  # since it was written last

    @property
    def records(self) -> list[Record]:
        """Of all logs that are done, in the order of their names."""
        return self.records_without(())

    def records_without(self, names: Iterable[str]) -> list[Record]:
        """Return those of all files but these, such as ones that have changed since."""
        left = frozenset(names)
        found = [record for name, done in self.files.items() if name not in left for record in done["logs"]]
        return sorted(found, key=lambda record: str(record["log"]))

    def done(self, name: str) -> bool:
        """Return whether a file is done, and is still the same."""
        known = self.files.get(name)
        return known is not None and (known["size"], known["mtime_ns"]) == stamp(name)

    def finish(self, name: str, stamped: tuple[int, int], records: list[Record]) -> None:
        """Note that a file is done."""
        size, mtime_ns = stamped
        self.files[name] = {"size": size, "mtime_ns": mtime_ns, "logs": records}
        self._finished.append(name)
        if monotonic() - self._written_s >= EVERY_S:
            self.write()

    def write(self) -> None:
        """Write it down."""
        text = json.dumps(
            {
                "robomend_batch": SCHEMA_VERSION,
                "settings": self.settings,
                "model": self.source,
                "files": {name: self.files[name] for name in sorted(self.files)},
            },
            indent=1,
            ensure_ascii=False,
        )
        write_beside(self.out / NAME, text.encode("utf-8", "surrogateescape") + b"\n")
        self._written_s = monotonic()
        for name in self._finished:  # not before it says that they are done
            state_file(self.out, name).unlink(missing_ok=True)
        self._finished.clear()


def open_manifest(
    out: Path, settings: dict[str, Any], source: str, names: Iterable[str], *, overwrite: bool
) -> Manifest:
    """Return the manifest of a folder, which is made if need be.

    Raises:
        AnotherRun: it holds something else, or other logs beside these.
        InputError: it cannot be made.
    """
    strangers = [entry.name for entry in out.iterdir() if entry.name not in (*OURS, RESULTS)]
    known = read_manifest(out) if (out / NAME).exists() else None
    if known is None and [name for name in strangers if not name.endswith(".tmp")]:
        raise AnotherRun(f"{out} holds {strangers[0]}, and no results: name a folder of its own")
    if known is not None and not overwrite:
        _check_same(out, known, settings, frozenset(names))
    if overwrite or known is None:
        _clear(out)
        known = Manifest(out, settings, source, {})
    (out / RESULTS).mkdir(exist_ok=True)
    known.write()
    return known


@contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Hold a folder, which is made if need be, against other runs; InputError if one is at work in it."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        held = os.open(out, os.O_RDONLY)
    except OSError as error:
        raise InputError(f"{out}: {error.strerror}; name a folder that can be written") from error
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"{out}: another run is at work in it") from None
        yield
    finally:
        os.close(held)


def read_manifest(out: Path) -> Manifest:
    """Return the manifest of a folder of results; InputError if it is none."""
    try:
        found = json.loads((out / NAME).read_bytes().decode("utf-8", "surrogateescape"))
        if found["robomend_batch"] != SCHEMA_VERSION:
            raise InputError(f"{out} was written by another version of robomend-batch: run it anew")
        return Manifest(out, found["settings"], found["model"], found["files"])
    except FileNotFoundError:
        raise InputError(f"{out} holds no results of robomend-batch") from None
    except OSError as error:
        raise InputError(f"{out / NAME} cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{out / NAME} is damaged: run with --overwrite") from error


def _check_same(out: Path, known: Manifest, settings: dict[str, Any], names: frozenset[str]) -> None:
    differ = [key for key in settings if known.settings.get(key) != settings[key]]
    differ += [key for key in known.settings if key not in settings]
    if differ:
        said = ", ".join(f"{key} (was {known.settings.get(key)!r})" for key in differ)
        raise AnotherRun(f"{out} holds results of another run: {said} differs; name another, or --overwrite")
    if gone := sorted(known.files.keys() - names):
        raise AnotherRun(
            f"{out} holds results of {gone[0]}{' and others' if len(gone) > 1 else ''} as well: name it "
            "again, or --overwrite"
        )


def _clear(out: Path) -> None:
    """Remove the results of another run, and nothing else."""
    for name in OURS:
        (out / name).unlink(missing_ok=True)
    keep_parts(out, frozenset())


def keep_parts(out: Path, wanted: frozenset[str]) -> None:
    """Remove parts that belong to no log that is done, states, and what a killed run left beside."""
    folder = out / RESULTS
    for file in folder.iterdir() if folder.is_dir() else ():
        part = file.with_suffix(".parquet").name if file.suffix == PIECE else file.name
        if file.is_dir():  # of a log that was being unpacked
            shutil.rmtree(file, ignore_errors=True)
        elif file.suffix in {".tmp", ENDING} or (file.suffix in {".parquet", PIECE} and part not in wanted):
            file.unlink(missing_ok=True)


def write_beside(file: Path, data: bytes) -> None:
    """Write a file beside, and rename it: it is there whole, or as it was."""
    beside = file.with_name(file.name + ".tmp")
    beside.write_bytes(data)
    os.replace(beside, file)
