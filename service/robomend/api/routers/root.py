"""/api/v1: what there is, for programs that find their way."""

from __future__ import annotations

from fastapi import APIRouter

from robomend.api.deps import PrincipalDep
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.schemas.operation import Operation, Root
from robomend.security import API, RULES
from robomend.version import version_info

router = APIRouter(tags=["operation"], route_class=GuardedRoute)


@router.get(API, responses=problems())
async def get_root(principal: PrincipalDep) -> Root:
    """Return what this service can do for whoever asks, and where the rest is said."""
    operations = [
        Operation(method=method, path=path)
        for (method, path), roles in RULES.items()
        if path.startswith(API) and (roles is None or principal.role in roles)
    ]
    return Root(name="robomend", version=version_info()["robomend"] or "0", operations=operations)
