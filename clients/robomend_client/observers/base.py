"""The one shape of all observers: samples with their times go in, verdicts come out. No clocks, no sockets,
no threads.

    feed(source, time_ns, value)   one sample: a message of a topic, the table of processes, …
    due_ns()                       when a verdict may change by time alone
    check(now_ns)                  the verdicts that hold now; an atom that is not among them is unknown
    evidence(atom, now_ns)         what a verdict rests on
    reset(time_ns)                 judge anew, by what comes from now on

So the same observer runs on a robot (fed by the agent), in a bridge (fed by ROS) and over a log (fed from a
bag, with the bag's times). Who feeds and asks it, in which order, is the Driver's business: see driver.py.
Times are integer nanoseconds of one clock; an observer never asks for the time itself. That nobody looks at
a source is the driver's business, too: an observer is reset when somebody does again.

A verdict is a literal with `since`, the beginning of the span that it rests on:

    a rate or a trend      the oldest sample of its window
    silence                now, less the silence that was waited for: it is confirmed as long as it goes on
    a reading              the reading

and, where it has them, `onset`: the last good sample before it turned bad, and `reading`: what was measured,
for people ("16 of 50 Hz") and with the kind of its symptom. Evidence that is older than an
action's answer says nothing about the action, so a verdict never claims to be younger than its samples are.

To add an observer of your own, write a function or a class and name it in the agent's file:
docs/observers.md, "Your own observer". To add one to robomend:

1. observers/NAME.py, or that of a kind which it is alike: the parameters (a frozen dataclass), the observer
   (one that judges readings by `Readings` is a reading.JudgedReadings); what each parameter is, with its
   unit, stands in their docstrings, from where editors and the reference have it;
2. a line in KINDS of observers/kinds.py, and in the map of observers/__init__.py;
3. docs/observers.md: its section;
4. tests/clients/observers/test_NAME.py, and an observer in EVERY_KIND of test_kinds.py beside it.

The schemas in examples/ follow from these; `./dev check --fix` writes them.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Collection, Sequence
from enum import Enum
from math import isfinite
from typing import Any, NamedTuple, Protocol, runtime_checkable

from robomend_client.literals import Atom, Literal
from robomend_client.readings import Reading


class Listener:
    """Told of everything that a driver takes in; by itself it lets it pass."""

    def sample(self, source: str, time_ns: int, value: object, now_ns: int) -> None:
        """A sample was taken in."""

    def lapse(self, now_ns: int, until_ns: int) -> None:
        """Nobody looks until then."""

    def starved(self, now_ns: int, yes: bool) -> None:
        """This computer is starved from now on, or no more."""

    def sight(self, now_ns: int, source: str, sight: Contact) -> None:
        """Nobody looks at a source any more, or somebody does again."""

    def publishers(self, now_ns: int, source: str, nodes: Sequence[str]) -> None:
        """These nodes publish a source."""

    def settle(self, now_ns: int, n: int, atoms: Collection[Atom]) -> None:
        """Observers were told to judge anew."""

    def restart(self, now_ns: int) -> None:
        """Time begins again, here."""


SECOND = 1_000_000_000

NOTHING: tuple[Literal, ...] = ()


def ns(seconds: float) -> int:
    """Return seconds as integer nanoseconds."""
    return round(seconds * SECOND)


class Contact(Enum):
    """Delivered in place of a sample: whether anybody looks at its source.

    What does not come while nobody looks is no silence. Observers of the source judge anew.
    """

    LOST = "lost"  # nobody looks from now on, until BACK or the next sample
    BACK = "back"  # somebody looks from now on; without LOST before it: nobody did, until now


class Publishers(NamedTuple):
    """Delivered in place of a sample: who publishes its source, as far as the robot's graph shows."""

    nodes: tuple[str, ...]


class Evidence(NamedTuple):
    """What a verdict rests on."""

    since_ns: int  # the beginning of the span that it rests on
    onset_ns: int | None = None  # the last good sample before it turned bad
    reading: Reading | None = None  # what was measured


class Verdict(NamedTuple):
    """A literal and what it rests on."""

    literal: Literal
    since_ns: int
    onset_ns: int | None = None
    reading: Reading | None = None


@runtime_checkable
class Observer(Protocol):
    """One observer of one aspect of the robot."""

    @property
    def sources(self) -> frozenset[str]:
        """What it wants to be fed with.

        `scan` is a topic: each message counts, its value does not matter. `odom:twist.twist.linear.x` is a
        field of one. Others are `processes`, `diagnostics`, `board`, and what a feeder of your own offers.
        """
        ...

    @property
    def atoms(self) -> tuple[Atom, ...]:
        """All that it may ever speak of; what it does not say is unknown."""
        ...

    @property
    def period_ns(self) -> int:
        """How often it is asked while samples come, on the grid of multiples of this. 0: after each
        sample.
        """
        ...

    @property
    def detection_s(self) -> float:
        """Detection delay: from a fault to the verdict that names it, at most."""
        ...

    @property
    def settling_s(self) -> float:
        """Settling time: from a reset to a verdict of either sign, at most, if there is anything to see."""
        ...

    def feed(self, source: str, time_ns: int, value: object) -> None:
        """Take in one sample.

        The times of one source do not go back, except by more than the observer looks back (a log that starts
        again, a simulation that was reset): then it starts anew. A value that it cannot read is an error
        (ValueError, WrongKind); a number that is none (NaN) is NoNumber: the driver leaves it out.
        """
        ...

    def due_ns(self) -> int | None:
        """Return when a verdict may change without another sample; None: by a sample only.

        A time that is past has had its answer. Who has several of them says the next one: DueAgain.
        """
        ...

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        """Return what holds at `now_ns`, which is no earlier than any check before.

        The same samples and the same time give the same answer, however often it was asked in between.
        """
        ...

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        """Return what the verdict on `atom` rests on; asked only for atoms that `check(now_ns)` names."""
        ...

    def reset(self, time_ns: int) -> None:
        """Forget all samples; from `time_ns` on, judge by what comes. Also called once before the first
        sample.
        """
        ...


@runtime_checkable
class DueAgain(Protocol):
    """An observer whose verdicts turn unknown one after another: each has a time of its own."""

    def due_after(self, now_ns: int) -> int | None:
        """Return the first of those times after `now_ns`; `due_ns` may be one that is past."""
        ...


@runtime_checkable
class Patient(Protocol):
    """An observer to which the times of its samples matter: a rate, a trend."""

    @property
    def patience_s(self) -> float:
        """How much later than it was sent a sample may be heard of, now, without a verdict that is wrong.

        An agent that was held up for longer has it judge anew. Others bear half of their detection delay.
        """
        ...


class Doubt:
    """Times in which this computer is starved (beats.Lateness), and a while after each: what comes late then,
    or not at all, is no sign of a fault.
    """

    def __init__(self, after_s: float) -> None:
        """`after_s`: so long after it verdicts rest on what came in such a time."""
        self._after_ns = ns(after_s)
        self._from_ns = self._until_ns = -(1 << 62)
        self._starved = False

    def starved(self, yes: bool, time_ns: int) -> None:
        """It is from now on, or no more."""
        if yes:
            if time_ns >= self._until_ns:
                self._from_ns = time_ns
            self._until_ns = 1 << 62
        elif self._starved:
            self._until_ns = time_ns + self._after_ns
        self._starved = yes

    def at(self, time_ns: int) -> bool:
        return self._from_ns <= time_ns < self._until_ns

    def put_off(self, due_ns: int, longest_ns: int) -> int:
        """Return when what is due at a time counts: not in doubt, where it would be over before `longest_ns`
        are; what was due before counts as it was.
        """
        if not self._from_ns <= due_ns < self._until_ns:  # asked for most often of all
            return due_ns
        return min(due_ns + longest_ns, self._until_ns)


@runtime_checkable
class Doubts(Protocol):
    """An observer that says bad of what comes late, or not at all."""

    def starved(self, yes: bool, time_ns: int) -> None:
        """This computer is starved from now on, or no more."""
        ...


@runtime_checkable
class SeesPublishers(Protocol):
    """An observer that is told who publishes a source of it, where a feed knows."""

    def published_by(self, nodes: Sequence[str], time_ns: int) -> None:
        """These nodes publish it from now on, once for each publisher."""
        ...


@runtime_checkable
class Steady(Protocol):
    """An observer that can take in many samples at once while its verdict stays: for logs."""

    def steady(self, times_ns: Any, values: Any, until_ns: int) -> Callable[[], None] | None:
        """Return what takes these samples in, if its verdict is the same at each moment until `until_ns`.

        None, and nothing has changed: it must be fed with them one by one.

        Args:
            times_ns: of its one source, none before another: an array of integers.
            values: likewise, an array of numbers; None where times suffice.
            until_ns: not before the last of them.
        """
        ...


class NoNumber(ValueError):
    """A sample that should be a number, and is none (NaN, infinite): it is left out, and told once."""


class WrongKind(TypeError):
    """A sample that is something else than the observer reads, as when a topic changes its type.

    What the observer watches is unknown until one comes that it can read.
    """

    def __init__(self, needed: str, value: object) -> None:
        super().__init__(f"{needed} needed, not {reprlib.repr(value)}")


def number(value: object) -> float:
    """Return a sample as a number, true as 1.

    Raises:
        NoNumber: it is NaN, or infinite; whoever feeds the observer leaves it out.
        WrongKind: it is something else altogether.
    """
    if type(value) is not float:
        if not isinstance(value, (int, float)):
            raise WrongKind("a number is", value)
        try:
            value = float(value)
        except OverflowError as error:
            raise NoNumber("an infinite number") from error
    if isfinite(value):
        return value
    raise NoNumber(f"no number: {value}")


def finite(value: object) -> float | None:
    """Return a part of a sample as a number; None where it is missing or none, which spoils no other part."""
    try:
        return None if value is None else number(value)
    except NoNumber:
        return None


def positive(**values: float) -> None:
    """Check parameters that must be above 0; the error begins with the name of the one that is not."""
    for name, value in values.items():
        if not value > 0:
            raise ValueError(f"{name} must be above 0, not {value:g}")
