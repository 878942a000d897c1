"""A moment that an agent recorded on a real robot, in the batch: the robot's own words, at their times."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from tests.clients.bridges.any_robot import any_robot
from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually, service_double
from tests.robomend_batch.running import batch_run, intervals

MODEL = """
robomend: 1
name: rover
nodes: {laser: {publishes: {scan: []}}, camera: {publishes: {image: []}}}
hardware: {motor: {}}
properties: {temperature: {}}
rules: ["not ab(motor) -> ok(temperature)"]
"""

LARGE = 200_000
GOOD = {"ok(scan)": True, "ok(image)": True, "ok(temperature)": True}


def newest(service: ServiceDouble) -> dict[str, Any] | None:
    """Return the newest moment of which all has come."""
    done = [one for one in tuple(service.moments.values()) if one["complete"]]
    return max(done, key=lambda one: one["at_ns"], default=None)


def at_ns(service: ServiceDouble) -> int:
    """Return when that was."""
    return int((newest(service) or {"at_ns": 0})["at_ns"])


@pytest.mark.parametrize("origin", ["ros1", "ros2"])
def test_the_batch_says_of_a_moment_what_the_robot_said(origin: str, tmp_path: Path) -> None:
    """A topic falls silent, and a value is too high; one topic is too large for the memory there is."""
    model = tmp_path / "rover.yaml"
    model.write_text(MODEL)
    folder = tmp_path / "state" / "moments"
    with any_robot(origin, tmp_path) as robot, service_double() as service:
        laser, camera, motor = (robot.node(name) for name in ("laser", "camera", "motor"))
        camera.do("publish", topic="/image", type="std_msgs/String", value={"data": "x" * LARGE}, rate=10)
        rate = {"from": robot.origin, "first_s": 60, "silence_s": 1}
        hot = {"kind": "property", "from": robot.origin, "source": "motor:data", "high": 60}
        sections: dict[str, Any] = {
            robot.origin: robot.section,
            "topics": {"scan": rate, "image": rate},
            "observers": {"temperature": hot},
            "moments": {"record": True, "before_s": 5, "after_s": 2, "memory_mb": 1, "per_hour": 3600},
        }
        file = config(tmp_path, service.url, {}, **sections)
        log = tmp_path / "agent.log"
        with agent(file):
            motor.do("publish", topic="/motor", type="std_msgs/Float64", value={"data": 40.0}, rate=10)
            while True:
                laser.do("publish", topic="/scan", type="std_msgs/String", value={"data": "s"}, rate=10)
                eventually(lambda: GOOD.items() <= service.holds().items(), "all is well", 120)
                eventually(lambda: not list(folder.glob("*")), "no moment is open, or waits")
                well_ns = time.time_ns() + 5_000_000_000
                eventually(lambda: time.time_ns() > well_ns, "it is well for long")  # noqa: B023  # at once
                before = log.read_text().count("nobody looked")
                began_ns = time.time_ns()
                laser.do("hush", topic="/scan")
                eventually(lambda: service.holds().get("ok(scan)") is False, "not ok(scan)", 60)
                eventually(lambda: at_ns(service) > began_ns, "a moment", 60)  # noqa: B023  # at once
                eventually(lambda: not list(folder.glob("*")), "the service has all of it")
                if log.read_text().count("nobody looked") == before:
                    break  # else the computer was late, and the agent began to observe anew
        moment = newest(service)
        assert moment is not None
        recording = tmp_path / "moment.mcap"
        recording.write_bytes(service.recordings[moment["key"]])
    held: dict[str, int] = {}
    for batch in service.batches():
        for text in batch["observations"]:
            if text.startswith("not ") and began_ns < batch["time"]:
                held.setdefault(text, batch["time"])
    [said] = moment["literals"]
    assert held == {"not ok(scan)": moment["at_ns"]}
    assert said["literal"] == "not ok(scan)"

    assert batch_run(tmp_path / "out", recording, "--observers", file, model=model) == 0
    found = intervals(tmp_path / "out")
    shown: dict[str, int] = {}
    for one in found:
        for text in one["observations"] if one["start_ns"] > began_ns else ():  # a busy node may have paused
            shown.setdefault(text, one["start_ns"])
    assert {text: at for text, at in shown.items() if text.startswith("not ")} == held
    states = [(one["state"], one["bad"]) for one in found]
    assert states[-1] == ("faulty", [["laser"]])
    assert states[-2] == ("healthy", [[]])

    topics = {topic["topic"]: topic for topic in moment["frame"]["topics"]}
    assert topics["/motor"]["messages"][0]["text"] == "data: 40"
    assert topics["/image"]["messages"][0]["text"].startswith("not kept")
    with recording.open("rb") as opened:
        messages = [(c.topic, len(m.data)) for _, c, m in make_reader(opened).iter_messages()]
    whole = [size for topic, size in messages if topic == "/image/kept"]
    assert 1 <= len(whole) <= 6
    assert min(whole) > LARGE
    assert sum(topic == "/image" for topic, _ in messages) > 2 * len(whole)
