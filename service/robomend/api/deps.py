"""What the routers are given: typed names for the parts that `create_app` received."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Annotated

from fastapi import Depends, Header, Path, Query, Request
from pydantic import AfterValidator, AwareDatetime

from robomend.api.problems import Problem
from robomend.api.schemas.base import MAX_INT, NAME, one_line
from robomend.api.shedding import LoadShedding
from robomend.api.store_probe import LoopWatch, StoreProbe
from robomend.api.streams import Hub
from robomend.batches.batches import Batches
from robomend.drills.drills import Drills
from robomend.errors import PreconditionRequired
from robomend.metrics import Metrics
from robomend.notifications.notifier import Notifier
from robomend.oneshots.oneshots import OneShots
from robomend.repairs.repairs import Repairs
from robomend.robots.robots import Robots
from robomend.security import Principal
from robomend.settings import Settings
from robomend.store import Store
from robomend.store.records import ABSENT, ANY, Paging


@dataclass(frozen=True, slots=True)
class Parts:
    """Everything that one application works with."""

    settings: Settings
    store: Store
    robots: Robots
    repairs: Repairs
    drills: Drills
    one_shots: OneShots
    hub: Hub
    metrics: Metrics
    watch: LoopWatch
    probe: StoreProbe
    shedding: LoadShedding
    notifier: Notifier
    batches: Batches


# Dependencies are coroutines even where they wait for nothing: the framework would hand plain functions to a
# thread, which costs more than the rest of a request.


async def _parts(request: Request) -> Parts:
    return parts_of(request)


async def _principal(request: Request) -> Principal:
    return principal_of(request)


def parts_of(request: Request) -> Parts:
    """Return the parts, for the busiest route: each dependency that is solved costs it 0.05 ms."""
    parts: Parts = request.app.state.parts
    return parts


def principal_of(request: Request) -> Principal:
    """Return whom the gate let in."""
    principal: Principal = request.scope["robomend.principal"]
    return principal


async def _still(request: Request) -> Callable[[], Awaitable[bool]]:
    return partial(request.app.state.gate.still, request)


PartsDep = Annotated[Parts, Depends(_parts)]
PrincipalDep = Annotated[Principal, Depends(_principal)]
StillDep = Annotated[Callable[[], Awaitable[bool]], Depends(_still)]
"""Asks the gate whether the request would be let in now."""

RobotPath = Annotated[str, Path(pattern=NAME, description="the robot's id", examples=["tedusar-1"])]
ModelPath = Annotated[str, Path(pattern=NAME, description="the model's name", examples=["tedusar"])]
RepairPath = Annotated[str, Path(pattern=r"^[A-Za-z0-9_.\-]{1,64}$", examples=["r-7k2m9x4q"])]
DrillPath = Annotated[str, Path(pattern=r"^[A-Za-z0-9_.\-]{1,64}$", examples=["d-7k2m9x4q"])]
KeyPath = Annotated[str, Path(pattern=r"^[A-Za-z0-9_\-]{1,64}$", examples=["k-7k2m9x4q"])]
MomentPath = Annotated[str, Path(pattern=r"^[A-Za-z0-9_\-]{1,64}$", examples=["m-4f1d6a02b7c91e3d5f80"])]
BatchPath = Annotated[str, Path(pattern=r"^[A-Za-z0-9_.\-]{1,64}$", examples=["b-7k2m9x4qhj"])]
ActionPath = Annotated[str, Path(pattern=r"^[A-Za-z0-9_.:\-]{1,128}$", examples=["r-7k2m9x4q:2"])]


async def _paging(
    cursor: Annotated[str | None, Query(max_length=200, description="`next` of the page before")] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> Paging:
    if cursor is not None and not cursor.isprintable():
        raise Problem(422, "cursor: not one that `next` gave")
    return Paging(cursor, limit)


PagingDep = Annotated[Paging, Depends(_paging)]


async def _span(
    paging: PagingDep,
    since: Annotated[
        AwareDatetime | None, Query(description="only what is not older (RFC 3339, with its offset)")
    ] = None,
    until: Annotated[AwareDatetime | None, Query(description="only what is older")] = None,
) -> Paging:
    return replace(paging, since_ns=_ns(since), until_ns=_ns(until))


def _ns(moment: datetime | None) -> int | None:
    if moment is None:
        return None
    exact = (moment - _EPOCH) // timedelta(microseconds=1) * 1000
    return min(max(exact, 0), MAX_INT)


_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

SpanDep = Annotated[Paging, Depends(_span)]
"""A page of a list over time."""

IfMatch = Annotated[
    str | None,
    Header(alias="If-Match", max_length=200, description="the ETag of the version to replace, or `*`"),
]
IfNoneMatch = Annotated[
    str | None,
    Header(alias="If-None-Match", max_length=200, description="`*`: only if it does not exist yet"),
]
IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        max_length=200,
        pattern=r"^[\x21-\x7e]+$",
        description="a repeat with the same key has the first one's effect and answer",
    ),
]


ReasonQuery = Annotated[
    str,
    Query(alias="reason", max_length=1000, description="why; it goes to the audit log"),
    AfterValidator(one_line),
]


ENTITY_TAG = re.compile(r'"[\x21\x23-\x7e]*"\Z')
"""One strong ETag (RFC 9110, 8.8.3). A weak one never matches here, and a list has more than one version."""


def expected_etag(if_match: str | None, if_none_match: str | None = None) -> str | None:
    """Return what the store is to expect: an ETag's content, ANY, ABSENT, or None where nothing is said."""
    if if_none_match is not None:
        if if_none_match.strip() != "*" or if_match is not None:
            raise Problem(422, "If-None-Match: only `*` is understood here, and not together with If-Match")
        return ABSENT
    if if_match is None:
        return None
    value = if_match.strip()
    if value == ANY:
        return ANY
    if ENTITY_TAG.match(value) and value[1:-1] != ANY:
        return value[1:-1]
    raise Problem(422, 'If-Match: give one ETag in double quotes, as in If-Match: "5f0c9a", or `*`')


def needs_etag(if_match: str | None) -> str:
    """Return what a deletion expects; it always needs If-Match."""
    expected = expected_etag(if_match)
    if expected is None:
        raise PreconditionRequired("deleting needs If-Match with the current ETag, or `*`")
    return expected


def quoted(etag: str) -> str:
    """Return an ETag as its header writes it."""
    return f'"{etag}"'
