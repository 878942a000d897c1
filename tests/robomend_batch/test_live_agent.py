"""A running agent that hears topics on its bus and the board through the service, and the batch of what it
recorded: the same literals.
"""

from __future__ import annotations

import json
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

from tests.clients.service_double import ServiceDouble, eventually, service_double
from tests.clients.talker import watching
from tests.robomend_batch.running import batch_run, intervals

MODEL = """
robomend: 1
name: rover
nodes: {laser: {publishes: {scan: []}}, camera: {publishes: {image: []}}}
hardware: {motor: {}, jaguar: {channel: 0}}
properties: {temperature: {}, jaguar_draws: {}, pack: {}}
rules: ["not ab(motor) -> ok(temperature)", "not ab(jaguar) -> ok(jaguar_draws) and ok(pack)"]
"""

SECTIONS: dict[str, Any] = {
    "starved": False,  # what is slow is said on a busy computer as well
    "topics": {"scan": {}, "image": {"rate_hz": 30, "tolerance_hz": 3, "silence_s": 2}},
    "observers": {
        "temperature": {"kind": "property", "source": "motor:temperature", "high": 60},
        "jaguar_draws": {"kind": "property", "from": "board", "source": "board:current(jaguar)", "high": 3},
        "pack": {"kind": "property", "from": "board", "source": "board:voltage(0)", "low": 20},
    },
    "board": {"rate_hz": 20},
}


def told(service: ServiceDouble) -> list[tuple[int, str]]:
    """Return the changes that the service was told, and when; heartbeats say the same again."""
    said: list[tuple[int, str]] = []
    held: dict[str, str] = {}
    for batch in service.batches():
        for text in batch["observations"]:
            atom = text.removeprefix("not ")
            if held.get(atom) != text:
                held[atom] = text
                said.append((batch["time"], text))
    return said


def shown(out: Path) -> list[tuple[int, str, Any, list[str]]]:
    """Return the beginnings of intervals in which something is known, and what is told of them."""
    found = [
        (one["start_ns"], one["state"], one["bad"], sorted(one["observations"])) for one in intervals(out)
    ]
    return [one for one in found if one[3]]


def test_what_an_agent_said_of_its_bus_is_what_its_recording_says(tmp_path: Path) -> None:
    """A topic falls silent and comes back, one is too slow all the while, values are wrong for a while."""
    measures = {"current_a": 1.5, "voltage_v": 24.0}

    def answers(method: str, path: str) -> tuple[int, Any] | None:
        if not path.endswith("/board"):
            return None
        channel = {"channel": 0, "component": "jaguar", "on": True, **measures}
        return 200, {"state": "running", "time_ns": time.time_ns(), "channels": [channel]}

    model = tmp_path / "rover.yaml"
    model.write_text(MODEL)
    recording = tmp_path / "run.jsonl"
    sections = SECTIONS | {"recording": {"file": str(recording), "mb": 1}}
    with service_double() as service:
        service.answers = answers
        with watching(tmp_path, service.url, **sections) as (_, talker):

            def comes(text: str, after_ns: int = 0) -> None:
                eventually(lambda: any(at > after_ns and one == text for at, one in told(service)), text)

            talker.say("scan")
            talker.say("image")  # at 10 Hz, where 30 are wanted
            talker.say("motor", data={"temperature": 40.0})
            for text in ("ok(scan)", "not ok(image)", "ok(temperature)", "ok(jaguar_draws)", "ok(pack)"):
                comes(text)
            silent_ns = talker.hush("scan")
            comes("not ok(scan)", silent_ns)
            again_ns = time.time_ns()
            talker.say("scan")
            comes("ok(scan)", again_ns)
            talker.say("motor", data={"temperature": 70.0})
            comes("not ok(temperature)")
            cool_ns = time.time_ns()
            talker.say("motor", data={"temperature": 40.0})
            comes("ok(temperature)", cool_ns)
            measures["current_a"] = 5.0
            comes("not ok(jaguar_draws)")
            right_ns = time.time_ns()
            measures |= {"current_a": 1.5, "voltage_v": 12.0}
            comes("not ok(pack)")
            comes("ok(jaguar_draws)", right_ns)
        said = told(service)
    assert all(before <= after for (before, _), (after, _) in pairwise(said))
    live = tmp_path / "live.ndjson"
    live.write_text("".join(json.dumps({"time": at, "literal": text}) + "\n" for at, text in said))
    assert batch_run(tmp_path / "out", recording, "--observers", tmp_path / "agent.yaml", model=model) == 0
    assert batch_run(tmp_path / "live", live, model=model) == 0
    found = shown(tmp_path / "out")
    assert found == shown(tmp_path / "live")
    assert {text for *_, seen in found for text in seen} >= {
        "not ok(scan)",
        "not ok(image)",
        "not ok(temperature)",
        "not ok(jaguar_draws)",
        "not ok(pack)",
    }
