"""The whole loop on a robot in memory: from a fault to a verified repair, or to a person told why."""

from __future__ import annotations

import asyncio
from functools import partial
from pathlib import Path

import pytest
from tests.repairs.robot import SHUT_DOWN, Robot, answers, repaired, robot_of, running, service, the_repair

from robomend.store import attempts, audit

pytestmark = pytest.mark.anyio


async def test_a_device_that_lost_power_is_repaired_in_one_plan_and_the_audit_log_says_why(
    tmp_path: Path,
) -> None:
    async with robot_of(tmp_path) as (runtime, robot):
        robot.cut("base")
        repair = await the_repair(runtime)
        page = await runtime.store.read(audit.page, robot="r1")
    assert repair["state"] == "repaired"
    assert repair["diagnosis"]["bad"] == ["base"]
    assert [step["state"] for step in repair["plan"]] == ["done"] * 3
    assert robot.done == SHUT_DOWN
    assert len(repair["rounds"]) == 1
    sent = [entry for entry in page.items if entry.action == "action.sent"]
    assert [entry.subject for entry in reversed(sent)] == SHUT_DOWN
    assert all("base should be on" in entry.reason for entry in sent)


@pytest.mark.parametrize(
    ("needs", "state", "reason"),
    [
        (
            "pose, image",
            "unconfirmed",
            "not confirmed: not ok(map), not ok(pose): still seen, and blamed on nobody only as topics wait "
            "for each other, in a circle that was never seen up",
        ),
        (
            "pose, image, start",  # nobody knows whether it was given
            "repaired",
            "no component is blamed any more; "
            "not ok(map), not ok(pose): still seen, and the model blames nobody for it",
        ),
    ],
)
async def test_silence_that_the_model_blames_nobody_for_is_told_at_the_end(
    tmp_path: Path, needs: str, state: str, reason: str
) -> None:
    model = f"""
    robomend: 1
    nodes:
      camera: {{publishes: {{image: []}}}}
      slam: {{publishes: {{map: [{needs}]}}}}
      localizer: {{publishes: {{pose: [map]}}}}
    topics: {{start: {{}}}}
    """

    class Circular(Robot):
        def facts(self) -> dict[str, bool]:
            facts = {f"running({node})": runs for node, runs in self.running.items()}
            return facts | {"ok(image)": self.running["camera"], "ok(map)": False, "ok(pose)": False}

        def do(self, name: str, parameter: str) -> None:
            self.running[parameter] = name == "start_node"

    kind = partial(Circular, running={"camera": False, "slam": True, "localizer": True})
    async with robot_of(tmp_path, kind, model) as (runtime, _):
        repair = await the_repair(runtime)
    assert (repair["state"], repair["reason"]) == (state, reason)


async def test_the_paper_s_domain_needs_two_rounds_and_never_cycles_power(tmp_path: Path) -> None:
    paper = (Path(__file__).parents[2] / "pddl" / "paper-repair.pddl").read_text()
    repair, robot = await repaired(tmp_path, lambda robot: robot.cut("base"), domain=paper)
    assert repair["state"] == "repaired"
    assert [one["diagnosis"]["bad"] for one in repair["rounds"]] == [["base"], ["base_node"]]
    assert robot.done == SHUT_DOWN


async def test_repairs_of_a_planted_fault_that_keep_failing_set_nothing_aside(tmp_path: Path) -> None:
    async with robot_of(tmp_path) as (runtime, robot):
        robot.spoil = answers(0, "start_node")
        bounds = {"bound_s": 60.0, "detect_s": 30.0}
        drill = await runtime.drills.create(
            "r1", fault="node-killed", component="mapping", topic=None, **bounds, by="ann", reason=""
        )
        repair = await the_repair(runtime)
        async with asyncio.timeout(60):
            while (ended := await runtime.drills.drill(drill["id"]))["finished_ns"] is None:
                await asyncio.sleep(0.05)
        quarantined = await runtime.repairs.quarantined("r1")
        remembered = await runtime.store.read(attempts.tried, "r1")
    assert (repair["drill"], repair["state"]) == (drill["id"], "escalated"), ended
    assert robot.done.count("start_node(mapping)") >= 3
    assert (ended["state"], ended["undone"]) == ("done", True)
    assert (quarantined, remembered) == ({}, ())


async def test_a_stuck_relay_ends_with_a_person_told_the_cause_whose_release_counts_across_a_restart(
    tmp_path: Path,
) -> None:
    async with robot_of(tmp_path) as (runtime, robot):
        robot.spoil = answers(0, "power_up")
        robot.cut("base")
        first = await the_repair(runtime)
        assert first["state"] == "escalated"
        assert first["reason"] == (
            "power_up(base) answered 'done', but on(base) was not seen within 1 s (3 times); "
            "no known repair: base left alone for a while, as its repairs keep failing or do not last"
        )
        assert list(await runtime.repairs.quarantined("r1")) == ["base"]
        assert robot.done == ["power_up(base)"] * 3
        await runtime.repairs.stop(by="ann", reason="the relay is being replaced")
        await runtime.repairs.release("r1", "base", by="ann", reason="relay replaced")
        await asyncio.sleep(0.2)  # the release has reached the loop
    async with (
        service(tmp_path) as runtime,
        running(Robot(runtime.repairs, runtime.robots, on=robot.on, connected=robot.connected)) as robot,
    ):
        await robot.settled()
        await runtime.repairs.resume(by="ann", reason="done")
        second = await the_repair(runtime, after=first["id"])
    assert second["state"] == "repaired"


async def test_a_node_that_dies_at_its_start_is_escalated_by_name(tmp_path: Path) -> None:
    dies = answers(1, "start_node")
    repair, _ = await repaired(tmp_path, lambda robot: robot.running.update(mapping=False), spoil=dies)
    assert repair["state"] == "escalated"
    assert repair["reason"] == (
        "start_node(mapping) failed (2 times); no known repair: mapping: start_node(mapping) is refused: "
        "it was done 3 times in this repair, and nothing else was observed since"
    )


async def test_a_node_that_runs_and_soon_dies_again_is_not_restarted_for_ever(tmp_path: Path) -> None:
    async def dies_soon(robot: Robot, name: str, parameter: str) -> int | None:
        if (name, parameter) == ("start_node", "mapping"):
            asyncio.get_running_loop().call_later(1.0, robot.running.__setitem__, "mapping", False)
        return None

    limits = {"attempts_per_hour": 6, "rounds": 6}
    async with robot_of(tmp_path, limits=limits) as (runtime, robot):
        robot.spoil = dies_soon
        robot.running["mapping"] = False
        async with asyncio.timeout(100):
            while (repair := await the_repair(runtime))["state"] != "escalated":
                assert len(robot.done) <= 4
                await asyncio.sleep(0.1)
        aside = await runtime.repairs.quarantined("r1")
    assert set(robot.done) == {"start_node(mapping)"}
    assert len(robot.done) in (3, 4)  # on a busy computer a start may seem to have lasted
    assert repair["reason"].startswith(
        "it comes and goes: 3 repairs in a row helped, and each time it was broken again within "
    )
    assert (
        "; repaired: mapping (3 times); suspects: mapping. Nothing is begun for them before "
        in repair["reason"]
    )
    assert repair["rounds"] == []
    assert aside["mapping"].reason == "mapping: 3 repairs in a row helped, and soon it came back"


async def test_observers_that_fall_silent_under_way_are_named_and_not_the_component(tmp_path: Path) -> None:
    async def silences(robot: Robot, name: str, parameter: str) -> int | None:
        robot.silent = True
        await asyncio.sleep(1.0)  # what was on its way has arrived
        return None

    async with robot_of(tmp_path, observed_timeout_s=2.0) as (runtime, robot):
        robot.spoil = silences
        robot.cut("base")
        repair = await the_repair(runtime)
        quarantined = await runtime.repairs.quarantined("r1")
        tried = await runtime.store.read(attempts.tried, "r1")
    assert repair["state"] == "escalated"
    assert repair["reason"] == (
        "power_up(base) answered 'done', but on(base) was not seen within 1 s, and nobody reported on(base) "
        "since: look whether the observers still work"
    )
    assert [one["ending"] for one in repair["rounds"]] == ["stale"]
    assert robot.done == ["power_up(base)"]
    assert (quarantined, tried) == ({}, ())


async def test_a_fault_of_our_own_ends_the_repair_and_not_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with robot_of(tmp_path) as (runtime, robot):
        with monkeypatch.context() as broken:
            broken.setattr("robomend.repairs.live_repair.Prediction", lambda *_: 1 / 0)
            robot.cut("base")
            first = await the_repair(runtime)
        robot.running["mapping"] = False  # the diagnosis changes: another repair
        second = await the_repair(runtime, after=first["id"])
    assert first["state"] == "failed"
    assert first["reason"] == "an error in robomend: ZeroDivisionError: division by zero; suspected: base"
    assert second["state"] == "repaired"
