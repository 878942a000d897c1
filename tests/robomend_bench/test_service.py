"""The load generator: what it counts is right, and it notices what goes wrong."""

from __future__ import annotations

import asyncio
import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.terminal import Terminal
from tests.waiting import until

from robomend_bench.service import command as bench
from robomend_bench.service import load, stops
from robomend_bench.service.command import command
from robomend_bench.service.load import SimulatedRobot, prepare, run_fleet
from robomend_bench.service.process import Served, served
from robomend_bench.service.stops import ASKED_OF, WAYS


@pytest.fixture(autouse=True)
def _without_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures need services that have warmed up; that there are figures does not."""
    monkeypatch.setattr(bench, "WARM_UP_S", 0.0)
    monkeypatch.setattr(stops, "WITHIN_S", 1.0)


@pytest.fixture(scope="module")
def service() -> Iterator[Served]:
    with served() as running:
        yield running


def test_a_run_accounts_for_every_change(service: Served) -> None:
    """Of new robots, and of those of a run before."""

    async def run() -> None:
        for seed in (2, 1):
            robots = [SimulatedRobot(f"a{number}", seed, faults=3) for number in range(5)]
            await prepare(service.url, robots)
            result = await run_fleet(service.url, robots, rate_hz=10, seconds=1, seed=seed)
            assert result["due"] == result["acknowledged"]["count"] == result["diagnosed"]["count"] == 50
            assert (result["errors"], result["lost"], result["undiagnosed"]) == ({}, [], 0)

    asyncio.run(run())


def test_what_the_service_does_not_know_is_reported_as_lost(
    service: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(load, "LEFT_S", 0.5)  # the diagnosis of what it never got does not come

    async def run() -> list[str]:
        robots = [SimulatedRobot(f"b{number}", 1, faults=3) for number in range(2)]
        await prepare(service.url, robots)
        robots[0].kept += 1  # a change that the service has not kept
        robots[1].known["ok(map)"] = True
        result = await run_fleet(service.url, robots, rate_hz=1, seconds=1, seed=1)
        return list(result["lost"])

    lost = asyncio.run(run())
    assert [line.split(":")[0] for line in lost] == ["b0", "b1"]


class SometimesRefused(SimulatedRobot):
    """Each fourth change goes where there is no robot."""

    def change(self) -> list[str]:
        said = super().change()
        name = self.name if self.revision % 4 else "nobody"
        self.path = f"/api/v1/robots/{name}/observations"
        return said


def test_what_was_refused_is_counted_and_not_called_lost(service: Served) -> None:
    async def run() -> None:
        robots: list[SimulatedRobot] = [SometimesRefused(f"d{number}", 1, faults=3) for number in range(3)]
        await prepare(service.url, robots)
        result = await run_fleet(service.url, robots, rate_hz=20, seconds=1, seed=1)
        assert result["errors"] == {"404": 15}
        assert (result["lost"], result["undiagnosed"]) == ([], 0)
        assert result["acknowledged"]["count"] == 45
        assert 0 < result["diagnosed"]["count"] <= 45  # after a refusal its opposite is no news

    asyncio.run(run())


def test_what_ends_the_measurement_with_1_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"errors": {"503": 2}, "lost": ["r1: revision 3, sent 4"]}
    monkeypatch.setattr("robomend_bench.service.command.measure", lambda *_: found)
    ended = CliRunner().invoke(command, ["--only", "fleet"])
    assert ended.exit_code == 1
    assert ended.stderr.splitlines()[1:] == ["fleet: errors: 503 2, lost: r1: revision 3, sent 4"]


def test_latency_counts_from_when_a_change_was_due(service: Served) -> None:
    """A robot whose connection is busy for a while has late changes, not fewer."""

    class HeldUp(SimulatedRobot):
        """The generator itself is held up."""

        def change(self) -> list[str]:
            if self.revision == 5:
                time.sleep(0.5)
            return super().change()

    async def run() -> None:
        robots: list[SimulatedRobot] = [HeldUp("c0", 1, faults=3)]
        await prepare(service.url, robots)
        result = await run_fleet(service.url, robots, rate_hz=20, seconds=1, seed=1)
        assert result["acknowledged"]["count"] == 20
        assert result["sent_late"]["max_ms"] > 250
        assert result["acknowledged"]["max_ms"] > 250

    asyncio.run(run())


def test_the_stop_is_measured_while_every_role_attacks() -> None:
    small = ["--seconds", "1", "--attackers", "2"]
    answer = CliRunner().invoke(command, ["--only", "stop-under-attack", "--format", "json", *small])
    assert answer.exit_code == 0, answer.output
    found = json.loads(answer.stdout)["stop-under-attack"]
    assert found["attacked"]["POST /stop"]["count"] > 0
    assert found["worst_ms"] == max(latency["max_ms"] for latency in found["attacked"].values())
    assert found["answers"]


SMALL = ("--robots", "5", "--seconds", "1", "--changes", "10", "--writers", "4", "--observations", "2000")


@pytest.mark.parametrize("parts", ["start,memory", "posts,ndjson"])
def test_parts_give_their_figures_each_of_a_service_of_its_own(parts: str) -> None:
    answer = CliRunner().invoke(command, ["--only", parts, "--format", "json", *SMALL])
    assert answer.exit_code == 0, answer.output
    assert set(json.loads(answer.stdout)) == set(parts.split(","))


def test_an_operator_beside_an_overload_is_a_process_of_its_own(service: Served) -> None:
    """In the generator's, the figures would also tell how busy that one is."""
    answer = CliRunner().invoke(
        command, ["--only", "overload", "--format", "json", "--url", service.url, *SMALL]
    )
    assert answer.exit_code == 0, answer.output
    asked = json.loads(answer.stdout)["overload"]["operator"]
    assert {name.partition(",")[0] for name in asked} >= {"GET /healthz", "GET /readyz"}
    assert all(took["p50_ms"] > 0 for took in asked.values())


def test_the_part_that_stops_real_repairs_gives_its_figures() -> None:
    """How fast depends on the machine; that each repair ends and no program outlives it does not."""
    small = ["--robots", "2", "--moments", "1"]
    answer = CliRunner().invoke(command, ["--only", "stop", "--format", "json", *small])
    assert answer.exit_code == 0, answer.output
    found = json.loads(answer.stdout)["stop"]
    assert found.pop("errors") == []
    assert list(found) == [f"{way}, asked of {whom}" for whom in ASKED_OF for way in WAYS]


def test_a_stop_is_measured_on_services_of_its_own() -> None:
    answer = CliRunner().invoke(command, ["--only", "stop", "--url", "http://127.0.0.1:1"])
    assert answer.exit_code == 2
    assert "of its own" in answer.output


def test_ctrl_c_while_repairs_act_leaves_no_program_board_or_file(tmp_path: Path) -> None:
    where = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    with Terminal("robomend-bench service --only stop --robots 2 --moments 400", tmp_path, where) as begun:
        until(lambda: has_acted(begun), "a program of an action has begun", 120)
        begun.ends_by_ctrl_c()


def has_acted(begun: Terminal) -> bool:
    """Return whether a program that takes its time has begun to start a node: by now others follow it."""
    logs = begun.temporary.glob("robomend-bench-*/start.log")
    return any("stubborn" in log.read_text() for log in logs)
