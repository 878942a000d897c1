"""The WCNF files of several observations, as published with the IJCAI 2019 paper, read into our values.

    c mutated gates: 16          a comment
    o 1 -2 -3 0                  one snapshot: literals that were observed
    p wcnf 17 22 7               variables, clauses, the weight of a hard clause
    1 7 0                        soft unit clause: variable 7 is true when component "7" is healthy
    7 -7 -6 -1 -3 0              hard clause

Such files do not name nets, so that a variable is known by its number: component "7", atom v(6). A clause
is a rule of the component whose health literal it holds.
"""

from __future__ import annotations

import gzip
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from robomend.errors import ModelError
from robomend.model.cnf import HealthCnf, Rule
from robomend_client.literals import Atom, Literal

MAX_BYTES = 256 * 1024 * 1024
"""Unpacked. A file that is larger is refused before it fills the memory."""


@dataclass(frozen=True)
class SnapshotFile:
    """A system and the snapshots that were taken of it."""

    cnf: HealthCnf
    snapshots: tuple[tuple[Literal, ...], ...]


def read_wcnf(path: Path) -> SnapshotFile:
    """Read a file, plain or packed with gzip (`.gz`).

    Raises:
        ModelError: with the line.
        OSError: the file cannot be read.
    """
    opened = gzip.open if path.suffix == ".gz" else open
    try:
        with opened(path, "rb") as file:
            data = file.read(MAX_BYTES + 1)
        text = data.decode()
    except (EOFError, gzip.BadGzipFile, UnicodeDecodeError) as error:
        raise ModelError(f"neither a text nor a whole gzip file: {error}", str(path)) from error
    if len(data) > MAX_BYTES:
        raise ModelError(f"larger than {MAX_BYTES >> 20} MiB unpacked: split it", str(path))
    name = path.name.removesuffix(".gz").removesuffix(".wcnf")
    return parse_wcnf(text.splitlines(), name, str(path))


def parse_wcnf(lines: Iterable[str], name: str, file: str | None = None) -> SnapshotFile:
    """Read the lines of such a file; `file` is named in errors."""
    top: int | None = None
    variables = 0
    hard: list[list[int]] = []
    health: list[int] = []
    snapshots: list[list[int]] = []
    observed = _Read()
    for number, line in enumerate(map(str.strip, lines), 1):
        if top is not None and line[:1].isdecimal():  # most lines are clauses
            clause = _integers(line, file, number)
            if clause[0] >= top:
                hard.append(clause[1:])
            elif len(clause) == 2 and clause[1] > 0:
                health.append(clause[1])
            else:
                raise ModelError("a soft clause must be one positive literal, its component", file, number)
            continue
        kind, _, rest = line.partition(" ")
        if kind == "p":
            top, variables = _header(rest, file, number)
        elif kind == "o":
            snapshots.append(_integers(rest, file, number, observed.__getitem__))
        elif kind not in {"", "c"}:
            if top is None:
                raise ModelError("a clause before the line 'p wcnf …'", file, number)
            raise ModelError("a clause begins with its weight, a number", file, number)
    if top is None:
        raise ModelError("no line 'p wcnf …'", file)
    if len(set(health)) < len(health):
        raise ModelError("two soft clauses name one component", file)
    seen = frozenset(observed.values()) - {0}
    return _compiled(name, hard, health, snapshots, seen, variables)


def _header(rest: str, file: str | None, line: int) -> tuple[int, int]:
    words = rest.split()
    if len(words) != 4 or words[0] != "wcnf" or not all(word.isdecimal() for word in words[1:]):
        raise ModelError("expected 'p wcnf VARIABLES CLAUSES TOP'", file, line)
    return int(words[3]), int(words[1])


class _Read(dict[str, int]):
    """Words that were read before, with their number: a hundred snapshots repeat the same few."""

    def __missing__(self, word: str) -> int:
        number = self[word] = int(word)
        return number


def _integers(text: str, file: str | None, line: int, number_of: Callable[[str], int] = int) -> list[int]:
    try:
        numbers = [*map(number_of, text.split())]
    except ValueError:
        raise ModelError(f"expected integers that end in 0, not {text.strip()[:60]!r}", file, line) from None
    if len(numbers) < 2 or numbers.pop() != 0 or 0 in numbers:
        raise ModelError("expected integers that end in one 0", file, line)
    return numbers


def _compiled(
    name: str,
    hard: list[list[int]],
    health: list[int],
    snapshots: list[list[int]],
    seen: frozenset[int],
    variables: int,
) -> SnapshotFile:
    """Number health first, then what is observed, then the rest, as HealthCnf wants it."""
    mentioned = set(map(abs, set[int]().union(*hard)))
    observed = sorted(set(map(abs, seen)) - set(health))
    rest = sorted((mentioned | set(range(1, variables + 1))) - set(health) - set(observed))
    renamed = {old: new for new, old in enumerate([*health, *observed, *rest], 1)}
    renumber = (renamed | {-old: -new for old, new in renamed.items()}).__getitem__
    components = tuple(str(variable) for variable in health)
    is_health = set(health)
    abnormal = {-variable: place for place, variable in enumerate(health)}
    origins = []
    for clause in hard:
        place = abnormal.get(clause[0]) if clause else None  # where it mostly is
        if place is None:
            place = next((abnormal[literal] for literal in clause if literal in abnormal), len(health))
        origins.append(place)
    rules = [
        Rule(f"the clauses of component {component}", f"component {component}") for component in components
    ]
    rules.append(Rule("the clauses of no component", "wcnf"))

    # one literal for each number, not for each time that it is seen
    literals = {
        number: Literal(Atom("ok" if abs(number) in is_health else "v", (str(abs(number)),)), number > 0)
        for number in seen
    }
    return SnapshotFile(
        HealthCnf(
            name=name,
            components=components,
            atoms=tuple(Atom("v", (str(variable),)) for variable in observed),
            clauses=tuple([tuple(map(renumber, clause)) for clause in hard]),
            origins=tuple(origins),
            rules=tuple(rules),
            variables=len(renamed),
            weak=all(map(is_health.isdisjoint, hard)),
        ),
        tuple([tuple([literals[number] for number in snapshot]) for snapshot in snapshots]),
    )
