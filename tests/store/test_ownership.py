"""One owner per robot: fences, takeover after a death, and an owner that was wrongly taken for dead."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sqlite3
import subprocess
import time

import psycopg
import pytest
from tests.postgres import PostgresServer
from tests.store.examples import owner, with_robots
from tests.store.instance import instance, next_line
from tests.waiting import eventually

from robomend.errors import Fenced, NotFound
from robomend.store import Store, journal, repairs
from robomend.store.ownership import BEAT_S, own
from robomend.store.records import Fence
from robomend.store.transaction import CHANNEL

pytestmark = pytest.mark.anyio


async def test_a_robot_has_one_owner(store: Store, second: Store) -> None:
    await with_robots(store, "r1", "r2")
    assert await store.ownership.orphans() == ("r1", "r2")
    fence = await store.ownership.acquire("r1")
    assert fence == Fence("r1", 1)
    assert await store.ownership.acquire("r1") == fence
    assert await second.ownership.acquire("r1") is None
    assert await second.ownership.orphans() == ("r2",)
    assert store.ownership.held == {"r1": fence}
    assert await store.read(owner, "r1") == (store.ownership.instance, 1)
    with pytest.raises(NotFound):
        await store.ownership.acquire("nobody")


async def test_of_many_who_try_at_once_one_gets_it(store: Store, second: Store) -> None:
    await with_robots(store, "r1")
    tries = [who.ownership.acquire("r1") for _ in range(5) for who in (store, second)]
    fences = {fence for fence in await asyncio.gather(*tries) if fence is not None}
    assert len(fences) == 1


async def test_a_released_robot_goes_on_with_a_higher_fence(store: Store, second: Store) -> None:
    await with_robots(store, "r1")
    await store.ownership.acquire("r1")
    await store.ownership.release("r1")
    await store.ownership.release("r1")
    assert await second.ownership.acquire("r1") == Fence("r1", 2)
    assert await store.ownership.acquire("r1") is None


async def test_closing_a_store_frees_its_robots(store: Store, second: Store) -> None:
    await with_robots(store, "r1")
    await second.ownership.acquire("r1")
    await second.close()
    assert await store.ownership.acquire("r1") == Fence("r1", 2)


async def test_instances_are_listed_while_they_run(store: Store, second: Store) -> None:
    async with asyncio.timeout(60):
        while len(await store.ownership.instances()) < 2:
            await asyncio.sleep(0.01)
    found = {i.id for i in await store.ownership.instances()}
    assert found == {store.ownership.instance, second.ownership.instance}
    await second.close()
    assert [i.id for i in await store.ownership.instances()] == [store.ownership.instance]


async def test_the_robots_of_a_killed_process_are_taken_over_with_its_repairs(store: Store, url: str) -> None:
    await with_robots(store, "r1")
    with instance(url, "own") as process:
        number, repair = (await asyncio.to_thread(next_line, process)).split()
        assert await store.ownership.acquire("r1") is None
        process.kill()
        process.wait(60)
        async with asyncio.timeout(60):
            while "r1" not in await store.ownership.orphans():
                await asyncio.sleep(0.05)
        fence = await store.ownership.acquire("r1")
    assert fence == Fence("r1", int(number) + 1)
    assert [r.id for r in (await store.read(repairs.page, "r1", open_only=True)).items] == [repair]
    assert [intent.id for intent in await store.read(journal.unsettled, "r1")] == [f"{repair}:0"]
    settled = await store.write(lambda tx: journal.settle(tx, f"{repair}:0", 3, "nobody knows", fence=fence))
    assert settled.fence == int(number)


def hangs_in_a_write(process: subprocess.Popen[bytes], url: str, hang: signal.Signals) -> bool:
    """Let a process hang; return whether it keeps all others from writing: SQLite has one lock."""
    process.send_signal(hang)
    if not url.startswith("sqlite"):
        return False
    with contextlib.closing(sqlite3.connect(url.removeprefix("sqlite:///"), timeout=1.0)) as connection:
        try:
            connection.execute("BEGIN IMMEDIATE").close()
        except sqlite3.OperationalError:
            return True
        connection.rollback()
        return False


@pytest.mark.parametrize(
    ("hang", "wake"),
    [(signal.SIGSTOP, signal.SIGCONT), (signal.SIGUSR1, signal.SIGUSR2)],
    ids=["stopped", "event loop held"],
)
async def test_an_owner_that_hangs_is_replaced_and_does_not_act_when_it_wakes(
    store: Store, url: str, hang: signal.Signals, wake: signal.Signals
) -> None:
    await with_robots(store, "r1")
    with instance(url, "act") as process:
        assert (await asyncio.to_thread(next_line, process)).startswith("acts")
        assert "r1" not in await store.ownership.orphans()
        while await asyncio.to_thread(hangs_in_a_write, process, url, hang):
            process.send_signal(wake)
        fence = None
        async with asyncio.timeout(
            60
        ):  # a busy computer may let it seem dead, and alive again, before it hangs
            while fence is None:
                await asyncio.sleep(0.05)
                if "r1" in await store.ownership.orphans():
                    fence = await store.ownership.acquire("r1")
        taken_s = time.clock_gettime(time.CLOCK_BOOTTIME)
        assert fence == Fence("r1", 2)
        process.send_signal(wake)
        while (line := await asyncio.to_thread(next_line, process)) != "fenced":
            assert float(line.split()[1]) < taken_s, "it acted although the robot was another's"
        await store.ownership.confirm(fence)  # we may


async def test_who_slept_reads_its_fence_before_it_acts(store: Store, second: Store) -> None:
    await with_robots(store, "r1", "r2")
    mine, taken = await store.ownership.acquire("r1"), await store.ownership.acquire("r2")
    assert mine is not None
    assert taken is not None
    take = second.write(lambda tx: own(tx, "r2", "another", lambda *_: False), robots=("r2",))
    assert await take == Fence("r2", 2)
    lost: asyncio.Queue[Fence] = asyncio.Queue()
    store.ownership.on_lost(lost.put_nowait)
    store.ownership._session.naps += 1  # as after a sleep
    with pytest.raises(Fenced, match=r"taken over|lost"):
        await store.ownership.confirm(taken)
    await store.ownership.confirm(mine)  # nobody wanted it
    assert await asyncio.wait_for(lost.get(), 60) == taken
    assert store.ownership.held == {"r1": mine}


async def test_an_owner_whose_connection_breaks_hears_of_it_and_can_write_no_more(
    postgres_server: PostgresServer, postgres_url: str
) -> None:
    store, second = Store(postgres_url), Store(postgres_url)
    await store.start()
    await second.start()
    try:
        await with_robots(store, "r1")
        old = await store.ownership.acquire("r1")
        assert old is not None
        lost: asyncio.Queue[Fence] = asyncio.Queue()
        store.ownership.on_lost(lost.put_nowait)
        before = store.ownership.instance
        with psycopg.connect(postgres_url, autocommit=True) as admin:
            admin.execute(
                "SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory' AND objid::bigint"
                " = (%s::bit(64)::bigint & 4294967295)",
                (f"{int(before, 16):064b}",),
            )
        assert await asyncio.wait_for(lost.get(), 60) == old
        assert store.ownership.held == {}
        new = await second.ownership.acquire("r1")
        assert new == Fence("r1", old.number + 1)
        with pytest.raises(Fenced):
            await store.write(lambda tx: repairs.create(tx, "r1", state="running", data={}, fence=old))
        await eventually(lambda: store.ownership.instance not in ("", before), "it is another instance")
        assert await store.ownership.acquire("r1") is None
    finally:
        await store.close()
        await second.close()


async def test_an_instance_that_hears_others_all_the_time_goes_on_saying_that_it_lives(
    postgres_url: str,
) -> None:
    store = Store(postgres_url)
    await store.start()
    session = store.ownership._session
    async with await psycopg.AsyncConnection.connect(postgres_url, autocommit=True) as other:
        ends = time.monotonic() + 3 * BEAT_S
        while time.monotonic() < ends:
            await other.execute(f"SELECT pg_notify('{CHANNEL}', '0')")
    last = session._told_s
    await eventually(lambda: session._told_s > last, "it says so")
    await store.close()
