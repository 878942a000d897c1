"""What both clients do alike on the wire: addresses, headers, time-outs, the state of an event stream."""

from __future__ import annotations

import json
import os
import ssl
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import httpx

from robomend_client.events import Event
from robomend_client.rest.calls import Call, path
from robomend_client.rest.errors import ApiError, ClientError, NotTheService, Unreachable
from robomend_client.rest.retry import Retry
from robomend_client.rest.sse import EventDecoder, read_event

CONNECT_S = 5.0

STREAM_SILENCE_S = 45.0
"""The service sends a comment every 15 s: three missed ones mean a dead connection."""

GAP = "gap"
"""The event that says: what you had last is not kept any more, this starts later."""


def trusted() -> ssl.SSLContext:
    """Return what certificates are checked by: those that this computer trusts, too, or SSL_CERT_FILE names.

    A fleet's certificate is often of an authority of its own, which no public list of them has.

    Raises:
        ClientError: SSL_CERT_FILE names no such file.
    """
    try:
        context = httpx.create_ssl_context()
        context.load_default_certs()
    except OSError as error:
        raise ClientError(f"SSL_CERT_FILE={os.environ.get('SSL_CERT_FILE', '')}: {error}") from error
    return context


@dataclass(frozen=True, slots=True)
class Connection:
    """Where the service is and how to speak to it."""

    url: str
    key: str | None
    timeout_s: float
    trust_env: bool

    def options(self) -> dict[str, Any]:
        """Return the options of httpx's clients."""
        headers = {"Accept": "application/json, application/problem+json"}
        if self.key:
            headers["Authorization"] = f"Bearer {self.key}"
        return {
            "base_url": self.url.rstrip("/"),
            "headers": headers,
            "trust_env": self.trust_env,
            # Loading the certificate bundle takes 30 ms and some MB, and plain HTTP has no use for it.
            "verify": False if self.url.startswith("http://") else trusted(),
            "limits": httpx.Limits(max_connections=32, max_keepalive_connections=8, keepalive_expiry=30.0),
        }

    def request(self, call: Call[Any]) -> dict[str, Any]:
        """Return the arguments of httpx's `request`."""
        return {
            "method": call.method,
            "url": call.path,
            "params": dict(call.params) or None,
            "json": call.json,
            "content": call.content,
            "data": call.form,
            "files": [("logs", log) for log in call.files] or None,
            "headers": dict(call.headers),
            "timeout": httpx.Timeout(self.timeout_s + call.wait_s, connect=min(CONNECT_S, self.timeout_s)),
        }

    def stream(self, stream: StreamState) -> dict[str, Any]:
        """Return the arguments of httpx's `stream`."""
        return {
            "method": "GET",
            "url": stream.path,
            "headers": stream.headers(),
            "timeout": httpx.Timeout(
                self.timeout_s, read=STREAM_SILENCE_S, connect=min(CONNECT_S, self.timeout_s)
            ),
        }


class StreamState:
    """The state of an event stream that outlives its connections."""

    def __init__(
        self,
        robot: str | None,
        after: int | str | None,
        patience_s: float | None,
        on_gap: Callable[[Mapping[str, Any]], None] | None = None,
        on_connection: Callable[[ClientError | None], None] | None = None,
    ) -> None:
        self.path = path("events") if robot is None else path("robots", robot, "events")
        self._decoder = EventDecoder("" if after is None else str(after))
        self._patience_s = patience_s
        self._on_gap = on_gap
        self._on_connection = on_connection
        self._retry = Retry()
        self._failures = 0
        self._lost_at: float | None = None

    def headers(self) -> dict[str, str]:
        headers = {"Accept": "text/event-stream", "Cache-Control": "no-store"}
        if self._decoder.last_id:
            headers["Last-Event-ID"] = self._decoder.last_id
        return headers

    def connected(self, response: httpx.Response) -> None:
        """The service accepted; a half event of the last connection is forgotten."""
        kind = response.headers.get("content-type", "")
        if not kind.startswith("text/event-stream"):
            raise NotTheService(f"{response.request.url} answered {kind or 'no type'}, not an event stream")
        self._decoder.reconnected()
        self._lost_at = None
        if self._on_connection is not None:
            self._on_connection(None)

    def receive(self, data: bytes) -> Iterator[Event]:
        self._failures = 0  # only what arrives counts: a service that accepts and hangs up is backed off from
        for message in self._decoder.receive(data):
            if message.name == GAP and self._on_gap is not None:
                self._on_gap(json.loads(message.data))
            event = read_event(message)
            if event is not None:
                yield event

    def ended(self) -> ClientError:
        """Return what it means that the service closed the stream: it is going down, or so it seems."""
        return Unreachable(f"{self.path}: the service closed the stream")

    def after(self, failure: ClientError) -> float:
        """Return the seconds until the next try; raise `failure` when patience has run out."""
        now = time.monotonic()
        if self._lost_at is None and self._on_connection is not None:
            self._on_connection(failure)
        self._lost_at = now if self._lost_at is None else self._lost_at
        self._failures += 1
        if self._patience_s is not None and now - self._lost_at >= self._patience_s:
            raise failure
        wait_s = self._retry.wait_s(self._failures, draw=now % 1.0)
        asked_s = failure.retry_after_s if isinstance(failure, ApiError) else self._decoder.retry_s
        return max(wait_s, min(asked_s or 0.0, 60.0))
