"""Moments of faults, as an agent keeps them and hands them in."""

from __future__ import annotations

import json
import resource
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually, service_double
from tests.clients.talker import watching

from robomend_client.agent.main import main
from robomend_client.agent.moments import clean, last_lines
from robomend_client.agent.ring import Ring, TopicDescription, write
from robomend_client.observers import SECOND

SAYS = """
import sys, time
sys.stdout.buffer.write(b"up\\n\\x00\\x1b[31m<b>red</b>\\xff\\n" + b"x" * 2_000_000)
print("\\ncannot open /dev/lidar")
sys.stdout.flush()
time.sleep(float(sys.argv[1]))
sys.exit(1)
"""


@pytest.fixture
def service() -> Iterator[ServiceDouble]:
    with service_double() as double:
        yield double


def complete(service: ServiceDouble) -> list[dict[str, Any]]:
    """Return the moments of which all has come."""
    return [moment for moment in tuple(service.moments.values()) if moment["complete"]]


def waiting(tmp_path: Path) -> list[str]:
    folder = tmp_path / "state" / "moments"
    return sorted(file.suffix for file in folder.iterdir()) if folder.is_dir() else []


def test_a_topic_that_falls_silent_comes_with_its_last_message_and_its_rate(
    service: ServiceDouble, tmp_path: Path
) -> None:
    moments = {"after_s": 2}
    with watching(tmp_path, service.url, topics={"scan": {}, "odom": {}}, moments=moments) as (_, talker):
        talker.say("odom", data={"x": 1})
        talker.say("scan", data={"ranges": [1, 2], "frame": "laser <b>"})
        eventually(lambda: service.holds().get("ok(scan)"), "ok(scan)")
        talker.hush("scan")
        eventually(lambda: complete(service), "a moment")
        [moment] = complete(service)
        eventually(lambda: waiting(tmp_path) == [], "nothing waits on the disk")
    assert "not ok(scan)" in [one["literal"] for one in moment["literals"]]
    assert "reading" in moment["literals"][0]
    topics = {one["topic"]: one for one in moment["frame"]["topics"]}
    assert json.loads(topics["scan"]["messages"][-1]["text"]) == {"ranges": [1, 2], "frame": "laser <b>"}
    assert topics["scan"]["messages"][-1]["at_s"] < 0
    assert "odom" in topics
    [series] = [one for one in moment["frame"]["series"] if one["source"] == "scan"]
    assert series["kind"] == "rate"
    assert series["values"][-1] == 0
    assert series["at_s"] == sorted(series["at_s"])


def test_time_that_nobody_looked_at_is_noted(service: ServiceDouble, tmp_path: Path) -> None:
    """What was halted does not know what came meanwhile, and a recording does not say so."""
    moments = {"after_s": 0, "per_hour": 3600}
    with watching(tmp_path, service.url, topics={"scan": {}}, moments=moments) as (process, talker):
        talker.say("scan")
        eventually(lambda: service.holds().get("ok(scan)"), "ok(scan)")
        log = tmp_path / "agent.log"
        before = log.read_text().count("nobody looked")
        process.send_signal(signal.SIGSTOP)
        halted_s = time.monotonic() + 0.5
        eventually(lambda: time.monotonic() > halted_s, "it was halted for a while")
        process.send_signal(signal.SIGCONT)
        eventually(lambda: log.read_text().count("nobody looked") > before, "it has seen that")
        talker.hush("scan")
        eventually(lambda: any("nobody looked" in str(m["frame"]["notes"]) for m in complete(service)), "it")


def test_a_process_that_ends_comes_with_its_last_words_made_safe(
    service: ServiceDouble, tmp_path: Path
) -> None:
    processes = {"lidar": {"command": [sys.executable, "-c", SAYS, "1"], "start": True}}
    with agent(config(tmp_path, service.url, processes, moments={"after_s": 1.5})):
        eventually(lambda: complete(service), "a moment")
    [moment] = complete(service)
    assert moment["literals"][0]["literal"] == "not running(lidar)"
    [row] = moment["frame"]["processes"]
    assert row["about"].startswith("exit code 1")
    [said] = moment["frame"]["logs"]
    assert said["lines"][-1] == "cannot open /dev/lidar"
    assert len(json.dumps(moment)) < 100_000


def test_a_moment_comes_after_the_observations_and_survives_the_agent_and_the_service(
    service: ServiceDouble, tmp_path: Path
) -> None:
    processes = {"lidar": {"command": [sys.executable, "-c", SAYS, "1"], "start": True}}
    file = config(tmp_path, service.url, processes, moments={"after_s": 0})
    service.down()
    with agent(file) as process:
        eventually(lambda: ".json" in waiting(tmp_path), "a moment on the disk")
        process.kill()
        process.wait(60)
    assert service.moments == {}
    heard: list[bool] = []
    service.answers = lambda _, path: (
        heard.append(bool(service.holds())) if path.endswith("moments") else None
    )
    service.up()
    file.write_text(json.dumps(json.loads(file.read_text()) | {"processes": {}}))
    with agent(file):
        eventually(lambda: complete(service), "the moment")
        eventually(lambda: waiting(tmp_path) == [], "nothing waits on the disk")
    assert heard[0]  # what was observed was there before
    assert [one["literals"][0]["literal"] for one in complete(service)] == ["not running(lidar)"]


def test_what_is_refused_is_said_and_costs_nothing_else(service: ServiceDouble, tmp_path: Path) -> None:
    def refuse(method: str, path: str) -> tuple[int, Any] | None:
        return (422, {"code": "bad-input", "detail": "no"}) if path.endswith("/moments") else None

    service.answers = refuse
    processes = {"lidar": {"command": [sys.executable, "-c", SAYS, "1"], "start": True}}
    with agent(config(tmp_path, service.url, processes, moments={"after_s": 0})):
        log = tmp_path / "agent.log"
        eventually(lambda: "the service refused a moment" in log.read_text(), "it is said")
        eventually(lambda: waiting(tmp_path) == [], "nothing waits on the disk")
        eventually(lambda: service.holds().get("ok(x)") is None and service.holds(), "observations go on")


def test_a_full_disk_loses_the_moment_and_nothing_else(service: ServiceDouble, tmp_path: Path) -> None:
    """A bound on the size of any file stands in for the disk: writing beyond it fails likewise."""
    topics: dict[str, dict[str, Any]] = {"scan": {}, **{f"other{number}": {} for number in range(20)}}
    moments = {"after_s": 0, "disk_mb": 1}
    with watching(tmp_path, service.url, topics=topics, moments=moments) as (process, talker):
        eventually(lambda: process.poll() is None, "an agent")
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (100_000, 100_000))
        for name in topics:
            talker.say(name, data=["x" * 1000] * 50)
        eventually(lambda: service.holds().get("ok(scan)"), "ok(scan)")
        log = tmp_path / "agent.log"
        most = log.stat().st_size + 6000  # for the log: less than the moment takes
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (most, 100_000))
        talker.hush("scan")
        eventually(lambda: "a moment is lost" in log.read_text(), "it is said")
        eventually(lambda: service.holds().get("ok(scan)") is False, "the observation came all the same")
        talker.say("scan")
        eventually(lambda: service.holds().get("ok(scan)"), "observing goes on")
        assert process.poll() is None
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (100_000, 100_000))
    assert waiting(tmp_path) == []


def test_a_moment_that_is_too_many_is_counted(service: ServiceDouble, tmp_path: Path) -> None:
    moments = {"after_s": 0, "per_hour": 0.1}
    with watching(tmp_path, service.url, topics={"scan": {}}, moments=moments) as (_, talker):
        for turn in range(1, 5):
            talker.say("scan")
            eventually(lambda: service.holds().get("ok(scan)"), "ok(scan)")
            talker.hush("scan")
            eventually(lambda: service.holds().get("ok(scan)") is False, "not ok(scan)")
            eventually(lambda: len(complete(service)) >= min(turn, 3), "its moment")  # noqa: B023  # at once
        log = tmp_path / "agent.log"
        eventually(lambda: "no moment is kept of it" in log.read_text(), "that it was one too many")
    assert len(complete(service)) == 3


def test_switched_off_nothing_is_kept(service: ServiceDouble, tmp_path: Path) -> None:
    with watching(tmp_path, service.url, topics={"scan": {}}, moments={"keep": False}) as (_, talker):
        talker.say("scan")
        eventually(lambda: service.holds().get("ok(scan)"), "ok(scan)")
        talker.hush("scan")
        eventually(lambda: service.holds().get("ok(scan)") is False, "not ok(scan)")
    assert service.moments == {}
    assert waiting(tmp_path) == []


def test_recording_without_what_it_needs_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = config(tmp_path, "http://127.0.0.1:1", {}, moments={"record": True, "memory_mb": 0.1})
    assert main(["--check", str(file)]) == 2
    assert "moments.memory_mb" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "safe"),
    [
        ("a\x00b\x1b[31m", "a\\x00b\\x1b[31m"),
        ("\ud800\u202e", "\\xd800\\x202e"),
        ("<b>ü</b>\n\t", "<b>ü</b>\n\t"),
        ("x" * 11, "x" * 9 + "…"),
        ("\x00" * 9, "\\x00\\x00\\…"),
    ],
)
def test_texts_are_made_safe(given: str, safe: str) -> None:
    assert clean(given, 10 if safe.endswith("…") else 20) == safe


def test_of_a_long_output_the_last_lines_are_there() -> None:
    text = "first\n" + "x" * 1_000_000 + "\n" + "\n".join(f"line {n}" for n in range(9))
    assert last_lines(text, 3) == ["line 6", "line 7", "line 8"]


# --- the ring ---------------------------------------------------------------------------------------------

PLAIN = TopicDescription(
    "std_msgs/msg/String", "string data", "ros2msg", "cdr", lambda data, most: data.decode()
)


def ring(memory: int, before_s: float = 30.0) -> Ring:
    return Ring(before_s, memory, record=True)


def test_the_largest_topic_gives_its_oldest_and_a_rate_stays_what_it_was() -> None:
    kept = ring(1_000_000)
    heard = kept.tap(lambda about: PLAIN)
    for tick in range(300):
        heard("/scan", tick * SECOND // 10, b"s" * 100, None)
        heard("/image", tick * SECOND // 10, b"i" * 100_000, None)
    assert kept.size <= 1_000_000
    scan, image = kept.topics["/scan"], kept.topics["/image"]
    assert len(scan.whole) == 300
    assert 2 <= len(image.whole) <= 9
    assert len(image.whole) + len(image.stamps) == 300
    assert image.whole[-1].time_ns == 299 * SECOND // 10


def test_while_a_moment_is_open_what_was_there_is_not_pushed_out() -> None:
    kept = ring(1_000_000)
    heard = kept.tap(lambda about: PLAIN)
    for tick in range(100):
        heard("/image", tick * SECOND // 10, b"i" * 100_000, None)
    kept.hold(10 * SECOND)
    for tick in range(100, 200):
        heard("/image", tick * SECOND // 10, b"i" * 100_000, None)
    assert kept.size <= 1_000_000
    times = [one.time_ns for one in kept.topics["/image"].whole]
    assert min(times) < 10 * SECOND
    assert len(kept.topics["/image"].stamps) + len(times) == 200


def test_what_is_older_goes_and_so_does_all_when_the_clock_goes_back() -> None:
    kept = ring(1_000_000, before_s=1.0)
    heard = kept.tap(lambda about: PLAIN)
    for tick in range(100):
        heard("/scan", tick * SECOND // 10, b"s", None)
    assert len(kept.topics["/scan"].whole) <= 11
    heard("/scan", 2 * SECOND, b"s", None)
    assert len(kept.topics["/scan"].whole) == 1
    heard("/scan", 1 << 62, b"s", None)  # ahead
    assert len(kept.topics["/scan"].whole) == 1


def test_a_recording_is_read_by_the_library(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    kept = ring(500_000)
    heard = kept.tap(lambda about: PLAIN)
    for tick in range(100):
        heard("/scan", tick * SECOND // 10, b"s%d" % tick, None)
        heard("/image", tick * SECOND // 10, b"i" * 100_000, None)
    file = tmp_path / "a.mcap"
    within = 5 * SECOND, 20 * SECOND
    notes = write(file, kept.recorded(*within), kept.looks(*within), *within, b"{}")
    assert notes == [note for note in notes if "/image" in note] != []
    with file.open("rb") as opened:
        found = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(opened).iter_messages()]
    assert found == sorted(found, key=lambda one: one[1])
    assert [one for one in found if one[0] == "/scan"] == [
        ("/scan", tick * SECOND // 10, b"s%d" % tick) for tick in range(50, 100)
    ]
    assert sum(topic == "/image" for topic, _, _ in found) == 50
    assert 1 <= sum(topic == "/image/kept" for topic, _, _ in found) <= 5
    assert {time_ns for topic, time_ns, _ in found if topic == "/robomend/moment"} == {
        5 * SECOND,
        20 * SECOND,
    }
