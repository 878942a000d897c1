"""What is read at once of one connection: when each of its messages came; and the end of a subscription."""

from __future__ import annotations

import asyncio

from hypothesis import given
from hypothesis import strategies as st

from robomend_client.beats import BEAT_NS
from robomend_client.bridges.problems import Problems
from robomend_client.bridges.ros1.subscription import Bursts, Subscription, spread
from robomend_client.observers import SECOND, Change, Driver
from robomend_client.observers.general import GeneralObserver
from robomend_client.observers.rate import Rate

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
