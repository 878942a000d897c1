"""Which topic answers which, seen from their times alone, and how fast it does.

    in    |     |        |     |         an answer comes a while after what it answers,
    out     |     |        |     |       and where the one is late, so is the other

That B follows A closely says nothing: two timers of one computer do so, too. An answer inherits the jitter
of what it answers. So the intervals of B are compared with those of the messages of A before them, by rank (a
pause of the whole computer is one pair of many), and only where B skips as many messages of A as it usually
does: a B that comes before its A would be compared with another one, and seem to follow it. What two answers
to the same topic have in common is that topic: a further input counts only for what the first one does not
explain (partial correlation).

Where the recording does not name publishers, topics that are sent within TOGETHER_S are taken to be of one
node, not an answer and its question: a camera sends its image and its calibration so.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from robomend_batch.learn.stretches import Times
from robomend_batch.learn.tails import Bound, bound
from robomend_client.observers.base import SECOND

LEAST_PAIRS = 100
MOST_PAIRS = 20_000
LEAST_LIKENESS = 0.12
"""Correlation by rank."""

LEAST_SIGNIFICANCE = 8.0
"""Likeness times the root of the pairs: so many standard deviations."""

CLOSE = 0.3
"""Of an interval of A: answers scatter by less (their middle half)."""

MOST_BEHIND = 4
"""Messages of A that may be under way."""

MOST_INPUTS = 3
TOGETHER_S = 0.002
LEAST_WITHIN_S = 0.05

Ranks = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DelayFound:
    """What was learned of a topic that answers others."""

    out_topic: str
    in_topic: str  # which it answers most closely
    more: tuple[str, ...]  # which it rests on besides
    likeness: float
    usual_s: float  # from the newest message to the answer
    within: Bound  # from the oldest unanswered one
    interval_s: float  # of the input


@dataclass(slots=True, eq=False)
class _Candidate:
    topic: str
    likeness: float
    delay_s: float
    ranks: Ranks  # of its intervals, by the intervals of the answers; NaN: there is none
    partial: float = field(default=0.0)


def learn_delays(
    pieces: Mapping[str, Sequence[Times]],
    node_of: Mapping[str, str],
    hours: float,
    per_hour: float,
    unnamed: Collection[str] = (),
) -> tuple[list[DelayFound], list[tuple[str, str]]]:
    """Return the topics that answer others, and those that are sent together.

    Args:
        pieces: topic -> its sorted times, by stretch; the stretches of all topics are the same.
        node_of: topic -> the node that publishes it; a node does not answer itself.
        hours: of all stretches.
        per_hour: false alarms, of each.
        unnamed: topics whose publishers are not known.
    """
    found = []
    together: list[tuple[str, str]] = []
    for out in sorted(pieces):
        inputs = _inputs(out, pieces, node_of)
        at_once = [one for one in inputs if one.delay_s < TOGETHER_S and {one.topic, out} & set(unnamed)]
        together += [(one.topic, out) for one in at_once]
        inputs = [one for one in inputs if one not in at_once]
        if not inputs:
            continue
        closest = inputs[0]
        samples = np.concatenate(
            [_waits(a, b) for a, b in zip(pieces[closest.topic], pieces[out], strict=True)]
        )
        if len(samples) < LEAST_PAIRS:
            continue
        gaps = np.concatenate([np.diff(times) for times in pieces[closest.topic]]) / SECOND
        found.append(
            DelayFound(
                out,
                closest.topic,
                tuple(sorted(one.topic for one in inputs[1:])),
                closest.likeness,
                closest.delay_s,
                bound(samples, hours, per_hour),
                float(np.median(gaps)),
            )
        )
    return found, together


def _inputs(out: str, pieces: Mapping[str, Sequence[Times]], node_of: Mapping[str, str]) -> list[_Candidate]:
    """Return what a topic answers, the closest first."""
    intervals = _ranks(np.concatenate([_interval(times) for times in pieces[out]] or [np.zeros(0)]))
    if np.isfinite(intervals).sum() < LEAST_PAIRS:
        return []
    candidates = []
    for topic in sorted(pieces):
        if topic != out and node_of[topic] != node_of[out]:
            candidate = _candidate(topic, pieces[topic], pieces[out], intervals)
            if candidate is not None:
                candidates.append(candidate)
    chosen: list[_Candidate] = []
    while candidates and len(chosen) < MOST_INPUTS:
        for one in candidates:
            one.partial = _partial(one.ranks, intervals, [other.ranks for other in chosen])
        best = max(candidates, key=lambda one: one.partial)
        if best.partial < LEAST_LIKENESS:
            break
        chosen.append(best)
        candidates.remove(best)
    return chosen


def _candidate(
    topic: str, asked: Sequence[Times], answers: Sequence[Times], intervals: Ranks
) -> _Candidate | None:
    """Return how alike the intervals are, for the number of messages under way that makes them most alike."""
    gaps = np.concatenate([np.diff(times) for times in asked] or [np.zeros(0)])
    if not len(gaps):
        return None
    best: _Candidate | None = None
    for behind in range(MOST_BEHIND):
        delays, steps = [], []
        for a, b in zip(asked, answers, strict=True):
            before = np.searchsorted(a, b, side="right") - 1 - behind
            known = before >= 0
            at = np.where(known, a[np.maximum(before, 0)] if len(a) else 0, 0)
            delay = np.where(known, b - at, np.nan).astype(np.float64)
            step = np.full(len(b), np.nan)
            if len(b) > 1:
                skipped = np.diff(before)
                usual = np.bincount(skipped[skipped > 0]).argmax() if (skipped > 0).any() else 0
                step[1:] = np.where(known[:-1] & (skipped == usual) & (usual > 0), np.diff(at), np.nan)
            delays.append(delay[-MOST_PAIRS:])
            steps.append(step)
        ranks = _ranks(np.concatenate(steps))
        delay_ns = np.concatenate(delays)
        delay_ns = delay_ns[np.isfinite(delay_ns)]
        if len(delay_ns) < LEAST_PAIRS:
            return best
        low, high = np.quantile(delay_ns, (0.25, 0.75))
        if high - low > CLOSE * float(np.median(gaps)):
            continue
        likeness, pairs = _alike(ranks, intervals)
        if likeness < LEAST_LIKENESS or likeness * np.sqrt(pairs) < LEAST_SIGNIFICANCE:
            continue
        if best is None or likeness > best.likeness:
            best = _Candidate(topic, likeness, float(np.median(delay_ns)) / SECOND, ranks)
    return best


def _interval(times: Times) -> NDArray[np.float64]:
    """Return the interval before each message; NaN before the first."""
    found = np.full(len(times), np.nan)
    found[1:] = np.diff(times)
    return found


def _ranks(values: NDArray[np.float64]) -> Ranks:
    """Return ranks from 0 to 1; what is no number has none."""
    ranks = np.full(len(values), np.nan)
    known = np.flatnonzero(np.isfinite(values))
    ranks[known[np.argsort(values[known], kind="stable")]] = np.linspace(0, 1, len(known))
    return ranks


def _alike(first: Ranks, second: Ranks) -> tuple[float, int]:
    """Return the correlation of two columns, and of how many pairs."""
    both = np.isfinite(first) & np.isfinite(second)
    pairs = int(both.sum())
    if pairs < LEAST_PAIRS:
        return 0.0, pairs
    return float(np.corrcoef(first[both], second[both])[0, 1]), pairs


def _partial(one: Ranks, out: Ranks, given: Sequence[Ranks]) -> float:
    """Return the correlation of two columns beyond what others explain."""
    both = np.isfinite(one) & np.isfinite(out)
    for other in given:
        both &= np.isfinite(other)
    if both.sum() < LEAST_PAIRS:
        return 0.0
    if not given:
        return _alike(one, out)[0]
    explained = np.column_stack([np.ones(int(both.sum())), *(other[both] for other in given)])
    rests = []
    for column in (one[both], out[both]):
        weights, *_ = np.linalg.lstsq(explained, column, rcond=None)
        rests.append(column - explained @ weights)
    if min(float(rest.std()) for rest in rests) < 1e-9:
        return 0.0
    return float(np.corrcoef(*rests)[0, 1])


def _waits(asked: Times, answers: Times) -> NDArray[np.float64]:
    """Return how long the oldest unanswered message waited for each answer, in seconds."""
    edges = np.concatenate([[np.int64(-1) << 62], answers])
    found = []
    for (before, answer), first in zip(pairwise(edges.tolist()), _first_after(asked, edges), strict=True):
        if before < first <= answer:
            found.append((answer - first) / SECOND)
    return np.array(found[1:], dtype=np.float64)  # the first one's question may be from before the stretch


def _first_after(asked: Times, edges: Times) -> list[int]:
    """Return the first time after each edge but the last; a time after all of them where there is none."""
    places = np.searchsorted(asked, edges[:-1], side="right")
    padded = np.concatenate([asked, [np.int64(1) << 62]])
    return [int(time) for time in padded[places]]
