"""Sets as integers: bit i stands for component i, which is health variable i + 1, or for lane i of a pass.

Subset, intersection and difference are then one operation, whatever the size of the set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

FEW = 16
"""Ones of a long integer that are found one by one faster than by going through its bytes."""

CHECK_EVERY = 64
"""Conflicts between two looks at the clock."""


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


def minimal_masks(masks: Iterable[int], check: Callable[[], None] = lambda: None) -> list[int]:
    """Return the masks without those that contain another, the smallest first.

    Args:
        check: called for each; may raise to end the work.
    """
    kept: list[int] = []
    for mask in sorted(dict.fromkeys(masks), key=int.bit_count):
        check()
        if not any(smaller & mask == smaller for smaller in kept):
            kept.append(mask)
    return kept


def classes_of(conflicts: Sequence[int], check: Callable[[], None] = lambda: None) -> list[int]:
    """Return the components of the conflicts in classes, as masks: those of one are in the same conflicts.

    A conflict is held against the classes that it meets, not against all: there may be thousands.

    Args:
        check: called now and then; may raise to end the work.
    """
    divisible = 0  # the components of classes that have more than one
    for conflict in conflicts:
        divisible |= conflict
    classes = [divisible]
    class_of = [0] * divisible.bit_length()  # of a component, by its position
    for number, conflict in enumerate(conflicts):
        if number % CHECK_EVERY == 0:
            check()
        left = conflict & divisible
        while left:
            one = class_of[(left & -left).bit_length() - 1]
            inside = classes[one] & conflict
            left ^= inside
            outside = classes[one] ^ inside
            if not outside:
                continue
            smaller, larger = sorted((inside, outside), key=int.bit_count)
            classes[one] = larger
            for bit in bits(smaller):
                class_of[bit] = len(classes)
            classes.append(smaller)
            for part in (smaller, larger):
                if not part & (part - 1):
                    divisible ^= part
    return classes
