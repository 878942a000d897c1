"""/events: server-sent events, of the whole service or of one robot; see robomend.api.streams."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Header, Query

from robomend.api.deps import PartsDep, RobotPath, StillDep
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.base import NAME
from robomend.api.streams import EventStream
from robomend.security import API
from robomend_client.events import Kind

router = APIRouter(prefix=API, tags=["events"], route_class=GuardedRoute)

LastEventId = Annotated[
    str | None,
    Header(
        alias="Last-Event-ID",
        description="the last event that came; an unknown one replays from the oldest, after a `gap`",
    ),
]

KindsQuery = Annotated[list[Kind] | None, Query(description="events of these kinds only; none: of all")]
AboutQuery = Annotated[
    str | None, Query(pattern=NAME, description="leave out what is about another robot than this one")
]
BriefQuery = Annotated[
    bool, Query(description="events without their data, and an event `ping` instead of the comment")
]

STREAM: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "An endless stream: `id`, `event` (its kind), `data` (JSON: time_ns, robot, data)",
        "content": {
            "text/event-stream": {
                "schema": {"type": "string"},
                "example": "id: 41\nevent: diagnosis\n"
                'data: {"time_ns":1764000000000000000,"robot":"tedusar-1",'
                '"data":{"revision":7,"result":{"diagnoses":[{"bad":["hokuyo"]}]}}}\n\n',
            }
        },
    }
}


@router.get("/events", response_class=EventStream, status_code=200, responses={**problems(), **STREAM})
async def all_events(
    parts: PartsDep,
    still: StillDep,
    last_event_id: LastEventId = None,
    kind: KindsQuery = None,
    about: AboutQuery = None,
    brief: BriefQuery = False,
) -> EventStream:
    """Follow everything that happens, from now on or after Last-Event-ID."""
    stream = parts.hub.open(None, last_event_id, kinds=kind or (), about=about, brief=brief)
    return EventStream(parts.hub, stream, parts.settings.send_timeout_s, still)


@router.get(
    "/robots/{robot}/events",
    response_class=EventStream,
    status_code=200,
    responses={**problems(404), **STREAM},
)
async def robot_events(
    robot: RobotPath,
    parts: PartsDep,
    still: StillDep,
    last_event_id: LastEventId = None,
    kind: KindsQuery = None,
    brief: BriefQuery = False,
) -> EventStream:
    """Follow what happens to one robot."""
    await parts.robots.memory.robot(robot)
    stream = parts.hub.open(robot, last_event_id, kinds=kind or (), brief=brief)
    return EventStream(parts.hub, stream, parts.settings.send_timeout_s, still)
