"""Changes that share a transaction behave as if each had its own: compared with a model in plain Python."""

from __future__ import annotations

import asyncio
import itertools
from dataclasses import dataclass, field
from functools import partial

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.store.examples import entry, with_robots

from robomend.entry import Entry
from robomend.store import Store, Transaction, View, diagnoses, events, observations, robots
from robomend.store.records import IdempotencyKey, StoredAssertion
from robomend_client.literals import Literal

pytestmark = pytest.mark.anyio

NAMES = ("scan", "odom", "map")
EXAMPLE = itertools.count()


@dataclass(frozen=True)
class Step:
    """One call within a change."""

    what: str  # observe, forget, assert, read or diagnose
    name: str
    positive: bool = True


@dataclass(frozen=True)
class Change:
    """What one `write` does to a robot, whether it fails at its end, and its idempotency key."""

    robot: int
    steps: tuple[Step, ...]
    fails: bool
    key: int | None


@dataclass
class Oracle:
    """What the store should hold of one robot."""

    revision: int = 0
    obs: dict[str, bool] = field(default_factory=dict)
    assertions: set[str] = field(default_factory=set)
    diagnoses: list[int] = field(default_factory=list)
    emitted: int = 0

    def apply(self, change: Change) -> int:
        for step in change.steps:
            if step.what in {"observe", "forget", "assert"}:
                self.revision += 1
            if step.what != "read":
                self.emitted += 1
            if step.what == "observe":
                self.obs[step.name] = step.positive
            elif step.what == "forget":
                self.obs.pop(step.name, None)
            elif step.what == "assert":
                self.assertions.add(step.name)
            elif step.what == "diagnose":
                self.diagnoses.append(self.revision)
        return self.revision


STEPS = st.builds(
    Step,
    st.sampled_from(["observe", "observe", "observe", "forget", "assert", "read", "diagnose"]),
    st.sampled_from(NAMES),
    st.booleans(),
)
CHANGES = st.builds(
    Change,
    st.integers(0, 1),
    st.lists(STEPS, max_size=4).map(tuple),
    st.sampled_from([False, False, False, True]),
    st.sampled_from([None, None, 0, 1]),
)


class Failed(Exception):
    """The failure of a change that is meant to fail."""


def run(tx: Transaction, robot: str, change: Change) -> int:
    for step in change.steps:
        atom = entry(step.name).atom
        if step.what == "observe":
            entries = [Entry(Literal(atom, step.positive), "test", 1)]
            observations.observe(tx, robot, accepted=entries, changed=entries)
        elif step.what == "forget":
            observations.observe(tx, robot, forgotten=[atom])
        elif step.what == "assert":
            observations.observe(tx, robot, asserted=[StoredAssertion(step.name, "true", "test", 1)])
        elif step.what == "read":
            robots.page(tx)
        elif step.what == "diagnose":
            diagnoses.record(tx, robot, observations.revision(tx, robot), {})
    if change.fails:
        raise Failed
    return observations.revision(tx, robot)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=st.lists(CHANGES, max_size=12))
async def test_a_group_is_as_good_as_one_after_the_other(store: Store, changes: list[Change]) -> None:
    number = next(EXAMPLE)
    robots = [f"r{number}-{index}" for index in range(2)]
    await with_robots(store, *robots)
    first = (await store.read(events.kept)).newest + 1

    oracles = [Oracle(), Oracle()]
    answers: dict[int, int] = {}
    expected: list[int | None] = []
    for change in changes:
        if change.key is not None and change.key in answers:
            expected.append(answers[change.key])
        elif change.fails:
            expected.append(None)
        else:
            expected.append(oracles[change.robot].apply(change))
            if change.key is not None:
                answers[change.key] = oracles[change.robot].revision

    async def write(change: Change) -> int | None:
        robot = robots[change.robot]
        once = None if change.key is None else IdempotencyKey(f"{number}", str(change.key), "same")
        try:
            return await store.write(lambda tx: run(tx, robot, change), robots=(robot,), once=once)
        except Failed:
            return None

    assert await asyncio.gather(*map(write, changes)) == expected
    for robot, oracle in zip(robots, oracles, strict=True):
        await store.read(partial(check, robot, oracle))
    log = await store.read(events.after, first - 1, limit=1000)
    total = sum(oracle.emitted for oracle in oracles)
    assert [event.id for event in log] == list(range(first, first + total))


def check(robot: str, oracle: Oracle, db: View) -> None:
    obs = observations.obs(db, robot)
    assert obs.revision == oracle.revision
    assert {e.atom.args[0]: e.positive for e in obs.entries} == oracle.obs
    assert {a.name for a in obs.assertions} == oracle.assertions
    history, kept = observations.history(db, robot).items, diagnoses.page(db, robot).items
    assert [batch.revision for batch in history] == list(range(oracle.revision, 0, -1))
    assert [diagnosis.revision for diagnosis in kept] == oracle.diagnoses[::-1]
