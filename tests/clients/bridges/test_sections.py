"""The sections of the bridges in the agent's file: mistakes are named, and the manual's examples are read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import agent, config
from tests.clients.service_double import eventually

from robomend_client.agent.config import load
from robomend_client.agent.feeds import EXTRAS, NEEDS
from robomend_client.agent.main import main
from robomend_client.yaml_reader import ConfigError

DOCS = Path(__file__).parents[3] / "docs"
PAGES = {"ros1": "ros.md", "ros2": "ros2.md", "zenoh": "zenoh.md", "medkit": "medkit.md"}
NAME = "name: must be of letters, digits, _ and /, not 'a b'"


@pytest.mark.parametrize(
    ("origin", "section", "complaint"),
    [
        ("ros1", {"master": "11311"}, "master: '11311' is no address; it should be like http://HOST:PORT/"),
        ("ros1", {"name": "a b"}, NAME),
        ("ros1", {"ping_s": 0}, "ping_s: must be from 0.05 to 60, not 0"),
        ("ros2", {"domain": 233}, "domain: must be from 0 to 232, not 233"),
        ("ros2", {"domain": 1.5}, "domain: must be a whole number, not 1.5"),
        ("ros2", {"discovery": "world"}, "discovery: must be"),
        ("ros2", {"publish": ["x"]}, "publish: must be of observations, diagnosis, diagnostics, not"),
        ("zenoh", {"connect": "tcp/here:1"}, "connect: must be a list"),
        ("medkit", {"url": "ftp://x"}, "url: must be like http://"),
        ("board", {"rate_hz": 0}, "rate_hz: must be from 0.1 to 20, not 0"),
    ],
)  # fmt: skip
def test_a_bad_section_ends_the_agent_with_2_and_names_file_line_and_key(
    origin: str, section: dict[str, Any], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lamp = {"kind": "property", "from": "board", "source": "board:current(lamp)", "high": 1}
    observers = {"lamp": lamp} if origin == "board" else {}
    file = config(tmp_path, "http://127.0.0.1:1", {}, observers=observers, **{origin: section})
    assert main([str(file)]) == 2
    assert f"{file}:1: {origin}.{complaint}" in capsys.readouterr().err


@pytest.mark.parametrize("origin", EXTRAS)
def test_without_the_extra_the_agent_ends_with_3_and_the_command(
    origin: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(NEEDS, origin, (*NEEDS[origin], "no_module_that_anybody_has"))
    file = config(tmp_path, "http://127.0.0.1:1", {}, **{origin: {}})
    assert main([str(file)]) == 3
    told = capsys.readouterr().err
    assert f"{origin} needs what is installed with: pip install 'robomend-client[{origin}]'" in told


@pytest.mark.parametrize("origin", PAGES)
def test_the_manual_s_example_is_read_and_an_unknown_key_refused(origin: str, tmp_path: Path) -> None:
    manual = (DOCS / PAGES[origin]).read_text()
    file = tmp_path / "agent.yaml"
    example = manual.partition("\n    robot: ")[2].partition("\n\n")[0]
    file.write_text("robot: " + example.replace("\n    ", "\n") + "\n")
    assert {spec.origin for spec in load(file).observers} == {origin}
    file.write_text(file.read_text().replace(f"\n{origin}:\n", f"\n{origin}:\n  nonsense: 1\n"))
    with pytest.raises(ConfigError, match=rf"{origin}\.nonsense: .*known are "):
        load(file)


def test_a_network_that_cannot_be_entered_is_told_once_and_the_agent_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    no_such = "<General><Interfaces><NetworkInterface name='no_such0'/></Interfaces></General>"
    monkeypatch.setenv("CYCLONEDDS_URI", f"<CycloneDDS><Domain id='any'>{no_such}</Domain></CycloneDDS>")
    sections: dict[str, Any] = {"ros2": {"discovery": "subnet"}, "zenoh": {"connect": ["nonsense"]}}
    log = tmp_path / "agent.log"
    told = ("ROS 2, DDS: domain 0 cannot be entered", "zenoh, the session: cannot be opened")
    with agent(config(tmp_path, "http://127.0.0.1:1", {}, **sections)) as process:
        eventually(lambda: all(one in log.read_text() for one in told), "both complaints", 60)
        assert process.poll() is None
    assert [log.read_text().count(one) for one in told] == [1, 1]
