"""Who runs, by what is seen of the nodes."""

from __future__ import annotations

from robomend_client.bridges.ros1.liveness import Nodes, NodeState


def test_a_node_that_is_only_listed_is_unknown_until_it_was_heard() -> None:
    nodes = Nodes()
    nodes.listed(frozenset({"/a"}))
    assert nodes.table() == {"/a": None}
    assert nodes.linked("/a", "http://a:1/", 0.0)
    assert nodes.table() == {"/a": True}


def test_a_lost_connection_alone_changes_nothing() -> None:
    nodes = Nodes()
    nodes.linked("/a", "http://a:1/", 0.0)
    nodes.unlinked("/a")
    assert nodes.table() == {"/a": True}
    assert nodes.asked("/a", NodeState.GONE, 1.0)
    assert nodes.table() == {"/a": False}


def test_a_frozen_node_does_not_run_and_one_out_of_reach_is_unknown() -> None:
    nodes = Nodes()
    nodes.linked("/a", "http://a:1/", 0.0)
    nodes.asked("/a", NodeState.FROZEN, 1.0)
    assert nodes.table() == {"/a": False}
    nodes.asked("/a", NodeState.UNREACHABLE, 2.0)
    assert nodes.table() == {"/a": None}
    assert nodes.heard("/a", 3.0)
    assert nodes.table() == {"/a": True}


def test_a_killed_node_that_the_master_goes_on_naming_is_stopped() -> None:
    nodes = Nodes()
    nodes.linked("/a", "http://a:1/", 0.0)
    nodes.unlinked("/a")
    nodes.asked("/a", NodeState.GONE, 1.0)
    nodes.listed(frozenset({"/a"}))
    assert nodes.table() == {"/a": False}
    nodes.listed(frozenset())
    assert nodes.table() == {}


def test_what_is_read_of_a_node_that_is_gone_was_said_before_unless_it_connects_anew() -> None:
    nodes = Nodes()
    nodes.linked("/a", "http://a:1/", 0.0)
    nodes.asked("/a", NodeState.GONE, 1.0)
    assert not nodes.heard("/a", 1.1)
    assert nodes.table() == {"/a": False}
    assert nodes.heard("/a", 1.2)  # nobody listens at its address, and it goes on
    nodes.asked("/a", NodeState.GONE, 2.0)
    assert nodes.linked("/a", "http://a:2/", 2.1)
    assert not nodes.heard("/a", 2.11)
    assert nodes.table() == {"/a": True}
    assert nodes.silent(2.6, 0.5) == frozenset()


def test_a_master_that_forgot_a_node_does_not_stop_it() -> None:
    nodes = Nodes()
    nodes.linked("/linked", "http://a:1/", 0.0)
    nodes.listed(frozenset({"/linked", "/answers"}))
    nodes.asked("/answers", NodeState.RUNNING, 0.0)
    nodes.listed(frozenset())
    assert nodes.table() == {"/linked": True, "/answers": True}
    nodes.asked("/answers", NodeState.GONE, 1.0)
    nodes.listed(frozenset())
    assert nodes.table() == {"/linked": True}


def test_who_was_not_heard_is_asked() -> None:
    nodes = Nodes()
    nodes.linked("/a", "http://a:1/", 0.0)
    nodes.linked("/b", "http://b:1/", 0.9)
    assert nodes.silent(1.0, 0.75) == {"/a"}
    nodes.asked("/a", NodeState.FROZEN, 1.0)
    assert nodes.silent(1.5, 0.75) == frozenset()
