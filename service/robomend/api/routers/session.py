"""/session: a browser signs in with a key, and is known by a cookie then; see robomend.api.gate."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from robomend.api.deps import PrincipalDep
from robomend.api.gate import Admission, GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.session import SessionOut, SignInBody
from robomend.api.views import session_out
from robomend.security import API

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
