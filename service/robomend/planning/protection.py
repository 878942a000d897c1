"""What nothing may switch off or stop, and why: the protected components, and what they cannot do without.

    protected            by the model, by the board's configuration, by the robot's
    its feeders          a feeder's shutdown is theirs too
    what it is tied to   it must restart after that restarts, and it may not
    what it drives       it must restart after that got its power back, and it may not

All go on from what was found: the feeder of a feeder, the node that a tied one is tied to, what feeds the
device of a driver. So there is one answer for a plan, for a person who switches a channel, and for a user's
own action. Pure.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping

from robomend.model.components import ComponentModel

Protection = Mapping[str, str]
"""Component -> why nothing switches it off or stops it, as a sentence."""


def marked(model: ComponentModel, channels: Collection[int] = ()) -> set[str]:
    """Return the components that the model protects, and those on protected channels of the power board:
    the model's, and `channels` of the board's configuration.
    """
    guarded = {*channels, *model.protected_channels}
    found = {name for name, part in model.parts.items() if part.protected}
    return found | {name for name, device in model.hardware.items() if device.channel in guarded}


def protection(model: ComponentModel, named: Iterable[str] = ()) -> dict[str, str]:
    """Return what is protected on a robot: what the model marks, what is named besides, and what these
    cannot do without.
    """
    found = {name: f"{name} is protected" for name in sorted(marked(model) | set(named))}
    pending = [(name, name) for name in found]
    while pending:
        name, saved = pending.pop()
        for other, why, of in _needed(model, name, saved):
            if other not in found:
                found[other] = f"{why} is protected"
                pending.append((other, of))
    return found


def _needed(model: ComponentModel, name: str, saved: str) -> Iterator[tuple[str, str, str]]:
    """Yield what a protected component cannot do without, why, and for whose sake what feeds that is kept."""
    if (hardware := model.hardware.get(name)) is not None:
        for feeder in hardware.fed_by:
            yield feeder, f"{saved}, which it feeds,", saved
    if (node := model.nodes.get(name)) is not None:
        for other in node.tied_to:
            yield other, f"{saved}, tied to it,", saved
        for device in node.drives:
            yield device, f"{name}, its driver, which would have to restart after it,", device


def protected_channels(
    model: ComponentModel, protected: Protection, channels: Collection[int] = ()
) -> dict[int, str]:
    """Return the channels that nothing switches off, each with the reason: those of protected components, and
    those that the model or the board's configuration names.
    """
    found = dict.fromkeys((*model.protected_channels, *channels), "nothing switches it off")
    for name, device in model.hardware.items():
        if device.channel is not None and name in protected:
            found[device.channel] = protected[name]
    return found
