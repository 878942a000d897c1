"""An alarm rings for what does not end, and for nothing else."""

from __future__ import annotations

import asyncio

from robomend.api.alarm import Alarm

SOON_S = 0.02


def test_it_rings_once_for_what_does_not_end() -> None:
    async def run() -> int:
        rang = 0
        ringing = asyncio.Event()

        def ring() -> None:
            nonlocal rang
            rang += 1
            ringing.set()

        with Alarm(SOON_S, ring) as alarm:
            alarm.begin()
            await ringing.wait()
            await _turns(alarm, 3)  # it still looks
            assert alarm.rang
            return rang

    assert asyncio.run(run()) == 1


def test_it_is_silent_for_what_ended_and_for_what_begins_anew() -> None:
    async def run() -> bool:
        with Alarm(SOON_S, lambda: None) as alarm:
            await _turns(alarm, 2)  # nothing began
            alarm.begin()
            alarm.end()
            await _turns(alarm, 2)
            return alarm.rang

    assert not asyncio.run(run())


def test_it_rings_again_for_what_begins_later_and_not_after_its_end() -> None:
    async def run() -> None:
        ringing = asyncio.Event()
        with Alarm(SOON_S, ringing.set) as alarm:
            for _ in range(2):
                alarm.begin()
                assert not alarm.rang
                await ringing.wait()
                ringing.clear()
            alarm.begin()
        with Alarm(SOON_S, lambda: None) as later:  # set after the other's timer would have run out
            await _turns(later, 3)
        assert not ringing.is_set()

    asyncio.run(run())


async def _turns(alarm: Alarm, times: int) -> None:
    """Return when the alarm's own timer has run out so often."""
    for _ in range(times):
        timer = alarm._timer
        while alarm._timer is timer:
            await asyncio.sleep(0)
