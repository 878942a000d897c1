"""A recording and its replay: the same literals at the same times."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.clients.observers.driving import RATE, SCAN, Told

from robomend_client.literals import Atom
from robomend_client.observers import (
    PROCESSES,
    Change,
    Contact,
    Driver,
    GeneralObserver,
    NodeObserver,
    Rate,
    Table,
    ns,
)
from robomend_client.observers.recording import Recording, replay

Events = list[tuple[str, int, int]]


def observers() -> list[GeneralObserver | NodeObserver | Told]:
    return [
        GeneralObserver("scan", RATE),
        GeneralObserver("scan", Rate(check_s=0.25)),
        GeneralObserver("odom", Rate(5, 1)),
        NodeObserver(["n"], Table(lifetime_s=1)),
        Told("said"),
    ]


OTHERS = ["settle", "lapse", "lost", "back", "heartbeat", "starved", "fed"]

events = st.lists(
    st.tuples(
        st.sampled_from(["scan"] * 3 + ["odom"] * 2 + [PROCESSES, "said"] + ["wake"] * 2 + OTHERS),
        st.one_of(st.integers(0, 120), st.integers(0, 120), st.integers(0, 3000)),  # ms until it happens
        st.integers(-30, 80),  # ms by which its own stamp is behind
    ),
    max_size=120,
)


@given(events)
def test_a_recording_replayed_gives_the_same_literals_at_the_same_times(
    tmp_path_factory: pytest.TempPathFactory, happened: Events
) -> None:
    file = tmp_path_factory.mktemp("recording") / "run.jsonl"
    now_ns, n = ns(1000), 0
    recording = Recording(file, now_ns, 10**9)
    driver = Driver(observers(), now_ns, listeners=(recording,))
    live: list[Change] = []
    for what, wait_ms, behind_ms in happened:
        now_ns += wait_ms * 1_000_000
        if what == "wake":
            live += driver.advance(now_ns)
        elif what == "heartbeat":
            live += driver.advance(now_ns)
            driver.standing()
        elif what == "settle":
            n += 1
            live += driver.advance(now_ns)
            live += driver.settle(n, [SCAN, Atom("running", ("n",))])
        elif what == "lapse":
            live += driver.lapse(now_ns)
        elif what in ("starved", "fed"):
            live += driver.starved(what == "starved", now_ns)
        elif what in ("lost", "back"):
            source = ("scan", "odom", PROCESSES)[behind_ms % 3]
            live += driver.sample(source, now_ns, Contact(what), now_ns)
        else:
            value = {"said": behind_ms % 3 > 0, PROCESSES: frozenset("n" * (behind_ms % 2))}.get(what)
            live += driver.sample(what, now_ns - behind_ms * 1_000_000, value, now_ns)
    live += driver.advance(now_ns)
    recording.close(now_ns)
    with file.open() as lines:
        again = list(replay(lines, lambda start_ns: Driver(observers(), start_ns)))
    assert again == live


def test_a_recording_has_a_bound_and_says_that_it_is_full(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "run.jsonl", 0, 500)
    for k in range(100):
        recording.sample("scan", k, None, k)
    recording.close(1000)
    lines = (tmp_path / "run.jsonl").read_text().splitlines()
    assert len("\n".join(lines)) < 600
    assert json.loads(lines[-1])["full"] is True


def test_a_torn_last_line_is_left_out_and_another_file_is_refused() -> None:
    def make(start_ns: int) -> Driver:
        return Driver([GeneralObserver("scan", RATE)], start_ns)

    assert list(replay(['{"start": 0}\n', '{"source": "sc'], make)) == []
    with pytest.raises(ValueError, match="not a line of a recording: 'hello"):
        list(replay(["hello\n"], make))
