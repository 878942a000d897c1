"""From a diagnosis to a validated plan: the paper's scenarios, then random robots against oracles."""

from __future__ import annotations

import heapq
import random
from dataclasses import replace
from itertools import count, permutations, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.repair.robots import ALL_OFF, NODES, POWER_UP, TEDUSAR, texts

from robomend.errors import OptionRefused, UnknownComponent
from robomend.model.components import ComponentModel, Hardware, Node
from robomend.repair.domain import Domain
from robomend.repair.domain_loading import load_domain, shipped
from robomend.repair.plan import Outcome, Plan
from robomend.repair.planning import PlanOptions, plan_for
from robomend.repair.problem import Fact, RepairProblem, repair_problem
from robomend.repair.validation import validate
from robomend_bench.plan_robots import broken, random_robot, some_bad
from robomend_client.literals import fails, holds

PLANNERS = ["pyperplan", "asp"]
PAPER = shipped("paper-repair.pddl")


@pytest.fixture(params=PLANNERS)
def planner(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def position(plan: Plan, text: str) -> int:
    return texts(plan).index(text)


# --- the paper's scenarios ------------------------------------------------------------------------


def test_power_up_powers_the_devices_before_it_starts_their_drivers(planner: str) -> None:
    plan = plan_for(TEDUSAR, ALL_OFF, POWER_UP, PlanOptions(planner=planner))
    assert plan.outcome is Outcome.SOLVED
    assert set(texts(plan)[:3]) == {f"power_up({name})" for name in ("jaguar", "hokuyo", "laser_alignment")}
    assert set(texts(plan)[3:]) == {f"start_node({name})" for name in NODES}
    assert position(plan, "start_node(hokuyo_node)") < position(plan, "start_node(hector_mapping)")
    assert plan.cost == 3 * 10 + 9 * 3
    assert plan.assumed == ()


def test_independent_repairs_run_side_by_side() -> None:
    plan = plan_for(TEDUSAR, ALL_OFF, POWER_UP)
    after = {str(step): {str(plan.steps[i]) for i in step.after} for step in plan.steps}
    assert after["start_node(jaguar_node)"] == {"power_up(jaguar)"}
    assert after["start_node(hector_mapping)"] == {"start_node(hokuyo_node)"}
    assert after["start_node(rviz)"] == set()
    assert after["power_up(jaguar)"] == after["power_up(hokuyo)"] == set()


def test_a_device_that_lost_power_is_switched_on_and_its_driver_restarted(planner: str) -> None:
    plan = plan_for(TEDUSAR, [fails("on", "jaguar")], ["jaguar"], PlanOptions(planner=planner))
    assert texts(plan) == ["power_up(jaguar)", "stop_node(jaguar_node)", "start_node(jaguar_node)"]
    assert plan.steps[2].after == (1,)  # and stop_node is after power_up: it stops what turned bad


def test_a_device_that_hangs_is_power_cycled(planner: str) -> None:
    plan = plan_for(TEDUSAR, [holds("on", "hokuyo")], ["hokuyo"], PlanOptions(planner=planner))
    assert texts(plan) == [
        "shutdown(hokuyo)",
        "power_up(hokuyo)",
        "stop_node(hokuyo_node)",
        "start_node(hokuyo_node)",
    ]


def test_the_papers_own_domain_only_switches_the_device_on(planner: str) -> None:
    options = PlanOptions(planner=planner, domain=PAPER)
    assert texts(plan_for(TEDUSAR, [fails("on", "jaguar")], ["jaguar"], options)) == ["power_up(jaguar)"]


def test_a_healthy_robot_needs_no_plan(planner: str) -> None:
    plan = plan_for(TEDUSAR, [], [], PlanOptions(planner=planner))
    assert (plan.outcome, plan.steps, plan.cost) == (Outcome.SOLVED, (), 0)


def test_steps_say_what_they_need_and_do_in_the_models_words() -> None:
    step = plan_for(TEDUSAR, [fails("on", "jaguar")], ["jaguar"]).steps[0]
    assert set(step.preconditions) == {holds("off", "jaguar")}
    assert {holds("on", "jaguar"), fails("off", "jaguar"), fails("bad", "jaguar")} <= set(step.effects)
    assert {holds("bad", "jaguar_node"), fails("good", "jaguar_node")} <= set(step.effects)


# --- what is assumed, left out, protected ---------------------------------------------------------


def test_what_nobody_observed_of_a_bad_component_is_assumed_and_said() -> None:
    plan = plan_for(TEDUSAR, [], ["hokuyo"])
    assert plan.assumed == (holds("on", "hokuyo"),)
    assert plan_for(TEDUSAR, [holds("on", "hokuyo")], ["hokuyo"]).assumed == ()


def test_unreachable_goals_are_named_and_the_rest_is_planned(planner: str) -> None:
    plan = plan_for(TEDUSAR, [], ["imu", "rviz"], PlanOptions(planner=planner))
    assert plan.outcome is Outcome.UNSOLVABLE
    assert plan.unreachable == ("imu: no known action makes it good (it has no power channel)",)
    assert texts(plan) == ["stop_node(rviz)", "start_node(rviz)"]


def test_the_reason_names_what_is_in_the_way() -> None:
    plan = plan_for(TEDUSAR, [fails("running", "imu_node")], ["imu", "imu_node"])
    assert plan.unreachable[1] == (
        "imu_node: start_node(imu_node) needs good(imu), and no known action brings that about"
    )


def test_nodes_that_are_meant_to_be_stopped_are_left_alone(planner: str) -> None:
    options = PlanOptions(planner=planner, expected_stopped=("hokuyo_node",))
    plan = plan_for(TEDUSAR, ALL_OFF, POWER_UP, options)
    assert plan.excluded == ("hokuyo_node",)
    assert not any("hokuyo_node" in text for text in texts(plan))
    assert "start_node(hector_mapping)" in texts(plan)


def test_quarantined_components_are_left_alone_and_what_needs_them_is_named() -> None:
    plan = plan_for(TEDUSAR, ALL_OFF, POWER_UP, PlanOptions(quarantined=("jaguar",)))
    assert "power_up(jaguar)" not in texts(plan)
    assert plan.unreachable == (
        "jaguar_node: start_node(jaguar_node) needs good(jaguar), and power_up(jaguar) is refused: "
        "jaguar is left alone",
    )


def test_nothing_shuts_a_protected_component_down_nor_what_feeds_it(planner: str) -> None:
    hardware = {
        "psu": Hardware("psu", 0),
        "pc": Hardware("pc", 2, fed_by=("psu",)),
        "arm": Hardware("arm", 1, fed_by=("psu",)),
    }
    robot = ComponentModel("r", hardware, {}, {})
    free = plan_for(robot, [], ["psu"], PlanOptions(planner=planner))
    assert "shutdown(psu)" in texts(free)
    safe = plan_for(robot, [], ["psu", "arm"], PlanOptions(planner=planner, protected=("pc",)))
    assert texts(safe) == []
    assert "shutdown(psu) is refused: pc, which it feeds, is protected" in safe.unreachable[0]


def test_what_hangs_on_a_supply_comes_back_with_it_and_its_drivers_restart(planner: str) -> None:
    """Without a channel of its own nothing else could bring it back; also through a hub without channel."""
    hardware = {
        "psu": Hardware("psu", 0),
        "hub": Hardware("hub", None, fed_by=("psu",)),
        "camera": Hardware("camera", None, fed_by=("hub",)),
        "lidar": Hardware("lidar", 1, fed_by=("hub",)),
    }
    nodes = {
        "camera_node": Node("camera_node", drives=("camera",), publishes={"image": ()}),
        "lidar_node": Node("lidar_node", drives=("lidar",), publishes={"scan": ()}),
    }
    robot = ComponentModel("r", hardware, nodes, {})
    options = PlanOptions(planner=planner)
    restarts = {f"{action}({node})" for action in ("stop_node", "start_node") for node in nodes}
    cycled = plan_for(robot, [], ["psu"], options)
    assert cycled.outcome is Outcome.SOLVED
    assert texts(cycled)[0] == "shutdown(psu)"
    assert set(texts(cycled)) == {
        *("shutdown(psu)", "power_up(psu)", "shutdown(lidar)", "power_up(lidar)"),
        *restarts,
    }
    came_back = plan_for(robot, [fails("on", "psu")], ["psu"], options)
    assert set(texts(came_back)) == {"power_up(psu)", *restarts}
    assert texts(came_back)[0] == "power_up(psu)"
    safe = plan_for(robot, [], ["psu"], replace(options, protected=("camera",)))
    assert texts(safe) == []


def test_a_spare_that_is_meant_to_be_off_is_switched_on_by_nothing_but_the_users_action(planner: str) -> None:
    spare = """
    (define (domain robot-repair)
      (:predicates (spare_for ?s ?h - hardware))
      (:action use_spare
        :parameters (?h ?s - hardware)
        :precondition (and (spare_for ?s ?h) (bad ?h) (off ?s))
        :effect (and (on ?s) (not (off ?s)) (good ?h) (not (bad ?h)) (increase (total-cost) 5)))
      (:init (spare_for gps_b gps_a)))
    """
    robot = ComponentModel("r", {"gps_a": Hardware("gps_a", 0), "gps_b": Hardware("gps_b", 1)}, {}, {})
    off = [fails("on", "gps_b")]
    options = PlanOptions(planner=planner, domain=spare, expected_stopped=("gps_b",))
    assert texts(plan_for(robot, off, ["gps_a"], options)) == ["use_spare(gps_a, gps_b)"]
    assert texts(plan_for(robot, off, ["gps_b"], options)) == []
    quarantined = replace(options, expected_stopped=(), quarantined=("gps_b",))
    assert texts(plan_for(robot, off, ["gps_a"], quarantined)) == ["shutdown(gps_a)", "power_up(gps_a)"]


def test_a_model_may_mark_what_is_protected() -> None:
    robot = replace(TEDUSAR, hardware={**TEDUSAR.hardware, "hokuyo": Hardware("hokuyo", 3, protected=True)})
    assert texts(plan_for(robot, [], ["hokuyo"])) == []


def test_names_that_are_not_the_models_are_refused() -> None:
    with pytest.raises(UnknownComponent, match="did you mean 'jaguar'"):
        plan_for(TEDUSAR, [], ["jagaur"])
    with pytest.raises(OptionRefused, match="choose one of"):
        plan_for(TEDUSAR, [], ["jaguar"], PlanOptions(planner="graphplan"))


def test_names_may_hold_what_pddl_cannot() -> None:
    robot = ComponentModel(
        "r",
        {"Front/Lidar 1": Hardware("Front/Lidar 1", 1)},
        {"front": Node("front"), "Front": Node("Front")},
        {},
    )
    plan = plan_for(robot, [], ["Front/Lidar 1", "Front"], PlanOptions(pddl=True))
    assert "power_up(Front/Lidar 1)" in texts(plan)
    assert "start_node(Front)" in texts(plan)
    assert plan.pddl is not None
    assert ";; o0 is Front/Lidar 1" in plan.pddl[1]


# --- structure ------------------------------------------------------------------------------------


def test_a_cycle_of_topics_keeps_nobody_from_starting(planner: str) -> None:
    nodes = {
        "a": Node("a", publishes={"ta": ("tb",)}),
        "b": Node("b", publishes={"tb": ("ta",)}),
        "c": Node("c", publishes={"tc": ("ta",)}),
    }
    robot = ComponentModel("r", {}, nodes, {})
    plan = plan_for(robot, broken(robot, nodes), nodes, PlanOptions(planner=planner))
    assert plan.outcome is Outcome.SOLVED
    assert position(plan, "start_node(a)") < position(plan, "start_node(c)")


def test_what_is_tied_restarts_too(planner: str) -> None:
    nodes = {"core": Node("core"), "bridge": Node("bridge", tied_to=("core",))}
    robot = ComponentModel("r", {}, nodes, {})
    plan = plan_for(robot, [], ["core"], PlanOptions(planner=planner))
    assert set(texts(plan)) == {f"{verb}({node})" for verb in ("stop_node", "start_node") for node in nodes}


def test_feeders_come_first(planner: str) -> None:
    hardware = {"arm": Hardware("arm", 1, fed_by=("psu",)), "psu": Hardware("psu", 0)}
    robot = ComponentModel("r", hardware, {}, {})
    plan = plan_for(robot, broken(robot, hardware), hardware, PlanOptions(planner=planner))
    assert texts(plan) == ["power_up(psu)", "power_up(arm)"]


def test_goals_that_exclude_each_other_are_said_honestly(planner: str) -> None:
    """The device comes back only at the price of a driver that cannot be restarted."""
    nodes = {"driver": Node("driver", ("arm",), restartable=False)}
    robot = ComponentModel("r", {"arm": Hardware("arm", 1)}, nodes, {})
    plan = plan_for(robot, [], ["arm"], PlanOptions(planner=planner))
    assert plan.outcome is Outcome.UNSOLVABLE
    assert plan.unreachable == ("driver: cannot be made good together with arm",)
    assert texts(plan) == ["shutdown(arm)", "power_up(arm)"]


def test_the_cost_of_a_component_scales_its_actions() -> None:
    robot = replace(TEDUSAR, hardware={**TEDUSAR.hardware, "hokuyo": Hardware("hokuyo", 3, cost=2.0)})
    assert plan_for(robot, [fails("on", "hokuyo")], ["hokuyo"]).cost == 20 + 1 + 3


OPERATOR = """
(define (domain robot-repair)
  (:action call_operator
    :parameters (?c - component)
    :precondition (bad ?c)
    :effect (and (good ?c) (not (bad ?c)) (increase (total-cost) 500))))
"""


def test_a_last_resort_is_not_taken_first_because_it_is_short(planner: str) -> None:
    options = PlanOptions(planner=planner, domain=OPERATOR)
    assert plan_for(TEDUSAR, [], ["hokuyo"], options).cost == 15 + 10 + 1 + 3
    assert texts(plan_for(TEDUSAR, [], ["imu"], options)) == ["call_operator(imu)"]


USB = """
(define (domain robot-repair)
  (:types bus - object)
  (:predicates (on_bus ?h - hardware ?b - bus))
  (:action reset_usb
    :parameters (?b - bus)
    :precondition (exists (?h - hardware) (and (on_bus ?h ?b) (bad ?h)))
    :effect (and
      (forall (?h - hardware) (when (on_bus ?h ?b) (and (good ?h) (not (bad ?h)))))
      (forall (?h - hardware ?n - node)
        (when (and (on_bus ?h ?b) (drives ?n ?h)) (and (bad ?n) (not (good ?n)))))
      (increase (total-cost) 5)))
  (:objects usb1 - bus)
  (:init (on_bus imu usb1)))
"""


def test_the_users_own_action_is_planned_with(planner: str) -> None:
    plan = plan_for(TEDUSAR, [], ["imu"], PlanOptions(planner=planner, domain=USB))
    assert texts(plan) == ["reset_usb(usb1)", "stop_node(imu_node)", "start_node(imu_node)"]


SPARE = """
(define (domain robot-repair)
  (:predicates (spare_for ?s - hardware ?h - hardware))
  (:action switch_to_spare
    :parameters (?h - hardware ?s - hardware)
    :precondition (and (spare_for ?s ?h) (bad ?h) (not (on ?s)))
    :effect (and (on ?s) (not (off ?s)) (good ?s) (not (bad ?s)) (off ?h) (not (on ?h))
      (good ?h) (not (bad ?h))
      (forall (?n - node) (when (drives ?n ?h) (and (bad ?n) (not (good ?n)))))
      (increase (total-cost) 8)))
  (:init (spare_for lidar2 lidar)))
"""


def test_a_spare_takes_over_where_the_device_cannot_come_back(planner: str) -> None:
    """The spare is meant to be off, so it is no goal; the broken device has no channel to cycle."""
    robot = ComponentModel(
        "r",
        {"lidar": Hardware("lidar"), "lidar2": Hardware("lidar2", 2)},
        {"lidar_node": Node("lidar_node", ("lidar",))},
        {},
    )
    options = PlanOptions(planner=planner, domain=SPARE)
    plan = plan_for(robot, [fails("on", "lidar2")], ["lidar", "lidar2"], options)
    assert texts(plan) == [
        "switch_to_spare(lidar, lidar2)",
        "stop_node(lidar_node)",
        "start_node(lidar_node)",
    ]
    seen = [holds("on", "lidar2")]
    assert texts(plan_for(robot, seen, ["lidar"], options)) == []


def test_users_actions_respect_protection_too(planner: str) -> None:
    robot = ComponentModel("r", {"lidar": Hardware("lidar", 1), "lidar2": Hardware("lidar2", 2)}, {}, {})
    options = PlanOptions(planner=planner, domain=SPARE)
    seen = [fails("on", "lidar2")]
    assert "switch_to_spare(lidar, lidar2)" in texts(plan_for(robot, seen, ["lidar"], options))
    safe = plan_for(robot, seen, ["lidar"], replace(options, protected=("lidar",)))
    assert texts(safe) == ["power_up(lidar2)"]
    assert "refused" in safe.unreachable[0]


# --- oracles --------------------------------------------------------------------------------------


def replayed(robot: ComponentModel, plan: Plan, problem: RepairProblem, domain: Domain) -> None:
    """The plan holds in the domain as written, in its own order and in others that its order allows."""
    lost = {sentence.split(":")[0] for sentence in plan.unreachable}
    goal = [fact for fact in problem.goal if fact[1] not in lost]
    chance = random.Random(0)
    for _ in range(4):
        order: list[int] = []
        while len(order) < len(plan.steps):
            ready = [s.index for s in plan.steps if s.index not in order and set(s.after) <= set(order)]
            order.append(chance.choice(ready))
        named = [(plan.steps[i].name, plan.steps[i].parameters) for i in order]
        assert validate(domain, problem, named, goal) is None, robot
    serial = [(step.name, step.parameters) for step in plan.steps]
    assert validate(domain, problem, serial, goal) is None


def check_robot(seed: int, planner: str) -> None:
    robot = random_robot(seed, 6 + seed % 12)
    bad = some_bad(robot, 1 + seed % 5, seed) if seed % 4 else robot.components
    seen = broken(robot, bad, seed)
    plan = plan_for(robot, seen, bad, PlanOptions(planner=planner, timeout_s=30))
    domain = load_domain()
    replayed(robot, plan, repair_problem(robot, domain, seen, bad), domain)


def test_plans_for_random_robots_hold_in_the_domain_as_written(long: bool) -> None:
    for seed in range(200 if long else 40):
        check_robot(seed, PLANNERS[seed % 2])


def cheapest(domain: Domain, problem: RepairProblem, goal: frozenset[Fact]) -> float | None:
    """The oracle: Dijkstra over the states of the domain as written, knowing nothing of ground parts."""
    names = list(problem.objects)
    actions = [
        (schema, values)
        for schema in domain.schemas.values()
        for values in product(names, repeat=len(schema.parameters))
        if all(
            domain.is_a(problem.objects[value], kind)
            for value, (_, kind) in zip(values, schema.parameters, strict=True)
        )
    ]
    from robomend.repair.validation import _World

    world = _World(domain, problem)
    tie = count()
    heap = [(0.0, next(tie), problem.initial)]
    done: set[frozenset[Fact]] = set()
    while heap:
        cost, _, state = heapq.heappop(heap)
        if state in done:
            continue
        if goal <= state:
            return cost
        done.add(state)
        for schema, values in actions:
            env = {variable: value for (variable, _), value in zip(schema.parameters, values, strict=True)}
            if not world.true(schema.precondition, env, set(state)):
                continue
            adds: set[Fact] = set()
            deletes: set[Fact] = set()
            for effect in schema.effects:
                for binding in world.every(effect.variables, env):
                    if world.true(effect.condition, binding, set(state)):
                        (adds if effect.adds else deletes).add(world.fact(effect.atom, binding))
            following = (state - deletes) | adds
            if following not in done:
                heapq.heappush(heap, (cost + schema.cost, next(tie), following))
    return None


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000))
def test_asp_is_cheapest_and_pyperplan_within_a_tenth(seed: int) -> None:
    robot = random_robot(seed, 4)
    bad = some_bad(robot, 1 + seed % 4, seed)
    seen = broken(robot, bad, seed)
    domain = load_domain()
    problem = repair_problem(robot, domain, seen, bad)
    asp = plan_for(robot, seen, bad, PlanOptions(planner="asp", timeout_s=30))
    default = plan_for(robot, seen, bad, PlanOptions(timeout_s=30))
    lost = {sentence.split(":")[0] for sentence in asp.unreachable}
    goal = frozenset(fact for fact in problem.goal if fact[1] not in lost)
    least = cheapest(domain, problem, goal)
    assert least is not None
    assert asp.cost == least
    assert least <= default.cost <= 1.1 * least
    assert default.unreachable == asp.unreachable
    if asp.outcome is Outcome.UNSOLVABLE:
        # What was given up cannot be had: no plan reaches one lost goal more.
        for extra in problem.goal:
            if extra[1] in lost:
                assert cheapest(domain, problem, goal | {extra}) is None


def test_every_order_that_the_partial_order_allows_is_a_plan() -> None:
    """All of them, for a plan of five steps."""
    domain = load_domain()
    seen, bad = [fails("on", "jaguar")], ["jaguar", "rviz"]
    problem = repair_problem(TEDUSAR, domain, seen, bad)
    plan = plan_for(TEDUSAR, seen, bad)
    allowed = 0
    for order in permutations(range(len(plan.steps))):
        if any(order.index(other) > order.index(step.index) for step in plan.steps for other in step.after):
            continue
        allowed += 1
        named = [(plan.steps[i].name, plan.steps[i].parameters) for i in order]
        assert validate(domain, problem, named, problem.goal) is None
    assert allowed == 10  # a chain of three beside a chain of two
