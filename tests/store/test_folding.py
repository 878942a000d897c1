"""OBS is rows, and batches of the log that came since: who reads it finds what was accepted, always."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.store.examples import entry, observe, with_robots

from robomend.entry import Entry
from robomend.observations.obs import Obs, consequences
from robomend.store import Store, Transaction, events, folding, observations, robots
from robomend.store.encoding import Encoded, atom_to_text
from robomend_client.events import Event
from robomend_client.literals import Atom, Literal
from robomend_client.readings import Reading, Symptom

pytestmark = pytest.mark.anyio

EXAMPLE = itertools.count()
READINGS = [Reading(1.5, "V", symptom=Symptom.VALUE), Reading('ü "text" <b>'), None, None]
ATOMS = [Atom("ok", ("scan",)), Atom("on", ("laser",)), Atom("inc", ("yaw",)), Atom("dec", ("yaw",))]


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every third batch brings the rows up to the log, and five entries are a large batch."""
    monkeypatch.setattr(folding, "EVERY", 3)
    monkeypatch.setattr(folding, "LARGE", 4)


@dataclass(frozen=True)
class Step:
    """A batch, a renewal of lifetimes, or somebody who brings the rows up to the log."""

    what: str  # batch, renew, bring-up
    literals: tuple[tuple[int, bool], ...]
    forgotten: tuple[int, ...]
    source: str


STEPS = st.lists(
    st.builds(
        Step,
        st.sampled_from(["batch", "batch", "batch", "renew", "bring-up"]),
        st.lists(st.tuples(st.integers(0, 3), st.booleans()), max_size=3).map(tuple),
        st.lists(st.integers(0, 3), max_size=1).map(tuple),
        st.sampled_from(["a", "a", "b"]),
    ),
    max_size=14,
)


async def accept(store: Store, robot: str, obs: Obs, step: Step, time_ns: int) -> None:
    """Take a batch into OBS, and write it as a robot does."""
    given = [
        Entry(Literal(ATOMS[n], sign), step.source, time_ns, time_ns + 9, reading=READINGS[n])
        for n, sign in step.literals
    ]
    changed = obs.update(given)
    new = {one.atom for one in changed}
    renewed = {
        one.atom: one
        for each in given
        for one in consequences(each)
        if one.atom not in new and obs.get(one.atom) == one
    }
    renewed |= {atom: held for atom in obs.several_of(given) - new if (held := obs.get(atom))}
    forgotten = [ATOMS[n] for n in step.forgotten]
    obs.forget(forgotten)

    def batch(tx: Transaction) -> int:
        return observations.observe(
            tx, robot, accepted=given, changed=changed, renewed=[*renewed.values()], forgotten=forgotten
        )

    await store.write(batch, robots=(robot,))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=STEPS)
async def test_obs_is_what_was_accepted(store: Store, second: Store, often: None, steps: list[Step]) -> None:
    robot, obs = f"r{next(EXAMPLE)}", Obs()
    await with_robots(store, robot)
    for time_ns, step in enumerate(steps, 1):
        who = (store, second)[time_ns % 2]
        if step.what == "bring-up":
            await who.write(lambda tx: tx.bring_up(robot))
        elif step.what == "batch":
            await accept(who, robot, obs, step, time_ns)
        else:
            held = [replace(one, expires_ns=time_ns + 99) for one in obs.entries()]
            # Else it may be more than a renewal.
            held = [one for one in held if consequences(one) == (one,) and not one.by_source]
            obs.update(held)
            at = await who.read(observations.revision, robot)

            def renew(tx: Transaction, held: list[Entry] = held, at: int = at) -> bool:
                return observations.renew(tx, robot, held, expected=at)

            assert await who.write(renew, robots=(robot,))
        kept = (await store.read(observations.obs, robot)).entries
        assert {one.atom: (one, one.by_source) for one in kept} == {
            one.atom: (one, one.by_source) for one in obs.entries()
        }
        assert [*kept] == sorted(kept, key=lambda one: atom_to_text(one.atom))


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=STEPS)
async def test_the_log_tells_what_was_told(store: Store, often: None, steps: list[Step]) -> None:
    robot, obs, told = f"r{next(EXAMPLE)}", Obs(), list[Event]()
    await with_robots(store, robot)
    before = (await store.read(events.kept)).newest
    end = store.subscribe(told.extend)
    for time_ns, step in enumerate(steps, 1):
        await accept(store, robot, obs, step, time_ns)
    end()
    log = await store.read(events.after, before)
    assert [*log] == told
    for event, live in zip(log, told, strict=True):
        assert isinstance(event.data, Encoded)
        assert isinstance(live.data, Encoded)
        assert event.data.text == live.data.text
    assert await store.read(events.after, before, robot=robot) == log


async def test_what_was_known_of_a_robot_that_is_made_again_is_gone(store: Store) -> None:
    await with_robots(store, "r1")
    await observe(store, "r1", entry("scan"), entry("odom"))
    await store.write(lambda tx: robots.delete(tx, "r1"))
    await with_robots(store, "r1")
    obs = await store.read(observations.obs, "r1")
    assert (obs.revision, obs.entries) == (1, ())
    await observe(store, "r1", entry("map"))
    obs = await store.read(observations.obs, "r1")
    assert (obs.revision, [one.atom.args for one in obs.entries]) == (2, [("map",)])


async def test_a_robot_that_is_deleted_and_made_again_in_one_group_keeps_what_came_after(
    store: Store,
) -> None:
    await with_robots(store, "r1")
    await observe(store, "r1", entry("scan"))

    def anew(tx: Transaction) -> int:
        observations.observe(tx, "r1", accepted=[entry("late")], changed=[entry("late")])
        robots.delete(tx, "r1")
        robots.put(tx, "r1", {"model": "tedusar"}, expected=None)
        return observations.observe(tx, "r1", accepted=[entry("map")], changed=[entry("map")])

    assert await store.write(anew) == 3
    await store.write(lambda tx: tx.bring_up("r1"))
    obs = await store.read(observations.obs, "r1")
    assert (obs.revision, [one.atom.args for one in obs.entries]) == (3, [("map",)])
