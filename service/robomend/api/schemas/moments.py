"""Moments: what an agent kept of the time in which something turned bad."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from robomend.api.schemas.base import In, Moment, Nanoseconds, Out, Sentence, moment_of
from robomend.api.schemas.repair import ChannelOut

Name = Annotated[str, Field(max_length=300)]
Text = Annotated[str, Field(max_length=4000)]
Line = Annotated[str, Field(max_length=1000)]
Seconds = Annotated[float, Field(ge=-1e9, le=1e9)]
Value = Annotated[float, Field(ge=-1e300, le=1e300)]


class MomentLiteral(In):
    """A literal that turned bad."""

    literal: Sentence
    at_s: Seconds = Field(default=0.0, description="when, from the moment on")
    reading: Annotated[str, Field(max_length=500)] | None = Field(
        default=None, description="what was measured", examples=["0 of 10 Hz for 2.1 s"]
    )


class MomentMessage(In):
    """A message as text, as much of it as fits."""

    at_s: Seconds
    text: Text


class MomentTopic(In):
    """The last messages of a topic."""

    topic: Name
    type: Name = ""
    by: list[Name] = Field(default=[], max_length=50, description="who publishes it")
    messages: list[MomentMessage] = Field(default=[], max_length=20)


class MomentSeries(In):
    """What an observer was fed with, around the moment."""

    source: Name = Field(examples=["odom:twist.twist.linear.x"])
    kind: Literal["value", "rate"] = Field(description="values, or how many came, in Hz")
    at_s: list[Seconds] = Field(max_length=2000, description="from the moment on; below 0: before it")
    values: list[Value] = Field(max_length=2000)


class MomentLog(In):
    """The last lines of a process."""

    node: Name
    lines: list[Line] = Field(max_length=200)


class MomentProcess(In):
    """A row of the agent's table of processes."""

    node: Name
    pid: int | None = None
    about: Annotated[str, Field(max_length=500)] = Field(
        examples=["exit code 1", "sleeping in futex_wait, 41 MB"]
    )


class MomentFrame(In):
    """The freeze frame."""

    topics: list[MomentTopic] = Field(default=[], max_length=500)
    series: list[MomentSeries] = Field(default=[], max_length=200)
    logs: list[MomentLog] = Field(default=[], max_length=200)
    processes: list[MomentProcess] = Field(default=[], max_length=500)
    nodes: dict[Name, bool | None] = Field(
        default={}, max_length=2000, description="of the robot's graph: whether each runs"
    )
    notes: list[Line] = Field(default=[], max_length=50, description="what is not in it, and why")


class MomentBody(In):
    """A moment. Sent again with the same agent and key, it takes the place of what was sent before."""

    agent: Annotated[str, Field(min_length=1, max_length=200)]
    key: str = Field(pattern=r"^[A-Za-z0-9_\-]{1,64}$", description="the agent's own name for it")
    at_ns: Nanoseconds = Field(description="when it turned bad, by the agent's clock")
    literals: list[MomentLiteral] = Field(min_length=1, max_length=200)
    complete: bool = Field(default=True, description="nothing will be added to the frame")
    frame: MomentFrame = MomentFrame()


class MomentKept(Out):
    """What the service has of a moment."""

    id: str = Field(examples=["m-4f1d6a02b7c91e3d5f80"])
    have: int = Field(description="bytes of its recording: where the next piece is to begin")


class PieceKept(Out):
    """How much of a recording has come."""

    have: int = Field(description="where the next piece is to begin")


class MomentLine(Out):
    """A moment in a list."""

    id: str
    robot: str
    agent: str
    at_ns: Nanoseconds = Field(description="when it turned bad, by the agent's clock")
    at: Moment = moment_of("at_ns")
    literals: list[MomentLiteral]
    complete: bool
    recording_bytes: int | None = Field(description="null: nothing was recorded, or not all has come yet")
    created_ns: Nanoseconds = Field(description="when it came, by the service's clock")
    created: Moment = moment_of("created_ns")


class MomentOut(MomentLine):
    """A moment."""

    frame: MomentFrame
    board: list[ChannelOut] = Field(
        default=[], description="the power board, as the service measured it when the moment first came"
    )
