"""Sets as integers: bit i stands for component i, which is health variable i + 1, or for lane i of a pass.

Subset, intersection and difference are then one operation, whatever the size of the set.
"""

from __future__ import annotations

from collections.abc import Iterable

FEW = 16
"""Ones of a long integer that are found one by one faster than by going through its bytes."""


def mask_of(health: Iterable[int]) -> int:
    """Return the mask of health variables."""
    mask = 0
    for variable in health:
        mask |= 1 << (variable - 1)
    return mask


def members(mask: int) -> tuple[int, ...]:
    """Return the health variables of a mask, ascending."""
    if mask.bit_length() > 64:
        return tuple([bit + 1 for bit in bits(mask)])
    found: list[int] = []  # as in `bits`, which a call of its own would take as long as
    while mask:
        low = mask & -mask
        found.append(low.bit_length())
        mask ^= low
    return tuple(found)


def outside(health: list[int], mask: int) -> list[int]:
    """Return the health variables, given as 1 … n, that are not in the mask."""
    others = health.copy()
    while mask:  # from the top, so that the places of the others stay what they are
        top = mask.bit_length() - 1
        del others[top]
        mask ^= 1 << top
    return others


def bits(number: int) -> list[int]:
    """Return the positions of the ones, ascending; in time linear in the length even for long integers."""
    found: list[int] = []
    if number.bit_length() <= 64 or number.bit_count() <= FEW:
        while number:
            low = number & -number
            found.append(low.bit_length() - 1)
            number ^= low
        return found
    for base, byte in enumerate(number.to_bytes((number.bit_length() + 7) // 8, "little")):
        while byte:
            low = byte & -byte
            found.append(base * 8 + low.bit_length() - 1)
            byte ^= low
    return found
