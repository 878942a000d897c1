"""An observer that says what it is told to, and topics that are fed to a driver."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from robomend_client.literals import Atom, Literal
from robomend_client.observers import Change, Driver, Evidence, GeneralObserver, Rate, Verdict, ns
from robomend_client.readings import Reading

SCAN = Atom("ok", ("scan",))
RATE = Rate(window=11, settle=5, silence_s=0.5, check_s=0.1)
DEMO = Rate(rate_hz=10, tolerance_hz=1, window=11, settle=5, silence_s=0.5, check_s=0.1)


class Told:
    """An observer that says what it is told to: the newest sample is its verdict."""

    def __init__(
        self, source: str, atom: Atom = SCAN, settling_s: float = 1.0, *, reads: bool = False
    ) -> None:
        self.sources = frozenset((source,))
        self.atoms = (atom,)
        self.period_ns = 0
        self.detection_s = 1.0
        self.settling_s = settling_s
        self.reads = reads
        self.said: tuple[Literal, ...] = ()
        self.reading: Reading | None = None
        self.reset(0)

    def feed(self, source: str, time_ns: int, value: object) -> None:
        if value == "boom":
            raise RuntimeError("boom")
        self.said = () if value is None else (Literal(self.atoms[0], bool(value)),)
        self.reading = None if value is None else Reading(f"{source} said {value}")
        self.fed_ns = time_ns

    def due_ns(self) -> int | None:
        return None

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        return self.said

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        return Evidence(self.fed_ns, reading=self.reading if self.reads else None)

    def reset(self, time_ns: int) -> None:
        self.said = ()
        self.reading = None
        self.fed_ns = time_ns


def values(changes: Sequence[Change]) -> list[str]:
    return [str(change.value) for change in changes]


def bare(verdicts: Iterable[Verdict]) -> list[Verdict]:
    """Return verdicts without what was measured."""
    return [verdict._replace(reading=None) for verdict in verdicts]


def beat(driver: Driver, source: str, first_s: float, count: int, hz: float = 10.0) -> list[Change]:
    """Feed a regular topic, live."""
    changes: list[Change] = []
    for k in range(count):
        at_ns = ns(first_s + k / hz)
        changes += driver.sample(source, at_ns, now_ns=at_ns)
    return changes


def verdict(observer: GeneralObserver, now_s: float) -> bool | None:
    """Return the sign of the topic's literal, or None if it is unknown."""
    literals = observer.check(ns(now_s))
    return literals[0].positive if literals else None
