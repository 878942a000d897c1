"""Connections that are read together: what came on each, in order, and one's end is nobody else's."""

from __future__ import annotations

import asyncio
import select
import socket
import time
from collections.abc import Callable

import pytest
from tests.waiting import eventually

from robomend_client.bridges.ros1 import bursts as module
from robomend_client.bridges.ros1.bursts import Bursts


class Reader:
    def __init__(self, on_data: Callable[[bytes], bool] = lambda _: False) -> None:
        self.data = b""
        self.reads = 0
        self.ends: list[Exception | None] = []
        self._on_data = on_data

    def received(self, data: bytes, arrived_ns: int) -> bool:
        self.data += data
        self.reads += 1
        self.arrived_ns = arrived_ns
        return self._on_data(data)

    def ended(self, error: Exception | None) -> None:
        self.ends.append(error)


def joined(bursts: Bursts, reader: Reader) -> tuple[socket.socket, socket.socket]:
    """Return the far end and ours."""
    far, near = socket.socketpair()
    near.setblocking(False)
    bursts.join(near, reader)
    return far, near


async def until_read(reader: Reader, data: bytes) -> None:
    await eventually(lambda: reader.data == data, f"{data!r} was read")


def test_each_gets_its_own_in_order_and_is_told_of_its_end() -> None:
    async def test() -> None:
        bursts = Bursts()
        readers = [Reader() for _ in range(300)]  # more than are read in one turn
        ends = [joined(bursts, reader) for reader in readers]
        for number, (far, _) in enumerate(ends):
            for part in range(3):
                far.sendall(b"%d.%d;" % (number, part))
                if part == 1:
                    await asyncio.sleep(0)
            far.close()
        await eventually(lambda: all(reader.ends == [None] for reader in readers), "all have ended")
        for number, reader in enumerate(readers):
            assert reader.data == b"".join(b"%d.%d;" % (number, part) for part in range(3))
        for _, near in ends:
            bursts.leave(near)  # again: it has left by itself
            near.close()
        bursts.close()

    asyncio.run(test())


def test_what_comes_within_a_rest_is_read_at_once_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REST_S", 0.5)

    async def test() -> None:
        bursts, reader = Bursts(), Reader()
        far, near = joined(bursts, reader)
        with far, near:
            far.sendall(b"a")
            await asyncio.sleep(0.01)  # it is known by now that there is something, and it rests
            far.sendall(b"b")
            await eventually(lambda: reader.data == b"ab", "both have come")
            assert reader.reads == 1
            bursts.close()

    asyncio.run(test())


def test_nobody_rests_while_one_is_in_the_middle_of_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    rests: list[float] = []

    async def test() -> None:
        loop = asyncio.get_running_loop()
        later = loop.call_later

        def noted(after_s: float, call: Callable[..., object], *given: object) -> asyncio.TimerHandle:
            if after_s == 0.004:
                rests.append(after_s)
            return later(after_s, call, *given)

        monkeypatch.setattr(loop, "call_later", noted)
        monkeypatch.setattr(module, "REST_S", 0.004)
        bursts, reader = Bursts(), Reader(lambda data: not data.endswith(b"."))
        far, near = joined(bursts, reader)
        with far, near:
            for part in (b"a", b"ab", b"abc."):
                far.sendall(part[-2:] if part.endswith(b".") else part[-1:])
                await until_read(reader, part)
            assert len(rests) == 1
            far.sendall(b"d.")
            await until_read(reader, b"abc.d.")
            assert len(rests) == 2
            bursts.close()

    asyncio.run(test())


def test_what_came_is_as_old_as_the_kernel_says_however_late_it_is_read() -> None:
    async def test() -> None:
        bursts, reader = Bursts(), Reader()
        with socket.create_server(("127.0.0.1", 0)) as server:
            far = socket.create_connection(server.getsockname())
            near, _ = server.accept()
        near.setblocking(False)
        with far, near:
            bursts.join(near, reader)
            async with asyncio.timeout(10):
                while True:  # the kernel begins to look at its clock a moment after it was asked to
                    reader.data = b""
                    before_ns = time.time_ns()
                    far.sendall(b"a")
                    select.select([near], [], [])
                    there_ns = time.time_ns()
                    time.sleep(0.03)  # nobody reads meanwhile: the agent is late
                    await until_read(reader, b"a")
                    assert before_ns <= reader.arrived_ns
                    if reader.arrived_ns <= there_ns:
                        break
            bursts.close()

    asyncio.run(test())


def test_a_clock_that_was_set_makes_nothing_old_and_nothing_from_the_future() -> None:
    def told(arrived_ns: int) -> list[tuple[int, int, bytes]]:
        stamp = module.STAMP.pack(*divmod(arrived_ns, 10**9))
        return [(socket.SOL_SOCKET, module.SO_TIMESTAMPNS, stamp)]

    read_ns, now_ns = 1_000_000_000_900, 1_000_000_001_000
    assert module._arrived_ns(told(now_ns - 10), read_ns, now_ns) == now_ns - 10
    for impossible_ns in (read_ns - 1, now_ns + 1, now_ns - 3600 * 10**9):
        assert module._arrived_ns(told(impossible_ns), read_ns, now_ns) == now_ns
    assert module._arrived_ns([], read_ns, now_ns) == now_ns  # where the system does not tell


def test_one_that_raises_ends_and_the_others_go_on() -> None:
    async def test() -> None:
        def bad(_: bytes) -> bool:
            raise ZeroDivisionError("mine")

        bursts, first, second = Bursts(), Reader(bad), Reader()
        ends = [joined(bursts, first), joined(bursts, second)]
        for pair in ends:
            pair[0].sendall(b"a")
        await eventually(lambda: second.data == b"a" and bool(first.ends), "one has raised")
        assert isinstance(first.ends[0], ZeroDivisionError)
        ends[0][0].sendall(b"b")  # nobody reads it any more
        ends[1][0].sendall(b"b")
        await eventually(lambda: second.data == b"ab", "the other goes on")
        assert (first.data, first.ends[1:], second.ends) == (b"a", [], [])
        bursts.close()
        for pair in ends:
            pair[0].close()
            pair[1].close()

    asyncio.run(test())


def test_one_that_is_sent_away_by_another_in_the_same_turn_is_not_read() -> None:
    async def test() -> None:
        bursts = Bursts()
        ends: list[tuple[socket.socket, socket.socket]] = []
        readers: list[Reader] = []

        def away(_: bytes) -> bool:
            for reader, pair in zip(readers, ends, strict=True):
                if not reader.data:
                    bursts.leave(pair[1])
            return False

        readers += [Reader(away) for _ in range(2)]
        ends += [joined(bursts, reader) for reader in readers]
        for pair in tuple(ends):
            pair[0].sendall(b"a")
        await eventually(lambda: any(reader.data for reader in readers), "one was read")
        later = Reader()
        ends.append(joined(bursts, later))  # of those who stay, everybody is read on
        readers.append(later)
        ends[2][0].sendall(b"c")
        await eventually(lambda: later.data == b"c", "the third")
        assert sorted(reader.data for reader in readers[:2]) == [b"", b"a"]
        bursts.close()
        for pair in ends:
            pair[0].close()
            pair[1].close()

    asyncio.run(test())
