"""Where the time from detection to `repaired` goes: every moment of it has one part. Pure.

    detection ─ begins ─► repair ─ decides ─► plan ─ acts, between them ─► last act of the plan ─┐
        repaired ◄─ concludes ─ told of health ◄─ observers ◄─ robot starts ◄──────────────────┤
                                decides ◄──── nothing more came: a missing effect ◄────────────┘

Who is waited for is found by the truth, as everything in the score: what the robot publishes, and what its
observers have told of it. docs/score.md says what each part is.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from enum import StrEnum
from itertools import pairwise

from robomend_bench.faults.anatomy import Anatomy
from robomend_bench.faults.condition import Health, abnormal, device_in, silenced, supplied, unseen
from robomend_bench.faults.kinds import PASSING
from robomend_bench.faults.observing import PRESETS, aspects_delay_s
from robomend_bench.faults.record import ENDED, Record
from robomend_client.literals import Atom


class Part(StrEnum):
    """What a moment between detection and `repaired` went into."""

    BEGINS = "begins"  # no repair is open yet, or none any more
    DECIDES = "decides"  # the repair waits for diagnoses, plans, or the next try
    ACTS = "acts"  # an act was ordered and has not answered
    BETWEEN = "between acts"  # of one plan: sending the next, or awaiting what it rests on
    ROBOT = "robot starts"  # nothing is left to be done, or can be yet, and a topic or a device is not back
    OBSERVERS = "observers"  # not all of the truth has reached the service
    STAYS = "stays"  # it is well and told, for less long than its observers need to see it fail again
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
        self._told = record.told()
        self._boots = [boot for device in anatomy.devices for boot in self._boots_of(device)]
        self._stays = list(self._proving())

    def _boots_of(self, device: str) -> Iterator[tuple[str, float, float]]:
        """Yield when a device was given its power, and when it had booted."""
        had = True
        for at_s, state in self._record.states:
            has = supplied(self._anatomy, state, device)
            if has and not had:
                yield device, at_s, at_s + self._anatomy.devices[device].boot_s
            had = has

    def _proving(self) -> Iterator[tuple[float, float]]:
        """Yield when what was wrong came right, and until when its observer could not see it fail."""
        returned = {
            topic: max((ended_s for name, _, ended_s in self._record.silences if name == topic), default=0.0)
            for topic in self._anatomy.topics
        }
        before, silence = set[Atom](), dict[Atom, bool]()  # what is wrong; whether it was only ever silent
        for at_s, state in self._record.states:
            silent = silenced(self._anatomy, state)
            now = {odd.atom for odd in abnormal(self._anatomy, state)}
            silence |= {atom: silence.get(atom, True) and atom.args[0] in silent for atom in now}
            for atom in before - now:
                back_s = max(at_s, returned.get(atom.args[0], 0.0))
                yield back_s, back_s + self._noticed_s(atom, silence=silence[atom])
            before = now
        for aspect in self._anatomy.aspects:  # what is judged of them is judged anew
            needs_s = aspects_delay_s(self._anatomy, {aspect.atom})
            ends = [ended_s for topic, _, ended_s in self._record.silences if topic in aspect.flows]
            yield from ((ended_s, ended_s + needs_s) for ended_s in ends)

    def _noticed_s(self, atom: Atom, *, silence: bool) -> float:
        """Return how long the observers of something take at most to see it fail."""
        topic = self._anatomy.topics.get(atom.args[0])
        if atom.predicate == "ok" and topic is not None:
            rate = PRESETS[self._record.observers].of(topic.rate_hz, topic.tolerance_hz)
            return (rate.silence if silence else max(rate.silence, rate.first_verdict_s)) + rate.check_s
        return aspects_delay_s(self._anatomy, {atom})

    def times(self) -> set[float]:
        """Return every moment at which the part may change."""
        record = self._record
        return {
            *(seen.at_s for seen in record.repairs),
            *(at_s for act in self._acts for at_s in act),
            *(at_s for at_s, _ in record.states),
            *(at_s for at_s, _ in self._told),
            *(at_s for _, began_s, ended_s in record.silences for at_s in (began_s, ended_s)),
            *(at_s for _, began_s, ended_s in self._boots for at_s in (began_s, ended_s)),
            *(at_s for proving in self._stays for at_s in proving),
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
        well, open_ = not abnormal(self._anatomy, truth), bool(state) and state not in ENDED
        if well and self._passing and not open_:
            return Part.PASSES
        between = False
        if state == "running":
            round_ends_s = next((r.at_s for r in repairs[last + 1 :] if r.state != "running"), float("inf"))
            between = any(at_s < began_s < round_ends_s for began_s, _ in self._acts)
        nothing_to_do = well or (state == "running" and not between)
        if self._boots_first(at_s) or (nothing_to_do and self._starts(at_s)):
            return Part.ROBOT
        if not self._all_told(at_s):
            return Part.OBSERVERS
        if well and any(back_s <= at_s < until_s for back_s, until_s in self._stays):
            return Part.STAYS
        if not open_:
            return Part.BEGINS
        if well:
            return Part.CONCLUDES
        if state == "running":
            return Part.BETWEEN if between else Part.MISSING
        return Part.DECIDES

    def _boots_first(self, at_s: float) -> bool:
        """Whether a device boots whose driver has to be started: nothing is back before that."""
        broken = {name for name, _ in self._record.state_at(at_s)}
        return any(
            began_s <= at_s < ended_s and not broken.isdisjoint(self._anatomy.drivers[device])
            for device, began_s, ended_s in self._boots
        )

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
        """Whether the service had been told all of the truth of this moment, the board's word aside."""
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
