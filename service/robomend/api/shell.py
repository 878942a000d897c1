"""What is around every page: who looks, what they may, the global stop, and which parts are asked for.

A page is made of parts. Its script asks for those that an event concerns, at the page's own address, with the
header `Robomend-Parts`: nothing else is looked up or sent then.
"""

from __future__ import annotations

import time
from collections.abc import Collection
from typing import Any

from starlette.requests import Request

from robomend.api.deps import Parts
from robomend.security import ACT, LOCAL, Principal, Role

PARTS_HEADER = "robomend-parts"
"""Of a request for some parts of a page only."""


def wanted_parts(request: Request, there: Collection[str]) -> tuple[str, ...]:
    """Return which of a page's parts to make: all of them, or those that are asked for."""
    asked = request.headers.get(PARTS_HEADER)
    if asked is None:
        return tuple(there)
    names = set(asked.split(","))
    return tuple(part for part in there if part in names)


def shell(request: Request, parts: Parts, principal: Principal, wanted: Collection[str]) -> dict[str, Any]:
    """Return what the template around a page needs."""
    address = request.url.path + (f"?{request.url.query}" if request.url.query else "")
    switch = parts.repairs.switch
    return {
        "principal": principal,
        "signed_in": principal is not LOCAL,
        "may_act": principal.role in ACT,
        "is_admin": principal.role is Role.ADMIN,
        "stop": switch.json(written=switch.settled),
        "now_ms": time.time_ns() // 1_000_000,
        "ping_s": parts.settings.ping_s,
        "to": address,
        "wanted": wanted,
        "fragment": PARTS_HEADER in request.headers,
    }
