"""The sentence that people are told of a robot: what, since when, what follows, what next, who is needed."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.repairs.robot import Robot, robot_of, the_repair

from robomend.model.loading import load_text
from robomend.planning.plan import action_title, action_titles, in_prose, power_note
from robomend.repairs.headline import Facts, Fallback, Headline, headline, of_repair, of_robot
from robomend.repairs.states import RepairState
from robomend.robots.health import HealthState

NOW = int(datetime(2026, 11, 27, 23, 30, tzinfo=UTC).timestamp()) * 10**9
AT = int(datetime(2026, 11, 27, 23, 23, 4, tzinfo=UTC).timestamp()) * 10**9
ILL = HealthState.UNHEALTHY


def symptom(literal: str, *blames: str, text: str = "", way: str = "", at: int = AT) -> dict[str, Any]:
    found: dict[str, Any] = {"literal": literal, "since_ns": at, "onset_ns": at, "blames": list(blames)}
    if text:
        found["reading"] = {"text": text} | ({"symptom": way} if way else {})
    return found


def step(name: str, *parameters: str, state: str = "waiting") -> dict[str, Any]:
    return {"name": name, "parameters": list(parameters), "state": state}


def repair(state: RepairState, *plan: dict[str, Any], **more: Any) -> dict[str, Any]:
    ended = state in {"repaired", "unconfirmed", "escalated", "cancelled", "failed"}
    return {
        "id": "r-1",
        "state": state,
        "plan": list(plan),
        "rounds": [],
        "reason": "",
        "waiting_for": [],
        "probe": None,
        "created_ns": AT,
        "finished_ns": AT if ended else None,
        **more,
    }


def said(**of: Any) -> tuple[str, str]:
    found = headline(Facts(**{"health": ILL, **of}))
    whole = found.text(NOW)
    what = Headline(found.what, ()).text(NOW)
    return what, whole.removeprefix(what).strip()


NO_POWER = [symptom("not on(hokuyo)", "hokuyo"), *(symptom(f"not ok({one})") for one in ("scan", "map"))]
MAP = symptom("not ok(map)", "hokuyo", "hector", text="0 of 2 Hz for 3.1 s", way="silent")


MEDIUM = Fallback("altitude", "medium", AT, "visibility fell to 2.9, at least 3.25")
BY_MEDIUM = "altitude works by medium since 23:23:04, as visibility fell to 2.9, at least 3.25"


@pytest.mark.parametrize(
    ("facts", "what"),
    [
        ({"health": HealthState.HEALTHY, "since_ns": AT}, f"Healthy since 23:23:04; {BY_MEDIUM}."),
        (
            {"health": HealthState.DEGRADED, "blamed": [(("lamp",), None)], "since_ns": AT},
            f"something is wrong since 23:23:04, because of lamp; the robot works without it; {BY_MEDIUM}.",
        ),
    ],
)
def test_a_function_that_falls_back_is_told_with_its_variant_since_when_and_why(
    facts: dict[str, Any], what: str
) -> None:
    assert said(**facts, functions=[MEDIUM])[0] == what


def test_what_follows_is_told_before_how_the_functions_work() -> None:
    what, _ = said(blamed=[(("hokuyo",), None)], symptoms=NO_POWER, functions=[MEDIUM])
    assert what.endswith(f"; scan and map follow; {BY_MEDIUM}.")


def test_of_many_functions_the_number_is_told_and_of_one_that_has_nothing_left_why() -> None:
    none = Fallback("motion", None, None, "thruster_1 is blamed")
    what, _ = said(
        health=HealthState.HEALTHY, functions=[none, *[MEDIUM._replace(since_ns=None, why="")] * 4]
    )
    begin = "Healthy; motion has no variant left, as thruster_1 is blamed; altitude works by medium; "
    assert what == begin + "altitude works by medium; and 2 more functions not by the best variant."


def test_a_function_whose_active_variant_cannot_do_it_or_may_not_is_not_called_working() -> None:
    broken = MEDIUM._replace(since_ns=None, why="camera is blamed", works=False)
    doubtful = MEDIUM._replace(doubt="nobody reports visibility")
    what, _ = said(health=HealthState.HEALTHY, functions=[broken, doubtful])
    begin = f"Healthy; altitude cannot work by medium, as camera is blamed; {BY_MEDIUM}; "
    assert what == begin + "whether it still does is unknown, as nobody reports visibility."


def test_what_was_seen_of_a_component_itself_is_told_as_it_is_with_what_follows() -> None:
    what, then = said(
        blamed=[(("hokuyo",), 1.0)],
        symptoms=NO_POWER,
        repair=repair(
            RepairState.AWAITING_APPROVAL,
            step("power_up", "hokuyo"),
            step("stop_node", "hokuyo_node"),
            step("start_node", "hokuyo_node"),
        ),
    )
    assert what == "hokuyo has no power since 23:23:04; scan and map follow."
    assert then == "Power up hokuyo and restart hokuyo_node?"


def test_one_that_follows_and_many_that_follow_are_counted() -> None:
    assert said(blamed=[(("hokuyo",), 1.0)], symptoms=NO_POWER[:2])[0].endswith("23:23:04; scan follows.")
    many = [*NO_POWER, symptom("not ok(pose)"), symptom("not ok(plan)")]
    assert said(blamed=[(("hokuyo",), 1.0)], symptoms=many)[0].endswith("; scan and 3 more follow.")
    assert said(blamed=[(("hokuyo",), 1.0)], symptoms=NO_POWER[:1])[0].endswith("since 23:23:04.")


@pytest.mark.parametrize(
    ("blamed", "believed"),
    [
        ([(("hokuyo",), None)], ", because of hokuyo."),
        ([(("hokuyo",), 0.95), (("hector",), 0.05)], ", almost certainly because of hokuyo."),
        ([(("hokuyo",), 0.7), (("hector",), 0.3)], ", probably because of hokuyo."),
        ([(("hokuyo",), 0.5), (("hector",), 0.5)], ", because of one of two: hokuyo or hector."),
        ([((one,), None) for one in "abc"], ", because of one of three: a, b or c."),
        ([((one,), None) for one in "abcdef"], ", because of one of six: a, b or another."),
        ([(("hokuyo",), 0.3), (("a", "b"), 0.7)], ", perhaps because of hokuyo."),
    ],
)
def test_belief_is_told_in_words(blamed: Any, believed: str) -> None:
    what, _ = said(blamed=blamed, symptoms=[MAP | {"blames": sorted({c for bad, _ in blamed for c in bad})}])
    assert what == f"map is silent since 23:23:04 (0 of 2 Hz for 3.1 s){believed}"


def test_two_independent_faults_are_two_with_a_time_each() -> None:
    what, _ = said(
        blamed=[(("hokuyo", "imu_node"), 0.5), (("imu_node", "laser"), 0.5)],
        symptoms=[
            symptom("not ok(scan)", "hokuyo", "laser"),
            symptom("not running(imu_node)", "imu_node", text="exit code 1: no /dev/imu", at=AT + 66 * 10**9),
            symptom("not ok(imu)"),
        ],
    )
    assert what == (
        "Two faults: scan is not as it should be since 23:23:04, because of one of two: hokuyo or laser; "
        "imu_node is not running since 23:24:10 (exit code 1: no /dev/imu); imu follows."
    )


@pytest.mark.parametrize(
    ("of", "then"),
    [
        (repair(RepairState.PLANNING), "A repair is being planned."),
        (
            repair(
                RepairState.RUNNING,
                step("power_up", "hokuyo", state="done"),
                step("start_node", "n", state="running"),
            ),
            "Under way: start n (step 2 of 2).",
        ),
        (
            repair(RepairState.RUNNING, step("start_node", "n", state="failed")),
            "The actions are done; what is observed next shows whether they helped.",
        ),
        (
            repair(RepairState.WAITING, waiting_for=["ok(scan)"], probe={"atom": "ok(scan)"}),
            "A look is needed: is scan as it should be?",
        ),
        (
            repair(RepairState.WAITING, waiting_for=["on(hokuyo)", "ok(scan)"]),
            "The repair waits to hear of on(hokuyo) and ok(scan).",
        ),
        (
            repair(RepairState.ESCALATED, reason="no known action makes imu good", retry_ns=AT + 10**9),
            "A person is needed: no known action makes imu good. The next try is at 23:23:05.",
        ),
        (
            repair(RepairState.CANCELLED, reason="not today"),
            "A person is needed: the repair was cancelled: not today.",
        ),
        (None, "No repair is under way yet."),
    ],
)
def test_what_happens_next_or_who_is_needed(of: Any, then: str) -> None:
    assert said(blamed=[(("hokuyo",), 1.0)], symptoms=NO_POWER, repair=of)[1] == then


@pytest.mark.parametrize(
    ("acts", "what"),
    [
        ([("stop_node", "done"), ("start_node", "running")], "hokuyo is being restarted"),
        ([("start_node", "running")], "hokuyo is being started"),
        ([("shutdown", "running"), ("power_up", "waiting")], "hokuyo is being power-cycled"),
        ([("power_up", "done")], "hokuyo is being switched on"),
    ],
)
def test_what_is_being_restarted_is_not_named_as_a_cause(acts: list[tuple[str, str]], what: str) -> None:
    of = repair(RepairState.RUNNING, *(step(name, "hokuyo", state=state) for name, state in acts))
    blamed = [(("hokuyo",), 1.0)]
    assert said(blamed=blamed, since_ns=AT, repair=of)[0] == f"{what}."
    assert said(blamed=blamed, symptoms=[MAP], repair=of)[0] == (
        f"map is silent since 23:23:04 (0 of 2 Hz for 3.1 s), and {what}."
    )
    no_power = said(blamed=blamed, symptoms=NO_POWER, repair=of)[0]
    ours = acts[0][0] in {"stop_node", "shutdown"}
    assert no_power.startswith(what if ours else said(blamed=blamed, symptoms=NO_POWER)[0])
    waits = repair(RepairState.RUNNING, step("power_up", "hokuyo"))
    assert said(blamed=blamed, symptoms=[MAP], repair=waits)[0].endswith(", because of hokuyo.")


@pytest.mark.anyio
async def test_while_its_restart_is_under_way_a_node_is_said_to_be_restarted(tmp_path: Path) -> None:
    begun, go_on = asyncio.Event(), asyncio.Event()

    async def slowly(robot: Robot, name: str, parameter: str) -> int | None:
        if name == "start_node":
            begun.set()
            await go_on.wait()
        return None

    async with robot_of(tmp_path) as (runtime, robot):
        robot.spoil = slowly
        robot.connected["lidar_node"] = False
        await begun.wait()
        [now] = await runtime.repairs.repairs("r1", before=None, limit=1)
        there = of_robot(await runtime.robots.memory.robot("r1"), now).text(NOW)
        go_on.set()
        await the_repair(runtime)
    assert "lidar_node is being restarted" in now["headline"]
    assert "lidar_node is being restarted" in there
    assert "because of lidar_node" not in now["headline"] + there


def test_of_a_repair_that_ended_well_it_is_said_what_was_wrong() -> None:
    done = {
        "symptoms": [symptom("not on(hokuyo)", "hokuyo"), symptom("not ok(scan)")],
        "plan": [step("power_up", "hokuyo", state="done")],
        "diagnosis": {"bad": ["hokuyo"]},
    }
    of = repair(RepairState.REPAIRED, rounds=[done], created_ns=AT, finished_ns=AT + 61 * 10**9)
    assert of_repair(of).text(NOW) == (
        "hokuyo had no power from 23:23:04 to 23:24:05; scan followed. This helped: Power up hokuyo."
    )
    assert (
        of_repair({**of, "rounds": [{**done, "helped": False}]})
        .text(NOW)
        .endswith("It is not seen that this helped: Power up hokuyo.")
    )
    assert of_repair({**of, "rounds": []}).text(NOW) == (
        "Well again since 23:24:05. Nothing was done: it became so by itself."
    )


def test_what_is_being_acted_on_is_not_called_unobserved() -> None:
    acting = repair(RepairState.RUNNING, plan=[{**step("start_node", "mapper"), "state": "running"}])
    partly = {"health": HealthState.PARTLY_UNKNOWN, "unknown": ["ok(map)"], "since_ns": AT}
    assert said(**partly, repair=acting)[0] == "mapper is being started; map is not judged anew yet."


def test_healthy_unknown_and_never_reported() -> None:
    healthy = HealthState.HEALTHY
    assert said(health=healthy, since_ns=AT) == ("Healthy since 23:23:04.", "Nothing is to be done.")
    done = repair(RepairState.REPAIRED, rounds=[{"plan": [step("power_up", "hokuyo", state="done")]}])
    assert said(health=healthy, repair=done)[1] == (
        "Nothing is to be done; repaired at 23:23:04: Power up hokuyo."
    )
    done["rounds"][0]["helped"] = False
    assert said(health=healthy, repair=done)[1] == (
        "Nothing is to be done; well again at 23:23:04; it is not seen that this helped: Power up hokuyo."
    )
    back = [step("start_node", "driver", state="already-there"), step("start_node", "map")]
    done["rounds"].append({"plan": back, "helped": False})  # of which nothing was done
    assert said(health=healthy, repair=done)[1].endswith("it is not seen that this helped: Power up hokuyo.")
    assert said(health=HealthState.UNKNOWN, since_ns=AT) == (
        "Nothing is heard of it since 23:23:04.",
        "A person is needed: are its agent and its network running?",
    )
    assert said(health=HealthState.UNKNOWN, reported=False)[0] == "Nothing has been reported yet."


@pytest.mark.parametrize(
    ("unknown", "away", "what", "then"),
    [
        (
            ["ok(scan)", "running(scan)"],
            (),
            "scan is not observed since 23:23:04; no fault is known.",
            "It is judged as soon as it is reported.",
        ),
        (
            ["ok(imu)", "ok(odom)", "ok(scan)", "on(lidar)"],
            ("agent",),
            "imu, odom and 2 more are not observed since 23:23:04; no fault is known.",
            "Is agent running? It no longer reports.",
        ),
        (
            [],
            (),
            "No fault is known, and what was observed is not judged yet.",
            "It is judged in a moment.",
        ),
    ],
)
def test_what_is_not_observed_is_named_and_who_should_report_it(
    unknown: list[str], away: tuple[str, ...], what: str, then: str
) -> None:
    partly = HealthState.PARTLY_UNKNOWN
    assert said(health=partly, unknown=unknown, away=away, since_ns=AT) == (what, then)


def test_a_long_reason_ends_with_a_whole_clause() -> None:
    first = "starting mapper could not be carried out: the robot's agent did not take it in 10 s (2 times)"
    given = f"{first}; no known repair: mapper: it was done 3 times in this repair, and nothing else was seen"
    then = said(repair=repair(RepairState.ESCALATED, reason=given))[1]
    assert then == f"A person is needed: {first}."
    then = said(repair=repair(RepairState.ESCALATED, reason="word " * 60))[1]
    assert then.endswith("word …")


names = st.sampled_from(["hokuyo", "laser", "imu", "x y", 'a"b', ""])
bad_sets = st.lists(names, min_size=1, max_size=4, unique=True).map(tuple)


@given(
    health=st.sampled_from(HealthState),
    blamed=st.lists(st.tuples(bad_sets, st.none() | st.floats(0, 1)), max_size=6, unique_by=lambda b: b[0]),
    symptoms=st.lists(
        st.builds(
            symptom, st.sampled_from(["not ok(scan)", "not on(imu)", "not a(b,c)", "not ((", "x"]), names
        )
    ),
    state=st.none() | st.sampled_from(RepairState),
)
def test_whatever_the_situation_there_are_two_sentences(
    health: Any, blamed: Any, symptoms: Any, state: Any
) -> None:
    of = None if state is None else repair(state)
    found = headline(Facts(health, blamed=blamed, symptoms=symptoms, repair=of))
    assert found.what[-1] == "."
    assert all(isinstance(part, str | int) for part in (*found.what, *found.then))
    assert "None" not in found.text(NOW)
    assert len([part for part in found.then if part]) > 0


def test_actions_have_names_of_the_trade() -> None:
    assert action_title("start_node", ["localisation"]) == "Start localisation"
    assert action_title("switch_to_spare", ["scan", "left"]) == "Switch to spare: scan, left"
    assert action_title("dock", []) == "Dock"
    cycle = [step("shutdown", "a"), step("stop_node", "n"), step("power_up", "a"), step("start_node", "n")]
    assert action_titles(cycle) == ["Power-cycle a", "Restart n"]
    assert action_titles([step("stop_node", "n"), step("start_node", "m")]) == ["Stop n", "Start m"]
    cycle[0]["note"] = "camera stays on"
    assert action_titles(cycle) == ["Power-cycle a (camera stays on)", "Restart n"]
    then = said(repair=repair(RepairState.AWAITING_APPROVAL, *cycle))[1]
    assert then == "Power-cycle a (camera stays on) and restart n?"


@pytest.mark.parametrize(
    ("hardware", "others", "off", "note"),
    [
        ("camera: {channel: 2}", [], [], "camera stays on"),
        ("camera: {channel: 2}, imu: {}", [], [], "camera and imu stay on"),
        ("camera: {channel: 2}, imu: {}, gps: {}", [], [], "all else stays on"),
        ("camera: {fed_by: lidar}, imu: {}", [], [], "camera goes off with it"),
        ("camera: {fed_by: lidar}, imu: {fed_by: camera}", [], [], "camera and imu go off with it"),
        ("camera: {channel: 2}, imu: {fed_by: camera}, gps: {}", ["camera"], [], "gps stays on"),
        ("camera: {channel: 2}, imu: {}", [], ["imu"], "camera stays on"),
        ("", [], [], ""),
    ],
)
def test_what_goes_off_with_a_device_or_stays_on_is_said(
    hardware: str, others: list[str], off: list[str], note: str
) -> None:
    parts = load_text(f"robomend: 1\nhardware: {{lidar: {{channel: 1}}, {hardware}}}\n").parts
    assert parts is not None
    assert power_note(parts, "lidar", others, off) == note


@pytest.mark.parametrize(
    ("reason", "prose"),
    [
        (
            "start_node(map) failed (2 times); map: stop_node(map) is refused",
            "starting map failed (2 times); map: stopping map is refused",
        ),
        ("power_up(Front/Lidar) answered 'done'", "powering up Front/Lidar answered 'done'"),
        ("shutdown(a): the policy says no", "switching off a: the policy says no"),
        (
            "jaguar explains not on(jaguar) and not ok(odom)",
            "jaguar explains no power at jaguar and odom not ok",
        ),
        (
            "but running(a), ok(b) and on(c) were not seen",
            "but a running, b ok and power at c were not seen",
        ),
        ("a(on(x)), ok(age, scan), book(x)", "a(power at x), ok(age, scan), book(x)"),
        (
            "no known repair: fan: no known action makes it good (it has no power channel); b left alone",
            "no known action mends fan (it has no power channel); b left alone",
        ),
        ("restart_node(map) failed", "restart_node(map) failed"),
        ("my_start_node(map) failed", "my_start_node(map) failed"),
        ("start_node(a, b) failed", "start_node(a, b) failed"),
    ],
)
def test_reasons_name_actions_as_people_say_them(reason: str, prose: str) -> None:
    assert in_prose(reason) == prose


def test_what_a_vain_repair_took_away_for_a_moment_is_as_old_as_before_it() -> None:
    """A driver that ends at each start: it ran for a moment, and is down since it first ended."""
    began, again = AT - 60 * 10**9, symptom("not running(map)", "map")
    tried = {"diagnosis": {"bad": ["map"]}, "plan": [], "symptoms": [symptom("not running(map)", at=began)]}
    ended = repair(RepairState.ESCALATED, rounds=[tried], reason="it did not help", finished_ns=AT + 1)
    what, _ = said(blamed=[(("map",), None)], symptoms=[again], repair=ended)
    assert what == "map is not running since 23:22:04."
    what, _ = said(blamed=[(("map",), None)], symptoms=[again], repair={**ended, "finished_ns": AT - 1})
    assert what == "map is not running since 23:23:04."  # it was well in the meantime


def test_a_repair_that_has_just_begun_does_not_say_that_nothing_explains_it() -> None:
    begun = of_repair(repair(RepairState.WAITING)).text(NOW)
    assert begun == "Something is wrong since 23:23:04. The repair waits for its turn."
    ended = of_repair(repair(RepairState.ESCALATED, reason="no known repair")).text(NOW)
    assert ended.startswith("Something is wrong, and no diagnosis explains it since 23:23:04. ")
