"""The node observer: what runs, by a table that must keep coming."""

from __future__ import annotations

from robomend_client.literals import Atom, fails, holds
from robomend_client.observers import PROCESSES, Evidence, NodeObserver, Table, ns

A, B = Atom("running", ("a",)), Atom("running", ("b",))


def test_nodes_are_unknown_before_the_first_look() -> None:
    assert NodeObserver(["a"]).check(0) == ()


def test_each_watched_node_runs_or_does_not() -> None:
    observer = NodeObserver(["jaguar_node", "hokuyo_node"])
    observer.feed(PROCESSES, 0, {"jaguar_node", "somebody_else"})
    assert observer.check(1) == (fails("running", "hokuyo_node"), holds("running", "jaguar_node"))


def test_a_feeder_may_say_that_it_does_not_know() -> None:
    observer = NodeObserver(["a", "b", "c"])
    observer.feed(PROCESSES, 0, {"a": True, "b": None, "c": False})
    assert observer.check(1) == (holds("running", "a"), fails("running", "c"))


def test_when_the_tables_stop_nothing_is_known() -> None:
    observer = NodeObserver(["a"], Table(lifetime_s=3))
    observer.feed(PROCESSES, ns(1), ["a"])
    assert observer.due_ns() == ns(4)
    assert observer.check(ns(3.99)) == (holds("running", "a"),)
    assert observer.check(ns(4)) == ()


def test_a_verdict_rests_on_the_newest_table_and_began_after_the_last_good_one() -> None:
    observer = NodeObserver(["a", "b"])
    for time_s, running in ((1, "ab"), (2, "ab"), (3, "b"), (4, "b")):
        observer.feed(PROCESSES, ns(time_s), set(running))
    assert observer.evidence(A, ns(5))[:2] == Evidence(ns(4), ns(2))[:2]
    assert observer.evidence(B, ns(5))[:2] == Evidence(ns(4))[:2]
