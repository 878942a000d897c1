"""Browsers: a page's user shows a key once, and a cookie from then on, for EventSource sends no headers.

    POST /session {"key": "rm_…"} ──► key ring ──► the store keeps a sign-in ──► Set-Cookie
    any request with the cookie ──► the store: is it there, in time, its key not revoked? ──► principal

The cookie is 256 random bits, of which the store has the SHA-256. It is asked each time: pages are few, and
so a sign-out or a revoked key counts at once, on every instance.

A browser sends cookies on its own, whoever made the page that asks. Three things keep other pages out:
SameSite=Strict; a change needs an Origin header that is ours or Sec-Fetch-Site: same-origin; and what the
browser itself calls cross-origin is refused for reads as well.
"""

from __future__ import annotations

import re
import secrets
import time
from collections import OrderedDict

from starlette.requests import Request
from starlette.responses import Response

from robomend.api.origin import foreign
from robomend.api.problems import Problem
from robomend.api.shedding import Bucket
from robomend.errors import NotFound
from robomend.security import Principal, Role, digest
from robomend.settings import Settings
from robomend.store import Store, Transaction, api_keys
from robomend.store.records import AuditEntry, SignIn

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
    """See the module."""

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
        return _principal(made), _cookie(request, token, round(lasts_s))

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
        principal = self._known[digest(token)] = _principal(found)
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


def _principal(found: SignIn) -> Principal:
    key = found.key
    return Principal(key.name, Role(key.role), key.robot, key.id, found.expires_ns)
