"""Who fell first: in a circle of topics that need each other, the order in which they fell silent.

    ctl: state → cmd, est: cmd → state      ctl hangs: cmd falls, and state as soon as est misses cmd

Both {ctl} and {est} explain it, and both fit what works. But the onset of `not ok(cmd)`, its last good
sample, is before that of `not ok(state)`, so that ctl is the more probable: a diagnosis all of whose outputs
in a circle fell later than another topic of it counts for LATER. Samples come once a period, so that
differences of less than one, the longer of the two, say nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from robomend.model.cnf import HealthCnf
from robomend.model.components import ComponentModel
from robomend.model.loops import Loop
from robomend_client.literals import Atom

LATER = 0.05
"""How much less probable it makes a diagnosis that what it blames fell after what rests on it."""

PERIOD_S = 0.1
"""Of a topic whose rate the model does not say: that of the observers' default."""


def onset_fit(
    model: ComponentModel,
    cnf: HealthCnf,
    loops: Iterable[Loop],
    onsets: Mapping[Atom, int],
    bad: Collection[str],
) -> float:
    """Return how well a diagnosis fits the order in which topics fell: 1, or LATER for each circle.

    Args:
        onsets: of the topics that are not ok, each with its last good sample, in nanoseconds.
        bad: what the diagnosis blames.
    """
    fit = 1.0
    for loop in loops:
        fallen = {atom: onsets[atom] for atom in loop.atoms if atom in onsets}
        if len(fallen) < 2:
            continue
        own = {
            output.atom
            for name in loop.components.intersection(bad)
            for output in cnf.puts_out.get(name, ())
            if output.atom in fallen
        }
        if not own:
            continue
        first = min(fallen, key=lambda atom: (fallen[atom], atom not in own))
        nearest = min(own, key=lambda atom: fallen[atom])
        period_ns = 1e9 * max(_period_s(model, first), _period_s(model, nearest))
        if fallen[nearest] - fallen[first] > period_ns:
            fit *= LATER
    return fit


def _period_s(model: ComponentModel, atom: Atom) -> float:
    topic = model.topics.get(atom.args[0])
    return PERIOD_S if topic is None or topic.rate_hz is None else 1 / topic.rate_hz
