"""Who is asking, may they, and not too often: the check in front of every route.

    Authorization header ──► key ring ──► principal ──► RULES (robomend.security) ──► rate ──► the route

It runs before a body is read, so nobody without a key makes us parse one. The key ring is a copy of the
store's keys, at most `FRESH_S` old: a key revoked on another instance opens nothing after that.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Coroutine
from typing import Any

import structlog
from fastapi.routing import APIRoute
from starlette.requests import Request
from starlette.responses import Response

from robomend.api.body import StrictRequest
from robomend.api.problems import Problem
from robomend.metrics import Metrics
from robomend.security import KEY, LOCAL, RULES, Principal, Role, digest, host_name, loopback
from robomend.settings import Settings
from robomend.store.interface import Store
from robomend.store.records import ApiKey

FRESH_S = 2.0


class KeyRing:
    """The keys that are valid now."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._by_hash: dict[str, Principal] = {}
        self._read_at = -math.inf
        self._reading: asyncio.Task[None] | None = None
        self.empty = False
        """No key was ever created, so this computer's own user needs none. False until the store was
        asked.
        """

    async def refresh(self) -> None:
        """Read the keys again if the copy is old; those who come meanwhile wait for the same reading."""
        if time.monotonic() - self._read_at < FRESH_S:
            return
        if self._reading is None:
            self._reading = asyncio.create_task(self._read(), name="reading the keys")
            self._reading.add_done_callback(self._was_read)
        await asyncio.shield(self._reading)  # one who gives up must not end it for the others

    async def _read(self) -> None:
        now = time.monotonic()
        keys = await self._store.read(lambda view: view.keys())
        self._by_hash = {key.hash: _principal(key) for key in keys if key.revoked_ns is None}
        # Revoking the last key must not open the door: only a store that never had one is open.
        self.empty = not keys
        self._read_at = now

    def _was_read(self, task: asyncio.Task[None]) -> None:
        if self._reading is task:
            self._reading = None
        if not task.cancelled():
            task.exception()  # whoever waits for it has it

    def forget(self) -> None:
        """Read the keys again at the next request."""
        self._read_at = -math.inf
        self._reading = None

    def find(self, key: str) -> Principal | None:
        """Return whose key this is, or None."""
        return self._by_hash.get(digest(key)) if KEY.match(key) else None


class Gate:
    """Lets a request through, or raises the Problem that answers it."""

    def __init__(self, ring: KeyRing, settings: Settings, metrics: Metrics) -> None:
        self.ring = ring
        self.settings = settings
        self._rates: dict[str, _Bucket] = {}
        self._refused = metrics.refused
        self._names = frozenset(name.lower() for name in settings.allowed_hosts)

    async def admit(self, request: Request, rule: tuple[str, str]) -> Principal:
        """Return who makes this request.

        Raises:
            Problem: 401 without a valid key where one is needed, 403 beyond the role, 429 too often.
        """
        if RULES.get(rule, _NOBODY) is None:
            return LOCAL
        await self.ring.refresh()
        principal = self._authenticate(request)
        request.scope["robomend.principal_name"] = principal.name
        structlog.contextvars.bind_contextvars(principal=principal.name)
        roles = RULES.get(rule, _NOBODY)
        assert roles is not None
        if principal.role not in roles:
            raise Problem(403, f"a key of role {principal.role} may not {rule[0]} {rule[1]}", code="refused")
        robot = request.path_params.get("robot")
        if principal.role is Role.ROBOT and robot is not None and robot != principal.robot:
            raise Problem(403, f"this key is for robot {principal.robot!r} only", code="refused")
        self._not_too_often(principal)
        return principal

    def _authenticate(self, request: Request) -> Principal:
        header = request.headers.get("authorization")
        if header is None:
            if self.ring.empty:
                self._check_host(request)
                return LOCAL
            raise Problem(
                401,
                "a key is needed: Authorization: Bearer rm_… (see `robomend keys create`)",
                headers={"WWW-Authenticate": "Bearer"},
            )
        scheme, _, key = header.partition(" ")
        found = self.ring.find(key.strip()) if scheme.lower() == "bearer" else None
        if found is None:
            raise Problem(
                401,
                "this key is unknown or revoked",
                headers={"WWW-Authenticate": 'Bearer error="invalid_token"'},
            )
        return found

    def _check_host(self, request: Request) -> None:
        """Without keys, whoever reaches the port is admin: a page whose name was pointed here must not.

        Such a name is in the Host header (DNS rebinding), so only names of this computer are served.
        """
        host = request.headers.get("host", "")
        name = host_name(host)
        if not loopback(name) and name not in self._names:
            raise Problem(
                421,
                f"Host {host[:100]!r} is no name of this computer; see the setting allowed_hosts",
                code="unknown-host",
            )

    def _not_too_often(self, principal: Principal) -> None:
        bucket = self._rates.get(principal.name)
        if bucket is None:
            bucket = self._rates[principal.name] = _Bucket(self.settings.requests_per_s, self.settings.burst)
        wait_s = bucket.take()
        if wait_s > 0:
            self._refused.labels("rate").inc()
            raise Problem(
                429,
                f"more than {self.settings.requests_per_s:g} requests per second with one key",
                headers={"Retry-After": str(math.ceil(wait_s))},
            )


class _Bucket:
    """A token bucket; there is one per key, so their number is bounded by that of the keys."""

    __slots__ = ("burst", "filled_at", "rate", "tokens")

    def __init__(self, rate: float, burst: int) -> None:
        self.rate, self.burst = rate, burst
        self.tokens = float(burst)
        self.filled_at = time.monotonic()

    def take(self) -> float:
        """Take one token; return 0, or the seconds until there is one."""
        now = time.monotonic()
        self.tokens = min(self.burst, self.tokens + (now - self.filled_at) * self.rate)
        self.filled_at = now
        if self.tokens >= 1:
            self.tokens -= 1
            return 0.0
        return (1 - self.tokens) / self.rate


_NOBODY: frozenset[Role] = frozenset()


class GuardedRoute(APIRoute):
    """A route behind the gate, whose body is read strictly. Every route of the service is one."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handle = super().get_route_handler()
        rule = (next(iter(sorted(self.methods or ()))), self.path_format)
        takes_json = self.body_field is not None

        async def guarded(request: Request) -> Response:
            gate: Gate = request.app.state.gate
            principal = await gate.admit(request, rule)
            request.scope["robomend.principal"] = principal
            strict = StrictRequest(request, gate.settings)
            if takes_json:
                await strict.read(_limit(gate.settings, rule))
                return await handle(strict)
            return await handle(request)

        return guarded


def _limit(settings: Settings, rule: tuple[str, str]) -> int:
    """Return how large the body may be: models are larger than the rest, and JSON doubles their line ends."""
    models = rule[1].endswith(("/diagnoses", "v1/plans"))
    return max(settings.max_body_bytes, 2 * settings.max_model_bytes) if models else settings.max_body_bytes


def _principal(key: ApiKey) -> Principal:
    return Principal(key.name, Role(key.role), key.robot)
