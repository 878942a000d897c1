"""Moments of faults, as an agent keeps them and hands them in."""

from __future__ import annotations

import asyncio
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from secrets import token_hex
from typing import Any

import pytest
from tests.clients.bridges.any_robot import any_robot
from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually
from tests.clients.talker import watching

from robomend.api.routers.moments import MomentBody
from robomend_client.agent.config import MomentsConfig
from robomend_client.agent.main import main
from robomend_client.agent.moments import Moments
from robomend_client.agent.ring import Ring, TopicDescription, write
from robomend_client.clock import Clock
from robomend_client.literals import fails
from robomend_client.observers import SECOND, Change

SAYS = """
import sys, time
sys.stdout.buffer.write(b"up\\n\\x00\\x1b[31m<b>red</b>\\xff\\n" + b"x" * 2_000_000)
print("\\ncannot open /dev/lidar")
sys.stdout.flush()
time.sleep(float(sys.argv[1]))
sys.exit(1)
"""


COMES_ANYHOW = {"tolerance_hz": 9.9, "silence_s": 10, "first_s": 60}
"""Of a topic that should stay ok, on a busy computer too."""


def complete(service: ServiceDouble) -> list[dict[str, Any]]:
    """Return the moments of which all has come."""
    return [moment for moment in tuple(service.moments.values()) if moment["complete"]]


def waiting(tmp_path: Path) -> list[str]:
    folder = tmp_path / "state" / "moments"
    return sorted(file.suffix for file in folder.iterdir()) if folder.is_dir() else []


def test_a_topic_that_falls_silent_comes_with_its_last_message_and_its_rate(
    service: ServiceDouble, tmp_path: Path
) -> None:
    sections: dict[str, Any] = {"topics": {"scan": {}, "odom": COMES_ANYHOW}, "moments": {"after_s": 2}}
    with watching(tmp_path, service.url, **sections) as (_, talker):
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
    """What was halted does not know what came meanwhile."""
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


def test_a_moment_on_a_computer_that_is_starved_again_and_again_is_taken_by_the_service(
    tmp_path: Path,
) -> None:
    """Whatever there is to be said of its frame and of its recording."""
    config = MomentsConfig(after_s=0, record=True, memory_mb=0.1)
    moments = Moments(config, "rover", "onboard", tmp_path, Clock(), [])
    bad, now_ns = fails("ok", "scan"), time.time_ns()
    heard = moments.ring.tap(lambda about: PLAIN)
    for tick in range(50):
        for topic in range(30):
            heard(f"/image{topic}", now_ns - (50 - tick) * SECOND // 10, b"i" * 2000, None)
    for number in range(200):
        at_ns = now_ns - (200 - number) * SECOND // 10
        moments.ring.lapse(at_ns, at_ns + SECOND // 20)
        moments.ring.starved(at_ns + SECOND // 20, number % 2 == 0)
    moments.changed([Change(now_ns, bad.atom, bad)])
    asyncio.run(moments.close())
    [file] = tmp_path.glob("*.json")
    frame = MomentBody.model_validate_json(file.read_bytes()).frame
    assert any("is overloaded" in note or "was overloaded" in note for note in frame.notes)
    assert any("nobody looked" in note for note in frame.notes)


def test_a_process_that_ends_comes_with_its_last_words_made_safe(
    service: ServiceDouble, tmp_path: Path
) -> None:
    """One that was stopped by order is no moment."""
    wheels = {"command": ["sleep", "600"], "start": True}
    processes = {"wheels": wheels, "lidar": {"command": [sys.executable, "-c", SAYS, "1"]}}
    with agent(config(tmp_path, service.url, processes, moments={"after_s": 1.5})):
        eventually(lambda: service.holds().get("running(wheels)"), "that the wheels run")
        assert service.do("r:1", "stop_node", "wheels")["code"] == 0
        eventually(lambda: service.holds().get("running(wheels)") is False, "that the wheels do not run")
        assert service.do("r:2", "start_node", "lidar")["code"] == 0
        eventually(lambda: complete(service), "a moment")
    [moment] = complete(service)
    assert moment["literals"][0]["literal"] == "not running(lidar)"
    assert len(moment["literals"]) == 1
    row, _ = moment["frame"]["processes"]
    assert row["about"].startswith("exit code 1")
    said = moment["frame"]["logs"][0]
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


class Disk:
    """The folder of an agent's moments on a small disk of its own; where none may be mounted, a bound on the
    size of any file stands in for it: writing beyond it fails likewise.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self._filler = folder, folder / "filler"
        self.agent = 0  # the number of its process
        folder.mkdir(parents=True)
        command = ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(folder)]
        self.mounted = subprocess.run(command, capture_output=True, check=False).returncode == 0

    def fill(self, left: int) -> None:
        """Leave so many bytes."""
        if not self.mounted:
            resource.prlimit(self.agent, resource.RLIMIT_FSIZE, (left, resource.RLIM_INFINITY))
            return
        found = os.statvfs(self.folder)
        with self._filler.open("ab") as filler:
            filler.write(bytes(max(0, found.f_bavail * found.f_bsize - left)))

    def empty(self) -> None:
        if not self.mounted:
            resource.prlimit(self.agent, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
        self._filler.unlink(missing_ok=True)

    def there(self) -> list[str]:
        """Return the ends of the names of what is there of moments."""
        return sorted(file.suffix for file in self.folder.iterdir() if file != self._filler)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    found = Disk(tmp_path / "state" / "moments")
    yield found
    if found.mounted:
        subprocess.run(["umount", "--lazy", str(found.folder)], check=True)


@pytest.mark.parametrize("when", ["while the recording is written", "between frame and recording"])
def test_on_a_full_disk_the_frame_arrives_and_says_why_there_is_no_recording(
    service: ServiceDouble, tmp_path: Path, disk: Disk, when: str
) -> None:
    image = {"type": "std_msgs/String", "value": {"data": token_hex(100_000)}, "rate": 10}  # not compressible
    scan = {"topic": "/scan", "type": "std_msgs/String", "value": {"data": "s"}, "rate": 10}
    with any_robot("ros1", tmp_path) as robot:
        node = robot.node("laser")
        node.do("publish", topic="/image", **image)
        node.do("publish", **scan)
        origin = {"from": robot.origin}
        sections = {
            robot.origin: robot.section,
            "topics": {
                "scan": {**origin, "first_s": 60, "silence_s": 1},
                "image": {**origin, **COMES_ANYHOW},
            },
            "moments": {"record": True, "before_s": 3, "after_s": 3, "per_hour": 3600},
        }

        def turns_bad() -> dict[str, Any]:
            """Have a topic fall silent; return the moment of it, once all of it has come."""
            eventually(lambda: service.holds().get("ok(scan)"), "ok(scan)")
            known = set(service.moments)

            def moment(*, whole: bool) -> dict[str, Any] | None:
                found = (one for key, one in tuple(service.moments.items()) if key not in known)
                return next((one for one in found if one["complete"] or not whole), None)

            node.do("hush", topic="/scan")
            eventually(lambda: moment(whole=False), "the first frame")
            if when == "between frame and recording" and not complete(service):
                disk.fill(0)
            eventually(lambda: moment(whole=True), "all of it")
            node.do("publish", **scan)
            eventually(lambda: service.holds().get("ok(scan)"), "observing goes on")
            eventually(lambda: disk.there() == [], "nothing is left of it")
            return moment(whole=True) or {}

        with agent(config(tmp_path, service.url, {}, **sections)) as process:
            disk.agent = process.pid
            eventually(lambda: len(service.holds()) == 2, "the topics")
            if when == "while the recording is written":
                disk.fill(700_000)
            lost = turns_bad()
            assert "scan" in [one["topic"].strip("/") for one in lost["frame"]["topics"]]
            [note] = [one for one in lost["frame"]["notes"] if one.startswith("not recorded: [Errno")]
            assert ("No space left on device" in note) is disk.mounted
            assert not service.recordings.get(lost["key"])
            disk.empty()
            kept = turns_bad()
            assert not [one for one in kept["frame"]["notes"] if one.startswith("not recorded")]
            assert len(service.recordings[kept["key"]]) > 1_000_000
            assert process.poll() is None


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


# --- the ring ---------------------------------------------------------------------------------------------

PLAIN = TopicDescription(
    "std_msgs/msg/String", "string data", "ros2msg", "cdr", lambda data, most: data.decode()
)


def ring(memory: int, before_s: float = 30.0) -> Ring:
    return Ring(before_s, memory, record=True)


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
