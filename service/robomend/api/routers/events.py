"""/events: server-sent events, of the whole service or of one robot; see robomend.api.streams."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Header

from robomend.api.deps import PartsDep, RobotPath, StillDep
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.streams import EventStream
from robomend.security import API

router = APIRouter(prefix=API, tags=["events"], route_class=GuardedRoute)

LastEventId = Annotated[
    str | None,
    Header(
        alias="Last-Event-ID",
        description="the last event that came; an unknown one replays from the oldest, after a `gap`",
    ),
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
async def all_events(parts: PartsDep, still: StillDep, last_event_id: LastEventId = None) -> EventStream:
    """Follow everything that happens, from now on or after Last-Event-ID."""
    return EventStream(parts.hub, parts.hub.open(None, last_event_id), parts.settings.send_timeout_s, still)


@router.get(
    "/robots/{robot}/events",
    response_class=EventStream,
    status_code=200,
    responses={**problems(404), **STREAM},
)
async def robot_events(
    robot: RobotPath, parts: PartsDep, still: StillDep, last_event_id: LastEventId = None
) -> EventStream:
    """Follow what happens to one robot."""
    await parts.robots.memory.robot(robot)
    return EventStream(parts.hub, parts.hub.open(robot, last_event_id), parts.settings.send_timeout_s, still)
