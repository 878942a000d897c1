"""The multiple observer (MObs): ok(OUT_triggered) while each message of one topic is answered on another in
time.

    in    |              |              |
    out      |  in time     ···········x   |  too late
              ok                  not ok at `within_s`, without waiting for the answer

An answer counts for all that was asked before it. A message on the other topic that nothing was asked for
says nothing, or that something is wrong, with `unasked: bad`. When nothing is asked for `lifetime_s`, the
verdict is unknown. On a computer that is starved, a late answer says nothing, and none counts LATER_S later.

Source: the paper, section IV-B. The published observer judges only when an answer comes, so that a node that
never answers is never noticed; `preset: published` has its parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from robomend_client.literals import Atom, Literal, parse_atom
from robomend_client.observers.base import NOTHING, SECOND, Doubt, Evidence, ns, positive
from robomend_client.readings import Reading, Symptom

LATER_S = 4.0


@dataclass(frozen=True)
class Answers:
    """What is expected.

    Attributes:
        within_s: from a message to its answer, at most, in seconds.
        unasked: what an answer means that nothing was asked for: `ignored` or `bad`.
        interval_s: how often something is asked, in seconds; only for the delays that are declared.
        lifetime_s: when nothing was asked for so many seconds, the verdict is unknown.
    """

    within_s: float = 0.5
    unasked: str = "ignored"
    interval_s: float = 1.0
    lifetime_s: float = 10.0

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"published": {"within_s": 0.5, "unasked": "bad"}}

    def __post_init__(self) -> None:
        positive(within_s=self.within_s, interval_s=self.interval_s, lifetime_s=self.lifetime_s)
        if self.unasked not in ("ignored", "bad"):
            raise ValueError(f"unasked must be one of ignored, bad, not {self.unasked!r}")


class MultipleObserver:
    """Watches whether one topic answers another."""

    def __init__(self, atom: str, in_topic: str, out_topic: str, expected: Answers | None = None) -> None:
        """
        Args:
            atom: what it speaks of, e.g. `ok(map_triggered)`; by default the entry's name.
            in_topic: the topic that asks.
            out_topic: the topic that answers.
            expected: of the answers.
        """
        if in_topic == out_topic:
            raise ValueError(f"out_topic must be another topic than in_topic, {in_topic}")
        expected = expected or Answers()
        self.atoms: tuple[Atom, ...] = (parse_atom(atom),)
        self.sources = frozenset((in_topic, out_topic))
        self.period_ns = 0
        self.detection_s = expected.within_s
        self.settling_s = expected.interval_s + expected.within_s
        self._in = in_topic
        self._within_ns = ns(expected.within_s)
        self._doubt = Doubt(expected.within_s)
        self._later_ns = max(self._within_ns, ns(LATER_S))
        self._limit = f"at most {expected.within_s:g}"
        self._lifetime_ns = ns(expected.lifetime_s)
        self._unasked_is_bad = expected.unasked == "bad"
        self._signs = {good: (Literal(self.atoms[0], good),) for good in (True, False)}
        self.reset(0)

    def reset(self, time_ns: int) -> None:
        self._asked_ns: int | None = None  # the oldest that is not answered
        self._from_ns = time_ns
        self._took_ns: int | None = None  # the newest answer; None: nothing was asked for it
        self._verdict: bool | None = None
        self._since_ns = self._judged_ns = time_ns
        self._good_ns: int | None = None

    def feed(self, source: str, time_ns: int, value: object = None) -> None:
        """A message of either topic; its value does not matter."""
        if source == self._in:
            if self._asked_ns is None:
                self._asked_ns = time_ns
        elif self._asked_ns is not None:
            self._took_ns = time_ns - self._asked_ns
            in_time = self._took_ns <= self._within_ns
            if in_time or time_ns > self._late_ns(self._asked_ns):
                self._judge(time_ns, in_time, self._asked_ns)
            self._asked_ns = None
        elif self._unasked_is_bad and time_ns - self._from_ns > self._within_ns:
            # Sooner it may answer what was asked before the reset.
            self._took_ns = None
            self._judge(time_ns, False, time_ns)

    def starved(self, yes: bool, time_ns: int) -> None:
        """This computer is from now on, or no more: who answers here is late as well."""
        self._doubt.starved(yes, time_ns)

    def _late_ns(self, asked_ns: int) -> int:
        """Return the last moment at which an answer is in time."""
        return self._doubt.put_off(asked_ns + self._within_ns, self._later_ns)

    def due_ns(self) -> int | None:
        if self._asked_ns is not None:
            return self._late_ns(self._asked_ns) + 1
        if self._verdict is None:
            return None
        ends_ns = self._judged_ns + self._lifetime_ns
        return min(ends_ns, max(self._judged_ns, self._from_ns + self._within_ns)) if self._early else ends_ns

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        if self._overdue(now_ns):
            return self._signs[False]
        if self._verdict is None or now_ns - self._judged_ns >= self._lifetime_ns:
            return NOTHING
        if self._verdict and now_ns - self._from_ns < self._within_ns:
            return NOTHING  # that there is no answer could not be known yet
        return self._signs[self._verdict]

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        if self._overdue(now_ns):
            assert self._asked_ns is not None
            waits = f"no answer for {(now_ns - self._asked_ns) / SECOND:.3g} s"
            return Evidence(self._asked_ns, self._good_ns, Reading(waits, "", self._limit, Symptom.SILENT))
        if self._took_ns is None:
            reading = Reading("an answer that nothing was asked for", symptom=Symptom.VALUE)
        else:
            slow = None if self._verdict else Symptom.SLOW
            reading = Reading(round(self._took_ns / SECOND, 3), "s", self._limit, slow)
        return Evidence(self._since_ns, None if self._verdict else self._good_ns, reading)

    @property
    def _early(self) -> bool:
        """Whether the verdict came so soon after the reset that it is not said at once."""
        return self._verdict is True and self._judged_ns - self._from_ns < self._within_ns

    def due_after(self, now_ns: int) -> int | None:
        times_ns = (self._from_ns + self._within_ns, self._judged_ns + self._lifetime_ns)
        return None if self._verdict is None else min((t for t in times_ns if t > now_ns), default=None)

    def _overdue(self, now_ns: int) -> bool:
        return self._asked_ns is not None and now_ns > self._late_ns(self._asked_ns)

    def _judge(self, time_ns: int, good: bool, since_ns: int) -> None:
        self._verdict = good
        self._judged_ns = time_ns
        self._since_ns = since_ns
        if good:
            self._good_ns = time_ns
