"""Who is asking, may they, and not too often: the check in front of every route.

    Authorization header ──► key ring ──┬─► principal ──► RULES (robomend.security) ──► rate ──► the route
    cookie of a sign-in ──► the store ──┘

It runs before a body is read, so nobody without a key makes us parse one. The key ring is a copy of the
store's keys, at most `FRESH_S` old: a key revoked on another instance opens nothing after that.
"""

from __future__ import annotations

import asyncio
import math
import re
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable, Coroutine
from functools import lru_cache
from typing import Any, Protocol

from fastapi.routing import APIRoute
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Scope

from robomend.api import lists
from robomend.api.body import AGAIN, StrictRequest
from robomend.api.problems import Problem
from robomend.errors import NotFound, RobomendError
from robomend.logs import PRINCIPAL
from robomend.metrics import Metrics
from robomend.robots.reporters import Reporter
from robomend.security import KEY, LOCAL, RULES, Principal, Role, digest, host_name, loopback
from robomend.settings import Settings
from robomend.store import Store, Transaction, api_keys
from robomend.store.records import ApiKey, AuditEntry, SignIn

PLAIN = "robomend_session"
SECURE = f"__Host-{PLAIN}"
"""Under TLS. Browsers take a cookie of this prefix from this very host only, and over TLS only."""

TOKEN = re.compile(r"[A-Za-z0-9_-]{43}\Z")
SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
MOST = 100
"""Browsers signed in with one key; one more signs the oldest out."""
ADDRESSES = 10_000
"""Client addresses whose sign-ins are counted."""
BURST = 10
KNOWN = 1000
"""Sign-ins that were found lately are known by heart, for a stop while the store does not answer."""


class SignIns:
    """Browsers: a page's user shows a key once, and a cookie from then on, for EventSource sends no headers.

        POST /session {"key": "rm_…"} ──► key ring ──► the store keeps a sign-in ──► Set-Cookie
        any request with the cookie ──► the store: is it there, in time, its key not revoked? ──► principal

    The cookie is 256 random bits, of which the store has the SHA-256. It is asked each time: pages are few,
    and so a sign-out or a revoked key counts at once, on every instance.

    A browser sends cookies on its own, whoever made the page that asks. Three things keep other pages out:
    SameSite=Strict; a change needs an Origin header that is ours or Sec-Fetch-Site: same-origin; and what the
    browser itself calls cross-origin is refused for reads as well.
    """

    def __init__(self, store: Store, settings: Settings) -> None:
        self._store = store
        self._settings = settings
        self._rates: OrderedDict[str, Bucket] = OrderedDict()
        self._known: OrderedDict[str, Principal] = OrderedDict()  # by digest: found lately

    def wait_s(self, request: Request) -> float:
        """Count a sign-in; return 0, or in how many seconds its client's address may try again."""
        address = request.client.host if request.client is not None else ""
        bucket = self._rates.get(address)
        if bucket is None:
            bucket = self._rates[address] = Bucket(self._settings.sign_ins_per_minute / 60, BURST)
            if len(self._rates) > ADDRESSES:
                self._rates.popitem(last=False)
        self._rates.move_to_end(address)
        return bucket.take()

    async def begin(self, request: Request, principal: Principal) -> tuple[Principal, str]:
        """Keep a sign-in; return who it is now, and the Set-Cookie header."""
        token = secrets.token_urlsafe(32)
        lasts_s = self._settings.sign_in_hours * 3600
        key, expires_ns = str(principal.key), time.time_ns() + round(lasts_s * 1e9)

        def begin(tx: Transaction) -> SignIn:
            made = api_keys.add_sign_in(tx, digest(token), key, expires_ns=expires_ns, most=MOST)
            tx.note(AuditEntry(actor=principal.name, action="session.begin", subject=principal.name))
            return made

        try:
            made = await self._store.write(begin)
        except NotFound as error:  # revoked since the ring was read
            raise Problem(401, "this key is revoked") from error
        return _signed_in(made), _cookie(request, token, round(lasts_s))

    async def find(self, request: Request) -> Principal | None:
        """Return who is signed in with the request's cookie, None if nobody is.

        Raises:
            Problem: 403, another origin's page sends it.
        """
        token = _token(request)
        if token is None:
            return None
        _check_origin(request)
        found = await self._store.read(api_keys.sign_in, digest(token))
        if found is None or found.key.revoked_ns is not None:
            self._known.pop(digest(token), None)
            return None
        principal = self._known[digest(token)] = _signed_in(found)
        while len(self._known) > KNOWN:
            self._known.popitem(last=False)
        return principal

    def known(self, request: Request) -> Principal | None:
        """Return who was signed in with the request's cookie when the store was asked last; for any thread.

        Raises:
            Problem: 403, another origin's page sends it.
        """
        token = _token(request)
        if token is None:
            return None
        _check_origin(request)
        found = self._known.get(digest(token))
        over = found is None or (found.until_ns is not None and found.until_ns < time.time_ns())
        return None if over else found

    async def end(self, request: Request, response: Response) -> None:
        """Forget the request's sign-in, if it has one, and its cookie."""
        token = _token(request)
        if token is None:
            return
        principal: Principal = request.scope["robomend.principal"]

        def end(tx: Transaction) -> None:
            api_keys.end_sign_in(tx, digest(token))
            tx.note(AuditEntry(actor=principal.name, action="session.end", subject=principal.name))

        await self._store.write(end)
        self._known.pop(digest(token), None)
        response.headers.append("Set-Cookie", _cookie(request, "", 0))


def _token(request: Request) -> str | None:
    token = request.cookies.get(SECURE) or request.cookies.get(PLAIN)
    return token if token is not None and TOKEN.match(token) else None


def _check_origin(request: Request) -> None:
    """Refuse a cookie that the browser may have sent for another origin's page."""
    site = request.headers.get("sec-fetch-site")
    told = site == "same-origin" or (site is None and "origin" in request.headers)
    if foreign(request.scope) is None and (told or request.method in SAFE):
        return
    raise Problem(
        403,
        "a request with a cookie must come from a page of this service (Origin, or Sec-Fetch-Site)",
        code="cross-origin",
    )


def _cookie(request: Request, token: str, lasts_s: int) -> str:
    """Return a Set-Cookie header. Behind a proxy that ends TLS, the Origin tells that the page is secure."""
    origin = request.headers.get("origin", "")
    secure = request.url.scheme == "https" or origin.lower().startswith("https://")
    name, more = (SECURE, "; Secure") if secure else (PLAIN, "")
    return f"{name}={token}; Path=/; Max-Age={lasts_s}; HttpOnly; SameSite=Strict{more}"


def _signed_in(found: SignIn) -> Principal:
    key = found.key
    return Principal(key.name, Role(key.role), key.robot, key.id, found.expires_ns)


# --- not too often: a token bucket


class Bucket:
    """A token bucket."""

    __slots__ = ("_policy", "burst", "filled_at", "rate", "tokens")

    def __init__(self, rate: float, burst: int) -> None:
        """`rate` tokens come a second, up to `burst`."""
        self.rate, self.burst = rate, burst
        self.tokens = float(burst)
        self.filled_at = time.monotonic()
        full_s = math.ceil(burst / rate)
        self._policy = (b"ratelimit-policy", b'"key";q=%d;w=%d' % (burst, full_s))

    def headers(self) -> tuple[tuple[bytes, bytes], ...]:
        """Return what a client is told of it (draft-ietf-httpapi-ratelimit-headers)."""
        back_s = math.ceil((self.burst - self.tokens) / self.rate)
        return self._policy, (b"ratelimit", b'"key";r=%d;t=%d' % (self.tokens, back_s))

    def take(self) -> float:
        """Take one token; return 0, or the seconds until there is one."""
        now = time.monotonic()
        self.tokens = min(self.burst, self.tokens + (now - self.filled_at) * self.rate)
        self.filled_at = now
        if self.tokens >= 1:
            self.tokens -= 1
            return 0.0
        return (1 - self.tokens) / self.rate


# --- what a request's headers say of where it comes from.
#
# A browser that asks for a page of another origin says so in Origin and in Sec-Fetch-Site.
#
# Other clients send neither. A browser sends Origin with every change and with reads by a script of another
# origin, Sec-Fetch-Site with every request, images and forms included (old ones do not).

OURS = frozenset({b"same-origin", b"none"})
"""none: somebody typed the address, or followed a bookmark."""


BY_NAME = "robomend.headers"
"""In a scope: its headers by their names; see `by_name`."""


def by_name(scope: Scope) -> dict[bytes, bytes]:
    """Return a request's headers by their names in lower case, of a repeated one the first.

    Starlette's mapping gives the same, with an exception inside for each that is not there.
    """
    found: dict[bytes, bytes] | None = scope.get(BY_NAME)
    if found is None:
        found = scope[BY_NAME] = dict(reversed(scope["headers"]))
    return found


def foreign(scope: Scope) -> str | None:
    """Return the header by which the request is known to come from a page of another origin, or None."""
    headers = by_name(scope)
    origin, site = headers.get(b"origin"), headers.get(b"sec-fetch-site")
    if origin is None and site is None:
        return None
    if origin is not None:
        kind, _, authority = origin.lower().partition(b"://")
        # A secure page may come through a proxy that ends TLS; a plain one is foreign to a secure service.
        downgraded = kind == b"http" and scope["scheme"] == "https"
        if downgraded or authority != headers.get(b"host", b"").lower():
            return "Origin"
    return None if site is None or site in OURS else "Sec-Fetch-Site"


FRESH_S = 2.0

STRANGERS_BYTES = 4096
"""Of a body that is read before it is known whose it is."""

STRANGERS_S = 5.0


class Admitter(Protocol):
    """What a route needs of whoever lets requests in."""

    settings: Settings

    async def admit(self, request: Request, rule: tuple[str, str]) -> Principal: ...


class KeyRing:
    """The keys that are valid now."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._by_hash: dict[str, Principal] = {}
        self._read_at = -math.inf
        self._reading: asyncio.Task[None] | None = None
        self.empty = False
        """No key was ever created, so this computer's own user needs none.
        False until the store was asked.
        """

    async def refresh(self) -> None:
        """Read the keys again if the copy is old; those who come meanwhile wait for the same reading."""
        if self.fresh:
            return
        if self._reading is None:
            self._reading = asyncio.create_task(self._read(), name="reading the keys")
            self._reading.add_done_callback(self._was_read)
        await asyncio.shield(self._reading)  # one who gives up must not end it for the others

    async def _read(self) -> None:
        now = time.monotonic()
        keys = await self._store.read(api_keys.every)
        self._by_hash = {key.hash: _principal(key) for key in keys if key.revoked_ns is None}
        # Revoking the last key must not open the door: only a store that never had one is open.
        self.empty = not keys
        self._read_at = now

    def _was_read(self, task: asyncio.Task[None]) -> None:
        if self._reading is task:
            self._reading = None
        if not task.cancelled():
            task.exception()  # whoever waits for it has it

    @property
    def fresh(self) -> bool:
        """Whether the copy counts without asking the store."""
        return time.monotonic() - self._read_at < FRESH_S

    def forget(self) -> None:
        """Read the keys again at the next request."""
        self._read_at = -math.inf
        self._reading = None

    def find(self, key: str) -> Principal | None:
        """Return whose key this is, or None."""
        return self._by_hash.get(digest(key)) if KEY.match(key) else None

    def bearer(self, authorization: bytes) -> Principal | None:
        """Return whose key is in an Authorization header, or None."""
        scheme, _, key = authorization.decode("latin-1").partition(" ")
        return self.find(key.strip()) if scheme.lower() == "bearer" else None


class Admission:
    """Lets a request through, or raises the Problem that answers it."""

    def __init__(self, store: Store, settings: Settings, metrics: Metrics) -> None:
        self.ring = KeyRing(store)
        self.sign_ins = SignIns(store, settings)
        self.settings = settings
        self._rates: dict[str, Bucket] = {}
        self._refused = metrics.refused
        self._names = frozenset(name.lower() for name in settings.allowed_hosts)
        self._ours = lru_cache(maxsize=256)(self._is_ours)  # Host headers, of which few are different

    async def admit(self, request: Request, rule: tuple[str, str]) -> Principal:
        """Return who makes this request.

        Raises:
            Problem: 401 without a valid key where one is needed, 403 beyond the role, 429 too often.
        """
        principal = await self.let_in(request.scope, rule)
        if RULES.get(rule) is not None:
            request.scope[AGAIN] = self._admit_again
        return principal

    async def let_in(self, scope: Scope, rule: tuple[str, str]) -> Principal:
        """Return who makes this request, as `admit` does, and leave nothing for later."""
        roles = RULES.get(rule, _NOBODY)
        if roles is None:
            return LOCAL
        principal = await self._authenticate(scope)
        scope["robomend.principal_name"] = principal.name
        PRINCIPAL.set(principal.name)
        _check_role(principal, roles, scope, rule)
        scope["robomend.rate"] = self._not_too_often(principal)
        return principal

    def known(self, request: Request, rule: tuple[str, str]) -> Principal | None:
        """Return who makes this request by what was known last, without asking anybody; None: nobody known.

        For any thread.

        Raises:
            Problem: 403 beyond the role, or another origin's page; 421 another host.
        """
        given = by_name(request.scope).get(b"authorization")
        if given is None:
            if self.ring.empty:
                return self._at_this_computer(request.scope)
            found = self.sign_ins.known(request)
        else:
            found = self.ring.bearer(given)
        if found is not None:
            request.scope["robomend.principal_name"] = found.name
            _check_role(found, RULES.get(rule, _NOBODY), request.scope, rule)
        return found

    async def still(self, request: Request) -> bool:
        """Return whether whoever was let in would be let in now: an open stream must not outlive its key."""
        try:
            await self._authenticate(request.scope)
        except Problem:
            return False
        except RobomendError:  # the database is away, which revokes nothing
            return True
        return True

    async def _admit_again(self, request: Request) -> None:
        """Let a request in that is under way, by its key alone."""
        if not await self.still(request):
            headers = {"WWW-Authenticate": 'Bearer error="invalid_token"'}
            raise Problem(401, "the key was revoked while the request was under way", headers=headers)

    async def sign_in(self, request: Request, key: str) -> tuple[Principal, str]:
        """Let a browser in with a key; return who it is now, and the cookie.

        Raises:
            Problem: 401 for a key that is none, 429 too often from one address.
        """
        wait_s = self.sign_ins.wait_s(request)
        if wait_s > 0:
            self._refused.labels("sign-ins").inc()
            headers = {"Retry-After": str(math.ceil(wait_s))}
            raise Problem(429, "too many sign-ins from this address", headers=headers)
        await self.ring.refresh()
        found = self.ring.find(key)
        if found is None:  # it may be younger than our copy
            self.ring.forget()
            await self.ring.refresh()
            found = self.ring.find(key)
        if found is None:
            raise Problem(401, _UNKNOWN, headers={"WWW-Authenticate": "Bearer"})
        return await self.sign_ins.begin(request, found)

    async def _authenticate(self, scope: Scope) -> Principal:
        if not self.ring.fresh:
            await self.ring.refresh()
        given = by_name(scope).get(b"authorization")
        if given is None:
            if self.ring.empty:
                return self._at_this_computer(scope)
            signed_in = await self.sign_ins.find(Request(scope))
            if signed_in is not None:
                return signed_in
            raise Problem(
                401,
                "a key is needed: Authorization: Bearer rm_… (see `robomend keys create`)",
                headers={"WWW-Authenticate": "Bearer"},
            )
        found = self.ring.bearer(given)
        if found is None:
            raise Problem(
                401,
                _UNKNOWN,
                headers={"WWW-Authenticate": 'Bearer error="invalid_token"'},
            )
        return found

    def _at_this_computer(self, scope: Scope) -> Principal:
        """Return the person at this computer: without keys, whoever reaches the port is admin.

        A page that their browser shows is not. It may have pointed its own name here (DNS rebinding), which
        is in the Host header then, so only names of this computer are served. Or it asks from its own origin,
        with an image, say: the browser tells (robomend.api.gate), and not even reads are answered.
        """
        host = by_name(scope).get(b"host", b"")
        if not self._ours(host):
            name = host.decode("latin-1")[:100]
            raise Problem(
                421,
                f"Host {name!r} is no name of this computer; see the setting allowed_hosts",
                code="unknown-host",
            )
        header = foreign(scope)
        if header is not None:
            raise Problem(
                403,
                f"without keys, no page of another origin is answered ({header}); see `robomend keys`",
                code="cross-origin",
            )
        return LOCAL

    def _is_ours(self, host: bytes) -> bool:
        """Return whether a Host header has a name of this computer."""
        name = host_name(host.decode("latin-1"))
        return loopback(name) or name in self._names

    def _not_too_often(self, principal: Principal) -> Bucket:
        bucket = self._rates.get(principal.name)
        if bucket is None:
            bucket = self._rates[principal.name] = Bucket(self.settings.requests_per_s, self.settings.burst)
        wait_s = bucket.take()
        if wait_s > 0:
            self._refused.labels("rate").inc()
            raise Problem(
                429,
                f"more than {self.settings.requests_per_s:g} requests per second with one key",
                headers={"Retry-After": str(math.ceil(wait_s))},
            )
        return bucket


def _check_role(
    principal: Principal, roles: frozenset[Role] | None, scope: Scope, rule: tuple[str, str]
) -> None:
    assert roles is not None
    role = principal.role
    if role not in roles:
        raise Problem(403, f"a key of role {role} may not {rule[0]} {rule[1]}", code="refused")
    if role is Role.ROBOT:
        robot = scope.get("path_params", {}).get("robot")
        if robot is not None and robot != principal.robot:
            raise Problem(403, f"this key is for robot {principal.robot!r} only", code="refused")


_NOBODY: frozenset[Role] = frozenset()
_UNKNOWN = "this key is unknown or revoked"


def reporter_of(principal: Principal) -> Reporter:
    """Return who reports. Without keys nobody can be told from the robot."""
    return Reporter(principal.name, principal.role is Role.ROBOT or principal is LOCAL)


class GuardedRoute(APIRoute):
    """A route behind the gate, whose body is read strictly and whose lists come as asked.

    Every route of the service is one.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handle = super().get_route_handler()
        rule = (next(iter(sorted(self.methods or ()))), self.path_format)
        takes_json = self.body_field is not None
        answers_with_list = lists.is_list(self.response_model)

        async def guarded(request: Request) -> Response:
            gate: Admitter = request.app.state.gate
            principal = await gate.admit(request, rule)
            request.scope["robomend.principal"] = principal
            strict = StrictRequest(request, gate.settings, request.app.state.parts.robots.readers)
            if takes_json:
                if RULES.get(rule) is None:  # before we know whose it is
                    await strict.read(STRANGERS_BYTES, STRANGERS_S)
                else:
                    await strict.read(_limit(gate.settings, rule))
                return await handle(strict)
            answer = await handle(request)
            return await lists.as_asked(request, answer) if answers_with_list else answer

        return guarded


def _limit(settings: Settings, rule: tuple[str, str]) -> int:
    """Return how large the body may be: models are larger than the rest, and JSON doubles their line ends."""
    models = rule[1].endswith(("/diagnoses", "v1/plans"))
    return max(settings.max_body_bytes, 2 * settings.max_model_bytes) if models else settings.max_body_bytes


def _principal(key: ApiKey) -> Principal:
    return Principal(key.name, Role(key.role), key.robot, key.id)
