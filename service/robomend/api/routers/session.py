"""/session: a browser signs in with a key, and is known by a cookie then; see robomend.api.gate."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from pydantic import Field

from robomend.api.deps import PrincipalDep
from robomend.api.gate import Admission, GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.base import In, Moment, Out, moment_of
from robomend.security import API, Principal


class SignInBody(In):
    """A browser signs in."""

    key: str = Field(max_length=100, examples=["rm_…"], description="from `robomend keys create`")


class SessionOut(Out):
    """Who makes the request."""

    name: str = Field(examples=["operator"], description="of the key")
    role: str = Field(examples=["operator"])
    robot: str | None = Field(description="of a robot's key: its own id")
    expires_ns: int | None = Field(description="of a browser that is signed in: when that ends")
    expires: Moment | None = moment_of("expires_ns")


router = APIRouter(prefix=API, tags=["session"], route_class=GuardedRoute)


@router.post("/session", responses=problems(body=True))
async def sign_in(body: SignInBody, request: Request, response: Response) -> SessionOut:
    """Sign a browser in with a key: the answer sets a cookie that opens what the key opens.

    It is HttpOnly and SameSite=Strict, and Secure under TLS. A change made with it must come from a page of
    this service: `Origin`, or `Sec-Fetch-Site: same-origin`.
    """
    gate: Admission = request.app.state.gate
    principal, cookie = await gate.sign_in(request, body.key)
    response.headers.append("Set-Cookie", cookie)
    return session_out(principal)


@router.get("/session", responses=problems())
async def get_session(principal: PrincipalDep) -> SessionOut:
    """Return who makes this request, and until when the browser is signed in."""
    return session_out(principal)


@router.delete("/session", status_code=204, responses=problems(507))
async def sign_out(request: Request, response: Response) -> None:
    """Sign the browser out: its cookie opens nothing any more, on any instance."""
    gate: Admission = request.app.state.gate
    await gate.sign_ins.end(request, response)


def session_out(principal: Principal) -> SessionOut:
    """Return who makes a request."""
    return SessionOut(
        name=principal.name, role=principal.role, robot=principal.robot, expires_ns=principal.until_ns
    )
