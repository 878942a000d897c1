"""Who asks for a stop, told without waiting for anything that may hang.

    the usual gate, on the service's event loop ── answers in time ──► its answer
                        │ the loop is held, or the database does not answer
                        └──► the keys and sign-ins as they were known last

A key that was revoked in a minute in which the database does not answer can still set a stop. The other way
round, a person at the red button would wait for a database. Who lifts a stop waits: it is lifted for nobody
who is only known from earlier.
"""

from __future__ import annotations

import asyncio
from functools import partial

from starlette.requests import Request

from robomend.api.admitted import AGAIN
from robomend.api.gate import Admission
from robomend.api.problems import Problem
from robomend.security import RULES, Principal
from robomend.settings import Settings

USUAL_S = 0.02
"""For the usual gate."""

UNKNOWN_S = 3.0
"""For a key that is not among those known last: it may be new."""


class UrgentAdmission:
    """See the module; stands in for `Admission` in another thread's event loop."""

    def __init__(self, usual: Admission, loop: asyncio.AbstractEventLoop) -> None:
        """`loop` is the event loop that the usual gate belongs to."""
        self.settings: Settings = usual.settings
        self._usual = usual
        self._loop = loop

    async def admit(self, request: Request, rule: tuple[str, str]) -> Principal:
        """Return who makes this request; raises as the usual gate does."""
        admitted = await self._admit(request, rule)
        request.scope[AGAIN] = partial(self.admit, rule=rule)  # in this loop, not in that of the usual gate
        return admitted

    async def _admit(self, request: Request, rule: tuple[str, str]) -> Principal:
        if RULES.get(rule) is None and rule in RULES:
            return await self._usual.let_in(request.scope, rule)  # needs no key, and so nothing to wait for
        if self._usual.ring.fresh and ("authorization" in request.headers or self._usual.ring.empty):
            known = self._usual.known(request, rule)
            if known is not None:
                return known
        asking = asyncio.run_coroutine_threadsafe(self._usual.let_in(request.scope, rule), self._loop)
        usual = asyncio.wrap_future(asking)
        await asyncio.wait({usual}, timeout=USUAL_S)
        if not usual.done():
            counts = rule[0] != "DELETE" or self._usual.ring.fresh
            known = self._usual.known(request, rule) if counts else None
            if known is not None:
                asking.cancel()
                return known
            await asyncio.wait({usual}, timeout=UNKNOWN_S)
        if not usual.done():
            asking.cancel()
            raise Problem(503, "the keys cannot be read now; try again")
        return usual.result()
