"""Faults that could be planted on a robot, by whom, how each is undone, and which never are.

    node killed        its process is ended                    undone by starting it
    node frozen        its process is halted, and goes on      undone by letting it go on
    node mute          another process stands in, and is mute  undone by starting the node's own
    topic dropped      the bus hands none of it on             undone by letting it pass
    topic delayed      the bus hands it on late, in bunches    undone by letting it pass
    device off         its channel is switched off             undone by switching it on
    device unplugged   a person pulls its data cable           undone by plugging it in
    channel …, board … what the emulated power board can do    undone by clearing it

To add one: a kind here, in BY, in `plantable`, and in `kept_by` or `taken_by` where it differs from the
others; who plants it in robomend/drills/hands.py; its row in docs/drill.md. Pure.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from robomend.model.components import ComponentModel, Hardware
from robomend.planning.influence import touched
from robomend.planning.protection import Protection, protected_channels
from robomend_client.literals import Atom


class FaultKind(StrEnum):
    """How a fault is planted."""

    KILLED = "node-killed"
    FROZEN = "node-frozen"
    MUTE = "node-mute"
    DROPPED = "topic-dropped"
    DELAYED = "topic-delayed"
    OFF = "device-off"
    UNPLUGGED = "device-unplugged"
    STUCK = "channel-stuck"
    OPEN = "channel-open"
    SHORT = "channel-short"
    BROWN_OUT = "board-brown-out"
    LATE = "board-late"
    SPLIT = "board-split"
    BOARD_MUTE = "board-mute"
    REFUSE = "board-refuse"
    GARBAGE = "board-garbage"
    DROP = "board-drop"


NODE_FAULTS = (FaultKind.KILLED, FaultKind.FROZEN, FaultKind.MUTE)
TOPIC_FAULTS = (FaultKind.DROPPED, FaultKind.DELAYED)
AGENTS_FAULTS = frozenset({*NODE_FAULTS, *TOPIC_FAULTS})
CHANNEL_FAULTS = (FaultKind.STUCK, FaultKind.OPEN, FaultKind.SHORT)
LINE_FAULTS = (
    FaultKind.LATE,
    FaultKind.SPLIT,
    FaultKind.BOARD_MUTE,
    FaultKind.REFUSE,
    FaultKind.GARBAGE,
    FaultKind.DROP,
)
"""Of the board's own connection: no component is at fault, and none is to be blamed."""

EMULATED: Mapping[FaultKind, str] = {
    kind: kind.partition("-")[2] for kind in (*CHANNEL_FAULTS, FaultKind.BROWN_OUT, *LINE_FAULTS)
}
"""Faults that only an emulated board has, by the names of its control port."""

BY: Mapping[FaultKind, str] = {
    **dict.fromkeys(AGENTS_FAULTS, "agent"),
    FaultKind.OFF: "board",
    FaultKind.UNPLUGGED: "a person",
    **dict.fromkeys(EMULATED, "emulated board"),
}

NEEDED_ACTION: Mapping[FaultKind, str] = {
    FaultKind.KILLED: "start_node",
    FaultKind.MUTE: "start_node",
    **dict.fromkeys((FaultKind.OFF, FaultKind.STUCK, FaultKind.SHORT), "power_up"),
}
"""What an undo does besides: a robot on which it is not permitted would keep the fault."""


@dataclass(frozen=True, slots=True)
class DrilledBoard:
    """What a drill may do to a robot's power board, as the robot's configuration has it."""

    protected: Collection[int] = ()
    emulated: bool = False  # it has a control port


@dataclass(frozen=True, slots=True)
class Plantable:
    """A fault that could be planted, or never is."""

    kind: FaultKind
    component: str | None  # what is at fault; None: nothing that the model knows
    act: str
    undo: str
    refused: str | None  # why it is not planted
    topic: str | None = None  # of the component's, which is disturbed

    @property
    def name(self) -> str:
        """KIND:COMPONENT, KIND:TOPIC, or KIND alone."""
        return fault_name(self.kind, self.component, self.topic)


def fault_name(kind: str, component: str | None, topic: str | None) -> str:
    """Return a fault's name, by which people ask for it."""
    target = topic or component
    return kind if target is None else f"{kind}:{target}"


def drivers_of(parts: ComponentModel, components: Collection[str]) -> frozenset[str]:
    """Return the nodes that drive these devices, or those that they feed; none of a node."""
    devices = touched(parts, list(components)) & parts.hardware.keys()
    return frozenset(name for name, node in parts.nodes.items() if devices.intersection(node.drives))


def taken_by(parts: ComponentModel, kind: FaultKind, component: str | None) -> frozenset[str]:
    """Return the components that a fault takes away; a low supply takes all devices on the board."""
    if kind is FaultKind.BROWN_OUT:
        return frozenset(name for name, device in parts.hardware.items() if device.channel is not None)
    return frozenset() if component is None else frozenset({component})


def kept_by(kind: FaultKind, taken: Collection[str], drivers: Collection[str]) -> frozenset[Atom]:
    """Return what goes on holding: a halted process runs, an unplugged device is on, its drivers run."""
    kept = {Atom("running", (name,)) for name in drivers}
    if kind in {FaultKind.FROZEN, FaultKind.MUTE, *TOPIC_FAULTS}:
        kept |= {Atom("running", (name,)) for name in taken}
    elif kind in {FaultKind.UNPLUGGED, FaultKind.OPEN, FaultKind.BROWN_OUT}:
        kept |= {Atom("on", (name,)) for name in taken}
    return frozenset(kept)


def plantable(
    parts: ComponentModel,
    protected: Protection,
    board: DrilledBoard | None,
    *,
    meant_off: Collection[str] = (),
) -> Iterator[Plantable]:
    """Yield every fault of a robot in the order of its model; see `drill_plan`.

    Args:
        protected: what nothing switches off or stops, and why.
        board: its power board; None: it has none.
        meant_off: components that are meant to be stopped or off, and stay so.
    """
    idle = {name: f"{name} is meant to be stopped or off" for name in meant_off}
    channels = protected_channels(parts, protected, () if board is None else board.protected)
    for name, device in parts.hardware.items():
        why = protected.get(name) or idle.get(name)
        yield from _of_device(name, device, why, None if device.channel is None else channels, board)
    for name, node in parts.nodes.items():
        why = protected.get(name) or idle.get(name)
        no_undo = None if node.restartable else "nothing restarts it, so that there is no undo"
        yield Plantable(
            FaultKind.KILLED, name, f"kill the process of {name}", f"start {name}", why or no_undo
        )
        yield Plantable(FaultKind.FROZEN, name, f"halt the process of {name}", "let it go on", why)
        yield Plantable(
            FaultKind.MUTE,
            name,
            f"put a mute process in the place of {name}",
            f"end that, and start {name}",
            why or no_undo,
        )
        for topic in node.publishes:
            yield from _of_topic(parts, name, topic, why or _reader_kept(parts, topic, protected))
    if board is not None and board.emulated:
        yield from _of_board(parts, protected)


def _of_device(
    name: str,
    device: Hardware,
    why: str | None,
    channels: Mapping[int, str] | None,
    board: DrilledBoard | None,
) -> Iterator[Plantable]:
    """Yield the faults of a device; `channels` are the protected ones, None where it hangs on none."""
    if channels is not None and device.channel is not None:
        off = why or channels.get(device.channel)
        where = f"channel {device.channel}"
        no_board = "the robot has no `board` that could switch it" if board is None else None
        yield Plantable(FaultKind.OFF, name, f"switch off {where}", f"switch on {where}", off or no_board)
        if board is not None and board.emulated:
            cleared = f"clear the fault of {where}, and switch it on"
            yield Plantable(FaultKind.STUCK, name, f"let the relay of {where} stick at off", cleared, off)
            yield Plantable(FaultKind.OPEN, name, f"break the cable of {where}", "mend the cable", off)
            yield Plantable(FaultKind.SHORT, name, f"short {where}", cleared, off)
    yield Plantable(FaultKind.UNPLUGGED, name, f"pull the data cable of {name}", "plug it in", why)


def _of_topic(parts: ComponentModel, node: str, topic: str, why: str | None) -> Iterator[Plantable]:
    publishers = sum(topic in other.publishes for other in parts.nodes.values())
    if publishers > 1:
        why = why or f"{topic} has {publishers} publishers: none of them would be at fault"
    undo = f"let {topic} pass again"
    yield Plantable(FaultKind.DROPPED, node, f"drop what is published on {topic}", undo, why, topic)
    delay = f"hold back what is published on {topic}, and hand it on in bunches"
    yield Plantable(FaultKind.DELAYED, node, delay, undo, why, topic)


def _of_board(parts: ComponentModel, protected: Protection) -> Iterator[Plantable]:
    """Yield the faults of an emulated board that are of no channel."""
    devices = taken_by(parts, FaultKind.BROWN_OUT, None)
    kept = sorted(devices & protected.keys())
    why = protected[kept[0]] if kept else None
    full = "let the supply give its full voltage, and restart drivers that stay mute"
    yield Plantable(FaultKind.BROWN_OUT, None, "let the board's supply give too little", full, why)
    for kind, act in (
        (FaultKind.LATE, "let the board's frames come late"),
        (FaultKind.SPLIT, "let the board's frames come in pieces"),
        (FaultKind.BOARD_MUTE, "let the board say nothing"),
        (FaultKind.REFUSE, "cut the connections to the board, and let it refuse new ones"),
        (FaultKind.GARBAGE, "let the board send bytes that are no frame, once"),
        (FaultKind.DROP, "cut the connections to the board, once"),
    ):
        yield Plantable(kind, None, act, "let the board's line be as it was", None)


def _reader_kept(parts: ComponentModel, topic: str, protected: Protection) -> str | None:
    """Return why what a protected node reads is not disturbed."""
    readers = (
        name
        for name, node in parts.nodes.items()
        if name in protected and any(topic in inputs for inputs in node.publishes.values())
    )
    reader = next(readers, None)
    return None if reader is None else f"{reader} reads {topic}, and is protected"
