"""What is held of a robot: only listed transitions, by its own methods, and never a lie about the disk."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from tests.examples import examples

from robomend.model.loading import load_text
from robomend.robots.diagnoser import Current
from robomend.robots.robot import HELD, SEARCH, Held, Robot, Search, SearchTrigger, Writing
from robomend.store.records import StoredModel, StoredObs, StoredRobot
from robomend.transitions import NoTransition

SOURCE = "robomend: 1\nname: m\nnodes: {n: {publishes: {t: []}}}\n"
SYSTEM = load_text(SOURCE, name="m", format=None)
MODEL = StoredModel("m", "v1", 1, "component", SOURCE, 0, "test")
STORED = StoredRobot("r1", {"model": "m"}, "e1", 0, 0)


class Task:
    """What a robot needs of the task of a diagnosis."""

    cancelled = False

    def cancel(self) -> None:
        self.cancelled = True


class Life(RuleBasedStateMachine):
    """A robot in memory beside a store that others write to as well: which batches each of them has."""

    @initialize()
    def begin(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.robot = Robot(STORED, MODEL, SYSTEM, self.never)
        self.disk: list[int] = []  # batches; as many as its revision
        self.memory: list[int] = []
        self.queue: list[tuple[Writing, int, int]] = []  # writes under way: revision expected, batch
        self.batches = 0
        self.tasks: list[Task] = []
        self.asked = self.begun = 0  # changes to be diagnosed, and those that a diagnosis has read
        self.read()

    async def never(self, robot: str) -> Robot:
        raise AssertionError("not read by itself")

    def teardown(self) -> None:
        if hasattr(self, "loop"):
            self.loop.close()

    @precondition(lambda self: not self.robot.gone)
    @rule()
    def read(self) -> None:
        self.robot.read(STORED, MODEL, SYSTEM, StoredObs(len(self.disk)), (), None, {})
        self.memory = list(self.disk)
        assert not self.robot.stale
        assert self.robot.head == len(self.disk)

    @rule()
    def take_in(self) -> None:
        before = self.robot.head
        self.batches += 1
        self.memory.append(self.batches)
        self.queue.append((self.robot.accepted(), before, self.batches))

    @precondition(lambda self: self.queue)
    @rule(repeated=st.booleans())
    def the_store_takes_the_oldest_write_or_refuses_it(self, repeated: bool) -> None:
        writing, expected, batch = self.queue.pop(0)
        if repeated:  # its key was used before
            self.robot.kept(writing, len(self.disk), repeated=True)
        elif self.robot.gone or expected != len(self.disk):
            self.robot.not_kept()
        else:
            self.disk.append(batch)
            self.robot.kept(writing, len(self.disk), repeated=False)

    @rule()
    def another_instance_writes(self) -> None:
        if not self.robot.gone:
            self.batches += 1
            self.disk.append(self.batches)
            self.robot.changed_elsewhere()

    @precondition(lambda self: not self.robot.gone)
    @rule()
    def delete(self) -> None:
        self.robot.deleted()
        assert all(task.cancelled for task in self.tasks[-1:])

    @rule()
    def wake(self) -> None:
        def start() -> Any:
            self.tasks.append(Task())
            return self.tasks[-1]

        before = len(self.tasks)
        under_way = self.robot.diagnosing
        self.robot.woken(start)
        self.asked += 1
        assert len(self.tasks) == before + (not under_way)
        assert self.robot.diagnosing

    @precondition(lambda self: self.robot.diagnosing)
    @rule()
    def a_diagnosis_reads_obs_and_comes(self) -> None:
        self.robot.diagnosis_began()
        self.begun = self.asked
        self.robot.diagnosis_came()
        assert not self.robot.diagnosing

    @precondition(lambda self: self.robot.diagnosing)
    @rule()
    def something_changes_while_a_diagnosis_is_made(self) -> None:
        self.robot.diagnosis_began()
        self.begun = self.asked
        self.wake()
        self.robot.diagnosis_came()
        assert self.robot.diagnosing  # once more

    @precondition(lambda self: self.robot.diagnosing)
    @rule()
    def a_diagnosis_fails(self) -> None:
        self.robot.diagnosis_gave_up()
        self.begun = self.asked  # a timer wakes it again

    @rule(revision=st.integers(0, 5))
    def a_diagnosis_is_published(self, revision: int) -> None:
        current = Current(revision, "v1", 0, {"diagnoses": [], "elapsed_s": 0.0}, None, None)
        newest = -1 if self.robot.current is None else self.robot.current.revision
        self.robot.is_diagnosed(current)
        assert self.robot.current is not None
        assert self.robot.current.revision == max(newest, revision)

    @invariant()
    def a_fresh_robot_with_nothing_on_the_way_is_what_is_on_disk(self) -> None:
        if hasattr(self, "robot") and not (self.robot.stale or self.robot.gone or self.queue):
            assert self.memory == self.disk
            assert self.robot.revision == self.robot.head == len(self.disk)

    @invariant()
    def no_change_is_left_undiagnosed(self) -> None:
        if hasattr(self, "robot"):
            assert self.robot.diagnosing or self.begun == self.asked


Life.TestCase.settings = settings(examples(200), stateful_step_count=30)
test_a_robots_life = Life.TestCase


def test_a_deleted_robot_is_never_read_again() -> None:
    robot = Robot(STORED, MODEL, SYSTEM, _unused)
    robot.read(STORED, MODEL, SYSTEM, StoredObs(0), (), None, {})
    robot.deleted()
    with pytest.raises(NoTransition, match="gone: READ"):
        robot.read(STORED, MODEL, SYSTEM, StoredObs(0), (), None, {})


def test_nothing_leads_out_of_gone_and_every_state_can_be_reached() -> None:
    assert {then for (state, _), then in HELD.items() if state is Held.GONE} == {Held.GONE}
    assert {then for _, then in HELD.items()} | {Held.UNREAD} == set(Held)
    assert {then for _, then in SEARCH.items()} == set(Search)
    assert {trigger for _, trigger in SEARCH} == set(SearchTrigger)


async def _unused(robot: str) -> Robot:
    raise AssertionError(robot)
