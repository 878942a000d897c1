"""Where the time from detection to `repaired` goes: every moment of it has one part. Pure.

    detection ─ begins ─► repair ─ decides ─► plan ─ acts, between them ─► last act of the plan ─┐
        repaired ◄─ concludes ─ told of health ◄─ observers ◄─ robot starts ◄──────────────────┤
                                decides ◄──── nothing more came: a missing effect ◄────────────┘

Who is waited for is found by the truth, as everything in the score: what the robot publishes, and what its
observers have told of it. docs/score.md says what each part is.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from enum import StrEnum
from itertools import pairwise

from robomend_bench.faults.anatomy import Anatomy
from robomend_bench.faults.condition import Health, abnormal, device_in, unseen
from robomend_bench.faults.kinds import PASSING
from robomend_bench.faults.record import ENDED, Record
from robomend_client.literals import Atom


class Part(StrEnum):
    """What a moment between detection and `repaired` went into."""

    BEGINS = "begins"  # no repair is open yet, or none any more
    DECIDES = "decides"  # the repair waits for verdicts, diagnoses, plans
    ACTS = "acts"  # an act was ordered and has not answered
    BETWEEN = "between acts"  # of one plan: sending the next, or awaiting what it rests on
    ROBOT = "robot starts"  # nothing is left to be done, and a topic is not back yet
    OBSERVERS = "observers"  # all topics are as the truth says, and not all of it is told
    MISSING = "missing effect"  # all is told, it is not well, and the plan's effect is still awaited
    CONCLUDES = "concludes"  # all is told, and it is well
    PASSES = (
        "passes"  # what goes by itself is there, and nobody can mend it; or it has gone, until the next time
    )


def where_time_goes(record: Record, anatomy: Anatomy, from_s: float, until_s: float) -> dict[Part, float]:
    """Return how many of the seconds from detection to `repaired` went into each part; they add up."""
    found = dict.fromkeys(Part, 0.0)
    moments = _Moments(record, anatomy)
    times = sorted({from_s, until_s, *(at_s for at_s in moments.times() if from_s < at_s < until_s)})
    for at_s, next_s in pairwise(times):
        found[moments.part(at_s)] += next_s - at_s
    return found


class _Moments:
    def __init__(self, record: Record, anatomy: Anatomy) -> None:
        self._record = record
        self._anatomy = anatomy
        self._acts = [
            (acted.at_s, acted.at_s if acted.done_s is None else acted.done_s) for acted in record.acts
        ]
        self._passing = {fault.component for _, fault in record.faults if fault.kind in PASSING}
        self._told: list[tuple[float, Mapping[Atom, bool]]] = []
        held: dict[Atom, bool] = {}
        for at_s, literals in record.said:
            held = held | {literal.atom: literal.positive for literal in literals}
            self._told.append((at_s, held))

    def times(self) -> set[float]:
        """Return every moment at which the part may change."""
        record = self._record
        return {
            *(seen.at_s for seen in record.repairs),
            *(at_s for act in self._acts for at_s in act),
            *(at_s for at_s, _ in record.states),
            *(at_s for at_s, _ in record.said),
            *(at_s for _, began_s, ended_s in record.silences for at_s in (began_s, ended_s)),
        }

    def part(self, at_s: float) -> Part:
        """Return what the time right after this moment went into."""
        if any(began_s <= at_s < ended_s for began_s, ended_s in self._acts):
            return Part.ACTS
        repairs, truth = self._record.repairs, self._record.state_at(at_s)
        if any(device_in(truth, name).health is Health.DEAD for name in self._passing):
            return Part.PASSES
        last = bisect_right([seen.at_s for seen in repairs], at_s) - 1
        state = "" if last < 0 else repairs[last].state
        well = not abnormal(self._anatomy, truth)
        if not state or state in ENDED:
            return Part.PASSES if self._passing and well else Part.BEGINS
        if state == "running":
            round_ends_s = next((r.at_s for r in repairs[last + 1 :] if r.state != "running"), float("inf"))
            if any(at_s < began_s < round_ends_s for began_s, _ in self._acts):
                return Part.BETWEEN
        if state != "running" and not (state == "verifying" and well):
            return Part.DECIDES
        if self._starts(at_s):
            return Part.ROBOT
        if not self._all_told(at_s):
            return Part.OBSERVERS
        return Part.CONCLUDES if well else Part.MISSING

    def _starts(self, at_s: float) -> bool:
        """Whether a topic is silent that is not in the truth of this moment."""
        odd = {literal.atom for literal in abnormal(self._anatomy, self._record.state_at(at_s))}
        return any(
            began_s <= at_s < ended_s
            and self._anatomy.topics[topic].observed
            and Atom("ok", (topic,)) not in odd
            for topic, began_s, ended_s in self._record.silences
        )

    def _all_told(self, at_s: float) -> bool:
        """Whether the observers had told all of the truth of this moment, the board's word aside."""
        state = self._record.state_at(at_s)
        odd = {literal.atom for literal in abnormal(self._anatomy, state)}
        unknown = unseen(self._anatomy, state)
        board = self._anatomy.power == "board"
        last = bisect_right([told_s for told_s, _ in self._told], at_s) - 1
        held = self._told[last][1] if last >= 0 else {}
        return all(
            held.get(literal.atom) == (literal.atom not in odd)
            for literal in self._anatomy.healthy
            if not (board and literal.atom.predicate == "on") and literal.atom not in unknown
        )
