"""Where samples come from: topics and their fields, the agent's own knowledge, feeds that are installed
apart.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.clients.service_double import eventually

from robomend_client.agent.config import load
from robomend_client.agent.feeds import Samples
from robomend_client.agent.usage import Usage
from robomend_client.yaml_reader import ConfigError

TWIST = {"twist": {"angular": {"z": 0.5}}, "ranges": [1.0, 2.0]}


def test_each_observer_gets_what_it_wants_of_a_message() -> None:
    got: list[tuple[str, object, int | None]] = []
    missing: list[tuple[str, str]] = []
    sources = frozenset({"odom", "odom:twist.angular.z", "odom:pose.x", "/scan"})
    samples = Samples(sources, lambda *sample: got.append(sample), lambda *what: missing.append(what))
    assert set(samples.topics) == {"odom", "scan"}
    samples.message("/odom", TWIST, 7)
    samples.message("scan")
    samples.message("other", 1)
    assert got == [("odom", TWIST, 7), ("odom:twist.angular.z", 0.5, 7), ("/scan", None, None)]
    assert [source for source, _ in missing] == ["odom:pose.x"]


# --- what the agent knows itself --------------------------------------------------------------------------


def test_usage_is_measured_for_a_node_with_all_that_it_started_and_for_the_host() -> None:
    busy = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'while True: pass'])"
    node = subprocess.Popen([sys.executable, "-c", busy], start_new_session=True)
    try:
        sources = ["processes:CPU(n)", "processes:Mem(n)", "host:CPU", "host:Mem"]
        usage = Usage(sources, ["n"])
        usage.measure({"n": node.pid})
        found: dict[str, float] = {}

        def worked() -> bool:
            found.update(usage.measure({"n": node.pid}))
            return found.get("processes:CPU(n)", 0.0) > 0.1

        eventually(worked, "work of the child of the node")
        assert set(found) == set(sources)
        assert 0 < found["processes:Mem(n)"] < 1
        assert 0 < found["host:Mem"] < 1
        assert 0 < found["host:CPU"] <= 1.01
    finally:
        os.killpg(node.pid, signal.SIGKILL)
        node.wait()
    host = {"host:CPU", "host:Mem"}
    eventually(lambda: set(usage.measure({"n": node.pid})) == host, "the end of the node and of its child")
    assert set(usage.measure({})) == {"host:CPU", "host:Mem"}


def test_waiting_for_a_processor_is_the_part_of_the_time_in_which_somebody_did(tmp_path: Path) -> None:
    (tmp_path / "pressure").mkdir()
    file = tmp_path / "pressure" / "cpu"
    usage = Usage(["host:Wait"], [], tmp_path)
    assert usage.measure({}) == {}  # a kernel that does not say
    total_us, found = 0, []

    def half() -> bool:
        nonlocal total_us
        total_us += 10**12
        file.write_text(f"some avg10=0.00 avg60=0.00 avg300=0.00 total={total_us}\nfull total=0\n")
        found.append(usage.measure({}))
        return len(found) > 2

    eventually(half, "measurements")
    assert found[0] == {}
    assert found[1:] == [{"host:Wait": 1.0}, {"host:Wait": 1.0}]  # never more than all of it
    file.write_text(f"some avg10=0.00 avg60=0.00 avg300=0.00 total={total_us}\n")
    assert usage.measure({}) == {"host:Wait": 0.0}


# --- feeds ------------------------------------------------------------------------------------------------


def written(tmp_path: Path, observers: str, more: str = "") -> Path:
    file = tmp_path / "agent.yaml"
    file.write_text(f"robot: r\nservice: {{url: 'http://127.0.0.1:1'}}\nobservers:\n{observers}\n{more}\n")
    return file


def test_topics_may_come_from_elsewhere_all_or_each(tmp_path: Path) -> None:
    topics = "rate: {from: ros1}\ntopics: {scan: {}, odom: {from: bus}}"
    config = load(written(tmp_path, "  x: {kind: general}", topics))
    assert {spec.name: spec.origin for spec in config.observers} == {
        "scan": "ros1", "odom": "bus", "x": "bus"
    }  # fmt: skip
    clash = "rate: {from: ros1}\ntopics: {scan: {}}"
    with pytest.raises(ConfigError, match=r"observers.scan.from: scan comes from ros1 for another"):
        load(written(tmp_path, "  scan: {kind: general}", clash))


@pytest.mark.parametrize(
    ("observer", "complaint"),
    [
        (
            "kind: property, source: 'processes:CPU(laser)', high: 1",
            "source: .*the agent has no process laser",
        ),
        ("kind: property, source: 'host:Disk', high: 1", "source: .*host:Disk is no source"),
        ("kind: general, from: tin_can", "from: no origin of samples is named .*: choose one of bus, ros1"),
    ],
)
def test_what_the_agent_does_not_know_is_refused_with_its_line(
    tmp_path: Path, observer: str, complaint: str
) -> None:
    with pytest.raises(ConfigError, match=rf"agent.yaml:4: observers.a.{complaint}"):
        load(written(tmp_path, f"  a: {{{observer}}}"))
