"""Two services on one database: when the owner of a robot is killed, the other goes on with its repair."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Iterator

import pytest
from tests.postgres import empty_database
from tests.repairs.remote import ServiceProcess, ended, latest, remote_robot, services
from tests.repairs.robot import CONFIG, Robot
from tests.store.examples import owner
from tests.waiting import for_ever

from robomend_client.actions import TIMED_OUT, UNREACHABLE
from robomend_client.rest.errors import Forbidden, StateConflict

pytestmark = pytest.mark.anyio


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def databases(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[], tuple[str, ...]]]:
    """What makes a database and returns the arguments that name it to two services."""
    with contextlib.ExitStack() as stack:

        def make() -> tuple[str, ...]:
            data = ("--data", str(tmp_path_factory.mktemp("data")))
            if request.param == "sqlite":
                return data
            server = request.getfixturevalue("postgres_server")
            return (*data, "--database", stack.enter_context(empty_database(server)))

        yield make


@pytest.fixture(scope="module")
def database(databases: Callable[[], tuple[str, ...]]) -> tuple[str, ...]:
    """The database of the services that tests share."""
    return databases()


@pytest.fixture(scope="module")
async def pair(database: tuple[str, ...]) -> AsyncIterator[list[ServiceProcess]]:
    """Two services that live as long as the tests of them."""
    async with services(database, database) as running:
        yield running


@pytest.fixture
async def two(pair: list[ServiceProcess]) -> AsyncIterator[list[ServiceProcess]]:
    """Two services without a robot."""
    yield pair
    client = pair[0].client
    assert client is not None
    await client.resume()
    async with asyncio.timeout(60):
        while True:
            try:
                await client.delete_robot("r1", "*")
            except StateConflict:  # a repair is at work on it, or has only just been ended
                for repair in (await client.all_repairs(open_only=True))["items"]:
                    with contextlib.suppress(StateConflict):
                        await client.cancel(repair["id"])
                await asyncio.sleep(0.05)
            else:
                break
    await client.delete_model("small", "*")


async def owner_of(running: list[ServiceProcess], database: tuple[str, ...]) -> ServiceProcess | None:
    """Return the service that carries out the robot's repairs; None while nobody living does."""
    from robomend.settings import Settings
    from robomend.store import opened

    values = dict(zip(("data", "database"), database[1::2], strict=False))
    async with opened(Settings.model_validate(values).database_url) as store:
        instance, _ = await store.read(owner, "r1")
        instances = await store.ownership.instances()
    pids = {one.pid for one in instances if one.id == instance}
    return next((one for one in running if one.process is not None and one.process.pid in pids), None)


async def test_the_other_instance_takes_over_a_repair_and_finishes_it(
    databases: Callable[[], tuple[str, ...]],
) -> None:
    database = databases()
    begun, killed = asyncio.Event(), asyncio.Event()

    async def slow(robot: Robot, name: str, parameter: str) -> int | None:
        begun.set()
        await killed.wait()  # an action takes time
        return None

    async with services(database, database) as running, remote_robot(running) as robot:
        robot.spoil = slow
        await robot.settled()
        robot.go_off()
        async with asyncio.timeout(60):
            await begun.wait()
        victim = await owner_of(running, database)
        assert victim is not None
        [other] = [service for service in running if service is not victim]
        client = other.client
        assert client is not None
        acknowledged = (await client.observations("r1"))["revision"]
        await victim.kill()
        killed.set()
        killed_s = time.monotonic()
        async with asyncio.timeout(60):
            while await owner_of([*running], database) is not other:
                await asyncio.sleep(0.2)
        print(f"taken over after {time.monotonic() - killed_s:.1f} s")
        repair = await latest([other], ended)
        after = await client.observations("r1")
        audit = await client.audit("r1", limit=500)
    assert repair["state"] == "repaired", repair["reason"]
    assert repair["rounds"][0]["ending"] == "interrupted"
    assert robot.complaints == []
    assert len(set(robot.ids)) == len(robot.ids)
    assert len(robot.done) == 5
    assert after["revision"] > acknowledged
    entries = [(entry["action"], entry["subject"], entry["after"]) for entry in audit["items"]]
    sent = [subject for action, subject, _ in entries if action == "action.sent"]
    # what the killed one wrote last may not have reached the robot: the other took it back, and sent its own
    never = {"result": UNREACHABLE}, {"result": TIMED_OUT}
    taken_back = [subject for what, subject, after in entries if what == "action.result" and after in never]
    assert len(taken_back) <= 2  # the plan has two chains, side by side
    assert sorted(sent) == sorted([*robot.done, *taken_back])


async def test_a_cancellation_reaches_the_owner_through_the_other_instance(
    database: tuple[str, ...], two: list[ServiceProcess]
) -> None:
    begun = asyncio.Event()

    async def hangs(robot: Robot, name: str, parameter: str) -> int | None:
        begun.set()
        await for_ever()
        return None

    async with remote_robot(two) as robot:
        robot.spoil = hangs
        await robot.settled()
        robot.cut("base")
        async with asyncio.timeout(60):
            await begun.wait()
        owner = await owner_of(two, database)
        [other] = [service for service in two if service is not owner]
        client = other.client
        assert client is not None
        open_one = (await client.repairs("r1", limit=1))["items"][0]
        await client.cancel(open_one["id"], "I see smoke")
        repair = await latest([other], ended)
    assert (repair["id"], repair["state"], repair["reason"]) == (open_one["id"], "cancelled", "I see smoke")


@pytest.mark.parametrize("way", ["repair.cancel", "stop.set"])
async def test_the_owner_sends_nothing_after_the_other_instance_was_asked_to_end_it(
    database: tuple[str, ...], two: list[ServiceProcess], way: str
) -> None:
    """The audit log is in the order of the writes: no intent comes after the request."""
    second, asked = asyncio.Event(), asyncio.Event()

    async def takes_time(robot: Robot, name: str, parameter: str) -> int | None:
        if len(robot.ids) > 1:
            second.set()
            await asked.wait()
        return None

    # The second action goes on until the request was made: on a busy computer that is longer than the usual
    # time-out of an action, after which it would be sent again.
    patient = {name: {**bounds, "timeout_s": 100.0} for name, bounds in CONFIG["actions"].items()}
    async with remote_robot(two, actions=patient) as robot:
        robot.spoil = takes_time
        await robot.settled()
        robot.go_off()
        async with asyncio.timeout(60):
            await second.wait()
        owner = await owner_of(two, database)
        [other] = [service for service in two if service is not owner]
        client = other.client
        assert client is not None
        open_one = (await client.repairs("r1", limit=1))["items"][0]
        if way == "stop.set":
            await client.stop("I see smoke")
        else:
            await client.cancel(open_one["id"], "I see smoke")
        asked.set()
        await latest([other], ended)
        await robot.rest()
        repair = await client.repair(open_one["id"])  # what is left to do may have begun another one by now
        audit = await client.audit(limit=500)
    assert repair["state"] == "cancelled"
    begun = [entry["id"] for entry in audit["items"] if entry["action"] == "robot.put"]
    actions = [entry["action"] for entry in reversed(audit["items"]) if entry["id"] > max(begun)]
    of_it = actions[: actions.index("repair.cancelled")]
    assert 2 <= of_it.count("action.sent") < 5
    after = of_it[of_it.index(way) :]
    assert "action.sent" not in after
    assert robot.complaints == []


async def test_every_instance_obeys_the_stop_as_it_is_on_disk(two: list[ServiceProcess]) -> None:
    """Not as it heard of it: its news come a moment later than the answer of the other."""
    async with remote_robot(two):
        one, other = two
        assert one.client is not None
        assert other.client is not None
        for _ in range(5):
            await one.client.stop("I see smoke")
            while not (await one.client.stopped())["written"]:  # a 202 holds on that instance only
                continue
            with pytest.raises(Forbidden, match="I see smoke"):
                await other.client.start_repair("r1")
            await one.client.resume()
            while (await one.client.stopped())["active"]:  # it is lifted when that is on disk, and is asked
                continue
            begun = await other.client.start_repair("r1")
            repair = await latest([other], ended)
            assert (repair["id"], repair["state"]) == (begun["id"], "repaired")
