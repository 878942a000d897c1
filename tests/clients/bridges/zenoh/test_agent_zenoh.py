"""The section `zenoh:` of the agent's file."""

from __future__ import annotations

from pathlib import Path

from tests.clients.running_agent import agent, config
from tests.clients.service_double import eventually


def test_an_address_that_is_none_is_told_and_the_agent_goes_on(tmp_path: Path) -> None:
    with agent(config(tmp_path, "http://127.0.0.1:1", {}, zenoh={"connect": ["nonsense"]})) as process:
        log = tmp_path / "agent.log"
        eventually(lambda: "zenoh, the session: cannot be opened" in log.read_text(), "a complaint", 60)
        assert process.poll() is None
    assert log.read_text().count("cannot be opened") == 1
