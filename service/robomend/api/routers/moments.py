"""/moments: what robots' topics, logs and readings were when something turned bad, and its recording.

A recording comes and goes in pieces: neither side ever holds all of it.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field
from starlette.responses import StreamingResponse

from robomend.api.body import BYTES_PER_S, check_content_type, read_chunks
from robomend.api.deps import MomentPath, PagingDep, PartsDep, RobotPath
from robomend.api.gate import GuardedRoute
from robomend.api.problems import Problem, problems
from robomend.api.schemas.base import MAX_INT, In, Items, Moment, Nanoseconds, Out, Sentence, moment_of
from robomend.api.schemas.repair import ChannelOut
from robomend.api.views import board_out
from robomend.errors import NotFound, StateConflict
from robomend.security import API
from robomend.settings import Settings
from robomend.store import Store, View, moments, robots
from robomend.store.records import MomentBounds, StoredMoment

# --- moments: what an agent kept of the time in which something turned bad.

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


router = APIRouter(prefix=API, tags=["moments"], route_class=GuardedRoute)

PIECE = "application/octet-stream"
PIECE_BYTES = 1 << 20
"""Of one piece, at most; smaller ones keep other writers waiting for less."""

MB = 1024 * 1024

PIECE_BODY = {
    "requestBody": {
        "required": True,
        "content": {PIECE: {"schema": {"type": "string", "format": "binary"}}},
    }
}
RECORDING: dict[int | str, dict[str, Any]] = {
    200: {"description": "The recording", "content": {PIECE: {"schema": {"type": "string"}}}}
}


def bounds(settings: Settings) -> MomentBounds:
    """Return how much is kept."""
    return MomentBounds(settings.moments_kept, int(settings.moments_mb * MB))


def line_of(moment: StoredMoment) -> dict[str, Any]:
    """Return a moment as it stands in a list."""
    return {
        "id": moment.id,
        "robot": moment.robot,
        "agent": moment.agent,
        "at_ns": moment.at_ns,
        "literals": list(moment.literals),
        "complete": moment.complete,
        "recording_bytes": moment.size if moment.have == moment.size else None,
        "created_ns": moment.created_ns,
    }


@router.post("/robots/{robot}/moments", responses=problems(404, body=True))
async def keep_moment(robot: RobotPath, body: MomentBody, parts: PartsDep) -> MomentKept:
    """Keep what an agent has of the moment in which something turned bad.

    With the same agent and key it is the same moment: what comes later takes the place of what came before,
    until it is complete.
    """
    value = body.model_dump(mode="json")
    state = await parts.robots.memory.robot(robot)
    wired = None if state.config.board is None else board_out(await parts.robots.board(robot))
    shown = {} if wired is None else {"channels": [one.model_dump(mode="json") for one in wired.channels]}
    kept = await parts.store.write(
        partial(
            moments.keep,
            robot=robot,
            agent=body.agent,
            key=body.key,
            at_ns=body.at_ns,
            literals=value["literals"],
            complete=body.complete,
            data=value["frame"],
            board=shown,
            bounds=bounds(parts.settings),
        ),
        robots=(robot,),
    )
    if kept.created_ns == kept.updated_ns:
        parts.metrics.moments.inc()
    parts.metrics.moment_bytes.labels("frames").inc(kept.bytes - (kept.size or 0))
    return MomentKept(id=kept.id, have=kept.have)


@router.put(
    "/robots/{robot}/moments/{moment}/recording",
    responses=problems(404, 409, body=True),
    openapi_extra=PIECE_BODY,
)
async def keep_recording(
    request: Request,
    robot: RobotPath,
    moment: MomentPath,
    parts: PartsDep,
    at: Annotated[int, Query(ge=0, le=MAX_INT, description="where the piece begins, in bytes")],
    size: Annotated[int, Query(ge=1, le=MAX_INT, description="of the whole recording, in bytes")],
) -> PieceKept:
    """Keep a piece of a moment's recording (.mcap), of at most 1 MiB.

    One that does not begin where the last one ended changes nothing; the answer says where to go on.
    """
    check_content_type(request, PIECE)
    most = int(parts.settings.max_recording_mb * MB)
    if size > most:
        raise Problem(413, f"the recording has {size} bytes; at most {most} are taken")
    timeout_s = parts.settings.body_timeout_s
    data = b"".join([chunk async for chunk in read_chunks(request, PIECE_BYTES, timeout_s, BYTES_PER_S)])
    keep = partial(
        moments.keep_piece,
        robot=robot,
        moment=moment,
        at=at,
        size=size,
        data=data,
        bounds=bounds(parts.settings),
    )
    have = await parts.store.write(keep, robots=(robot,))
    if have == at + len(data):
        parts.metrics.moment_bytes.labels("recordings").inc(len(data))
    return PieceKept(have=have)


@router.get("/robots/{robot}/moments", responses=problems(404))
async def list_moments(robot: RobotPath, parts: PartsDep, paging: PagingDep) -> Items[MomentLine]:
    """List the robot's moments, newest first: what turned bad, and whether it was recorded."""
    await parts.store.read(robots.get, robot)
    found = await parts.store.read(moments.page, robot, paging)
    return Items(items=[MomentLine.model_validate(line_of(one)) for one in found.items], next=found.next)


@router.get("/moments/{moment}.mcap", response_class=Response, responses={**problems(404, 409), **RECORDING})
async def get_recording(moment: MomentPath, parts: PartsDep) -> Response:
    """Return the recording of a moment: raw messages of the seconds around it, as MCAP."""
    found = await parts.store.read(moments.get, moment)
    if found.size is None:
        raise NotFound(f"moment {moment} has no recording")
    if found.have < found.size:
        raise StateConflict(
            f"of the recording of moment {moment} {found.have} of {found.size} bytes have come"
        )
    headers = {
        "Content-Length": str(found.size),
        "Content-Disposition": f'attachment; filename="{found.robot}-{moment}.mcap"',
    }
    return StreamingResponse(_pieces(parts.store, found), headers=headers, media_type=PIECE)


@router.get("/moments/{moment}.json", responses=problems(404))  # before the next: they are tried in order
async def get_moment_file(moment: MomentPath, parts: PartsDep, response: Response) -> MomentOut:
    """Return a moment as a file to be kept."""
    response.headers["Content-Disposition"] = f'attachment; filename="{moment}.json"'
    return await parts.store.read(moment_out, moment)


@router.get("/moments/{moment}", responses=problems(404))
async def get_moment(moment: MomentPath, parts: PartsDep) -> MomentOut:
    """Return a moment with its freeze frame: last messages, values, log lines, processes, graph."""
    return await parts.store.read(moment_out, moment)


def moment_out(view: View, moment: str) -> MomentOut:
    """Return a moment as it is answered."""
    found = moments.get(view, moment)
    frame = dict(moments.frame(view, found))
    board = frame.pop("board", {})
    return MomentOut.model_validate({**line_of(found), "frame": frame, "board": board.get("channels", [])})


async def _pieces(store: Store, moment: StoredMoment) -> AsyncIterator[bytes]:
    at = 0
    while data := await store.read(moments.piece, moment, at):
        at += len(data)
        yield data
