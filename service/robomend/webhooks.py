"""Signed calls of configured addresses: who may be called, and how a call is signed.

    POST <url>                                   application/json
    X-Robomend-Timestamp: 1761000000             seconds since the epoch
    X-Robomend-Signature: sha256=<hex>           HMAC-SHA256 of "<timestamp>.<body>" with the shared secret
    Idempotency-Key: repair-7:2                  a receiver that has seen it answers as before

Where a webhook may point is checked on every call, after the name was looked up and against the very address
that is then connected to, so that a name cannot change in between.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import hmac
import ipaddress
import re
import socket
import ssl
import time
import unicodedata
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any
from urllib.parse import urlsplit

import httpx

from robomend.errors import InputError
from robomend.redaction import shown_url

ANSWER_BYTES = 64 * 1024

INSIDE = tuple(
    map(
        ipaddress.ip_network,
        (
            "168.63.129.16/32",  # a public address with metadata for machines of its cloud
            "192.0.0.0/24",  # protocol assignments, another cloud's metadata among them
            "192.88.99.0/24",  # relays of 6to4, which is deprecated
            "224.0.0.0/4",
            "3fff::/20",  # documentation
            "5f00::/16",  # segment identifiers of a network's own
            "ff00::/8",
            "::/96",  # IPv4 addresses in disguise: deprecated, translated (SIIT, locally), 6to4
            "::ffff:0:0:0/96",
            "64:ff9b:1::/48",
            "2002::/16",
        ),
    )
)
"""Refused although some versions of the standard library take them for addresses of the internet."""

NAT64 = ipaddress.ip_network("64:ff9b::/96")


@cache
def certificates() -> ssl.SSLContext:
    """Return whom calls by HTTPS trust. To read that takes 20 ms, for which the event loop waits once."""
    return httpx.create_ssl_context(trust_env=False)


def client() -> httpx.AsyncClient:
    """Return a client that follows nobody elsewhere, and takes no proxy from the environment."""
    return httpx.AsyncClient(follow_redirects=False, trust_env=False, verify=certificates())


@dataclass(frozen=True, slots=True)
class Webhook:
    """One receiver. Neither `secret` nor what may be a credential of the address is in logs or answers."""

    url: str
    secret: str
    allow_private: bool = False  # else loopback, private, link-local and metadata addresses are refused

    @property
    def shown(self) -> str:
        """The address as messages have it."""
        return shown_url(self.url)

    def __repr__(self) -> str:
        return f"Webhook(url={self.shown!r}, secret=…, allow_private={self.allow_private})"


def receiver(options: Mapping[str, Any], hosts: Collection[str]) -> Webhook:
    """Return the receiver that an executor's options name.

    Args:
        hosts: those that may have private addresses, from the service's settings: `name` or `name:port`.

    Raises:
        InputError: options that do not fit, or an address that cannot be called.
    """
    unknown = set(options) - {"url", "secret", "allow_private"}
    url, secret = options.get("url"), options.get("secret")
    if unknown or not isinstance(url, str) or not isinstance(secret, str) or not secret:
        raise InputError("a webhook needs url and secret, and takes nothing else")
    try:
        parts = urlsplit(url)
        host, port = (parts.hostname or "").lower(), parts.port
    except ValueError as error:
        raise InputError(f"url: {shown_url(url)!r}: {error}") from error
    if parts.scheme not in ("http", "https") or not host or port == 0:
        raise InputError(f"url: {shown_url(url)!r} is no http or https address with a host")
    if "@" in parts.netloc:
        raise InputError("url: no user and password in an address; a receiver knows us by `secret`")
    if not url.isprintable() or " " in url:
        raise InputError("url: an address has no spaces or control characters")
    allowed = {name.lower() for name in hosts}
    private = host in allowed or f"{host}:{port or (443 if parts.scheme == 'https' else 80)}" in allowed
    if options.get("allow_private") and not private:
        raise InputError(
            f"allow_private: which private addresses may be called is for the service's own settings to say: "
            f"name {host!r} in webhook_hosts there"
        )
    if not private and _is_inside(host):
        raise InputError(f"url: {host} is a private address, and the setting webhook_hosts does not name it")
    return Webhook(url, secret, private)


def _is_inside(host: str) -> bool:
    """Return whether a host is given by a private address, in whatever spelling a resolver understands.

    Names are looked up at each call.
    """
    plain = unicodedata.normalize("NFKC", host).replace("\u3002", ".").rstrip(".").lower()
    if re.fullmatch(r"[0-9a-fx.]+", plain):  # 127.1, 2130706433, 0x7f000001, 0177.0.0.1
        with contextlib.suppress(OSError):
            plain = socket.inet_ntoa(socket.inet_aton(plain))
    try:
        return not outside(plain)
    except ValueError:
        return plain == "localhost" or plain.endswith(".localhost")


def signature(secret: str, timestamp: str, body: bytes) -> str:
    """Return the value of X-Robomend-Signature; receivers compare it in constant time."""
    digest = hmac.new(secret.encode(), timestamp.encode() + b"." + body, hashlib.sha256).hexdigest()
    return f"sha256={digest}"


async def allowed_address(hook: Webhook) -> str | None:
    """Return the address that the hook's name leads to now, or None when it may not be called."""
    parts = urlsplit(hook.url)
    port = parts.port or (443 if parts.scheme == "https" else 80)
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(parts.hostname, port, type=socket.SOCK_STREAM)
    for *_, where in found:
        if hook.allow_private or outside(str(where[0])):
            return str(where[0])
    return None


def outside(text: str) -> bool:
    """Return whether an address is one of the internet; what it stands for counts, not how it is written."""
    address = ipaddress.ip_address(text)
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            address = address.ipv4_mapped
        elif address in NAT64:  # the last four bytes
            address = ipaddress.IPv4Address(int(address) & 0xFFFF_FFFF)
    return address.is_global and not any(address in network for network in INSIDE)


async def post(
    client: httpx.AsyncClient, hook: Webhook, address: str, idempotency_key: str, body: bytes
) -> httpx.Response:
    """Call the receiver at this address of its, signed. ValueError for an answer beyond all measure."""
    url = httpx.URL(hook.url)
    timestamp = str(int(time.time()))
    request = client.build_request(
        "POST",
        url.copy_with(host=address),
        content=body,
        headers={
            "Host": url.netloc.decode(),
            "Content-Type": "application/json",
            "Idempotency-Key": idempotency_key,
            "X-Robomend-Timestamp": timestamp,
            "X-Robomend-Signature": signature(hook.secret, timestamp, body),
        },
        extensions={"sni_hostname": url.host},
    )
    response = await client.send(request, stream=True)
    try:
        received = b""
        async for chunk in response.aiter_raw():
            received += chunk
            if len(received) > ANSWER_BYTES:
                raise ValueError("the answer is longer than 64 KiB")
        return httpx.Response(response.status_code, content=received)
    finally:
        await response.aclose()
