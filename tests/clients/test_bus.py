"""The local bus: from nodes to subscribers and observers, over real sockets."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from robomend_client.agent.broker import MOST_CLIENTS, Broker, Tap
from robomend_client.bus import LONGEST_LINE, Bus, BusGone, parse_address
from robomend_client.observers import Contact

Heard = list[tuple[str, object]]


def with_broker(address: str, test: Callable[[Broker, Heard], Awaitable[None]]) -> None:
    async def run() -> None:
        heard: Heard = []
        broker = Broker(address, lambda message: heard.append((message.topic, message.data)))
        await broker.open()
        try:
            await asyncio.wait_for(test(broker, heard), 60)
        finally:
            await broker.close()

    asyncio.run(run())


async def until(true: Callable[[], object]) -> None:
    while not true():
        await asyncio.sleep(0.005)


async def connect(broker: Broker) -> Bus:
    return await asyncio.to_thread(Bus, broker.address)


@pytest.mark.parametrize("kind", ["unix", "tcp"])
def test_messages_reach_the_observers_and_those_who_asked(kind: str, tmp_path: Path) -> None:
    async def test(broker: Broker, heard: Heard) -> None:
        talker, listener = await connect(broker), await connect(broker)
        listener.subscribe("scan")
        await asyncio.sleep(0.05)  # nobody answers a subscription
        talker.publish("odom", 1)
        talker.publish("scan", {"ranges": [1, 2]})
        assert list(await asyncio.to_thread(lambda: list(listener.receive()))) == [
            ("scan", {"ranges": [1, 2]})
        ]
        assert heard == [("odom", 1), ("scan", {"ranges": [1, 2]})]
        talker.close()
        listener.close()

    with_broker(f"unix:{tmp_path}/bus" if kind == "unix" else "tcp:127.0.0.1:0", test)
    assert not (tmp_path / "bus").exists()


@pytest.mark.parametrize(
    "rubbish",
    [
        b"x\n",
        b"[]\n",
        b'{"topic": 3, "data": 1}\n',
        b'{"topic": "a", "time": "now"}\n',
        b'{"topic": "a", "fields": []}\n',
        b"[" * 5000 + b"\n",
        b"z" * 70000,
    ],
)
def test_rubbish_ends_its_own_connection_only(rubbish: bytes) -> None:
    async def test(broker: Broker, heard: Heard) -> None:
        good = await connect(broker)
        reader, writer = await asyncio.open_connection(*parse_address(broker.address))
        writer.write(rubbish)
        with contextlib.suppress(ConnectionResetError):
            assert await reader.read() == b""
        writer.close()
        good.publish("a", 1)
        await until(lambda: heard == [("a", 1)])
        good.close()

    with_broker("tcp:127.0.0.1:0", test)


@pytest.mark.parametrize("address", ["tcp:127.0.0.1:0", "unix"])
def test_rubbish_is_told_once_for_each_client(
    address: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def test(broker: Broker, heard: Heard) -> None:
        where = parse_address(broker.address)
        for _ in range(3):
            opened = asyncio.open_unix_connection(where) if isinstance(where, str) else None
            reader, writer = await (opened or asyncio.open_connection(*where))
            writer.write(b"what?\n")
            with contextlib.suppress(ConnectionResetError):
                assert await reader.read() == b""
            writer.close()

    with_broker(f"unix:{tmp_path}/bus" if address == "unix" else address, test)
    (told,) = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    place = f"process {os.getpid()}" if address == "unix" else "127.0.0.1"
    assert told.startswith(f"the bus, a client at {place}: disconnected: ")


def test_a_subscriber_that_does_not_read_loses_messages_and_holds_up_nobody() -> None:
    async def test(broker: Broker, heard: Heard) -> None:
        sleeper, talker = await connect(broker), await connect(broker)
        sleeper.subscribe("scan")
        await asyncio.sleep(0.05)  # nobody answers a subscription
        for _ in range(200):
            await asyncio.to_thread(talker.publish, "scan", "x" * 60_000)
        await until(lambda: len(heard) == 200)
        assert broker.dropped > 0
        sleeper.close()
        talker.close()

    with_broker("tcp:127.0.0.1:0", test)


def test_one_client_too_many_is_turned_away() -> None:
    async def test(broker: Broker, heard: Heard) -> None:
        buses = [await connect(broker) for _ in range(MOST_CLIENTS + 1)]
        with pytest.raises(BusGone):
            await asyncio.to_thread(lambda: list(buses[-1].receive()))
        buses[-2].publish("a", 1)
        await until(lambda: heard == [("a", 1)])
        for bus in buses:
            bus.close()

    with_broker("tcp:127.0.0.1:0", test)


def test_an_agent_elsewhere_listens_in_and_comes_back(tmp_path: Path) -> None:
    async def test() -> None:
        heard: Heard = []
        address = f"unix:{tmp_path}/bus"
        seen: list[Contact] = []
        tap = Tap(address, ["scan"], lambda message: heard.append((message.topic, message.data)), seen.append)
        listening = asyncio.create_task(tap.run())
        for number in range(2):
            broker = Broker(address, lambda message: None)
            await broker.open()
            await until(lambda broker=broker: broker._subscribers)  # type: ignore[misc]  # bound for this round
            talker = await connect(broker)
            talker.publish("scan", number)
            await until(lambda number=number: ("scan", number) in heard)  # type: ignore[misc]  # as above
            assert seen[0] is Contact.LOST
            assert seen[-1] is Contact.BACK
            talker.close()
            await broker.close()
        listening.cancel()
        await asyncio.gather(listening, return_exceptions=True)

    asyncio.run(asyncio.wait_for(test(), 60))


def test_a_message_that_is_too_long_is_the_senders_error(tmp_path: Path) -> None:
    async def test(broker: Broker, heard: Heard) -> None:
        bus = await connect(broker)
        with pytest.raises(ValueError, match=str(LONGEST_LINE)):
            bus.publish("scan", "x" * LONGEST_LINE)
        bus.close()

    with_broker("tcp:127.0.0.1:0", test)


@pytest.mark.parametrize(
    "address", ["", "unix:", "tcp:1", "tcp:h:x", "tcp:h:70000", "udp:h:1", "unix:" + "x" * 120]
)
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(ValueError, match=r"bus address|too long"):
        parse_address(address)
