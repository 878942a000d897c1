"""What a suite is, and where suites are found. One file a suite, in `robomend_bench/suites/`.

A suite gives groups of questions about one model (a circuit, a robot of one size) and turns a contender's
name into something that answers them. To add one, put a module with an object `SUITE` into `suites/`; it is
found by itself:

    class Mine:
        name, version, summary = "mine", "1", "one line for --list"
        modes = {"first": "what is measured"}          the first one is the default
        def contenders(self, mode): ...                names that run when --engines says nothing
        def groups(self, wish): ...                    models and questions; seeded, the same for all
        def prepare(self, contender, group, wish): ... in the contender's own process: returns `ask`
        def exported(self, question, group): ...       what other solvers are asked: robomend_bench.exporting

    SUITE = Mine()

Groups, questions and answers must pickle: each contender answers in a process of its own. Questions that
change make a new version: papers cite a suite by its name, version and seed.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol
from typing import Literal as OneOf

from robomend.errors import OptionRefused
from robomend_bench.exporting import Exported

Clock = OneOf["wall", "cpu"]

DATA = Path(__file__).resolve().parent / "data"
"""The circuits and instances that come with the package."""


ONE = ("first", "why", "few", "once", "cold", "cold-why", "structure")
"""Modes that ask for one minimum-cardinality diagnosis; see robomend_bench.contenders."""

EXPLAINED = ("why", "few", "cold-why", "explained")
"""Modes in which conflicts are told, as they are by default; in the others they are left out."""


@dataclass(frozen=True, slots=True)
class External:
    """A solver of somebody else, by its command line: see robomend_bench.external."""

    name: str
    format: str
    command: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Wish:
    """What the command line asks of a suite."""

    mode: str
    only: tuple[str, ...] = ()  # names of groups; empty: the suite's own choice
    instances: int | None = None  # questions a group; None: the suite's own choice
    seed: int = 1
    faults: tuple[int, int] | None = (
        None  # how many are injected, at least and at most; None: the suite's own
    )
    # Only questions of these minimum cardinalities, equally many of each, where a suite can tell.
    sizes: tuple[int, int] | OneOf["any"] | None = None
    max_size: int = 2  # in mode "subset"
    timeout_s: float = 10.0  # a question
    clock: Clock = "wall"  # or "cpu": the time of the process, for machines that others use too
    data: Path = DATA
    external: tuple[External, ...] = ()  # solvers of others, as contenders by a command line


@dataclass(frozen=True, slots=True)
class Question:
    """One instance: the name that tables show, and whatever the suite needs to ask it."""

    name: str
    payload: Any


@dataclass(frozen=True, slots=True)
class Group:
    """Questions about one model; `size` is the x of the scaling plot (components)."""

    name: str
    size: int
    model: Any
    questions: tuple[Question, ...]


@dataclass(frozen=True, slots=True)
class Answer:
    """What a contender answered. Two complete answers to one question must have the same `result`."""

    result: tuple[int | None, ...]  # compared between contenders, e.g. (number of diagnoses,)
    complete: bool
    shown: int | None = None  # for the table: how many diagnoses
    calls: int = 1  # one measurement may hold many calls of some microseconds; the time is divided
    seconds: float | None = None  # a published figure, which is taken instead of the time measured
    cost: float | None = None  # of a plan, see robomend_bench.tables
    bound: float = 1.0  # how many times the cheapest cost that is known this contender may need
    note: str = ""  # why it is not complete


Ask = Callable[[Question], Answer]


class Suite(Protocol):
    """See the module."""

    name: str
    version: str
    summary: str
    modes: Mapping[str, str]

    def contenders(self, mode: str) -> tuple[str, ...]:
        """Return who runs when nobody is named; the first is the one that ratios refer to."""
        ...

    def groups(self, wish: Wish) -> Iterator[Group]:
        """Yield the groups, the smallest first."""
        ...

    def prepare(self, contender: str, group: Group, wish: Wish) -> Ask:
        """Return what answers this group's questions; building it is not part of the measurement."""
        ...

    def exported(self, question: Question, group: Group) -> Exported:
        """Return what solvers that are not ours are asked.

        Raises:
            OptionRefused: the question is none for them.
        """
        ...


def suite_names() -> tuple[str, ...]:
    """Return the suites that are there, in alphabetical order."""
    return tuple(sorted(_modules()))


def find_suite(name: str) -> Suite:
    """Return a suite by the name that people use, e.g. `robots-v1`.

    Raises:
        OptionRefused: there is none of this name.
    """
    modules = _modules()
    if name not in modules:
        raise OptionRefused(f"no suite is named {name!r}: there are {', '.join(sorted(modules))}")
    suite: Suite = import_module(modules[name]).SUITE
    return suite


def _modules() -> dict[str, str]:
    package = import_module("robomend_bench.suites")
    names = [module.name for module in pkgutil.iter_modules(package.__path__)]
    return {name.replace("_", "-"): f"{package.__name__}.{name}" for name in names}
