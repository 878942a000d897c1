"""The head of a plain batch as it came last on a connection: the next one is read by what differs.

An observer posts to one place over one connection, so its heads are the same letter for letter but for a few
values (VARYING). Where the rest is the same, the parser would find the same, and is not asked again:

    POST … ⏎ Host: … ⏎ Content-Length: │ 34 │ ⏎ Idempotency-Key: │ 5f0c9a │ ⏎⏎ │ body
    ────── as before ───────────────── │    │ ──── as before ─── │        │ as before

Only the reading is remembered. Whose key it is, what it may, how often: that is asked of each request. What
is not quite the same is parsed as before, and gets the parser's answers.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from starlette.types import Scope

from robomend.api.origin import BY_NAME, by_name

END = b"\r\n\r\n"

VARYING = {
    b"content-length": re.compile(rb"[0-9]{1,6}"),
    b"idempotency-key": re.compile(rb"[\x21-\x7e]{1,200}"),
    b"x-request-id": re.compile(rb"[\x21-\x7e]{1,200}"),
}
"""What its value may be where a head is read here; each ends at the end of its line."""


class KnownHead:
    """See the module."""

    __slots__ = ("_by_name", "_first", "_headers", "_rest", "_scope")

    def __init__(
        self, scope: Scope, first: bytes, rest: Sequence[tuple[int, bytes, re.Pattern[bytes], bytes]]
    ) -> None:
        """Made by `of`. `first` goes up to the first value; `rest`: a header, its form, up to the next."""
        self._scope = dict(scope)
        self._headers: list[tuple[bytes, bytes]] = scope["headers"]
        self._by_name = by_name(scope)
        self._first = first
        self._rest = rest

    @classmethod
    def of(cls, data: bytes, scope: Scope) -> KnownHead | None:
        """Return what is known of a head; None if the next one is to be parsed again.

        Args:
            data: begins with the head.
            scope: what the parser found in it, of a plain batch.
        """
        head, _, _ = data.partition(END)
        line, *lines = head.split(b"\r\n")
        headers = scope["headers"]
        if line != b"POST " + scope["raw_path"] + b" HTTP/1.1" or len(lines) != len(headers):
            return None
        pieces = [line + b"\r\n"]
        varying: list[tuple[int, bytes, re.Pattern[bytes]]] = []
        for number, (line, (name, value)) in enumerate(zip(lines, headers, strict=True)):
            given, _, rest = line.partition(b":")
            if given.lower() != name or rest.strip(b" \t") != value:
                return None
            if name == b"connection" and value.lower() != b"keep-alive":
                return None
            if any(name == another for _, another, _ in varying):
                return None  # of two the first counts
            if name in VARYING:
                pieces[-1] += given + b": "
                pieces.append(b"\r\n")
                varying.append((number, name, VARYING[name]))
            else:
                pieces[-1] += line + b"\r\n"
        pieces[-1] += b"\r\n"
        first, *others = pieces
        return cls(scope, first, [(*one, piece) for one, piece in zip(varying, others, strict=True)])

    def read(self, data: bytes) -> tuple[Scope, int, int] | None:
        """Return a request's scope, the bytes of its head and of its body; None: its head is another one."""
        if not data.startswith(self._first):
            return None
        headers, named = self._headers.copy(), self._by_name.copy()
        at = len(self._first)
        for number, name, form, piece in self._rest:
            value = form.match(data, at)
            if value is None or not data.startswith(piece, value.end()):
                return None
            at = value.end() + len(piece)
            named[name] = value[0]
            headers[number] = (name, value[0])
        scope = self._scope.copy()
        scope["headers"], scope[BY_NAME] = headers, named
        return scope, at, int(named[b"content-length"])
