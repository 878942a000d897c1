"""Circuits that are made by a seed, up to 30,000 gates: how setting up grows, without a file from elsewhere.

A circuit is a sheet of gates, as in a layout: layers of a thirtieth of the gates each, in which every gate
reads two or three nets near it in the layers below. What no gate reads is seen.
"""

from __future__ import annotations

import random
from collections.abc import Mapping

from robomend.errors import InputError
from robomend_bench.contenders import MODES
from robomend_bench.suite import ONE, Wish
from robomend_bench.suites.iscas85 import Circuits

NAMES = ("1000", "3000", "10000", "30000")

LAYERS = 30
REACH = 6
"""How far to either side a gate reads."""

KINDS = ("AND", "NAND", "NAND", "OR", "NOR", "XOR", "NOT")


class MadeCircuits(Circuits):
    """See the module."""

    modes: Mapping[str, str] = {mode: MODES[mode] for mode in ONE}

    def text(self, name: str, wish: Wish) -> str:
        """Return a circuit of so many gates; it depends on the seed and its size only."""
        if name not in NAMES:
            raise InputError(f"no circuit of {name!r} gates: choose from {', '.join(NAMES)}")
        return made_circuit(int(name), random.Random(f"{wish.seed} {name} gates"))


def made_circuit(gates: int, chance: random.Random) -> str:
    """Return a circuit in .bench form."""
    width = gates // LAYERS
    above = [f"i{place}" for place in range(width)]
    lines = [f"INPUT({net})" for net in above]
    body = []
    unread = dict.fromkeys(above)
    below = above
    for number in range(gates):
        layer, place = divmod(number, width)
        if place == 0 and layer:
            above, below = [f"g{(layer - 1) * width + one}" for one in range(width)], above
        kind = chance.choice(KINDS)
        near = [(place + step) % width for step in chance.sample(range(-REACH, REACH + 1), 3)]
        reads = [above[near[0]]]
        if kind != "NOT":
            reads += [
                (above if chance.random() < 0.8 else below)[one] for one in near[1 : chance.choice((2, 2, 3))]
            ]
        for net in reads:
            unread.pop(net, None)
        unread[f"g{number}"] = None
        body.append(f"g{number} = {kind}({', '.join(reads)})")
    lines += [f"OUTPUT({net})" for net in unread if net.startswith("g")]
    return "\n".join([*lines, *body, ""])


SUITE = MadeCircuits("made-circuits", "circuits of 1,000 to 30,000 gates, by the seed", NAMES, NAMES, None)
