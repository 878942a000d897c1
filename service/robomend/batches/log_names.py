"""Which files may be read as logs: those below one folder, and none that a link leads out of it."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath

from robomend.errors import InputError, NotFound, Refused

ENDINGS = (".bag", ".bag.active", ".mcap", ".db3", ".parquet", ".csv", ".ndjson", ".jsonl")
"""What is taken of a folder, as by `robomend-batch`, …"""

COMPRESSED = re.compile(r"\.(zstd|zst|gz|bz2)\Z")
"""… or compressed: then this follows."""

UPLOAD = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+\-]{0,199}")
"""The name of an uploaded log: of a file, not of a path, and no option."""

MOST_STARS = 3

MOST_ENTRIES = 200_000
"""Files that are looked at below the folder."""


def check_upload(name: str) -> str:
    """Return the name of an uploaded log; Refused for a path, InputError for what is no log."""
    if "/" in name or "\\" in name or "\0" in name or name in {"", ".", ".."}:
        raise Refused(f"{name[:80]!r} is a path: an uploaded log has the name of a file only")
    if not UPLOAD.fullmatch(name):
        raise InputError(f"{name[:80]!r}: an uploaded log is named by letters, digits and ._+- only")
    if not is_log(name):
        raise InputError(
            f"{name}: a log ends in one of {', '.join(ENDINGS)}, and .gz, .bz2 or .zst behind it"
        )
    return name


def is_log(name: str) -> bool:
    """Return whether a file is a log, by its name."""
    return COMPRESSED.sub("", name.lower()).endswith(ENDINGS)


def find_below(folder: Path, patterns: Sequence[str], most: int) -> list[str]:
    """Return the logs that names, folders and patterns mean, relative to the folder, in their order.

    Raises:
        Refused: a path that is not below it, or a link that leads out of it.
        NotFound: there is no such log.
        InputError: there are more than `most`.
    """
    root = folder.resolve()
    if not root.is_dir():
        raise NotFound(f"the setting batch_folder names {folder}, and there is no such folder")
    found: dict[Path, str] = {}
    for pattern in patterns:
        parts = PurePosixPath(pattern).parts
        if not parts or "\0" in pattern or pattern.startswith(("/", "~")) or ".." in parts:
            raise Refused(f"{pattern[:200]!r}: name logs relative to batch_folder, and below it")
        if parts.count("**") > MOST_STARS:
            raise InputError(f"{pattern[:200]!r}: at most {MOST_STARS} times ** in a pattern")
        matched = False
        for name in _matching(root, "/".join(parts)):
            real = check_below(root, name)
            matched = True
            found[real] = min(name, found.get(real, name))  # a log with several names is read once
            if len(found) > most:
                raise InputError(f"more than {most} logs (max_batch_logs); name fewer")
        if not matched:
            raise NotFound(f"below batch_folder there is no log {pattern[:200]!r}")
    return sorted(found.values())


def check_below(root: Path, name: str) -> Path:
    """Return where a log really is; Refused if that is not below the folder, InputError for no file."""
    real = Path(os.path.realpath(root / name))
    if not real.is_relative_to(root):
        raise Refused(f"{name}: a link leads out of batch_folder")
    try:
        regular = stat.S_ISREG(real.stat().st_mode)
    except OSError as error:
        raise NotFound(f"{name}: {error.strerror}") from error
    if not regular:
        raise InputError(f"{name} is no file")
    return real


def _matching(root: Path, pattern: str) -> Iterator[str]:
    named = root / pattern
    if os.path.lexists(named):
        check = Path(os.path.realpath(named))
        if not check.is_relative_to(root):
            raise Refused(f"{pattern}: a link leads out of batch_folder")
        if not check.is_dir():
            yield pattern
            return
        prefix = "" if pattern == "." else f"{pattern}/"
        yield from (f"{prefix}{name}" for name in _walk(check) if is_log(name))
        return
    yield from (name for name in _walk(root) if _fits(pattern, name))


def _walk(folder: Path) -> Iterator[str]:
    """Yield all files below, relative to the folder. Links to folders are not followed."""
    count = 0
    for at, folders, files in os.walk(folder):
        folders.sort()
        for name in sorted(files):
            count += 1
            if count > MOST_ENTRIES:
                raise InputError(f"batch_folder has more than {MOST_ENTRIES} files: name folders of it")
            yield os.path.relpath(os.path.join(at, name), folder)


def _fits(pattern: str, name: str) -> bool:
    """Whether a relative name fits a pattern: * and ? within a part, ** any number of folders."""
    return _parts_fit(pattern.split("/"), name.split("/"))


def _parts_fit(parts: Sequence[str], names: Sequence[str]) -> bool:
    if not parts or not names:
        return not parts and not names
    if parts[0] == "**":
        rest = parts[1:]
        return not rest or any(_parts_fit(rest, names[start:]) for start in range(len(names)))
    return fnmatchcase(names[0], parts[0]) and _parts_fit(parts[1:], names[1:])
