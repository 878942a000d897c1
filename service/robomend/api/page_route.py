"""A route that people look at: HTML whatever happens, forms from our own pages only, and no foreign code.

    GET  ──► gate ──► the page                     401: the page for signing in, at the same address
    POST ──► gate ──► from a page of ours? ──► done ──► 303 back to a page

Every view has an address, and every change is a form, so that all of it works without scripts. A browser
sends cookies with whatever form any page has, so a form must say by Origin or Sec-Fetch-Site that it is ours.
Without keys there is no cookie to steal, but the same holds: whoever reaches the port is admin then.

Pages are made one at a time, in a thread: the event loop goes on with what robots want.

What is around every page: who looks, what they may, the global stop, and which parts are asked for.

A page is made of parts. Its script asks for those that an event concerns, at the page's own address, with the
header `Robomend-Parts`: nothing else is looked up or sent then.
"""

from __future__ import annotations

import asyncio
import gzip
import time
from collections.abc import Callable, Collection, Coroutine, Mapping
from typing import Any
from urllib.parse import parse_qsl

from fastapi.exceptions import RequestValidationError
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from robomend.api.body import check_content_type, read_chunks
from robomend.api.deps import Parts, parts_of
from robomend.api.gate import GuardedRoute, foreign
from robomend.api.problems import Problem, of_error, of_validation
from robomend.api.schemas.base import one_line
from robomend.errors import RobomendError
from robomend.security import ACT, LOCAL, Principal, Role
from robomend.web.rendering import render

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


POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)

HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cache-Control": "no-store",
    "Vary": "Accept-Encoding",
    # Forms of a page with the policy no-referrer come with `Origin: null`.
    "Referrer-Policy": "same-origin",
}

FORM = "application/x-www-form-urlencoded"
FORM_BYTES = 64 << 10
FORM_FIELDS = 50
FORM_S = 10.0

PACKED_FROM = 1000
"""Bytes from which a page goes out compressed. None holds a secret that its address could fish for."""


PER_S = 20.0
"""Parts of pages made in a second, of all pages together: about a tenth of a core."""


class PagePace:
    """How soon open pages may ask again: all of them together are a small load, however many there are.

    A page asks at once when an event concerns it after a quiet while. From then on each answer tells it how
    long to wait: with few pages not at all. A robot's changes do not wait behind the people who watch.
    """

    def __init__(self) -> None:
        self._free_at_s = 0.0  # each answer is given the next place in a queue

    def again_s(self, now_s: float) -> float:
        """Return how long the page that is answered now is to wait before it asks again, seconds."""
        self._free_at_s = max(self._free_at_s, now_s) + 1 / PER_S
        return self._free_at_s - now_s


class PageRoute(GuardedRoute):
    """See the module."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handle = super().get_route_handler()

        async def shown(request: Request) -> Response:
            try:
                return await handle(request)
            except Problem as problem:
                return await problem_page(request, problem)
            except RobomendError as error:
                return await problem_page(request, of_error(error))
            except RequestValidationError as error:
                return await problem_page(request, of_validation(error))

        return shown


async def read_form(request: Request, most: int = FORM_BYTES) -> Mapping[str, str]:
    """Return the fields of a form, the last of those with one name; line ends are as in a file.

    Every route that changes something calls it: it refuses forms that may be on somebody else's page.
    """
    check_ours(request)
    check_content_type(request, FORM)
    body = b"".join([chunk async for chunk in read_chunks(request, most, FORM_S, 4096.0)])
    try:
        fields = parse_qsl(body.decode(), keep_blank_values=True, errors="strict", max_num_fields=FORM_FIELDS)
    except ValueError as error:
        raise Problem(400, "the form is not as a browser sends it") from error
    return {name: value.replace("\r\n", "\n") for name, value in fields}


def reason_of(form: Mapping[str, str]) -> str:
    """Return why somebody sends a form."""
    return one_line(form.get("reason", ""))[:1000]


def check_ours(request: Request) -> None:
    """Refuse a form that may be on somebody else's page; for whoever reads one without `read_form`."""
    site = request.headers.get("sec-fetch-site")
    told = site == "same-origin" or (site is None and "origin" in request.headers)
    if foreign(request.scope) is not None:
        raise Problem(403, "this form is on a page of another origin", code="cross-origin")
    if not told and "authorization" not in request.headers:  # no browser sends that on its own
        raise Problem(400, "a form must say whose page it is on, as browsers do (Origin, Sec-Fetch-Site)")


async def page(request: Request, template: str, status: int = 200, **values: Any) -> Response:
    """Return a page, or of it what the request's `Robomend-Parts` names."""
    headers = HEADERS
    if PARTS_HEADER in request.headers:
        pace: PagePace = request.app.state.pace
        headers = {**HEADERS, "Robomend-Again-Ms": f"{pace.again_s(time.monotonic()) * 1000:.0f}"}

    def made() -> Response:
        text = render(template, **values)
        return packed(request, text.encode(), "text/html; charset=utf-8", headers, status)

    one_at_a_time: asyncio.Lock = request.app.state.pages
    async with one_at_a_time:
        return await asyncio.to_thread(made)


def back(to: str) -> Response:
    """Return the way to a page of ours, after a form was done."""
    return RedirectResponse(to, 303, headers=HEADERS)


def packed(
    request: Request, body: bytes, media_type: str, headers: Mapping[str, str], status: int = 200
) -> Response:
    """Return an answer, compressed where the browser takes it."""
    headers = dict(headers)
    if len(body) >= PACKED_FROM and "gzip" in request.headers.get("accept-encoding", ""):
        body = gzip.compress(body, 5, mtime=0)
        headers["Content-Encoding"] = "gzip"
    return Response(body, status, headers, media_type)


async def problem_page(request: Request, problem: Problem) -> Response:
    """Return a problem for people. Without a key, it is the page for signing in.

    Whoever was let in finds the way on, and the stop, around it, which is fetched anew like any page's. What
    a form led to has no address that could be: it goes without.
    """
    address = request.url.path + (f"?{request.url.query}" if request.url.query else "")
    template = "sign_in.html" if problem.status == 401 and request.method == "GET" else "problem.html"
    values: dict[str, Any] = {"problem": problem, "to": address, "method": request.method, "told": False}
    status, principal = problem.status, request.scope.get("robomend.principal")
    asked = request.headers.get(PARTS_HEADER)
    if principal is not None and request.method == "GET" and asked in (None, "stop"):
        template = "problem_inside.html"
        values |= shell(request, parts_of(request), principal, ("stop",))
        status = 200 if asked else status
    answer = await page(request, template, status, **values)
    for name, value in problem.headers.items():
        answer.headers[name] = value
    return answer
