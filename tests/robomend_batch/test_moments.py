"""A moment that an agent recorded on a real robot, in the batch: the robot's own words, at their times."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from tests.clients.bridges.any_robot import AnyRobot, any_robot
from tests.clients.bridges.ros1.test_actions import REPAIR
from tests.clients.bridges.test_evidence import STAMPED, act, goals
from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually, service_double
from tests.robomend_batch.running import batch_run, intervals, logs

from robomend_client.agent.ring import EMPTY, EMPTY_CDR, Ring, TopicDescription, write
from robomend_client.observers.base import SECOND
from robomend_client.observers.combining import Change
from robomend_client.observers.driver import Driver
from robomend_client.observers.kinds import read_topics
from robomend_client.yaml_reader import read

MODEL = """
robomend: 1
name: rover
nodes: {laser: {publishes: {scan: []}}}
"""

LARGE = 200_000


def newest(service: ServiceDouble) -> dict[str, Any] | None:
    """Return the newest moment of which all has come."""
    done = [one for one in tuple(service.moments.values()) if one["complete"]]
    return max(done, key=lambda one: one["at_ns"], default=None)


def at_ns(service: ServiceDouble) -> int:
    """Return when that was."""
    return int((newest(service) or {"at_ns": 0})["at_ns"])


def test_where_nobody_looked_and_where_it_was_starved_the_batch_says_what_was_said(tmp_path: Path) -> None:
    """Half of the rate while the computer is starved, and two seconds that nobody looked at, are no fault."""
    model, file = tmp_path / "rover.yaml", tmp_path / "agent.yaml"
    model.write_text(MODEL)
    file.write_text(json.dumps({"topics": {"scan": {"from": "ros2", "rate_hz": 10, "silence_s": 1}}}))
    [topic] = read_topics(read(file))
    ring, start_ns = Ring(30.0, 1 << 20, record=True), 1_764_000_000 * SECOND
    heard = ring.tap(lambda about: TopicDescription(EMPTY, "", "ros2msg", "cdr", lambda data, most: ""))
    driver, said = Driver([topic.observer.make()], start_ns, listeners=(ring,)), dict[str, int]()

    def note(changes: Iterable[Change]) -> None:
        said.update({str(c.value): c.time_ns - start_ns for c in changes if c.value and not c.value.positive})

    for tick in range(250):
        at_ns = start_ns + tick * SECOND // 10
        if tick in (50, 120):
            note(driver.starved(tick == 50, at_ns))
        if tick == 170:
            note(driver.lapse(at_ns + 2 * SECOND))
        silent = 170 <= tick < 190 or tick >= 220 or (60 <= tick < 100 and tick % 2)
        if not silent:
            heard("/scan", at_ns, EMPTY_CDR, None)
            note(driver.sample("scan", at_ns, None, at_ns))
    note(driver.advance(start_ns + 25 * SECOND))
    assert list(said) == ["not ok(scan)"]
    assert 22.5 < said["not ok(scan)"] / SECOND < 23.5

    recording, within = tmp_path / "moment.mcap", (start_ns, start_ns + 25 * SECOND)
    write(recording, ring.recorded(*within), ring.looks(*within), *within, b"{}")
    assert batch_run(tmp_path / "out", recording, "--observers", file, model=model) == 0
    shown: dict[str, int] = {}
    for one in intervals(tmp_path / "out"):
        for text in one["observations"]:
            if text.startswith("not "):
                shown.setdefault(text, one["start_ns"] - start_ns)
    assert shown == said


EVERY = """
robomend: 1
name: rover
nodes: {camera: {publishes: {imu: [], scan: [], points: [], image: []}}, navigator: {}}
properties: {goals: {}, dock: {}, log: {}, moves: {}, age: {}, hot: {}, device: {}, lifecycle: {}}
rules:
  - "not ab(camera) -> ok(log,camera) and ok(moves,imu) and ok(age,scan) and ok(lifecycle,camera)"
  - "not ab(camera) -> ok(hot) and ok(device)"
  - "not ab(navigator) -> ok(goals,dock)"
"""

Act = Callable[[], object]


def plants_of(robot: AnyRobot) -> dict[str, tuple[dict[str, Any], Act, Act]]:
    """Return the observers of a robot's evidence, by their atoms, with what makes it bad and good."""
    navigator, camera, _ = (robot.node(name) for name in ("navigator", "camera", "mission"))
    navigator.do("serve", name="dock", **(REPAIR if robot.origin == "ros1" else {}))
    number = {"type": "std_msgs/Float64", "rate": 10}
    stamped = {"type": STAMPED[robot.origin], "rate": 10, "stamped": True}
    published: set[str] = set()

    def says(topic: str, **line: Any) -> Act:
        """Publish in place of what was published before."""

        def publish() -> None:
            if topic in published:
                camera.do("unpublish", topic=topic)
            published.add(topic)
            camera.do("publish", topic=topic, **line)

        return publish

    def status(level: int) -> Act:
        value = {"status": [{"name": "arm: motor", "level": level, "message": "no current"}]}
        return says("/diagnostics", type="diagnostic_msgs/DiagnosticArray", rate=5, value=value)

    def motor(temperature: float) -> Act:
        return says("/motor", **number, value={"data": temperature})

    plants: dict[str, tuple[dict[str, Any], Act, Act]] = {
        "ok(log,camera)": (
            {"kind": "rosout", "hold_s": 3},
            lambda: camera.do("log", level="error", text="cannot open /dev/video0"),
            lambda: None,
        ),
        "ok(goals,dock)": (goals(robot), lambda: act(robot, aborts=True), lambda: act(robot)),
        "ok(moves,imu)": (
            {"kind": "changing", "source": "imu:data", "still_s": 2},
            says("/imu", **number, value={"data": 0.5}),
            says("/imu", **number, moves="data"),
        ),
        "ok(age,scan)": (
            {"kind": "age"},
            says("/scan", **stamped, behind_s=3 * 3600),
            says("/scan", **stamped),
        ),
        "ok(points)": (
            {},  # it is a topic
            lambda: camera.do("hush", topic="/points"),
            says("/points", type="std_msgs/String", value={"data": "p"}, rate=10),
        ),
        "ok(hot)": ({"kind": "property", "source": "motor:data", "high": 60}, motor(80.0), motor(40.0)),
        "ok(device)": ({"kind": "diagnostic", "status": ["arm: *"]}, status(2), status(0)),
    }
    if robot.origin == "ros2":
        camera.do("lifecycle", name="driver")
        camera.do("move", name="driver", transition="configure")
        plants["ok(lifecycle,camera)"] = (
            {"kind": "lifecycle", "node": "driver", "start_s": 120},
            lambda: camera.do("move", name="driver", transition="deactivate"),
            lambda: camera.do("move", name="driver", transition="activate"),
        )
    return plants


@pytest.mark.timeout(900)  # a moment of each kind
@pytest.mark.parametrize("origin", ["ros1", "ros2"])
def test_of_a_moment_of_each_kind_of_evidence_the_batch_says_what_the_robot_said(
    origin: str, tmp_path: Path
) -> None:
    """What was bad, since when, and as it was measured; one topic is too large for the memory there is."""
    model, folder = tmp_path / "rover.yaml", tmp_path / "state" / "moments"
    model.write_text(EVERY)
    with any_robot(origin, tmp_path) as robot, service_double() as service:
        plants = plants_of(robot)
        large = {"type": "std_msgs/String", "value": {"data": "x" * LARGE}, "rate": 10}
        robot.nodes["mission"].do("publish", topic="/image", **large)
        rate = {"from": robot.origin, "first_s": 60, "silence_s": 3}  # a busy robot's nodes are late
        sections: dict[str, Any] = {
            robot.origin: robot.section,
            "topics": {"points": rate, "image": {**rate, "silence_s": 10}},
            "observers": {atom: {"from": origin, **keys} for atom, (keys, _, _) in plants.items() if keys},
            "moments": {"record": True, "before_s": 20, "after_s": 2, "memory_mb": 1, "per_hour": 3600},
        }
        file = config(tmp_path, service.url, {}, **sections)

        def missing() -> list[str]:
            return [atom for atom in plants if service.signs().get(atom) is not True]

        def planted(atom: str) -> int:
            """Make something bad, for as long as its moment lasts; return when it was still well."""
            _, bad, good = plants[atom]
            eventually(lambda: not missing(), f"{atom}: all is well but for {missing()}", 60)
            eventually(lambda: not list(folder.glob("*")), "no moment is open, or waits", 60)
            well_ns = time.time_ns() + 4 * SECOND
            eventually(lambda: time.time_ns() > well_ns, "it is well for long")
            began_ns = time.time_ns()
            bad()
            eventually(lambda: service.holds().get(atom) is False, f"not {atom}", 60)
            eventually(lambda: at_ns(service) > began_ns, "a moment", 60)
            eventually(lambda: not list(folder.glob("*")), "the service has all of it", 60)
            good()
            return began_ns

        with agent(file):
            eventually(lambda: service.polls, "the agent", 60)
            later = plants.keys() & {"ok(lifecycle,camera)"}  # it is said once: the agent is to hear of it
            for atom in plants.keys() - later:
                plants[atom][2]()
            eventually(lambda: later.issuperset(missing()), "the agent hears the robot", 60)
            for atom in later:
                plants[atom][2]()
            for number, atom in enumerate(plants):
                began_ns = planted(atom)
                moment = newest(service)
                assert moment is not None
                recording, out = tmp_path / f"{number}.mcap", tmp_path / f"out{number}"
                recording.write_bytes(service.recordings[moment["key"]])
                assert batch_run(out, recording, "--observers", file, model=model) == 0
                [record] = logs(out)
                found = {
                    one["literal"]: (one["time_ns"], one["reading"])
                    for one in record["readings"]
                    if one["time_ns"] > began_ns
                }
                held = said_live(service, began_ns)
                assert list(held) == [f"not {atom}"]
                assert {text: at for text, (at, _) in found.items()} == about(held)
                assert [(one["literal"], one["reading"]) for one in moment["literals"]] == [
                    (text, reading) for text, (_, reading) in found.items()
                ]
    assert moment is not None
    topics = {topic["topic"]: topic for topic in moment["frame"]["topics"]}
    assert topics["/image"]["messages"][0]["text"].startswith("not kept")
    with recording.open("rb") as opened:
        messages = [(c.topic, len(m.data)) for _, c, m in make_reader(opened).iter_messages()]
    whole = [size for topic, size in messages if topic == "/image/kept"]
    assert 1 <= len(whole) <= 6
    assert min(whole) > LARGE
    assert sum(topic == "/image" for topic, _ in messages) > 2 * len(whole)


def about(times: dict[str, int]) -> dict[str, Any]:
    """Return times for comparison: a message that waits in a socket of a busy computer is judged later on the
    robot than in the recording, where it stands when it came.
    """
    return {text: pytest.approx(at_ns, rel=0, abs=SECOND / 4) for text, at_ns in times.items()}


def said_live(service: ServiceDouble, began_ns: int) -> dict[str, int]:
    """Return what was said to be bad since then, and for when."""
    held: dict[str, int] = {}
    for batch in service.batches():
        for text in batch["observations"]:
            if text.startswith("not ") and began_ns < batch["time"]:
                held.setdefault(text, batch["time"])
    return held
