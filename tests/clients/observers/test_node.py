"""The node observer: what runs, by a table that must keep coming."""

from __future__ import annotations

from robomend_client.literals import Atom
from robomend_client.observers import PROCESSES, Evidence, NodeObserver, ns

A, B = Atom("running", ("a",)), Atom("running", ("b",))


def test_a_verdict_rests_on_the_newest_table_and_began_after_the_last_good_one() -> None:
    observer = NodeObserver(["a", "b"])
    for time_s, running in ((1, "ab"), (2, "ab"), (3, "b"), (4, "b")):
        observer.feed(PROCESSES, ns(time_s), set(running))
    assert observer.evidence(A, ns(5))[:2] == Evidence(ns(4), ns(2))[:2]
    assert observer.evidence(B, ns(5))[:2] == Evidence(ns(4))[:2]
