"""Healthy is said of now only: reports, lapses, acts and diagnoses in any order."""

from __future__ import annotations

from unittest.mock import patch

from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.entry import Entry
from robomend.model.loading import load_text
from robomend.oneshots.warm_model import ask_engine
from robomend.repairs.conclusions import nobody_blamed
from robomend.repairs.headline import of_robot
from robomend.repairs.states import RepairTrigger
from robomend.robots.batches import Update
from robomend.robots.clock import CLOCK
from robomend.robots.diagnoser import Current
from robomend.robots.health import HealthState, health_of
from robomend.robots.robot import Robot
from robomend.store.records import StoredModel, StoredObs, StoredRobot
from robomend_client.literals import Atom, Literal

SOURCE = """
robomend: 1
name: cameras
nodes:
  left: {publishes: {image: []}}
  merge: {publishes: {depth: [image]}}
"""
SYSTEM = load_text(SOURCE, name="cameras", format=None)
MODEL = StoredModel("cameras", "v1", 1, "component", SOURCE, 0, "test")
ATOMS = (
    Atom("running", ("left",)),
    Atom("running", ("merge",)),
    Atom("ok", ("image",)),
    Atom("ok", ("depth",)),
)
OBSERVED = tuple(map(str, ATOMS[:2]))  # of the topics nobody promised to report them
S = 10**9

reports = st.tuples(st.just("report"), st.sampled_from(ATOMS), st.booleans(), st.sampled_from([1 * S, 3 * S]))
steps = st.one_of(
    reports,
    reports,
    st.tuples(st.just("lapse"), st.integers(1, 4)),
    st.tuples(st.just("diagnose")),
    st.tuples(st.just("act"), st.sampled_from(ATOMS)),
)


async def never(robot: str) -> Robot:
    raise AssertionError(robot)


class World:
    """A robot in memory, and what is true of it, kept apart."""

    def __init__(self) -> None:
        config = {"model": "cameras", "observed": list(OBSERVED)}
        self.robot = Robot(StoredRobot("r1", config, "e1", 0, 0), MODEL, SYSTEM, never)
        self.robot.read(self.robot.stored, MODEL, SYSTEM, StoredObs(0, (), ()), (), None, {})
        self.now_ns = 1_000 * S
        self.said: dict[Atom, tuple[bool, int]] = {}  # the last word, and until when it counts
        self.judged: frozenset[Literal] = frozenset()  # what the present diagnosis is of
        self.acted: dict[Atom, int] = {}  # and nobody has spoken of it since
        self.blames = False
        for atom in ATOMS:
            self.do("report", atom, True, None)
        self.do("diagnose")

    def alive(self) -> frozenset[Literal]:
        return frozenset(Literal(a, sign) for a, (sign, until) in self.said.items() if self.now_ns < until)

    def do(self, what: str, *how: object) -> None:
        self.now_ns += S // 10
        match what, how:
            case "report", (Atom() as atom, bool() as sign, int() | None as lives_ns):
                until = None if lives_ns is None else self.now_ns + lives_ns
                entry = Entry(Literal(atom, sign), "test", self.now_ns, until, self.now_ns, None)
                if self.robot.apply(Update([entry])).changed:
                    writing = self.robot.accepted()
                    self.robot.kept(writing, self.robot.head, repeated=False)
                self.said[atom] = (sign, 2**63 if until is None else until)
                self.acted.pop(atom, None)
            case "lapse", (int() as seconds,):
                self.now_ns += seconds * S
            case "diagnose", ():
                self.diagnose()
            case "act", (Atom() as atom,):
                self.robot.sight.acted(set(), self.now_ns, [atom], self.now_ns)
                if atom in self.said:
                    self.acted[atom] = self.now_ns

    def diagnose(self) -> None:
        self.judged = frozenset(self.robot.literals())
        engine = make_engine("sat", SYSTEM.cnf)
        try:
            result = ask_engine(engine, SYSTEM.cnf, self.judged, Options())
        finally:
            engine.close()
        self.blames = not result.healthy
        bad = [{"bad": list(one.bad)} for one in result.diagnoses]
        data = {"result": {"diagnoses": bad}, "model_version": MODEL.version}
        self.robot.is_diagnosed(Current.published(self.robot.revision, self.now_ns, data))


@given(st.lists(steps, max_size=30))
def test_healthy_is_only_said_over_what_is_alive_judged_and_seen_since_the_last_act(
    walk: list[tuple[object, ...]],
) -> None:
    world = World()
    with patch.object(CLOCK, "now_ns", lambda: world.now_ns):
        for what, *how in walk:
            world.do(str(what), *how)
            state, unknown = health_of(world.robot)
            end, reason = nobody_blamed(world.robot, {"rounds": [{"plan": [{"sent_ns": 1}]}]})
            alive = world.alive()
            lapsed = {atom for atom in world.said if not {Literal(atom, True), Literal(atom, False)} & alive}
            new_and_bad = {one for one in alive - world.judged if not one.positive}
            assert (end is RepairTrigger.HEALTHY) == (state is HealthState.HEALTHY)
            if state is HealthState.HEALTHY:
                assert not world.blames
                assert lapsed | new_and_bad | world.acted.keys() == set()
            elif state is not HealthState.UNHEALTHY and world.robot.current is not None:
                assert lapsed or new_and_bad or world.acted or not alive
            assert lapsed | world.acted.keys() <= set(unknown) or state is HealthState.UNHEALTHY
            if end is RepairTrigger.UNSEEN:
                bad = {str(Literal(atom, False)) for atom in lapsed if not world.said[atom][0]}
                assert all(one in reason for one in bad)


def test_a_robot_of_which_all_is_known_to_be_well_is_healthy() -> None:
    world = World()
    with patch.object(CLOCK, "now_ns", lambda: world.now_ns):
        assert health_of(world.robot) == (HealthState.HEALTHY, ())
        assert nobody_blamed(world.robot, {})[0] is RepairTrigger.HEALTHY


def test_what_is_reported_and_not_judged_yet_is_not_called_unobserved() -> None:
    world = World()
    world.do("report", Atom("ok", ("image",)), False, None)
    with patch.object(CLOCK, "now_ns", lambda: world.now_ns):
        told = of_robot(world.robot, None).text(world.now_ns)
    assert told.startswith("No fault is known, and what was observed is not judged yet.")
