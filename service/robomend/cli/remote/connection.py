"""Where the service is, the key to it, and what went wrong in words of the command line.

Exit codes: 2 what was asked for is at fault or not permitted, 3 the service is away or failed; DECLINED
where a click came too late.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from robomend.errors import BackendError, InputError, RobomendError
from robomend_client.near import did_you_mean

if TYPE_CHECKING:
    from robomend_client.rest import Client
    from robomend_client.rest.errors import ClientError

DEFAULT_URL = "http://127.0.0.1:8600"
URL_VARIABLE = "ROBOMEND_URL"
KEY_VARIABLE = "ROBOMEND_KEY"

TIMEOUT_S = 10.0
"""For each answer of the service."""

DECLINED = 1
"""The exit code of a command that came too late: what it was about is in another state by now."""

LOOKED_AT = 1000
"""Robots, and repairs, whose names are compared with one that nobody knows."""

Command = Callable[..., Any]


def service_options(role: str, default: str | None = DEFAULT_URL) -> Callable[[Command], Command]:
    """Add --url and --key to a command.

    Args:
        role: the least that a key needs.
        default: the service that is asked unless another is named; None: no service.
    """
    where = "Of the service" if default else "Ask the service that runs there"
    url = click.option(
        "--url",
        envvar=URL_VARIABLE,
        default=default,
        show_default=default is not None,
        help=f"{where}; also by {URL_VARIABLE}.",
    )
    key = click.option("--key", envvar=KEY_VARIABLE, help=f"Of role {role}; better by {KEY_VARIABLE}.")
    return lambda command: url(key(command))


def format_option(*others: str, default: str = "table") -> Callable[[Command], Command]:
    """Add --format to a command: table or json, unless said otherwise."""
    formats = (default, *others) if others else (default, "json")
    return click.option("--format", "format_", type=click.Choice(formats), default=default, show_default=True)


@contextmanager
def asking(
    url: str, key: str | None, *, robot: str | None = None, repair: str | None = None
) -> Iterator[Client]:
    """A client of the service; what goes wrong with it is raised as InputError or BackendError.

    Args:
        robot: what is asked about, so that the error about an unknown one names its neighbours.
        repair: likewise.
    """
    import httpx

    from robomend_client.rest import NEVER, Client, ClientError

    if not url.startswith(("http://", "https://")):
        raise InputError(f"--url {url}: an address begins with http:// or https://, as {DEFAULT_URL}")
    try:
        client = Client(url, key, timeout_s=TIMEOUT_S, retry=NEVER)
    except httpx.InvalidURL as error:
        raise InputError(f"--url {url}: {error}") from error
    except ClientError as error:
        raise InputError(str(error)) from error
    with client:
        try:
            yield client
        except ClientError as error:
            raise said(error, client, url, key, robot=robot, repair=repair) from error


def said(
    error: ClientError, client: Client, url: str, key: str | None, *, robot: str | None, repair: str | None
) -> RobomendError:
    """Return what a failure means to whoever typed the command."""
    import httpx

    from robomend_client.rest import errors

    if isinstance(error, errors.AnswerTimedOut):
        return BackendError(f"{url} did not answer in {TIMEOUT_S:g} s: whether it acted is unknown")
    if isinstance(error, errors.TlsFailed):
        return BackendError(str(error))
    if isinstance(error.__cause__, httpx.RemoteProtocolError) and url.startswith("http://"):
        return BackendError(
            f"{url} ends the connection without an answer: if it serves TLS, its address begins with https://"
        )
    if isinstance(error, errors.Unreachable):
        return BackendError(
            f"nobody answers at {url}: `robomend serve` starts a service there, --url or {URL_VARIABLE} "
            "names another"
        )
    if isinstance(error, errors.NotTheService):
        return BackendError(f"{url} is no robomend service: {error}")
    if isinstance(error, errors.Unauthorized):
        if key:
            return InputError(f"{url} does not know this key: it is mistyped, or was revoked")
        return InputError(
            f"{url} asks for a key: give it by {KEY_VARIABLE} or --key; `robomend keys create`, where the "
            "service runs, makes one"
        )
    if isinstance(error, errors.NotFound):
        unknown = _unknown(client, robot, repair)
        return InputError(f"{url}: {unknown}" if unknown else error.detail)
    if isinstance(error, errors.PreconditionFailed):
        return InputError("somebody else changed it meanwhile: look at it, and say it again")
    if isinstance(error, errors.ServiceFailed):
        return BackendError(f"{url}: {error}")
    if isinstance(error, errors.ApiError):
        return InputError(error.detail)
    return BackendError(f"{url}: {error}")


def _unknown(client: Client, robot: str | None, repair: str | None) -> str | None:
    """Return the error about a name that the service does not know, with the one that was meant."""
    from robomend_client.rest.errors import ClientError

    try:
        if robot is not None:
            known = [one["id"] for one in client.robots(limit=LOOKED_AT)["items"]]
            if robot not in known:
                return _nobody("robot", robot, known, "`robomend status` lists them")
        if repair is not None:
            known = [one["id"] for one in client.all_repairs(limit=LOOKED_AT)["items"]]
            if repair not in known:
                return _nobody("repair", repair, known, "`robomend repairs` lists them")
    except ClientError:  # the error that we came with is the one to tell
        return None
    return None


def _nobody(what: str, name: str, known: list[str], remedy: str) -> str:
    return f"no {what} is named {name!r}{did_you_mean(name, known) or f': {remedy}'}"
