"""What an agent can do besides its own processes: programs, units of systemd, USB devices; allow-lists."""

from __future__ import annotations

import asyncio
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from tests.clients.running_agent import alive
from tests.clients.service_double import eventually
from tests.distributions import install

from robomend_client.actions import FAILED, OK, REFUSED, Action, ActionResult
from robomend_client.agent.executors.base import ActionExecutor, ActionSpec, Executors, read_actions
from robomend_client.agent.executors.program import Program
from robomend_client.agent.executors.ros_programs import (
    CallService,
    ChangeMode,
    Launch,
    Lifecycle,
    LoadComponent,
    ParameterChange,
    SwitchControllers,
)
from robomend_client.agent.executors.systemd import Units
from robomend_client.agent.executors.usb import ResetUsb
from robomend_client.yaml_reader import ConfigError, read

MANUAL = (Path(__file__).parents[2] / "docs" / "agent.md").read_text()
SAY = [sys.executable, "-c", "import sys; print(*sys.argv[1:], sep='|')"]


def do(executor: ActionExecutor, *parameters: str) -> ActionResult:
    action = Action("r:1", executor.name, parameters, 10.0)
    return asyncio.run(executor.execute(action, lambda number, message: None))


def program(tmp_path: Path, command: Sequence[str], **more: object) -> Program:
    return Program("calibrate", command, tmp_path, **more)  # type: ignore[arg-type]  # of several types


# --- programs ---------------------------------------------------------------------------------------------


def test_a_program_gets_its_parameters_as_arguments_and_no_shell_reads_them(tmp_path: Path) -> None:
    odd = "left; touch $(pwd)/owned"
    executor = program(tmp_path, [*SAY, "--arm={arm}", "{arm}"], parameters={"arm": [odd]})
    assert do(executor, odd) == ActionResult(
        OK, f"calibrate({odd}) is done; its last output: --arm={odd}|{odd}"
    )
    assert not (tmp_path / "owned").exists()


def test_an_exit_code_is_a_failure_with_the_last_output(tmp_path: Path) -> None:
    result = do(program(tmp_path, [sys.executable, "-c", "print('no arm'); raise SystemExit(4)"]))
    assert (result.code, result.message) == (
        FAILED,
        "calibrate() failed with exit code 4; its last output: no arm",
    )
    killed = do(program(tmp_path, [sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"]))
    assert "was ended by signal 9" in killed.message


def test_a_program_that_is_not_there_is_a_failure(tmp_path: Path) -> None:
    assert "/nowhere cannot be started" in do(program(tmp_path, ["/nowhere"])).message


def test_directory_and_environment_are_the_programs(tmp_path: Path) -> None:
    (tmp_path / "work").mkdir()
    show = [sys.executable, "-c", "import os; print(os.getcwd(), os.environ['ARM'])"]
    result = do(program(tmp_path, show, directory="work", environment={"ARM": "left"}))
    assert result.message.endswith(f"{tmp_path}/work left")


def test_cut_off_it_is_ended_with_all_that_it_started(tmp_path: Path) -> None:
    child = (
        f"import os, time; open({str(tmp_path / 'child')!r}, 'w').write(str(os.getpid())); time.sleep(1000)"
    )
    parent = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {child!r}])"
    executor = program(tmp_path, [sys.executable, "-c", parent])

    async def run() -> None:
        action = Action("r:1", "calibrate", (), 10.0)
        task = asyncio.create_task(executor.execute(action, lambda number, message: None))
        while not ((tmp_path / "child").exists() and (tmp_path / "child").read_text()):
            await asyncio.sleep(0.01)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert task.cancelled()

    asyncio.run(run())
    eventually(lambda: not alive(int((tmp_path / "child").read_text())), "the end of the program's child")


# --- ROS's own programs -----------------------------------------------------------------------------------


@pytest.fixture
def ros_programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand-ins that say with what they were called; robomend_ros itself is tested with a real rclpy."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in ("ros2", "roslaunch"):
        (folder / name).write_text(
            '#!/bin/sh\nprintf "%s|" "$0" "$@"\ncase "$*" in *broken*) exit 1;; esac\n'
        )
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")


@pytest.mark.usefixtures("ros_programs")
@pytest.mark.parametrize(("release", "program"), [("ros1", "roslaunch|"), ("ros2", "ros2|launch|")])
def test_a_launch_file_is_run_with_its_arguments_which_no_shell_reads(
    tmp_path: Path, release: str, program: str
) -> None:
    sides = {"arm": ["left", "$(reboot); a b"]}
    launch = Launch("home", "arm", "home.launch", tmp_path, release, {"side": "{arm}", "v": "1"}, sides)
    assert do(launch, "left").message.endswith(f"/{program}arm|home.launch|side:=left|v:=1|")
    assert do(launch, "$(reboot); a b").message.endswith("|side:=$(reboot); a b|v:=1|")


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (
            lambda base: program(base, ["{a}"], parameters={"a": ["b"]}),
            "command must name its program itself",
        ),
        (
            lambda base: program(base, ["a", "{leg}"]),
            "command has a place for {leg}, but the parameters are:",
        ),
        (lambda base: Lifecycle("mend", {"a": "/a"}), "transition must be one of configure, activate"),
        (lambda base: Lifecycle("activate", {"a": "-x"}), "nodes: '-x' must be a full name"),
        (
            lambda base: CallService("a", {"a": "/a"}, "std_srvs/Empty"),
            "type must be as std_srvs/srv/Trigger",
        ),
        (lambda base: CallService("a", {"a": "/a"}, "a/srv/B", {"x": "{y}"}), "request has a place for {y}"),
        (lambda base: ParameterChange("p"), "values must map a word to a value"),
        (
            lambda base: ParameterChange("p", {"x": "1"}, back="x"),
            "values, steps and back must",
        ),
        (lambda base: ParameterChange("p", steps={"x": "much"}), "steps must map a word"),
        (lambda base: ParameterChange("p", steps={"x": "1"}), "least and most must bound"),
        (lambda base: SwitchControllers("a", {"a": "/m"}), "activate must name controllers"),
        (lambda base: SwitchControllers("a", {"a": "/m"}, ["x"], ["x"]), "deactivate must not name"),
        (lambda base: ChangeMode("a", {"a": "/m"}, []), "modes must list modes"),
        (lambda base: LoadComponent("load", {"a": "/a"}, "/box"), "plugin must be named"),
        (lambda base: Launch("a", "--x", "f", base), "package must be a name, not '--x'"),
        (lambda base: Launch("a", "p", "f", base, "ros3"), "release must be one of ros1, ros2, not 'ros3'"),
    ],
)
def test_what_could_not_be_done_is_refused_by_name(
    tmp_path: Path, make: Callable[[Path], object], complaint: str
) -> None:
    with pytest.raises(ValueError, match=f"^{complaint}"):
        make(tmp_path)


# --- systemd ----------------------------------------------------------------------------------------------


@pytest.fixture
def systemctl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A stand-in that says with what it was called: there is no systemd where tests run."""
    stand_in = tmp_path / "bin" / "systemctl"
    stand_in.parent.mkdir()
    stand_in.write_text(
        '#!/bin/sh\necho "$@"\n'
        'case "$*" in *is-active*runs*) exit 0;; *is-active*) exit 3;; *broken*) exit 5;; esac\n'
    )
    stand_in.chmod(0o755)
    monkeypatch.setenv("PATH", f"{stand_in.parent}:{os.environ['PATH']}")
    return stand_in


def test_units_are_started_by_the_actions_name_or_by_a_verb(systemctl: Path) -> None:
    start = Units("start_node", {"camera_node": "camera.service"})
    assert do(start, "camera_node").message.endswith("--no-ask-password start -- camera.service")
    restart = Units("mend", {"a": "a@1.service"}, verb="restart", user=True)
    assert do(restart, "a").message.endswith("--user --no-ask-password restart -- a@1.service")


def test_a_unit_that_is_active_already_is_said_to_run_already(systemctl: Path) -> None:
    result = do(Units("start_node", {"a": "runs.service"}), "a")
    assert (result.code, result.message) == (OK, "runs already: runs.service is active")


def test_a_unit_that_fails_is_a_failure(systemctl: Path) -> None:
    result = do(Units("start_node", {"a": "broken.service"}), "a")
    assert (result.code, "exit code 5" in result.message) == (FAILED, True)


# --- USB --------------------------------------------------------------------------------------------------


@pytest.fixture
def usb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A tree as the kernel shows it: two equal cameras, a lidar, an interface; the device files are plain
    files.
    """
    devices = [
        ("1-1", "046d", "0825", "A1", 1, 4),
        ("1-2", "046d", "0825", "A2", 1, 5),
        ("2-1", "10c4", "ea60", "", 2, 3),
    ]
    for name, vendor, product, serial, bus, number in devices:
        folder = tmp_path / "sys" / name
        folder.mkdir(parents=True)
        for attribute, value in (
            ("idVendor", vendor),
            ("idProduct", product),
            ("busnum", bus),
            ("devnum", number),
        ):
            (folder / attribute).write_text(f"{value}\n")
        if serial:
            (folder / "serial").write_text(f"{serial}\n")
        file = tmp_path / "dev" / f"{bus:03d}" / f"{number:03d}"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    (tmp_path / "sys" / "1-1:1.0").mkdir()
    monkeypatch.setattr(ResetUsb, "sysfs", tmp_path / "sys")
    monkeypatch.setattr(ResetUsb, "dev", tmp_path / "dev")
    return tmp_path


@pytest.mark.parametrize(("device", "file"), [("10C4:ea60", "002/003"), ("046d:0825:A2", "001/005")])
def test_the_device_that_is_meant_is_reset(
    usb: Path, monkeypatch: pytest.MonkeyPatch, device: str, file: str
) -> None:
    asked: list[tuple[str, int]] = []
    monkeypatch.setattr(
        "fcntl.ioctl", lambda fd, request, _: asked.append((os.readlink(f"/proc/self/fd/{fd}"), request))
    )
    result = do(ResetUsb("reset_usb", {"it": device}), "it")
    assert result.code == OK
    assert asked == [(str(usb / "dev" / file), 0x5514)]


@pytest.mark.parametrize(
    ("device", "complaint"),
    [("dead:beef", "is not plugged in"), ("046d:0825", "is plugged in 2 times; name the serial")],
)
def test_a_device_that_is_not_there_or_not_the_only_one_is_a_failure(
    usb: Path, device: str, complaint: str
) -> None:
    result = do(ResetUsb("reset_usb", {"it": device}), "it")
    assert (result.code, complaint in result.message) == (FAILED, True)


def test_what_the_kernel_refuses_is_a_failure(usb: Path) -> None:
    result = do(ResetUsb("reset_usb", {"it": "10c4:ea60"}), "it")  # a plain file: the kernel's own answer
    assert (result.code, "Inappropriate ioctl" in result.message) == (FAILED, True)


# --- all of them ------------------------------------------------------------------------------------------


def specs(tmp_path: Path, text: str) -> tuple[ActionSpec, ...]:
    file = tmp_path / "agent.yaml"
    file.write_text(text)
    top = read(file)
    found = read_actions(top, tmp_path)
    top.finish()
    return found


MANY = """\
actions:
  calibrate: {kind: process, command: [a, "{arm}", "{way}"], parameters: {arm: [left, right], way: [up]}}
  home: {kind: process, command: [b]}
  start_node: {kind: systemd, units: {camera_node: camera.service}}
  reset_usb: {kind: reset_usb, devices: {camera: "046d:0825", lidar: "10c4:ea60"}}
"""


def test_the_agent_says_what_it_can_do(tmp_path: Path) -> None:
    executors = Executors("onboard", [spec.make() for spec in specs(tmp_path, MANY)])
    assert executors.can == [
        "calibrate:left,up", "calibrate:right,up", "home", "start_node:camera_node", "reset_usb:camera",
        "reset_usb:lidar",
    ]  # fmt: skip


def test_too_many_choices_of_parameters_are_offered_by_the_name_alone(tmp_path: Path) -> None:
    def can(tens: int) -> list[str]:
        lists = ", ".join(f"p{n}: [a, b, c, d, e, f, g, h, i, j]" for n in range(tens))
        text = f"actions: {{aim: {{kind: process, command: [/bin/true], parameters: {{{lists}}}}}}}"
        return Executors("onboard", [spec.make() for spec in specs(tmp_path, text)]).can

    assert len(can(3)) == 1000
    assert can(3)[-1] == "aim:j,j,j"
    assert can(4) == ["aim"]


@pytest.mark.parametrize(
    ("name", "parameters", "complaint"),
    [
        ("format_disk", ("a",), "knows no format_disk; it knows calibrate, home, start_node, reset_usb"),
        ("home", ("fast",), "home(fast) is not allowed; configured are: no parameter"),
        ("calibrate", ("left",), "configured are: left, right with up"),
        ("calibrate", ("left", "down"), "calibrate(left, down) is not allowed"),
        ("reset_usb", ("$(reboot)",), "reset_usb($(reboot)) is not allowed; configured are: camera, lidar"),
        ("start_node", ("camera.service",), "configured are: camera_node"),
    ],
)
def test_whatever_is_not_on_a_list_is_refused(
    tmp_path: Path, name: str, parameters: tuple[str, ...], complaint: str
) -> None:
    executors = Executors("onboard", [spec.make() for spec in specs(tmp_path, MANY)])
    refused = executors.find(Action("r:1", name, parameters, 1.0))
    assert isinstance(refused, ActionResult)
    assert (refused.code, complaint in refused.message) == (REFUSED, True)


@pytest.mark.parametrize(
    ("action", "complaint"),
    [
        ("{kind: proces}", r"x.kind: no kind of action is named 'proces': .*did you mean 'process'"),
        ("{kind: process, command: a}", r"x.command: must be a list"),
        ("{kind: process}", r"x.command: command must be a list|x.command: is missing"),
        ("{kind: process, command: [a], parameters: {arm: left}}", r"x.parameters.arm: must be a list"),
        ("{kind: process, command: [a], shell: true}", r"x.shell: is no key here"),
        ("{kind: systemd, units: {a: -H}, verb: start}", r"x.units: units: '-H' is no unit's name"),
        ("{kind: systemd, units: {a: a.service}}", r"x.verb: verb must be one of"),
        ("{kind: systemd, unit: {a: a.service}, verb: start}", r"x.unit: is no key here; did you mean units"),
        ("{kind: horn.py:Horn}", r"x.kind: there is no file"),
        ("{kind: reset_usb, devices: {a: camera}}", r"x.devices: devices: 'camera' is no device"),
    ],
)
def test_each_mistake_is_named_with_its_place(tmp_path: Path, action: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=rf"agent.yaml:2: actions\.({complaint})"):
        specs(tmp_path, f"actions:\n  x: {action}\n")


# --- your own ---------------------------------------------------------------------------------------------


def test_the_kind_of_action_of_the_manual_does_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = MANUAL.split("### Your own kind of action\n")[1].split("\n## ")[0]
    code, entry, example = re.findall(r"```(?:python|toml|yaml)\n(.*?)```", section, re.DOTALL)
    points = dict([re.findall(r'^(\w+) = "my_robot:(\w+)"$', entry, re.MULTILINE)[0]])
    group = re.findall(r'"(robomend\.\w+)"\]', entry)[0]
    monkeypatch.syspath_prepend(str(install(tmp_path / "site", "my_robot", code, {group: points})))
    monkeypatch.delitem(sys.modules, "my_robot", raising=False)
    (tmp_path / "agent.yaml").write_text(example.replace("/dev/horn", f"{tmp_path}/horn"))
    (spec,) = read_actions(read(tmp_path / "agent.yaml"), tmp_path)
    executor = spec.make()
    assert Executors("onboard", [executor]).can == ["warn:low", "warn:high"]
    assert do(executor, "low") == ActionResult(OK, "warn(low) was sounded 3 times")
    assert (tmp_path / "horn").read_text() == "low\n" * 3
    sys.modules.pop("my_robot", None)
    (tmp_path / "my_robot.py").write_text(code)
    by_file = (tmp_path / "agent.yaml").read_text().replace("kind: horn", 'kind: "my_robot.py:Horn"')
    (spec,) = specs(tmp_path, by_file)
    assert do(spec.make(), "high") == ActionResult(OK, "warn(high) was sounded 3 times")
