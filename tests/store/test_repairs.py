"""Repairs, the action journal, memory, quarantine, the agents' queue, keys, audit and the stop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection
from functools import partial
from operator import eq

import pytest
from tests.store.examples import with_robots

from robomend.errors import Fenced, NotFound, StateConflict
from robomend.store import (
    Store,
    Transaction,
    agent_actions,
    api_keys,
    attempts,
    drills,
    journal,
    models,
    repairs,
    robots,
)
from robomend.store.records import (
    AgentAction,
    Fence,
    Intent,
    Quarantine,
    StoredAttempt,
    StoredRepair,
)

pytestmark = pytest.mark.anyio


async def own(store: Store, robot: str = "r1") -> Fence:
    await with_robots(store, robot)
    fence = await store.ownership.acquire(robot)
    assert fence is not None
    return fence


async def test_an_answer_to_a_request_about_a_drill_leaves_a_newer_one_in_its_place(store: Store) -> None:
    fence = await own(store)
    drill = await store.write(lambda tx: drills.create(tx, "r1", state="planting", data={}))
    asked = []
    for what in ("cancel", "abandon"):
        found = await store.write(partial(drills.ask, drill=drill.id, what=what, by="ada", reason=""))
        asked.append(found.asked)
    update = partial(drills.update, drill=drill.id, state="undoing", data={}, open=True, watched=False)
    for answered, left in zip(asked, (asked[1], None), strict=True):
        write = partial(update, fence=fence, answered=partial(eq, answered))
        assert (await store.write(write, robots=("r1",))).asked == left


async def begin(store: Store, fence: Fence) -> StoredRepair:
    return await store.write(
        lambda tx: repairs.create(tx, fence.robot, state="running", data={"plan": [1, 2]}, fence=fence)
    )


async def intend(store: Store, repair: StoredRepair, step: int, fence: Fence) -> Intent:
    return await store.write(
        lambda tx: journal.intend(
            tx,
            repair.id,
            step,
            action=f"{repair.id}:{step}",
            name="power_up",
            parameters=["jaguar"],
            timeout_s=10.0,
            fence=fence,
        ),
        robots=(fence.robot,),
    )


async def test_every_write_about_a_repair_is_refused_with_an_old_fence(store: Store) -> None:
    old = await own(store)
    repair = await begin(store, old)
    await intend(store, repair, 0, old)
    request = await store.write(lambda tx: repairs.ask(tx, repair.id, "cancel", by="ada", reason="smoke"))
    await store.ownership.release("r1")
    assert await store.ownership.acquire("r1") == Fence("r1", old.number + 1)
    tried = StoredAttempt("r1", ("jaguar",), ("power_up(jaguar)",), False, True, repair.id, 1)
    quarantine = Quarantine("r1", "jaguar", "failed 3 times", 3, 1, None)
    writes: list[Callable[[Transaction], object]] = [
        lambda tx: repairs.create(tx, "r1", state="running", data={}, fence=old),
        lambda tx: repairs.update(tx, repair.id, state="failed", data={}, open=False, fence=old),
        lambda tx: repairs.put_step(tx, repair.id, 0, state="done", data={}, fence=old),
        lambda tx: journal.settle(tx, f"{repair.id}:0", 0, fence=old),
        lambda tx: attempts.remember(tx, tried, fence=old),
        lambda tx: attempts.put_quarantine(tx, quarantine, fence=old),
        lambda tx: attempts.count(tx, "r1", "jaguar", repair.id, fence=old),
        lambda tx: repairs.answer(tx, request.number, fence=old),
    ]
    for write in writes:
        with pytest.raises(Fenced):
            await store.write(write)
    with pytest.raises(Fenced):
        await intend(store, repair, 1, old)
    assert (await store.read(repairs.get, repair.id)) == repair


async def test_a_fence_gives_no_right_to_another_robot(store: Store) -> None:
    fence, other = await own(store, "r1"), await own(store, "r2")
    repair = await begin(store, other)
    assert fence.number == other.number
    with pytest.raises(Fenced):
        await intend(store, repair, 0, fence)


def remember(attempt: StoredAttempt, fence: Fence, tx: Transaction) -> None:
    attempts.remember(tx, attempt, fence=fence)


async def test_what_was_tried_on_other_robots_of_the_model_is_read_a_few_of_each_and_no_drills(
    store: Store,
) -> None:
    fences = {robot: await own(store, robot) for robot in ("r1", "r2", "r3")}

    def attempt(robot: str, number: int, **data: object) -> StoredAttempt:
        return StoredAttempt(robot, ("jaguar",), (), False, True, None, number, data)

    await store.write(lambda tx: models.put(tx, "other", "x: 1", format="five", by="t", expected=None))
    await store.write(lambda tx: robots.put(tx, "r4", {"model": "other"}, expected=None))
    fence = await store.ownership.acquire("r4")
    assert fence is not None
    await store.write(partial(remember, attempt("r4", 0), fence))
    for number in range(attempts.EACH + 3):
        await store.write(partial(remember, attempt("r2", number), fences["r2"]))
    await store.write(partial(remember, attempt("r1", 1), fences["r1"]))
    await store.write(partial(remember, attempt("r3", 1, drill="d-1"), fences["r3"]))
    await store.write(partial(remember, attempt("r3", 2), fences["r3"]))
    found = await store.read(lambda view: attempts.of_fleet(view, "r1"))
    newest = [attempt("r2", number) for number in range(attempts.EACH + 2, 2, -1)]
    assert found == (attempt("r3", 2), *newest)


async def test_many_drills_do_not_crowd_out_what_was_tried_of_real_faults(store: Store) -> None:
    fence = await own(store)

    def attempt(number: int, drill: str | None) -> StoredAttempt:
        of_drill = {} if drill is None else {"drill": drill}
        return StoredAttempt("r1", ("jaguar",), (), False, True, None, number, of_drill)

    real = [attempt(number, None) for number in range(3)]
    drilled = [attempt(number, f"d-{number % 2}") for number in range(120)]
    for each in (*real, *drilled):
        await store.write(partial(remember, each, fence))
    assert await store.read(attempts.tried, "r1") == tuple(reversed(real))
    of_one = await store.read(lambda view: attempts.tried(view, "r1", drill="d-1"))
    assert of_one == (*reversed(drilled[1::2]), *reversed(real))


async def queue(store: Store, action: str, host: str | None = None, timeout_s: float = 60.0) -> AgentAction:
    return await store.write(
        lambda tx: agent_actions.queue(
            tx, action, "r1", host=host, name="start_node", parameters=["imu_node"], timeout_s=timeout_s
        )
    )


async def take(
    store: Store, agent: str, host: str | None = None, can: Collection[str] | None = None
) -> str | None:
    action = await store.write(lambda tx: agent_actions.take(tx, "r1", host=host, agent=agent, can=can))
    return None if action is None else action.id


async def test_an_action_is_handed_out_until_its_first_answer(store: Store) -> None:
    await with_robots(store, "r1")
    assert await take(store, "a") is None
    first = await queue(store, "r-1:0")
    assert await queue(store, "r-1:0") == first
    await queue(store, "r-1:1")
    assert [await take(store, "a"), await take(store, "a")] == ["r-1:0", "r-1:0"]
    assert await take(store, "b") == "r-1:1"
    await store.write(lambda tx: agent_actions.answer(tx, "r-1:0"))
    assert await take(store, "a") is None
    assert {a.id for a in await store.read(agent_actions.waiting, "r1")} == {"r-1:0", "r-1:1"}
    done = await store.write(lambda tx: agent_actions.finish(tx, "r-1:0", 0, "started"))
    assert await store.write(lambda tx: agent_actions.finish(tx, "r-1:0", 1, "again")) == done
    with pytest.raises(StateConflict):
        await store.write(lambda tx: agent_actions.answer(tx, "r-1:0"))
    with pytest.raises(NotFound):
        await store.write(lambda tx: agent_actions.finish(tx, "r-9:9", 0, ""))
    assert await queue(store, "r-1:0") == done


async def test_an_action_goes_to_its_host_and_not_after_its_time(store: Store) -> None:
    await with_robots(store, "r1")
    await queue(store, "late", timeout_s=0.0)
    await queue(store, "arm", host="arm")
    await queue(store, "any")
    assert await take(store, "agent-base", "base") == "any"
    assert await take(store, "agent-arm", "arm") == "arm"
    withdrawn = await store.write(lambda tx: agent_actions.withdraw(tx, "arm", 5, "cancelled"))
    assert (withdrawn.code, withdrawn.answered) == (5, False)
    assert await take(store, "agent-arm", "arm") is None
    await store.write(lambda tx: agent_actions.answer(tx, "any"))
    with pytest.raises(StateConflict):
        await store.write(lambda tx: agent_actions.withdraw(tx, "any", 5, "cancelled"))


async def test_an_action_goes_past_agents_that_cannot_do_it(store: Store) -> None:
    await with_robots(store, "r1")
    await queue(store, "first")
    await store.write(
        lambda tx: agent_actions.queue(
            tx, "spare", "r1", host=None, name="switch_to_spare", parameters=["a", "b"], timeout_s=60.0
        )
    )
    assert await take(store, "bridge", can={"switch_to_spare:a"}) is None  # two parameters: by name alone
    assert await take(store, "bridge", can={"switch_to_spare"}) == "spare"
    await store.write(
        lambda tx: agent_actions.queue(
            tx, "d", "r1", host=None, name="undo_fault", parameters=["laser", "x"], timeout_s=60.0
        )
    )
    assert await take(store, "other", can={"undo_fault:arm"}) is None  # a drill's: by the component
    assert await take(store, "bridge", can={"undo_fault:laser"}) == "d"
    assert await take(store, "other", can={"start_node:laser", "stop_node:imu_node"}) is None
    assert await take(store, "other", can={"start_node:imu_node"}) == "first"


async def test_an_agent_that_vanished_loses_its_action_to_another(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    await with_robots(store, "r1")
    await queue(store, "x")
    assert await take(store, "gone") == "x"
    assert await take(store, "other") is None
    later = time.time_ns() + 6_000_000_000
    monkeypatch.setattr("time.time_ns", lambda: later)
    assert await take(store, "other") == "x"


async def test_two_agents_never_take_one_action(store: Store) -> None:
    await with_robots(store, "r1")
    for number in range(20):
        await queue(store, f"x:{number}")
    taken = await asyncio.gather(*(take(store, f"agent-{number}") for number in range(20)))
    assert len(set(taken)) == 20


async def test_a_key_has_a_name_of_its_own_while_it_is_in_use_and_is_revoked_for_good(store: Store) -> None:
    key = await store.write(
        lambda tx: api_keys.add(tx, name="k", hash="h1", role="robot", robot="r1", by="ada")
    )
    assert await store.read(api_keys.every) == (key,)
    with pytest.raises(StateConflict):
        await store.write(
            lambda tx: api_keys.add(tx, name="k", hash="h2", role="viewer", robot=None, by="ada")
        )
    revoked = await store.write(lambda tx: api_keys.revoke(tx, key.id))
    assert revoked.revoked_ns is not None
    assert await store.write(lambda tx: api_keys.revoke(tx, key.id)) == revoked
    again = await store.write(
        lambda tx: api_keys.add(tx, name="k", hash="h2", role="viewer", robot=None, by="ada")
    )
    assert await store.read(api_keys.every) == (revoked, again)
    with pytest.raises(NotFound):
        await store.write(lambda tx: api_keys.revoke(tx, "k-none"))


async def test_the_newest_repair_of_each_robot_is_found_for_many_at_once(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(repairs, "AT_ONCE", 2)
    begun: dict[str, str] = {}
    for robot in ("r1", "r2", "r3"):
        fence = await own(store, robot)
        for _ in range(2):
            begun[robot] = (await begin(store, fence)).id
    await own(store, "idle")
    asked = ("r1", "r2", "r3", "idle", "nobody")
    found = await store.read(repairs.newest, asked)
    assert {robot: repair.id for robot, repair in found.items()} == begun
    assert await store.read(repairs.newest, ()) == {}
