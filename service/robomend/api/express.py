"""A short way for the busiest request of all, POST …/observations with a JSON batch.

    edge ──► plain? ── yes ──► gate ──► read ──► robots ──► answer
               │ no
               └─► the framework: routing, exit stacks, dependencies, validation ──► the same functions

The framework's way costs twice what the rest of this request does.
The route stays declared where it was, in routers/observations.py, with its schema and its place in the gate's
table; this is the same sequence of the same functions. Whatever is not quite plain takes the framework's way
and gets its answers: tests/api/test_express.py holds both to the same answers.
"""

from __future__ import annotations

import re
import time

from starlette.requests import Request
from starlette.routing import BaseRoute
from starlette.types import Receive, Scope, Send

from robomend.api.deps import Parts, reporter_of
from robomend.api.gate import Admission
from robomend.api.ingestion import read_batch
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
        request, parts = Request(scope, receive), self._parts
        given = by_name(scope).get(b"idempotency-key")
        try:
            principal = await self._gate.admit(request, RULE)
            batch, once = await read_batch(
                request, parts, principal, None if given is None else given.decode()
            )
            with parts.shedding.one(time.perf_counter() - scope["robomend.began"]):
                outcome = await parts.robots.observe(
                    scope["path_params"]["robot"], batch, by=reporter_of(principal), once=once
                )
            response = accepted_response(outcome)
        except (Problem, RobomendError) as error:
            response = answer_to(request, error)
        await response(scope, receive, send)
