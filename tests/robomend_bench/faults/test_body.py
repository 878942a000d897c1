"""A robot's innards in time, on a clock of their own."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.robomend_bench.faults.small import ROBOT

from robomend_bench.faults.body import Body
from robomend_bench.faults.condition import Act, observed
from robomend_bench.faults.kinds import Fault, begun
from robomend_bench.faults.observing import PRESETS, HostObservers, Preset
from robomend_bench.faults.robot import find_robot, robot_names
from robomend_client.literals import Atom, Literal


def test_an_act_that_is_withdrawn_changes_nothing() -> None:
    body = Body(ROBOT, "test", 0.0, lambda topic, at_s: None)
    body.plant(Fault("mapper", "dead"))
    withdraw = body.order(Act("start_node", ("mapper",)), lambda code, message: None)
    withdraw()
    body.advance(1.0)
    assert "mapper" not in body.running()


def watch(robot: str, preset: Preset, fault: Fault | None, until_s: float, each: Callable[..., None]) -> None:
    """Run a robot with the real observers; `each` is given what they hold, every 0.1 s."""
    anatomy = find_robot(robot).anatomy
    hosts = [HostObservers(anatomy, host, preset, 0.0) for host in anatomy.hosts]

    def message(topic: str, at_s: float) -> None:
        for host in hosts:
            if topic in host.topics:
                host.message(topic, at_s)

    body = Body(anatomy, "test", 0.0, message)
    held: dict[Atom, Literal] = {}
    for step in range(1, int(until_s * 10) + 1):
        body.advance(step / 10)
        if step == 30:  # every window is full
            body.hiccups = fault is None
            if fault is not None:
                body.plant(fault)
        on = {device: body.on(device) for device in anatomy.devices}
        for host in hosts:
            for change in host.check(step / 10, body.running(), on):
                held.pop(change.atom, None)
                if change.value is not None:
                    held[change.atom] = change.value
        if anatomy.power == "board":
            held |= {Atom("on", (d,)): Literal(Atom("on", (d,)), at) for d, at in on.items()}
        each(step / 10, held)


@pytest.mark.parametrize("name", robot_names())
def test_the_observers_end_up_with_the_settled_observation(name: str, long: bool) -> None:
    robot = find_robot(name)
    faults = sorted(robot.universe.shows)
    for fault in faults if long else faults[3::17]:
        last: dict[Atom, Literal] = {}

        def keep(at_s: float, held: dict[Atom, Literal], last: dict[Atom, Literal] = last) -> None:
            last.clear()
            last.update(held)

        watch(name, PRESETS["published"], fault, 8.0, keep)
        wanted = observed(robot.anatomy, begun(robot.anatomy, fault))
        assert {last.get(literal.atom) for literal in wanted} == wanted, fault


@pytest.mark.parametrize("preset", PRESETS.values(), ids=str)
def test_jitter_and_hiccups_stay_within_what_observers_tolerate(preset: Preset) -> None:
    odd: list[tuple[float, Literal]] = []

    def note(at_s: float, held: dict[Atom, Literal]) -> None:
        odd.extend((at_s, literal) for literal in held.values() if not literal.positive)

    for name in ("base", "made-1"):
        watch(name, preset, None, 60.0, note)
    assert odd == []
