"""The agent's YAML file: what it means, and complaints that name file, line and key."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from robomend_client.agent.config import AgentConfig, load
from robomend_client.agent.main import main
from robomend_client.observers import Rate
from robomend_client.yaml_reader import ConfigError

ROOT = Path(__file__).parents[2]

WHOLE = """\
robot: tedusar
agent: onboard
host: pc
service: {url: "http://127.0.0.1:8080", key_file: key}
state_dir: state
bus: {listen: "tcp:127.0.0.1:0"}
report: {heartbeat_s: 1, lifetime_s: 5, buffer_mb: 1}
when_agent_ends: keep
rate: {window: 11, settle: 5, silence_s: 0.5, check_s: 0.1}
topics:
  /scan: {rate_hz: 20, tolerance_hz: 2}
  odom:
processes:
  laser:
    command: [laser, --device, /dev/ttyACM0]
    directory: work
    environment: {LANG: C, LEVEL: 3}
    ready: {output: "ready|up"}
    start_timeout_s: 4
    stop_grace_s: 0
    start: yes
"""


def loaded(tmp_path: Path, text: str) -> AgentConfig:
    (tmp_path / "key").write_text("s3cret\n")
    file = tmp_path / "agent.yaml"
    file.write_text(text)
    return load(file)


def test_every_key_arrives(tmp_path: Path) -> None:
    config = loaded(tmp_path, WHOLE)
    assert (config.robot, config.agent, config.host) == ("tedusar", "onboard", "pc")
    assert config.service.key() == "s3cret"
    assert "s3cret" not in repr(config)
    assert config.state_dir == tmp_path / "state"
    assert (config.bus, config.joins_bus, config.keep_processes) == ("tcp:127.0.0.1:0", False, True)
    assert (config.heartbeat_s, config.lifetime_s, config.buffer_bytes) == (1, 5, 1024 * 1024)
    demo = Rate(window=11, settle=5, silence_s=0.5, check_s=0.1)
    scan = Rate(20, 2, window=11, settle=5, silence_s=0.5, check_s=0.1)
    assert config.topics == (("scan", scan), ("odom", demo))
    (laser,) = config.processes
    assert laser.command == ("laser", "--device", "/dev/ttyACM0")
    assert laser.directory == tmp_path / "work"
    assert dict(laser.environment) == {"LANG": "C", "LEVEL": "3"}
    assert (laser.ready, laser.start, laser.stop_grace_s) == ("output", True, 0)


def test_little_is_needed_and_the_rest_has_its_published_default(tmp_path: Path) -> None:
    config = loaded(tmp_path, "robot: r\nservice: {url: http://127.0.0.1:1}\ntopics: {scan: }\n")
    assert config.topics == (("scan", Rate()),)
    assert config.processes == ()
    assert config.bus == f"unix:{config.state_dir}/bus"
    assert not config.keep_processes


def test_a_unit_s_state_folder_is_the_default_as_the_file_s_own_may_be_read_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = "robot: r\nservice: {url: 'http://h'}\n"
    assert loaded(tmp_path, short).state_dir == tmp_path / "robomend-agent-state"
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/robomend-agent:/var/lib/more")
    assert loaded(tmp_path, short).state_dir == Path("/var/lib/robomend-agent")
    assert loaded(tmp_path, f"{short}state_dir: mine\n").state_dir == tmp_path / "mine"


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("robot: tedusar", "robbot: tedusar", ":1: robbot: is no key here; did you mean robot?"),
        ("robot: tedusar", "robot: [a]", ":1: robot: must be one value"),
        ("robot: tedusar", "robot:", ":1: robot: has no value"),
        ("host: pc", "agent: pc", ":3: agent: is there twice"),
        ("http://", "ftp://", ":4: service.url: must start with http://"),
        ("http://127.0.0.1:8080", "http://127.0.0.1:x", ":4: service.url: must be like http://"),
        ("http://127.0.0.1:8080", "https://[::1", ":4: service.url: must be like http://"),
        ("key_file: key", "key_file: agent.yaml", ":4: service.key_file: holds no key"),
        ("state_dir: state", 'state_dir: "a\\0b"', ":5: state_dir: holds a NUL"),
        ("key_file: key", "key_file: none", ":4: service.key_file: cannot be read"),
        ("tcp:127.0.0.1:0", "127.0.0.1", ":6: bus.listen: '127.0.0.1' is no bus address"),
        ("lifetime_s: 5", "lifetime_s: 1.5", ":7: report.lifetime_s: must be at least twice"),
        ("lifetime_s: 5", "lifetime_s: soon", ":7: report.lifetime_s: must be a number"),
        ("lifetime_s: 5", "lifetime_s: .nan", ":7: report.lifetime_s: must be a number"),
        ("buffer_mb: 1}", "buffer_mb: 0}", ":7: report.buffer_mb: must be from 0.01"),
        ("when_agent_ends: keep", "when_agent_ends: pray", ":8: when_agent_ends: must be one of stop, keep"),
        ("host: pc", "starved: 2", ":3: starved: must be from 0.01 to 1"),
        ("settle: 5", "settle: 11", ":9: rate.settle: settle must be from 1 to window"),
        ("window: 11", "window: 2.5", ":9: rate.window: must be a whole number"),
        ("rate_hz: 20", "rate_hz: 1", ":11: topics./scan.silence_s: silence_s of 0.5 is no longer"),
        ("rate_hz: 20", "hz: 20", ":11: topics./scan.hz: is no key here"),
        ("[laser, --device, /dev/ttyACM0]", "laser --device", ":15: processes.laser.command: must be a list"),
        ("ready|up", "(", ":18: processes.laser.ready.output: is no regular expression"),
        (
            'ready: {output: "ready|up"}',
            "ready: never",
            ":18: processes.laser.ready: must be one of exec, notify or {output: REGEX}, not 'never'",
        ),
        ("start: yes", "start: maybe", ":21: processes.laser.start: must be true or false"),
        ("topics:", "topics: [", "not YAML"),
        ("  odom:", "  # é🤖\n  odom\a:", ":13: not YAML: character #x07 is not allowed"),
        ("processes:", "processes: 3\nx:", ":13: processes: must be a mapping"),
    ],
)
def test_each_mistake_is_named_with_its_place(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    assert old in WHOLE
    with pytest.raises(ConfigError) as raised:
        loaded(tmp_path, WHOLE.replace(old, new, 1))
    assert complaint in str(raised.value)
    assert str(raised.value).startswith(str(tmp_path / "agent.yaml"))


def test_a_file_that_is_no_text_is_named_with_the_line(tmp_path: Path) -> None:
    (tmp_path / "agent.yaml").write_bytes(b"robot: r\nhost: \xe9\n")
    with pytest.raises(ConfigError, match=r"agent.yaml:2: not YAML: the file is not UTF-8 text"):
        load(tmp_path / "agent.yaml")


@pytest.mark.parametrize(
    ("example", "what"), [("tedusar.yaml", "a model"), ("robot.yaml", "a robot's configuration")]
)
def test_check_of_another_kind_of_file_says_which_it_is_and_which_is_wanted(
    example: str, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = ROOT / "examples" / example
    assert main(["--check", str(file)]) == 2
    said = capsys.readouterr().err
    assert re.match(rf"{file}:\d+: this is {what}; an agent's file is wanted, with `robot: ID`", said)


def test_check_says_what_a_configuration_means(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    beside = 'observers:\n  scan: {kind: property, source: "scan:range", low: 1}\n'
    loaded(tmp_path, WHOLE + beside)
    assert main([str(tmp_path / "agent.yaml"), "--check"]) == 3
    said, amiss = capsys.readouterr()
    assert f"processes.laser.command: directory {tmp_path / 'work'} is not there" in amiss
    assert "topic scan: 20 ± 2 Hz" in said
    assert "observer scan (property): ok(scan)" in said  # another one than the topic's
    assert "process laser: laser --device /dev/ttyACM0" in said


ASKED = """
actions:
  clear: {kind: ros2_service, services: {planner: /planner/clear}, type: std_srvs/srv/Empty}
  set_fps: {kind: ros2_parameter, nodes: {camera: /camera}, parameter: fps, values: {low: 5}, back: before}
  bring_up: {kind: lifecycle, nodes: {camera: /camera}, transition: restart}
  switch: {kind: controllers, managers: {arm: /manager}, activate: [slow], deactivate: [fast]}
  set_mode: {kind: mode, nodes: {base: /base}, modes: [SLOW]}
  restart: {kind: component, nodes: {cam: /cam}, container: /box, package: p, plugin: "p::Cam"}
"""


def test_check_says_what_actions_would_send_and_sends_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOMEND_RCLPY_PYTHON", "/nowhere")  # nothing can be sent
    loaded(tmp_path, "robot: r\nservice: {url: 'http://localhost'}\n" + ASKED)
    assert main([str(tmp_path / "agent.yaml"), "--check"]) == 0
    said = capsys.readouterr().out
    for line in (
        "action clear:planner",
        "  clear(planner): the service /planner/clear (std_srvs/srv/Empty) is called with {}",
        "  set_fps(camera, low): the parameter fps of /camera is set to 5",
        "  set_fps(camera, before): fps of /camera: it was not changed by this agent",
        "  bring_up(camera): /camera is brought up again",
        "  switch(arm): /manager activates slow and deactivates fast",
        "  set_mode(base, SLOW): /base is asked for mode SLOW",
        "  restart(cam): /box is asked to restart /cam",
    ):
        assert f"{line}\n" in said + "\n"


def test_check_looks_for_the_programs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    there, not_executable = tmp_path / "there", tmp_path / "text"
    for file in (there, not_executable):
        file.write_text("#!/bin/sh\n")
    there.chmod(0o755)

    def checked(processes: str, actions: str = "") -> tuple[int, str]:
        text = f"robot: r\nservice: {{url: 'http://127.0.0.1:1'}}\nprocesses: {{{processes}}}\n"
        (tmp_path / "agent.yaml").write_text(f"{text}actions: {{{actions}}}\n")
        return main([str(tmp_path / "agent.yaml"), "--check"]), capsys.readouterr().err

    assert checked(f"a: {{command: [{there}]}}, b: {{command: [./there], directory: .}}") == (0, "")
    assert checked("a: {command: [sh, -c, x]}", f"go: {{kind: process, command: [{there}]}}") == (0, "")
    for processes, actions, why in (
        (f"a: {{command: [{not_executable}]}}", "", f"processes.a.command: {not_executable} may not be exec"),
        ("a: {command: [/no/such]}", "", "processes.a.command: there is no file /no/such"),
        ("a: {command: [sh], directory: none}", "", f"processes.a.command: directory {tmp_path / 'none'} is"),
        ("", "go: {kind: process, command: [no-such]}", "actions.go.command: no program 'no-such' is in"),
    ):
        code, said = checked(processes, actions)
        assert code == 3
        assert f"{tmp_path / 'agent.yaml'}: {why}" in said
