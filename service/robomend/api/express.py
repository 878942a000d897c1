"""A short way for the busiest request of all, POST …/observations with a JSON batch.

    edge ──► plain? ── yes ──► gate ──► read ──► robots ──► answer
               │ no
               └─► the framework: routing, exit stacks, dependencies, validation ──► the same functions

The framework's way costs twice what the rest of this request does; direct.py leaves out the server's as well.
The route stays declared where it was, in routers/observations.py, with its schema and its place in the gate's
table; this is the same sequence of the same functions. Whatever is not quite plain takes the framework's way
and gets its answers: tests/api/test_express.py holds both to the same answers.
"""

from __future__ import annotations

import re
import time
from hashlib import sha256

from starlette.requests import Request, empty_receive
from starlette.responses import Response
from starlette.routing import BaseRoute
from starlette.types import Receive, Scope, Send

from robomend.api import strict_json
from robomend.api.deps import Parts, reporter_of
from robomend.api.gate import Admission
from robomend.api.ingestion import batch_of, once_of, read_batch
from robomend.api.origin import by_name
from robomend.api.problems import Problem, answer_to
from robomend.api.schemas.base import NAME
from robomend.api.views import accepted_response
from robomend.errors import RobomendError
from robomend.security import API

PATH = re.compile(rf"{API}/robots/({NAME.strip('^$')})/observations\Z")
KEY = re.compile(rb"[\x21-\x7e]{1,200}\Z")
RULE = ("POST", f"{API}/robots/{{robot}}/observations")


class Express:
    """See the module."""

    def __init__(self, parts: Parts, gate: Admission, route: BaseRoute) -> None:
        """`route` is the one that this is a short way to; metrics name it."""
        self._parts = parts
        self._gate = gate
        self._route = route

    def takes(self, scope: Scope) -> bool:
        """Return whether this request is a plain one; then `scope` knows its robot."""
        headers = by_name(scope)
        if scope["method"] != "POST" or headers.get(b"content-type") != b"application/json":
            return False
        found = PATH.match(scope["path"])
        if found is None or not KEY.match(headers.get(b"idempotency-key", b"-")):
            return False
        scope["path_params"] = {"robot": found[1]}
        scope["route"] = self._route
        return True

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that `takes` has found to be plain."""
        response = await self.answer(scope, None, receive)
        await response(scope, receive, send)

    async def answer(self, scope: Scope, body: bytes | None, receive: Receive = empty_receive) -> Response:
        """Return the answer to a plain request; its body is received if it is not there yet."""
        given, parts = by_name(scope).get(b"idempotency-key"), self._parts
        key = None if given is None else given.decode()
        try:
            if body is None:
                request = Request(scope, receive)
                principal = await self._gate.admit(request, RULE)
                batch, once = await read_batch(request, parts, principal, key)
            else:
                principal = await self._gate.let_in(scope, RULE)  # it will not outlive its key
                batch = batch_of(strict_json.loads(body, parts.settings.max_nesting))
                once = None if key is None else once_of(scope, principal, key, sha256(body).hexdigest())
            shedding, began = parts.shedding, time.perf_counter()
            place = shedding.begin(began - scope["robomend.began"])
            try:
                outcome = await parts.robots.observe(
                    scope["path_params"]["robot"], batch, by=reporter_of(principal), once=once
                )
            finally:
                shedding.end(place, time.perf_counter() - began)
        except (Problem, RobomendError) as error:
            return answer_to(Request(scope), error)
        return accepted_response(outcome)
