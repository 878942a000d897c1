"""When the service looks for circles of objects that nobody holds any more, and at how many at once.

    loaded at the start      never again                     `settle`
    young                    twenty times a second           `Looks`; and when there are 2,000 more of them
    survived a look          every other second              `Looks`
    all that is old          a day's looks apart, if it has grown by a quarter

What is in no circle is freed at once as ever. At Python's defaults every object of a thousand robots is
walked a few times a second: half of the service's time under load, in pauses of 50 ms.

Python looks when so many objects more were made than freed. Robots' states, which take each other's place,
keep that near nothing, while tens of thousands of young ones gather, and then a look takes 7 to 20 ms, each
five seconds. Looks of half a millisecond take more time together, and keep nobody waiting.
"""

from __future__ import annotations

import gc

THRESHOLDS = (2_000, 1_000, 43_200)
"""Of young objects, of looks at them, and of looks at survivors. One look at 20,000 young objects, which a
request with thousands of sentences makes, took 3 to 9 ms."""

YOUNG, SURVIVORS = 0, 1

YOUNG_EVERY, SURVIVORS_EVERY = 2, 80
"""Signs of the event loop."""


def settle() -> None:
    """What is loaded by now stays: it is never looked at again. From now on Python looks by THRESHOLDS."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*THRESHOLDS)
    gc.enable()


class Looks:
    """Of one process, in time with its event loop's signs (api/loop_watch.py)."""

    def __init__(self) -> None:
        self._signs = 0

    def at_sign(self) -> None:
        """The event loop gives a sign, each 25 ms: look, if it is time to."""
        self._signs += 1
        if self._signs % SURVIVORS_EVERY == 0:
            gc.collect(SURVIVORS)
        elif self._signs % YOUNG_EVERY == 0:
            gc.collect(YOUNG)
