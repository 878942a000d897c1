"""`robomend attach`: from a running robot to the first true word, with nothing written before."""

from __future__ import annotations

import html
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import xmlrpc.client
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from socketserver import ThreadingMixIn
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import httpx
import pytest
import yaml
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from tests.blocks import BLOCKS
from tests.clients.running_agent import alive
from tests.forked import popen
from tests.node_process import NodeProcess
from tests.other_root import user_systemd
from tests.robomend_batch.recordings import Sample, steady, write
from tests.robomend_batch.running import batch_run, logs
from tests.robomend_demo.playing import children
from tests.ros1 import robot as ros1_robot
from tests.ros2 import Ros2Robot
from tests.ros2 import robot as ros2_robot
from tests.terminal import AFTER_CTRL_C
from tests.waiting import until
from tests.wrong_clock import WrongClock
from tests.zenoh_robot import robot as zenoh_robot

from robomend.cli.commands import run
from robomend.model.from_graph import first_model
from robomend.model.loading import load_model, load_text
from robomend_batch.attach_command import DEFAULT_PORT, alike_namespaces, joined, plugged_in, settled
from robomend_client.ros_graph import Ear, Heard, HeardDevice, RosGraph

MOST_S = 110.0
SECONDS = "10"

MINE = [
    line.partition("#")[0].removeprefix("./dev run ").split()
    for block in BLOCKS
    if block.test == "tests/robomend_batch/test_attach.py"
    for line in block.text.splitlines()
]


def shown(words: str) -> list[str]:
    """Return the command that a page shows with these words, without the program."""
    [command] = [line for line in MINE if line[2:4] == words.split()]
    return command[1:]


README = next(line[1:] for line in MINE if line == ["robomend", "attach"])


class Attached:
    """A command that runs."""

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self.process = process
        self.folder = folder

    @property
    def said(self) -> str:
        return (self.folder / "said").read_text()

    def until_said(self, pattern: str) -> str:
        """Wait until it has said something; return the line."""
        found: list[str] = []

        def there() -> bool:
            found[:] = [line for line in self.said.splitlines() if re.search(pattern, line)]
            return bool(found) or self.process.poll() is not None

        until(there, f"{pattern}: {self.said}", MOST_S)
        assert found, self.said
        return found[-1]

    def end(self) -> int:
        """Ctrl-C; return the exit code, when all that it started is gone."""
        parts = children(self.process.pid)
        self.process.send_signal(signal.SIGINT)
        code = self.process.wait(60)
        until(lambda: not any(map(alive, parts)), "all parts are gone")
        return code


@contextmanager
def attached(folder: Path, environment: Mapping[str, str], *words: str) -> Iterator[Attached]:
    """Attach to a robot; `folder` is where the command runs."""
    with (folder / "said").open("w") as said:
        process = popen(
            [sys.executable, "-m", "robomend", *words, "--seconds", SECONDS],
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            text=True,
            cwd=folder,
            env={**environment, "PYTHONUNBUFFERED": "1"},
        )
    one = Attached(process, folder)
    try:
        yield one
    finally:
        if process.poll() is None:
            one.end()


def rover2(ros: Ros2Robot) -> None:
    """Nodes with a chain of topics, a latched one, one that is silent, and statuses."""
    kind = "std_msgs/String"
    lidar = ros.node("lidar_driver")
    lidar.do("publish", topic="/scan", type=kind, rate=20, reliable=False)
    status = {"name": "lidar_driver: scan", "level": 0, "message": "fine"}
    kind_of_statuses = "diagnostic_msgs/DiagnosticArray"
    lidar.do("publish", topic="/diagnostics", type=kind_of_statuses, rate=5, value={"status": [status]})
    mapper = ros.node("mapper")
    mapper.do("relay", topic="/scan", to="/pose", type=kind, reliable=False)
    mapper.do("publish", topic="/map", type=kind, latched=True)
    planner = ros.node("planner")
    planner.do("relay", topic="/pose", to="/plan", type=kind)
    planner.do("publish", topic="/cmd_vel", type=kind, rate=0.001)
    planner.do("serve", name="/navigate")


def answer(page: str, question: str, said: str) -> None:
    """Answer a question of a robot's page, as its form does."""
    url, _, robot = page.partition("/ui/robots/")
    form = {"robot": robot, "question": question, "answer": said}
    answer = httpx.post(f"{url}/ui/models/{robot}/answers", data=form, headers={"Origin": url}, timeout=60)
    assert answer.status_code == 303, answer.text


def test_a_robot_with_ros_2_is_healthy_and_what_its_nodes_show_is_put_to_them(tmp_path: Path) -> None:
    """Beside their topics, too."""
    imu = {"topic": "/imu", "type": "sensor_msgs/Imu", "rate": 10}
    moves = {"moves": "linear_acceleration.z"}
    odom = {"topic": "/odom", "type": "std_msgs/String", "rate": 10}

    def start(ros: Ros2Robot) -> None:
        rover2(ros)
        ros.node("imu_driver").do("publish", **imu, **moves)
        ros.node("base_driver").do("publish", **odom)
        odometry = ros.node("odometry")
        odometry.do("relay", topic="/odom", to="/filtered", type="std_msgs/String")
        odometry.do("lifecycle", name="costmap")
        odometry.do("move", name="costmap", transition="configure")
        odometry.do("move", name="costmap", transition="activate")

    def again(node: NodeProcess, **line: Any) -> None:
        node.do("unpublish", topic=line["topic"])
        node.do("publish", **line)

    with ros2_robot(tmp_path) as ros:
        start(ros)
        client = ros.node("operator")
        with attached(tmp_path, ros.environment, *README) as attach:
            attach.until_said(r"\) healthy$")
            assert "unhealthy" not in attach.said
            refused = run(["attach", "--seconds", SECONDS, str(tmp_path / "robot")])
            assert refused == 2  # one at a time
            faults: dict[str, tuple[Callable[[], object], Callable[[], object]]] = {
                "imu_driver": (
                    lambda: again(ros.nodes["imu_driver"], **imu),  # its value stands still
                    lambda: again(ros.nodes["imu_driver"], **imu, **moves),
                ),
                "base_driver": (
                    lambda: again(ros.nodes["base_driver"], **odom, reliable=False),
                    lambda: again(ros.nodes["base_driver"], **odom),
                ),
                "costmap": (
                    lambda: ros.nodes["odometry"].do("move", name="costmap", transition="deactivate"),
                    lambda: ros.nodes["odometry"].do("move", name="costmap", transition="activate"),
                ),
                "planner": (
                    lambda: client.do("act", name="/navigate", order=13),  # aborted
                    lambda: client.do("act", name="/navigate", order=1),
                ),
            }
            for node, (plant, undo) in faults.items():
                plant()
                attach.until_said(rf"unhealthy: {node}$")
                attach.until_said(r"^    .* A person is needed: robomend only observes it\.$")
                undo()
                until(lambda: re.search(r"\) healthy\n\Z", attach.said), f"{node}: {attach.said}", MOST_S)
            for one in list(ros.nodes.values()):
                one.close()
            attach.until_said(r"unhealthy: .*imu_driver.*")
            start(ros)
            ros.node("operator")
            until(lambda: re.search(r"\) healthy\n\Z", attach.said), attach.said, MOST_S)
            page = attach.until_said("^the page: ").removeprefix("the page: ")
            answer(page, "lidar_driver", "lidar")
            attach.until_said("^answered on the page")
            ros.nodes["lidar_driver"].kill()
            attach.until_said(r"unhealthy: lidar_driver$")
            assert attach.end() == 0
            assert "ended: all that was started is gone" in attach.said
    model = load_model(tmp_path / "robot" / "robot-model.yaml").parts
    assert model is not None
    assert model.nodes["lidar_driver"].drives == ("lidar",)
    assert model.nodes["mapper"].publishes == {"map": (), "pose": ("scan", "scan_qos")}
    assert model.nodes["planner"].publishes["cmd_vel"] == ()
    assert model.nodes["planner"].publishes["plan"] == ("pose", "pose_qos")
    assert [name for name, topic in model.topics.items() if topic.silent] == ["cmd_vel", "map"]
    assert "policy: observe" in (tmp_path / "robot" / "robot.yaml").read_text()


def test_when_a_lifecycle_manager_takes_all_down_the_node_that_failed_is_named(tmp_path: Path) -> None:
    servers = ("planner", "controller", "navigator")
    with ros2_robot(tmp_path) as ros:
        for name in servers:
            ros.node(f"{name}_host").do("lifecycle", name=f"{name}_server")
        ros.node("manager").do("manage", nodes=[f"/{name}_server" for name in servers])
        with attached(tmp_path, ros.environment, *README) as attach:
            attach.until_said(r"\) healthy$")
            ros.nodes["controller_host"].kill()
            attach.until_said(r"unhealthy: controller_host and controller_server$")
            page = attach.until_said("^the page: ").removeprefix("the page: ")
            url, _, robot = page.partition("/ui/robots/")
            down = [f"not ok({name}_server_lifecycle)" for name in servers if name != "controller"]

            def seen() -> str:
                return httpx.get(f"{url}/api/v1/robots/{robot}/observations", timeout=60).text

            until(lambda: all(one in seen() for one in down), "the others were taken down", MOST_S)
            found = httpx.get(f"{url}/api/v1/robots/{robot}/diagnosis", timeout=60).json()["result"]
            assert [one["bad"] for one in found["diagnoses"]] == [["controller_host", "controller_server"]]


def test_a_robot_with_ros_1_is_watched_what_comes_later_joins_and_long_hearing_makes_bounds_tighter(
    tmp_path: Path,
) -> None:
    """Once a person says so."""
    kind = "std_msgs/String"

    def well(after: str) -> None:
        pattern = rf"{after}[^$]*\) healthy\n"
        until(lambda: re.search(pattern, attach.said), f"{after}: {attach.said}", MOST_S)

    with ros1_robot(tmp_path) as ros:
        ros.node("lidar_driver").do("publish", topic="/scan", type=kind, rate=20)
        mapper = ros.node("mapper")
        mapper.do("subscribe", topic="/scan", type=kind)
        mapper.do("publish", topic="/pose", type=kind, rate=10)
        words = [
            ros.master.uri if word.startswith("http:") else word
            for word in shown("--ros1 http://robot:11311")
        ]
        with attached(tmp_path, ros.master.environment, *words) as attach:
            attach.until_said(r"\bhealthy$")
            ros.node("late").do("publish", topic="/later", type=kind, rate=10)
            attach.until_said(r"^joined: late$")
            assert "unhealthy" not in attach.said
            mapper.do("hush", topic="/pose")
            attach.until_said(r"unhealthy: mapper$")
            mapper.do("publish", topic="/pose", type=kind, rate=10)
            well("unhealthy: mapper")

            file = tmp_path / "rover" / "agent.yaml"
            before = watched(file)
            assert before["silence_s"] >= 1.0  # more on a busy machine
            heard = {"window": before["window"], "count": 144_000, "seconds": 7200.0}
            rates = {"longest_s": 0.08, "slowest_hz": 19.0, "fastest_hz": 20.5}
            usual = file.parent / "robomend-agent-state" / "usual.json"

            def asked() -> bool:
                usual.write_text(json.dumps({"scan": heard | rates}))  # as after two hours of its own
                return "asked on the page" in attach.said

            until(asked, "it asks", MOST_S)
            question = attach.until_said("^asked on the page: ").removeprefix("asked on the page: ")
            assert f"scan: silence after 0.35 s, now {before['silence_s']:.2g} s" in question
            assert watched(file) == before
            page = attach.until_said("^the page: ").removeprefix("the page: ")
            assert question in html.unescape(httpx.get(page, timeout=60).text)
            answer(page, question, "yes")
            attach.until_said("^tighter bounds are taken over")
            assert watched(file)["silence_s"] == pytest.approx(0.35, abs=0.01)
            assert watched(file)["tolerance_hz"] < before["tolerance_hz"] / 2
            well("taken over")
            ros.nodes["lidar_driver"].do("hush", topic="/scan")
            attach.until_said(r"unhealthy: lidar_driver$")
    text = (tmp_path / "rover" / "rover.yaml").read_text()
    assert "\n  late:" in text
    assert "\n  later: {rate_hz:" in text
    assert "tighter" not in text  # its numbers say so now
    assert "in 2 h since: longest 80 ms" in text


class Others(ThreadingMixIn, SimpleXMLRPCServer):
    """Nodes that answer the master and others; each connection in a thread: some are kept open."""

    daemon_threads = True
    request_queue_size = 512  # nodes' queues are their own


ODD = ("no", "1e3", "null", "a: b", "'q", "#c", "ünder", "- x")
"""Names that YAML takes for something else; a master takes any."""


def test_500_nodes_odd_names_what_is_broken_already_and_a_clock_that_jumps_are_no_fault(
    tmp_path: Path,
) -> None:
    """What was broken already while it was listened to is asked."""
    kind = "std_msgs/String"
    clock = WrongClock(tmp_path)
    with ros1_robot(tmp_path) as ros, Others(("127.0.0.1", 0), logRequests=False) as others:
        others.register_function(lambda caller: [1, "", os.getpid()], "getPid")
        threading.Thread(target=others.serve_forever, daemon=True).start()
        uri = f"http://127.0.0.1:{others.server_address[1]}/"
        ros.node("lidar_driver").do("publish", topic="/scan", type=kind, rate=20)
        camera = ros.node("camera")
        camera.do("publish", topic="/image", type=kind, rate=20)
        with xmlrpc.client.ServerProxy(ros.master.uri) as master:
            for name in (*ODD, *(f"node{number}" for number in range(500))):
                master.registerPublisher(f"/{name}", f"/{name}/state", kind, uri)
        around = {**ros.master.environment, "PYTHONPATH": clock.environment["PYTHONPATH"]}
        with attached(tmp_path, around, *README) as attach:

            def said(words: str) -> object:
                camera.do("log", level="error", text="no frame")
                return re.search(words, attach.said, re.MULTILINE)

            until(lambda: said(r"^listening, .* 5\d\d nodes, "), "it listens to all", MOST_S)
            clock.set(3600)
            until(lambda: said("wrote .*/robot/agent.yaml"), "it is listened to the end", MOST_S)
            attach.until_said(r"\) (healthy|partly-unknown)$")
            clock.set(-3600)
            assert "unhealthy" not in attach.said
            camera.kill()
            attach.until_said(r"unhealthy: camera$")
            assert attach.end() == 0
        others.shutdown()
    text = (tmp_path / "robot" / "robot-model.yaml").read_text()
    parts = load_text(text).parts
    assert parts is not None
    assert {"lidar_driver", "camera", "node499", "no", "1e3"} <= set(parts.nodes)
    heard = r"^  scan: {rate_hz: |^#   .*: no publisher was connected"
    assert re.search(heard, text, re.MULTILINE), "what is connected after the 500 is not silent by design"
    assert re.search(r"#   camera logged \d+ errors?: was it well\?", text), attach.said


def watched(file: Path) -> dict[str, Any]:
    """Return what an agent's file says of the rate of /scan."""
    topics: dict[str, dict[str, Any]] = yaml.safe_load(file.read_text())["topics"]
    return topics["scan"]


SYSTEMCTL = """#!{python}
import os, pathlib, re, shlex, subprocess, sys
home = pathlib.Path(os.environ["XDG_CONFIG_HOME"])
with (home / "asked").open("a") as asked:
    print(*sys.argv[2:], file=asked)
if sys.argv[2] == "restart":
    text = (home / "systemd" / "user" / sys.argv[3]).read_text()
    text = text.replace("%%", "%").replace("$$", "$")
    [command] = re.findall("^ExecStart=(.*)$", text, re.M)
    said = dict(shlex.split(one)[0].split("=", 1) for one in re.findall("^Environment=(.*)$", text, re.M))
    [folder] = re.findall("^WorkingDirectory=(.*)$", text, re.M)
    own = {{name: value for name, value in os.environ.items() if not name.startswith("ROS_")}}
    with (home / (sys.argv[3] + ".log")).open("w") as log:
        around = dict(cwd=folder, env={{**own, **said}}, stdout=log, stderr=log)
        child = subprocess.Popen(shlex.split(command), **around)
    with (home / "started").open("a") as started:
        print(child.pid, file=started)
sys.exit(sys.argv[2] == "is-active")
"""
"""It starts what a unit says, in the environment that the unit says, and ends nothing."""


def test_detached_it_goes_on_as_units_of_the_user(tmp_path: Path) -> None:
    home, programs = tmp_path / "config $HOME", tmp_path / "bin"
    home.mkdir()
    programs.mkdir()
    (programs / "systemctl").write_text(SYSTEMCTL.format(python=sys.executable))
    (programs / "systemctl").chmod(0o755)
    with ros2_robot(tmp_path) as ros:
        rover2(ros)
        path = f"{programs}:{ros.environment['PATH']}"
        around = {**ros.environment, "PATH": path, "XDG_CONFIG_HOME": str(home)}
        try:
            with (
                attached(tmp_path, around, *README, "--detach", "--name", "rover", "rover 50%") as attach,
                socket.socket() as other,
            ):
                attach.until_said("^listening, ")
                with suppress(OSError):  # who takes the usual port meanwhile keeps it
                    other.bind(("127.0.0.1", DEFAULT_PORT))
                    other.listen()
                taken = other.getsockname()[1] == DEFAULT_PORT  # else another has it, and may end meanwhile
                page = attach.until_said("^the page: ").removeprefix("the page: ")
                assert not taken or f":{DEFAULT_PORT}/" not in page
                attach.until_said("It ends with: systemctl --user disable --now robomend-rover")
                assert attach.process.wait(MOST_S) == 0
            url, _, robot = page.partition("/ui/robots/")

            def healthy() -> bool:
                return bool(httpx.get(f"{url}/api/v1/robots/{robot}").json()["state"] == "healthy")

            until(healthy, "it is healthy", MOST_S)
            units = sorted((home / "systemd" / "user").iterdir())
            assert [unit.name for unit in units] == [
                f"robomend-{robot}-agent.service",
                f"robomend-{robot}.service",
            ]
        finally:
            started = (home / "started").read_text().split()
            for pid in started:
                with suppress(ProcessLookupError):
                    os.kill(int(pid), signal.SIGTERM)
            until(lambda: not any(alive(int(pid)) for pid in started), "both have ended")


def test_detached_a_real_systemd_starts_it_again_and_ends_it(tmp_path: Path) -> None:
    home, units = tmp_path / "config", ("robomend-rover-agent.service", "robomend-rover.service")
    with ros2_robot(tmp_path) as ros, user_systemd(tmp_path, home) as systemctl:

        def asked(*words: str) -> str:
            return subprocess.check_output([systemctl, "--user", *words], text=True)

        rover2(ros)
        path = f"{systemctl.parent}:{ros.environment['PATH']}"
        around = {**ros.environment, "PATH": path, "XDG_CONFIG_HOME": str(home)}
        with attached(tmp_path, around, *README, "--detach", "--name", "rover", "rover 50%") as attach:
            page = attach.until_said("^the page: ").removeprefix("the page: ")
            attach.until_said("It ends with: systemctl --user disable --now robomend-rover")
            assert attach.process.wait(MOST_S) == 0
        robot = page.replace("/ui/", "/api/v1/")

        def state() -> str:
            with suppress(httpx.TransportError):
                return str(httpx.get(robot).json()["state"])
            return "no answer"

        until(lambda: state() == "healthy", "it is healthy", MOST_S)
        process = ("show", "--property=MainPID", "--value")
        for unit in units:
            killed = asked(*process, unit)
            asked("kill", "--signal=KILL", unit)
            until(lambda: asked(*process, unit) not in (killed, "0\n"), f"{unit} runs again", MOST_S)  # noqa: B023  # it ends here
        ros.nodes["lidar_driver"].kill()
        until(lambda: state() == "unhealthy", "they look after it again", MOST_S)
        asked("disable", "--now", *units)
        assert [asked(*process, unit) for unit in units] == ["0\n", "0\n"]
        assert asked("show", "--property=UnitFileState", "--value", *units).split() == ["disabled"] * 2


def test_a_robot_with_ros_2_over_zenoh_is_watched(tmp_path: Path) -> None:
    kind = "std_msgs/String"
    with zenoh_robot(tmp_path) as ros:
        ros.node("lidar_driver").do("publish", topic="/scan", type=kind, rate=20)
        mapper = ros.node("mapper")
        mapper.do("subscribe", topic="/scan", type=kind)
        mapper.do("publish", topic="/pose", type=kind, rate=10)
        words = [
            word if word != "tcp/robot:7447" else ros.endpoint for word in shown("--zenoh tcp/robot:7447")
        ]
        with attached(tmp_path, {**os.environ, "ROS_DOMAIN_ID": str(ros.domain)}, *words) as attach:
            attach.until_said(r"\) healthy$")
            assert "unhealthy" not in attach.said
            ros.nodes["lidar_driver"].kill()
            attach.until_said(r"unhealthy: lidar_driver$")
    text = (tmp_path / "rover" / "rover.yaml").read_text()
    assert "pose: [scan]" in text
    rates = load_model(tmp_path / "rover" / "rover.yaml").parts
    assert rates is not None
    assert rates.topics["scan"].rate_hz == pytest.approx(20, rel=0.3)


def test_it_ends_with_all_that_it_started_at_whatever_moment(tmp_path: Path) -> None:
    with ros2_robot(tmp_path) as ros:
        lidar = ros.node("lidar_driver")
        for number, moment in enumerate(("^looking for", "^listening, ", "^wrote .*agent.yaml")):
            if number == 1:
                lidar.do("publish", topic="/scan", type="std_msgs/String", rate=10)
            with attached(tmp_path, ros.environment, *README, f"robot{number}") as attach:
                attach.until_said(moment)
                assert attach.end() in (*AFTER_CTRL_C, 0), attach.said
                assert "ended: all that was started is gone" in attach.said
                assert "Traceback" not in attach.said


def test_files_that_are_there_are_shown_and_not_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording(tmp_path / "one.bag", 10)
    recording(tmp_path / "other.bag", 20)
    folder = tmp_path / "rover"
    monkeypatch.chdir(tmp_path)
    assert run([word.replace("good", "one") for word in shown("--bag good.bag")]) == 0
    before = {file: file.read_text() for file in folder.glob("*.yaml")}
    assert len(before) == 3
    capsys.readouterr()
    assert run(["attach", "--bag", str(tmp_path / "one.bag"), str(folder)]) == 0
    assert "+" not in capsys.readouterr().out  # nothing is new
    model = folder / "rover.yaml"
    model.write_text(before[model].replace("nodes:\n", "nodes:\n  lamp: {}\n"))
    before[model] = model.read_text()
    assert run(["attach", "--bag", str(tmp_path / "other.bag"), str(folder)]) == 0
    said = capsys.readouterr()
    assert re.search(r"^\+  scan: \{rate_hz: 20,", said.out, re.MULTILINE)
    assert f"{folder} stays as it is; not there now: lamp; --update takes over what was heard" in said.err
    assert {file: file.read_text() for file in folder.glob("*.yaml")} == before
    assert run(["attach", "--update", "--bag", str(tmp_path / "other.bag"), str(folder)]) == 0
    assert "scan: {rate_hz: 20," in (folder / "agent.yaml").read_text()


@pytest.mark.parametrize("ending", [".bag", ".mcap", ".db3"])
def test_a_draft_of_recordings_claims_only_what_was_recorded(
    ending: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No node that nobody named is watched, none is said to log no errors, no rate is of a moment."""
    log = write(tmp_path / f"good{ending}", [*steady("odom", 20, 30), *steady("scan", 1e5, 0.001)])
    assert run(["attach", "--bag", str(log), str(tmp_path / "rover")]) == 0
    said = capsys.readouterr()
    files = (tmp_path / "rover" / f"{one}.yaml" for one in ("rover", "agent", "robot"))
    model, agent, robot = (file.read_text() for file in files)
    assert "kind: rosout" not in agent
    assert "scan: {rate_hz" not in model
    assert "100 messages within 0.99 ms" in model
    assert "which node publishes odom?" in model
    assert "publisher_of" not in agent.partition("# processes:")[0]
    assert "publisher_of" not in robot
    assert "s are recorded, too little" not in said.err
    given = log, "--observers", tmp_path / "rover" / "agent.yaml"
    assert batch_run(tmp_path / "out", *given, model=tmp_path / "rover" / "rover.yaml") == 0
    assert "faulty" not in logs(tmp_path / "out")[0]["span_ns"]


@pytest.mark.parametrize("name", ["true", "0x1F", "1e3", "2026-11-29"])
def test_names_that_yaml_dislikes_are_names(name: str, tmp_path: Path) -> None:
    recording(tmp_path / "good.bag", 10)
    given = ["attach", "--bag", str(tmp_path / "good.bag"), f"--name={name}", str(tmp_path / "rover")]
    assert run(given) == 0
    for file, key in (("agent", "robot"), ("robot", "model"), (name, "name")):
        assert yaml.safe_load((tmp_path / "rover" / f"{file}.yaml").read_text())[key] == name
    assert run(given) == 0


def test_a_folder_of_recordings_is_read_and_one_of_moments_gives_nothing_to_watch(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "good").mkdir()
    recording(tmp_path / "good" / "a.bag", 10)
    recording(tmp_path / "good" / "b.bag", 10)
    assert run(["attach", "--bag", str(tmp_path / "good"), str(tmp_path / "rover")]) == 0
    assert "scan: {rate_hz: 10" in (tmp_path / "rover" / "agent.yaml").read_text()
    assert "next, over the logs that you doubt: robomend-batch run" in capsys.readouterr().out
    write(tmp_path / "short.bag", steady("scan", 1e5, 0.001))
    assert run(["attach", "--bag", str(tmp_path / "short.bag"), str(tmp_path / "other")]) == 0
    said = capsys.readouterr()
    assert "0.00099 s are recorded, too little for most rates" in said.err
    assert "nothing in the recordings can be watched: give longer ones" in said.err
    assert "next" not in said.out


@pytest.mark.parametrize(
    ("scans", "learned_of_all"),
    [
        (steady("scan", 10, 40, start_s=2.0), False),  # it begins late
        (steady("scan", 10, 40, start_s=8.0), False),
        (
            [
                *steady("scan", 50, 20),
                *steady("scan", 0.5, 30, start_s=20),
                *steady("scan", 50, 90, start_s=30),
            ],
            True,
        ),
    ],
)
def test_a_draft_calls_nothing_of_its_own_recording_faulty(
    scans: list[Sample], learned_of_all: bool, tmp_path: Path
) -> None:
    """Where a topic was slow long before the end, it is watched by what is learned of all of it."""
    log = write(tmp_path / "good.bag", [*steady("odom", 20, scans[-1][0]), *scans])
    assert run(["attach", "--bag", str(log), str(tmp_path / "rover")]) == 0
    agent = (tmp_path / "rover" / "agent.yaml").read_text()
    assert ("  # learned from all of the logs\n  scan: {rate_hz: " in agent) == learned_of_all
    given = log, "--observers", tmp_path / "rover" / "agent.yaml"
    assert batch_run(tmp_path / "out", *given, model=tmp_path / "rover" / "rover.yaml") == 0
    assert set(logs(tmp_path / "out")[0]["span_ns"]) == {"healthy", "unknown"}


def test_a_node_that_logged_errors_in_a_recording_is_asked_about(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    log, text = types["rosgraph_msgs/msg/Log"], types["std_msgs/msg/String"]
    with Writer(tmp_path / "good.bag") as bag:

        def connection(topic: str, kind: str, node: str) -> Any:
            return bag.add_connection(topic, kind, typestore=store, callerid=node)

        nodes = {
            name: connection(f"/{name}_data", text.__msgtype__, f"/{name}") for name in ("lidar", "camera")
        }
        rosout = connection("/rosout", log.__msgtype__, "/lidar")
        for number in range(300):
            for one in nodes.values():
                bag.write(one, number * 10**8, store.serialize_ros1(text(data="x"), text.__msgtype__))
            if number == 100:
                zero = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
                stamp = types["std_msgs/msg/Header"](seq=0, stamp=zero, frame_id="")
                line = log(
                    header=stamp, level=8, name="/lidar", msg="no", file="", function="", line=0, topics=[]
                )
                bag.write(rosout, number * 10**8, store.serialize_ros1(line, log.__msgtype__))
    assert run(["attach", "--bag", str(tmp_path / "good.bag"), str(tmp_path / "rover")]) == 0
    assert "lidar logged 1 error: was it well?" in (tmp_path / "rover" / "rover.yaml").read_text()
    agent = (tmp_path / "rover" / "agent.yaml").read_text()
    assert "camera_log: {kind: rosout" in agent
    assert "lidar_log" not in agent


def test_devices_are_proposed_and_none_of_them_counts_before_somebody_says_so(tmp_path: Path) -> None:
    ports, port = tmp_path / "dev" / "serial" / "by-id", tmp_path / "ttyUSB0"
    ports.mkdir(parents=True)
    port.touch()
    (ports / "usb-FTDI_FT232R-if00").symlink_to(port)
    with port.open() as _:
        found = plugged_in(tmp_path / "dev")
    assert re.fullmatch(
        rf".*FT232R-if00, which .* \({os.getpid()}\) has open", found["usb-FTDI_FT232R-if00"].source
    )
    found["H-1234"] = HeardDevice("hardware_id of the status 'lidar_driver: scan'", "/lidar_driver")
    graph = RosGraph({"/scan": frozenset({"/lidar_driver"})})
    text = first_model(Heard(graph, "a test", 60, 1, devices=found), "rover").text
    said = "hardware_id of the status 'lidar_driver: scan', by lidar_driver"
    assert f"#   H-1234: {{blame_hardware: true}}    # {said}\n" in text
    parts = load_text(text).parts
    assert parts is not None
    assert not parts.hardware
    begun = text.replace("# hardware:", "hardware:").replace("#   H-1234:", "  H-1234:")
    assert list(load_text(begun).parts.hardware) == ["H-1234"]  # type: ignore[union-attr]  # it is of components


def test_launch_files_ask_for_what_is_not_there(tmp_path: Path) -> None:
    recording(tmp_path / "good.bag", 10)
    launch = tmp_path / "all.launch"
    node = '<node pkg="{0}" type="{0}_node" name="{0}"/>'
    launch.write_text(f"<launch>{node.format('lidar')}{node.format('camera')}</launch>")
    folder = tmp_path / "rover"
    given = ["--bag", str(tmp_path / "good.bag"), "--launch", str(launch), str(folder)]
    assert run(["attach", *given]) == 0
    text = (folder / "rover.yaml").read_text()
    assert "camera (camera/camera_node) is launched and was not there: why?" in text
    assert load_model(folder / "rover.yaml").cnf.components == ("lidar",)
    assert "camera" not in (folder / "agent.yaml").read_text()


def recording(file: Path, rate_hz: int) -> None:
    """Write a recording of half a minute."""
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "std_msgs/msg/String"
    message = store.serialize_ros1(store.types[kind](data="x"), kind)
    with Writer(file) as bag:
        scan = bag.add_connection("/scan", kind, typestore=store, callerid="/lidar_30719_1739203333671")
        for number in range(30 * rate_hz):
            bag.write(scan, number * 10**9 // rate_hz, message)


@pytest.mark.parametrize(
    ("arguments", "code", "why"),
    [
        (["--ros1", "--ros2"], 2, "give one of --ros1, --ros2, --zenoh and --bag"),
        (["--ros2", "rover"], 2, "'rover' is no domain of ROS 2, from 0 to 232; DIR stands before --ros2"),
        (["--ros1", "nonsense"], 2, "'nonsense' is no address"),
        (["--ros1", "http://127.0.0.1:1/"], 2, "no robot was found. the master at http://127.0.0.1:1/"),
        (["--ros1", "http://127.0.0.1:1/", "--url", "http://127.0.0.1:1"], 3, "nobody answers at"),
        (["--name", "a b"], 2, "'a b' is no robot's name"),
        (["--detach"], 2, "--detach needs systemd"),
        (["--detach", "--bag", "."], 2, "--bag starts nothing that --detach could leave running"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_said(
    arguments: list[str],
    code: int,
    why: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_HOSTNAME", "127.0.0.1")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert run(["attach", *arguments]) == code
    told = capsys.readouterr().err
    assert why in told
    if "no robot was" in why:
        assert "ROS_HOSTNAME=127.0.0.1" in told
    assert not list(tmp_path.glob("*/*.yaml"))


def test_an_agents_file_that_is_no_text_is_refused_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "agent.yaml").write_bytes(b"\xa9\xff")
    assert run(["attach", "--name", "rover", str(tmp_path)]) == 2
    assert "agent.yaml is no text (UTF-8): move it away" in capsys.readouterr().err
    (tmp_path / "agent.yaml").unlink()
    (tmp_path / "agent.yaml").mkdir()
    assert run(["attach", "--name", "rover", str(tmp_path)]) == 2
    assert "agent.yaml cannot be read: Is a directory" in capsys.readouterr().err


def test_another_robots_folder_is_not_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "agent.yaml").write_text("robot: walker\n")
    assert run(["attach", "--name", "rover", str(tmp_path)]) == 2
    assert "has the files of 'walker', not of 'rover'" in capsys.readouterr().err


def test_numbers_that_are_about_the_same_change_no_file() -> None:
    old = "a:\n  # 60 messages\n  x: {rate_hz: 10, tolerance_hz: 4}    # 60 messages\n  y: {rate_hz: 1}\n"
    new = "a:\n  # 61 messages\n  x: {rate_hz: 10.2, tolerance_hz: 4.1}    # 61 messages\n  y: {rate_hz: 2}\n"
    assert settled(old, new) == old.replace("y: {rate_hz: 1}", "y: {rate_hz: 2}")


def test_twins_are_seen_and_parts_of_one_robot_are_not() -> None:
    robots = [f"/{robot}/{node}" for robot in ("a", "b") for node in ("base", "lidar", "planner")]
    assert alike_namespaces([*robots, "/map_server"]) == ["a", "b"]
    assert alike_namespaces(["/left/camera", "/right/camera", "/arm/driver", "/arm/planner", "/base"]) == []


def test_a_topic_that_was_silent_by_design_does_not_join_nor_a_node_that_just_came() -> None:
    second = 10**9
    graph = RosGraph({"/odom": frozenset({"/base"}), "/cmd_vel": frozenset({"/base"})})
    before = Heard(graph, "a test", 60, 60 * second, {"/odom": Ear(range(0, second, 10**8)).heard()})
    more = RosGraph({**graph.publishers, "/new": frozenset({"/late"}), "/too": frozenset({"/newest"})})
    came = Ear(range(100 * second, 160 * second, second // 10)).heard()
    since = {"/late": 90 * second, "/newest": 155 * second, "/robomend_agent": 0}
    now = Heard(more, "a test", 60, 160 * second, {"/new": came, "/cmd_vel": came}, since_ns=since)
    found = joined(before, now, 60)
    assert found is not None
    assert found.graph.nodes == {"/base", "/late"}
    assert found.topics["/new"].count == 600
    assert "/cmd_vel" not in found.topics
    assert joined(found, now, 60) is None
