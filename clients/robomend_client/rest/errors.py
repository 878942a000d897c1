"""The exceptions that callers of the REST client may catch.

ClientError
├── Unreachable            no answer: refused, reset, or the name does not resolve
│   ├── AnswerTimedOut     no answer in time: whether the service acted is unknown
│   └── TlsFailed          https:// to what speaks plain HTTP, or shows a certificate that is not trusted
├── NotTheService          an answer that no robomend service gives (a proxy's page, another program's port)
└── ApiError               the service said no, with a problem (RFC 9457) whose `code` is stable
    ├── InvalidRequest     400, 413, 415, 422 and every 4xx without a class of its own
    ├── Unauthorized       401: no key, or one that is not known
    ├── Forbidden          403: the key's role, the policy or a protection says no
    ├── NotFound           404
    ├── StateConflict           409: the resource is not in the state that the request needs
    ├── PreconditionFailed 412: someone else changed it in the meantime
    ├── PreconditionRequired 428: say which version you are replacing
    ├── TooManyRequests    429
    └── ServiceFailed      5xx: nothing wrong with the request; it may be sent again
        └── Unavailable    408, 502, 503, 504

Catch by class for the kind, look at `code` for the exact reason. All of them pickle.
"""

from __future__ import annotations

import ssl
from collections.abc import Mapping
from typing import Any

import httpx


class ClientError(Exception):
    """The root of all of them."""


class Unreachable(ClientError):
    """Nobody answered."""


class AnswerTimedOut(Unreachable):
    """The answer did not come in time: whether the service acted is unknown."""


class TlsFailed(Unreachable):
    """No TLS with what is there: it speaks plain HTTP, or its certificate is not trusted."""


class NotTheService(ClientError):
    """Something answered that is no robomend service."""


class ApiError(ClientError):
    """The service answered with a problem.

    `code` is the stable name of the reason, `detail` the sentence for people, `problem` the whole body.
    """

    def __init__(
        self,
        status: int,
        code: str,
        detail: str,
        problem: Mapping[str, Any],
        retry_after_s: float | None = None,
    ) -> None:
        super().__init__(status, code, detail, dict(problem), retry_after_s)
        self.status = status
        self.code = code
        self.detail = detail
        self.problem = dict(problem)
        self.retry_after_s = retry_after_s

    def __str__(self) -> str:
        return f"{self.status} {self.code}: {self.detail}"


class InvalidRequest(ApiError):
    """The request itself is at fault: sending it again does not help."""


class Unauthorized(ApiError):
    """No key, or one that the service does not know."""


class Forbidden(ApiError):
    """Role, policy or protection says no."""


class NotFound(ApiError):
    """No such robot, model, repair, …"""


class StateConflict(ApiError):
    """The resource is not in the state that the request needs."""


class PreconditionFailed(ApiError):
    """If-Match names another version than the current one."""


class PreconditionRequired(ApiError):
    """Replacing a resource needs the version that is being replaced."""


class TooManyRequests(ApiError):
    """Slow down; `retry_after_s` says by how much."""


class ServiceFailed(ApiError):
    """The service failed; the request may be right."""


class Unavailable(ServiceFailed):
    """The service, or what it stands on, is away for now."""


BY_STATUS: dict[int, type[ApiError]] = {
    401: Unauthorized,
    403: Forbidden,
    404: NotFound,
    408: Unavailable,  # the service waited for our body: the line was slow, not the request wrong
    409: StateConflict,
    412: PreconditionFailed,
    428: PreconditionRequired,
    429: TooManyRequests,
    502: Unavailable,
    503: Unavailable,
    504: Unavailable,
}


def raise_for(response: httpx.Response) -> None:
    """Raise what the answer says, if it is no success; the body must have been read."""
    status = response.status_code
    if status < 300:
        return
    if status < 400:
        raise NotTheService(
            f"{response.request.url} redirects to {response.headers.get('location')}; use that address"
        )
    try:
        problem = response.json()
    except ValueError:
        problem = {}
    if not isinstance(problem, dict):
        problem = {}
    code = str(problem.get("code") or f"http-{status}")
    detail = str(problem.get("detail") or problem.get("title") or response.reason_phrase or "no reason given")
    error = BY_STATUS.get(status, ServiceFailed if status >= 500 else InvalidRequest)
    raise error(status, code, detail, problem, _seconds(response.headers.get("retry-after")))


def translate(error: httpx.TransportError) -> ClientError:
    """Return what httpx's `error` is to callers of this client."""
    try:
        where = f"{error.request.method} {error.request.url}"
    except RuntimeError:  # httpx: the request was never set
        where = "the request"
    if isinstance(error, httpx.TimeoutException) and not isinstance(error, httpx.ConnectTimeout):
        return AnswerTimedOut(f"{where}: no answer in time ({type(error).__name__})")
    if isinstance(error, httpx.UnsupportedProtocol | httpx.DecodingError):
        return NotTheService(f"{where}: {error}")
    if (tls := _tls(error)) is not None:
        return TlsFailed(f"{where}: {tls}")
    return Unreachable(f"{where}: {str(error) or type(error).__name__}; is the service running there?")


NO_TLS = frozenset({"WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "HTTP_REQUEST"})
"""What OpenSSL, by its age, says of an answer in plain HTTP."""


def _tls(error: BaseException) -> str | None:
    """Return what kept TLS from coming about, with the remedy; None if it was not TLS that failed."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, ssl.SSLError):
        cause = cause.__cause__ or cause.__context__
    if cause is None:
        return None
    if isinstance(cause, ssl.SSLCertVerificationError):
        return (
            f"its certificate is not trusted ({cause.verify_message}); the variable SSL_CERT_FILE names a "
            "file of certificates that are"
        )
    if cause.reason in NO_TLS:
        return "what is there speaks no TLS: a service without a certificate is at http://"
    return None


def _seconds(retry_after: str | None) -> float | None:
    """Return Retry-After in seconds; its other form, a date, is left to the ordinary back-off."""
    try:
        return max(0.0, float(retry_after)) if retry_after else None
    except ValueError:
        return None
