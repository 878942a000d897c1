"""Connections that are read together: what came on each, when, in order; one's end is nobody else's."""

from __future__ import annotations

import asyncio
import select
import socket
import time
from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st
from tests.waiting import eventually

from robomend_client.beats import BEAT_NS
from robomend_client.bridges.problems import Problems
from robomend_client.bridges.ros1.subscription import READ_BYTES, Bursts, Subscription, spread
from robomend_client.observers import SECOND, Change, Driver
from robomend_client.observers.general import GeneralObserver
from robomend_client.observers.rate import Rate
from robomend_client.python310 import timeout


class Reader:
    def __init__(self, on_data: Callable[[bytes], bool] = lambda _: False) -> None:
        self.data = b""
        self.reads = 0
        self.ends: list[Exception | None] = []
        self._on_data = on_data

    def received(self, data: memoryview, after_ns: int, arrived_ns: int) -> bool:
        assert after_ns <= arrived_ns
        self.data += data
        self.reads += 1
        self.arrived_ns = arrived_ns
        return self._on_data(bytes(data))

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


async def all_is_read_that_does_not_wait(bursts: Bursts) -> None:
    """Return when one that has just begun, and is read as it comes, was read."""
    other = Reader()
    far, near = joined(bursts, other)
    far.sendall(b"x")
    await until_read(other, b"x")
    bursts.leave(near)
    far.close()
    near.close()


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


def test_what_comes_waits_until_somebody_wants_to_judge_and_is_then_read_together() -> None:
    async def test() -> None:
        bursts, reader = Bursts(), Reader()
        far, near = joined(bursts, reader)
        with far, near:
            far.sendall(b"a")
            await until_read(reader, b"a")  # what is new is read as it comes
            for part in (b"b", b"c"):
                far.sendall(part)
                await all_is_read_that_does_not_wait(bursts)
            assert reader.data == b"a"
            bursts.read()
            assert (reader.data, reader.reads) == (b"abc", 2)
            bursts.close()

    asyncio.run(test())


def test_one_that_is_in_the_middle_of_a_message_is_read_as_it_comes() -> None:
    async def test() -> None:
        bursts, reader = Bursts(), Reader(lambda data: not data.endswith(b"."))
        far, near = joined(bursts, reader)
        with far, near:
            for begun, part in ((b"a", b"a"), (b"ab", b"b"), (b"abc.", b"c.")):
                far.sendall(part)
                await until_read(reader, begun)
            far.sendall(b"d")
            await all_is_read_that_does_not_wait(bursts)
            assert reader.data == b"abc."
            bursts.read()
            far.sendall(b"e.")
            await until_read(reader, b"abc.de.")
            bursts.close()

    asyncio.run(test())


def test_whoever_hangs_up_is_known_at_once_with_all_that_was_said_before() -> None:
    async def test() -> None:
        bursts, reader = Bursts(), Reader()
        far, near = joined(bursts, reader)
        with near:
            far.sendall(b"a")
            await until_read(reader, b"a")
            far.sendall(bytes(READ_BYTES // 4))
            far.sendall(b"b")
            far.close()
            await eventually(lambda: reader.ends == [None], "it has ended")
            assert len(reader.data) == READ_BYTES // 4 + 2
            bursts.close()

    asyncio.run(test())


def test_what_was_said_elsewhere_before_somebody_hung_up_is_read_before_that_is_told() -> None:
    async def test() -> None:
        bursts = Bursts()
        said: list[str] = []

        class Telling(Reader):
            def ended(self, error: Exception | None) -> None:
                said.append(readers[1].data.decode())

        readers = [Telling(), Reader()]
        ends = [joined(bursts, reader) for reader in readers]
        for (far, _), reader in zip(ends, readers, strict=True):
            far.sendall(b"a")
            await until_read(reader, b"a")
        ends[1][0].sendall(b"b")  # it would wait
        ends[0][0].close()
        await eventually(lambda: said, "one has ended")
        await asyncio.sleep(0)  # both were read in one turn
        assert readers[1].data == b"ab"
        bursts.close()
        ends[1][0].close()
        for _, near in ends:
            near.close()

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
            async with timeout(10):
                while True:  # the kernel begins to look at its clock a moment after it was asked to
                    reader.data = b""
                    before_ns = time.time_ns()
                    far.sendall(b"a")
                    select.select([near], [], [])
                    there_ns = time.time_ns()
                    time.sleep(0.03)  # nobody reads meanwhile: the agent is late
                    bursts.read()
                    assert before_ns <= reader.arrived_ns
                    if reader.arrived_ns <= there_ns:
                        break
            bursts.close()

    asyncio.run(test())


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
        bursts.read()
        assert (second.data, first.data, first.ends[1:], second.ends) == (b"ab", b"a", [], [])
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


# --- when each message came, and the end of a subscription -------------------------------------------------

TIMES = st.integers(0, 10 * BEAT_NS)


@given(TIMES, TIMES, st.integers(0, 50))
def test_messages_of_one_read_lie_in_their_order_behind_what_was_read_before(
    after_ns: int, newest_ns: int, count: int
) -> None:
    times_ns = list(spread(after_ns, newest_ns, count))
    assert len(times_ns) == count
    assert times_ns == sorted(times_ns)
    if times_ns:
        assert times_ns[-1] == newest_ns
        assert times_ns[0] >= min(after_ns, newest_ns)


def test_a_fast_topic_is_never_said_to_be_faster_than_it_is() -> None:
    driver = Driver([GeneralObserver("imu", Rate(rate_hz=500.0, tolerance_hz=50.0))], 0)
    said: list[Change] = []
    before_ns = 0
    for read_ns in range(BEAT_NS, SECOND, BEAT_NS):
        for time_ns in spread(before_ns, read_ns, 25):  # so many in each beat
            said += driver.sample("imu", time_ns, None, read_ns)
        before_ns = read_ns
    assert [str(change.value) for change in said] == ["ok(imu)"]


def test_a_topic_that_is_closed_takes_no_publisher_any_more() -> None:
    async def told_too_late() -> list[str]:
        bursts = Bursts()
        topic = Subscription("/rosout", "/us", lambda publisher, message, ns: None, Problems("ros1"), bursts)
        await topic.close()
        topic.publishers(["http://127.0.0.1:9/"])  # by the master, while we take our leave
        bursts.close()
        return [task.get_name() for task in asyncio.all_tasks()]

    assert not any(name.startswith("/rosout") for name in asyncio.run(told_too_late()))
