"""Quarantine: components whose repairs keep failing, or never last, are left alone; the time doubles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from robomend.planning.tried import DEFAULT_PATIENCE, S_TO_NS, Attempt, Patience


@dataclass(frozen=True, slots=True)
class Quarantined:
    """Why a component is left alone, and until when."""

    failures: int
    until_ns: int
    reason: str


@dataclass
class _Record:
    """How the repairs of one component went lately."""

    patience: Patience
    failures: int = 0  # repairs in a row that did not help
    relapses: int = 0  # repairs in a row that helped, and not for long
    last_ns: int = 0
    helped: bool = False  # the last one

    def add(self, one: Attempt) -> None:
        """Take the next repair into account; it is also the news that the one before did not last."""
        if self.helped:
            # A quarantine in between was no time in which the component could break again and be repaired.
            soon_s = self.patience.relapse_s + self.backoff_s
            self.relapses = self.relapses + 1 if one.time_ns - self.last_ns <= soon_s * S_TO_NS else 0
        self.failures = 0 if one.helped else self.failures + 1
        self.last_ns, self.helped = one.time_ns, one.helped

    @property
    def relapsing(self) -> bool:
        """Whether it is the relapses that count most."""
        return self.relapses - self.patience.relapses > self.failures - self.patience.attempts

    @property
    def count(self) -> int:
        return self.relapses if self.relapsing else self.failures

    @property
    def backoff_s(self) -> float:
        """How long to leave the component alone after the last repair."""
        beyond = self.count - (self.patience.relapses if self.relapsing else self.patience.attempts)
        if beyond < 0:
            return 0.0
        # 2**63 s is longer than anybody waits; the exponent is bounded so that the power is too.
        return min(self.patience.max_backoff_s, self.patience.backoff_s * 2.0 ** min(beyond, 63))

    @property
    def why(self) -> str:
        if self.relapsing:
            return f"{self.count} times in a row, each time it helped, and soon it was broken again"
        return f"{self.count} times in a row and it did not help"


def quarantined(
    tried: Iterable[Attempt],
    *,
    now_ns: int,
    released: Mapping[str, int] | None = None,
    patience: Patience = DEFAULT_PATIENCE,
) -> dict[str, Quarantined]:
    """Return the components to leave alone now, with doubling back-off.

    Those whose last repairs all failed, and those that broke again each time, soon after a repair had helped.

    Args:
        released: when a person let a component be tried again; what came before does not count.
    """
    records: dict[str, _Record] = {}
    for one in sorted(tried, key=lambda one: one.time_ns):
        for name in one.bad:
            if one.time_ns >= (released or {}).get(name, one.time_ns):
                records.setdefault(name, _Record(patience)).add(one)
    found: dict[str, Quarantined] = {}
    for name, record in records.items():
        until_ns = record.last_ns + int(record.backoff_s * S_TO_NS)
        if now_ns < until_ns:
            found[name] = Quarantined(record.count, until_ns, f"{name} was repaired {record.why}")
    return found
