"""A small diagnosis of a circuit by a few simulations: an upper bound, often the minimum, never surely.

    pass: each gate flipped, in a lane of its own ──► which wrong outputs it mends, and whether it spoils one
       ▲                                                     │
       │                                                     ▼
       └─── again, with these flipped already ◄── few gates that mend all and spoil nothing
                     │
                     ▼ all outputs are right (a short pass tells: without each of them, or with all)
            gates that need not be flipped are dropped

What mends one output may spoil what another gate mends, so that the next pass goes on from what is still
wrong. A search for the minimum that knows such an incumbent need only prove that there is nothing smaller:
the model that it would search for, and most of what leads to it, is saved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robomend.diagnosis.circuits.flips import Flips

PASSES = 6
"""What is not mended by then is mended by too many gates to be of use; most take one or two."""


def find_incumbent(
    flips: Flips,
    inputs: Sequence[bool],
    expected: Sequence[bool],
    wrong: list[int],
    between: Callable[[], None] = lambda: None,
) -> list[int] | None:
    """Return gates (indices into flippable) that explain all together, and each is needed; None: not found.

    Args:
        wrong: what the pass over single gates found, `Flips.one_by_one`.
        between: called between passes.
    """
    gates = flips.lanes & ~1
    chosen: frozenset[int] = frozenset()
    before = len(wrong) + 1
    for attempt in range(PASSES):
        if attempt:
            wrong = flips.one_by_one(inputs, expected, chosen)
        still = []
        spoiling = 0
        for lanes in wrong:
            if lanes & 1:
                still.append(lanes)
            else:
                spoiling |= lanes
        added = _cover([gates & ~(lanes | spoiling) for lanes in still])
        if not added or len(still) >= before:  # they were in each other's way: the best one alone
            added = {_lowest(_least(wrong, gates)) - 1}
        chosen ^= added
        before = len(still)
        members = sorted(chosen)
        between()
        while (needed := flips.needed(inputs, expected, members)) is not None:
            spare = next((gate for gate in members if gate not in needed), None)
            if spare is None:
                return members
            members.remove(spare)
            between()
    return None


def _cover(mending: list[int]) -> set[int]:
    """Return few gates of which one mends each output, the outputs that few gates mend first.

    Args:
        mending: of each wrong output the lanes in which it is right, and no other output is spoilt.
    """
    chosen = set()
    mending = sorted(filter(None, mending), key=int.bit_count)
    while mending:
        lanes = mending[0]
        for others in mending:
            lanes = lanes & others or lanes
        lane = _lowest(lanes)
        chosen.add(lane - 1)
        mending = [others for others in mending if not others >> lane & 1]
    return chosen


def _lowest(lanes: int) -> int:
    return (lanes & -lanes).bit_length() - 1


def _least(words: list[int], among: int) -> int:
    """Return the lanes that are in fewest of the words."""
    for digit in reversed(_counted(words)):
        among = among & ~digit or among
    return among


def _counted(words: list[int]) -> list[int]:
    """Return in how many of the words each lane is, as binary digits, the last one first: an adder a lane."""
    digits: list[int] = []
    for word in words:
        carry = word
        for index, digit in enumerate(digits):
            digits[index] = digit ^ carry
            carry &= digit
            if not carry:
                break
        else:
            if carry:
                digits.append(carry)
    return digits
