"""The codes of a log are what OBS would have said at each time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from robomend.diagnosis.library import Codes
from robomend.entry import Entry
from robomend.model.loading import load_model
from robomend.observations.obs import FOREVER, Obs
from robomend.resources import resource
from robomend_batch.problems import LogRefused, Problems
from robomend_batch.track import Rows, Stretch, Track
from robomend_batch.words import Words
from robomend_client.literals import Atom, Literal
from robomend_client.observers.base import SECOND

VOCABULARY = load_model(resource("examples", "tedusar.yaml")).vocabulary

SENTENCES = [
    sign + atom
    for atom in ("ok(scan)", "on(jaguar)", "inc(odom_yaw)", "dec(odom_yaw)", "const(odom_yaw)")
    for sign in ("", "not ")
] + ["matched(odom_yaw,imu_yaw)", "not matched(imu_yaw,odom_yaw)"]

Said = tuple[int, str, int | None]
"""Time, sentence, lifetime."""

said = st.lists(
    st.tuples(st.integers(0, 30), st.sampled_from(SENTENCES), st.one_of(st.none(), st.integers(0, 12))),
    min_size=1,
    max_size=40,
)


def words() -> Words:
    return Words(VOCABULARY, "keep", Problems())


def rows_of(lines: list[Said], known: Words) -> Rows:
    """Return lines as the readers do."""
    flat = [
        (time, sensor, value, FOREVER if life is None else time + life)
        for time, sentence, life in lines
        for sensor, value in known.settings(sentence, "here")
    ]
    time, sensor, value, expires = zip(*flat, strict=True)
    return Rows(
        np.array(time, dtype=np.int64),
        np.array(sensor, dtype=np.int32),
        np.array(value, dtype=np.int8),
        np.array(expires, dtype=np.int64),
    )


def meant(codes: Codes, sensors: tuple[Atom, ...]) -> list[frozenset[Literal]]:
    """Return the literals of codes, bit by bit."""
    found = []
    for row in codes.tolist():
        bits = sum(word << (64 * number) for number, word in enumerate(row))
        found.append(
            frozenset(
                Literal(atom, shown == 0)
                for number, atom in enumerate(sensors)
                for shown in (0, 1)
                if bits >> (2 * number + shown) & 1
            )
        )
    return found


def held(stretches: Iterator[Stretch], known: Words) -> dict[int, frozenset[Literal]]:
    """Return what holds from each time on, without repetitions."""
    at: dict[int, frozenset[Literal]] = {}
    for stretch in stretches:
        assert stretch.segment == 0
        for time, literals in zip(stretch.time_ns.tolist(), meant(stretch.codes, known.sensors), strict=True):
            at[time] = literals
    return changes(at)


def changes(at: dict[int, frozenset[Literal]]) -> dict[int, frozenset[Literal]]:
    found: dict[int, frozenset[Literal]] = {}
    before: frozenset[Literal] | None = None
    for time in sorted(at):
        if at[time] != before:
            found[time] = before = at[time]
    return found


def by_obs(lines: list[Said], known: Words) -> dict[int, frozenset[Literal]]:
    """Say the lines to OBS one by one, and ask it at each time."""
    obs = Obs()
    now = lines[0][0]
    begun = now
    at: dict[int, frozenset[Literal]] = {}
    end = max(time for time, _, _ in lines)
    queue = list(lines)
    for moment in range(begun, end + 1):
        while queue and max(now, queue[0][0]) <= moment:
            time, sentence, life = queue.pop(0)
            now = max(now, time)
            obs.update(
                Entry(literal, "", time, None if life is None else time + life)
                for literal in known.literals(sentence, "here")
            )
        at[moment] = frozenset(obs.literals(moment))
    return changes(at)


@example([(5, "ok(scan)", 3), (8, "on(jaguar)", None), (9, "on(hokuyo)", None)], [1])
@example([(5, "ok(scan)", 3), (8, "on(jaguar)", None)], [])
@example([(5, "ok(scan)", None), (5, "not ok(scan)", None), (3, "on(jaguar)", None)], [])
@given(said, st.lists(st.integers(1, 12), max_size=4))
def test_a_track_says_at_each_time_what_obs_says(lines: list[Said], cuts: list[int]) -> None:
    known = words()
    rows = rows_of(lines, known)
    track = Track()

    def blocks() -> Iterator[Stretch]:
        start = 0
        for size in [*cuts, len(rows)]:
            yield from track.add(rows.part(start, start + size))
            start += size

    assert held(blocks(), known) == by_obs(lines, known)


def test_more_sensors_than_a_word_holds_are_told_apart() -> None:
    known, track = words(), Track()
    lines: list[Said] = [(time, f"ok(t{time})", None) for time in range(70)]
    lines += [(70, "not ok(t3)", None), (71, "not ok(t40)", None)]
    at = held(track.add(rows_of(lines, known)), known)
    assert at[71] - at[69] == {Literal(Atom("ok", ("t3",)), False), Literal(Atom("ok", ("t40",)), False)}
    assert len(at[71]) == 70


def test_a_log_in_no_order_at_all_is_refused() -> None:
    known, track = words(), Track()
    lines: list[Said] = [(-time * 10 * SECOND, "ok(scan)", None) for time in range(2000)]
    with pytest.raises(LogRefused, match="sort it"):
        list(track.add(rows_of(lines, known)))
