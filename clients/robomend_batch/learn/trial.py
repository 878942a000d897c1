"""The drafted observers over what was held back: by the same reader and driver as `robomend-batch run`.

Whatever turns false there is a false alarm, for the robot was healthy.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from robomend_batch.learn.gathering import open_log
from robomend_batch.learn.stretches import Stretch
from robomend_batch.logs.wanted import Wants
from robomend_batch.observing import Observing
from robomend_batch.problems import Problems
from robomend_client.literals import Atom
from robomend_client.observers.combining import Change
from robomend_client.observers.driver import Driver


def false_alarms(observing: Observing, names: Sequence[str], stretches: Sequence[Stretch]) -> Counter[Atom]:
    """Return how often each atom turned false in stretches of the logs, each of which is judged by itself."""
    found: Counter[Atom] = Counter()
    for log in sorted({stretch.log for stretch in stretches}):
        mine = [stretch for stretch in stretches if stretch.log == log]
        found += _of_log(observing, Path(names[log]), mine)
    return found


def _of_log(observing: Observing, path: Path, stretches: Sequence[Stretch]) -> Counter[Atom]:
    found: Counter[Atom] = Counter()

    def count(changes: Sequence[Change]) -> None:
        found.update(c.atom for c in changes if c.value is not None and not c.value.positive)

    with open_log(path) as recording:
        wants = Wants(recording.channels, observing.specs, path, Problems(), False, observing.names)
        drivers = [
            Driver([spec.make() for spec in wants.specs], stretch.start_ns, lenient=observing.lenient)
            for stretch in stretches
        ]
        here = 0
        for time_ns, number, data in recording.messages(wants.channels):
            while here + 1 < len(stretches) and time_ns >= stretches[here + 1].start_ns:
                here += 1
            if not stretches[here].start_ns <= time_ns < stretches[here].end_ns:
                continue
            for source, extract in wants.of[number]:
                try:
                    value = None if extract is None or data is None else extract(data)
                except Exception:  # noqa: BLE001  # damaged bytes raise whatever: counted when they were gathered
                    continue
                count(drivers[here].sample(source, time_ns, value))
        for driver, stretch in zip(drivers, stretches, strict=True):
            count(driver.advance(stretch.end_ns - 1))
    return found
