"""A robot's innards in time, on a clock of their own."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.robomend_bench.faults.small import ROBOT

from robomend_bench.faults.anatomy import Anatomy
from robomend_bench.faults.body import Body
from robomend_bench.faults.condition import Act, observed
from robomend_bench.faults.kinds import Fault, begun
from robomend_bench.faults.observing import PRESETS, HostObservers, Preset
from robomend_bench.faults.robot import find_robot, robot_names
from robomend_client.literals import Atom, Literal


class Watched:
    """A body with its messages."""

    def __init__(self, anatomy: Anatomy = ROBOT) -> None:
        self.messages: dict[str, list[float]] = {topic: [] for topic in anatomy.topics}
        self.body = Body(anatomy, "test", 0.0, lambda topic, at_s: self.messages[topic].append(at_s))

    def order(self, name: str, component: str) -> list[int]:
        """Order an act; its answer will be in the list."""
        codes: list[int] = []
        self.body.order(Act(name, (component,)), lambda code, message: codes.append(code))
        return codes

    def between(self, topic: str, first_s: float, last_s: float) -> int:
        return sum(first_s < at_s <= last_s for at_s in self.messages[topic])


def test_a_restart_takes_its_time_and_warms_up() -> None:
    watched = Watched()
    watched.body.plant(Fault("mapper", "dead"))
    watched.body.advance(2.0)
    assert "mapper" not in watched.body.running()
    codes = watched.order("start_node", "mapper")
    watched.body.advance(2.1)
    assert not codes
    watched.body.advance(2.2)
    assert codes == [0]
    assert "mapper" in watched.body.running()
    watched.body.advance(4.0)
    assert min(at_s for at_s in watched.messages["map"] if at_s > 2.0) >= 2.15 + 0.3


def test_an_act_that_is_withdrawn_changes_nothing() -> None:
    watched = Watched()
    watched.body.plant(Fault("mapper", "dead"))
    withdraw = watched.body.order(Act("start_node", ("mapper",)), lambda code, message: None)
    withdraw()
    watched.body.advance(1.0)
    assert "mapper" not in watched.body.running()


def test_a_loop_starts_again_by_the_node_that_kicks() -> None:
    watched = Watched()
    watched.body.plant(Fault("estimator", "dead"))
    watched.body.advance(3.0)
    assert watched.between("state", 1, 3) == 0
    assert 3 <= watched.between("command", 1, 3) <= 5
    watched.order("start_node", "estimator")
    watched.body.advance(8.0)
    assert watched.between("state", 5, 8) >= 29


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
