"""What may be done to a robot: modes, allow-list, protection, limits and windows, as tables."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning.plan import Step
from robomend.planning.policy import Limits, Mode, Policy, Window
from robomend.robots.configuration import RobotConfig, policy_of
from robomend_client.literals import Literal, fails, holds

COMPONENTS = frozenset({"lidar", "lidar_b", "driver"})


def step(name: str, *parameters: str, effects: tuple[Literal, ...] = ()) -> Step:
    return Step(0, name, parameters, 1.0, (), (), effects)


POWER_UP = step("power_up", "lidar", effects=(holds("on", "lidar"), fails("off", "lidar")))
SHUTDOWN = step("shutdown", "lidar", effects=(holds("off", "lidar"), fails("on", "lidar")))
STOP = step("stop_node", "driver")
OWN = step("swap", "lidar", "lidar_b", effects=(holds("off", "lidar"), holds("good", "lidar_b")))
RESET = step("reset_usb", "usb1")
MODE = step("set_mode", "low", effects=(holds("good", "driver"), fails("bad", "driver")))  # names nobody


@pytest.mark.parametrize(
    ("policy", "taken", "said"),
    [
        (Policy(), POWER_UP, None),
        (Policy(mode=Mode.OBSERVE), POWER_UP, "the policy for 'power_up' is 'observe'"),
        (Policy(actions={"shutdown": Mode.OBSERVE}), SHUTDOWN, "the policy for 'shutdown' is 'observe'"),
        (Policy(actions={"shutdown": Mode.OBSERVE}), POWER_UP, None),
        (
            Policy(allowed=frozenset({"power_up", "start_node"})),
            SHUTDOWN,
            "'shutdown' is not on the robot's allow-list (power_up, start_node)",
        ),
        (Policy(protected={"lidar": "lidar is protected"}), POWER_UP, None),
        (
            Policy(protected={"lidar": "lidar is protected"}),
            SHUTDOWN,
            "lidar stays as it is: lidar is protected",
        ),
        (
            Policy(protected={"driver": "driver is protected"}),
            STOP,
            "driver stays as it is: driver is protected",
        ),
        (Policy(protected={"lidar": "lidar is protected"}), OWN, "lidar stays as it is: lidar is protected"),
        (Policy(protected={"lidar_b": "lidar_b is protected"}), OWN, None),
    ],
)
def test_a_step_is_refused_for_a_reason_that_names_it(policy: Policy, taken: Step, said: str | None) -> None:
    assert policy.refusal(taken, {}, COMPONENTS) == said


@pytest.mark.parametrize(
    ("attempts", "steps", "refused"),
    [
        ({"lidar": 2}, [POWER_UP], None),
        ({"lidar": 3}, [POWER_UP], "power_up(lidar)"),
        ({"lidar": 2}, [SHUTDOWN, POWER_UP], "power_up(lidar)"),  # never left off half-way
        ({"usb1": 100}, [RESET], None),  # no component of the model
        ({"lidar_b": 3}, [OWN], "swap(lidar, lidar_b)"),
        ({"driver": 3}, [MODE], "set_mode(low)"),
        ({"driver": 2}, [STOP, MODE], "set_mode(low)"),
    ],
)
def test_the_limit_holds_for_a_plan_as_a_whole(
    attempts: dict[str, int], steps: list[Step], refused: str | None
) -> None:
    said = Policy(limits=Limits(attempts_per_hour=3)).plan_refusal(steps, attempts, COMPONENTS)
    assert (None if said is None else said.partition(":")[0]) == refused


@pytest.mark.parametrize(
    ("mode", "actions", "steps", "wanted"),
    [
        (Mode.AUTO, {}, [POWER_UP], Mode.AUTO),
        (Mode.AUTO, {"power_up": Mode.APPROVE}, [POWER_UP, STOP], Mode.APPROVE),
        (Mode.APPROVE, {"stop_node": Mode.AUTO}, [STOP], Mode.AUTO),
        (Mode.APPROVE, {"stop_node": Mode.AUTO}, [STOP, POWER_UP], Mode.APPROVE),
        (Mode.AUTO, {"stop_node": Mode.OBSERVE}, [STOP, POWER_UP], Mode.OBSERVE),
        (Mode.APPROVE, {}, [], Mode.APPROVE),
    ],
)
def test_a_plan_needs_what_its_strictest_step_needs(
    mode: Mode, actions: dict[str, Mode], steps: list[Step], wanted: Mode
) -> None:
    assert Policy(mode=mode, actions=actions).mode_for(steps) is wanted


NIGHT = {"weekdays": [4], "start": "22:00", "end": "04:30"}  # from Friday into Saturday
NOON = {"start": "12:00", "end": "13:00"}


@pytest.mark.parametrize(
    ("window", "moment", "inside"),
    [
        (NOON, "2026-11-18 12:00", True),
        (NOON, "2026-11-18 13:00", False),
        (NOON, "2026-11-18 11:59", False),
        (NIGHT, "2026-11-20 22:00", True),  # a Friday
        (NIGHT, "2026-11-21 04:29", True),
        (NIGHT, "2026-11-21 04:30", False),
        (NIGHT, "2026-11-21 22:30", False),  # Saturday's own night
        (NIGHT, "2026-11-20 03:00", False),  # Thursday's
    ],
)
def test_a_window_holds_from_its_start_to_before_its_end(
    window: dict[str, object], moment: str, inside: bool
) -> None:
    at = datetime.fromisoformat(moment).replace(tzinfo=UTC)
    now_ns = int(at.timestamp()) * 10**9
    assert Window.of(window).holds(now_ns) is inside
    assert Policy(windows=(Window.of(window),)).may_begin(now_ns) is inside


def test_a_robot_s_configuration_becomes_its_policy() -> None:
    config = RobotConfig.from_json(
        "r1",
        {
            "model": "m",
            "policy": "auto",
            "allow": ["power_up"],
            "protected": ["driver"],
            "hold_s": 2.5,
            "limits": {"attempts_per_hour": 3, "rounds": 2},
            "actions": {"power_up": {"policy": "approve"}, "shutdown": {"timeout_s": 1.0}},
            "windows": [NOON],
        },
    )
    parts = ComponentModel(
        "m", {"lidar": Hardware("lidar", 1, protected=True)}, {"driver": Node("driver")}, {}
    )
    policy = policy_of(config, parts)
    assert policy == Policy(
        mode=Mode.AUTO,
        actions={"power_up": Mode.APPROVE},
        allowed=frozenset({"power_up"}),
        protected={"driver": "driver is protected", "lidar": "lidar is protected"},
        limits=Limits(attempts_per_hour=3, rounds=2),
        hold_s=2.5,
        windows=(Window(frozenset(range(7)), 720, 780),),
    )


def test_unless_told_a_person_is_asked() -> None:
    assert policy_of(RobotConfig.from_json("r1", {"model": "m"}), None).mode is Mode.APPROVE
