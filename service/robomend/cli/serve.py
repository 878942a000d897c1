"""`robomend serve`: run the service until a signal ends it."""

from __future__ import annotations

import asyncio
import gc
import json
import resource
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.config import read_settings, settings_options
from robomend.cli.files import ExistingFile
from robomend.errors import InputError
from robomend.memory_limits import check_room, memory_unlimited, share_arenas

if TYPE_CHECKING:
    from robomend.settings import Settings

STARTUP_FAILED = 3
OPEN_FILES = 65_536

THREADS = 16
"""That the service begins with: the store's, the control lane's, those of what blocks."""

FIRST_MEGABYTES = 64
"""Of address space, beside the stacks of its threads: a service without them ends at its first requests."""

GARBAGE = (2_000, 100, 1_000)
"""Of young objects, of looks at them, and of looks at survivors, until Python looks for circles; for the
old ones it also waits until there are a quarter more. At its defaults every object of a thousand robots is
walked a few times a second.
"""


def gone(setting: str) -> Callable[[click.Context, click.Parameter, Any], None]:
    """Return what refuses an option that there was, naming what takes its place."""

    def refuse(_: click.Context, __: click.Parameter, value: Any) -> None:
        from robomend.settings import GONE

        if value is not None:
            raise InputError(f"--{setting}: {GONE[setting]}")

    return refuse


@click.command("serve")
@settings_options
@click.option("--host", help="Address to listen on; any but loopback needs keys.")
@click.option("--port", type=click.IntRange(0, 65535), help="0 lets the system choose one.")
@click.option("--allowed-host", "allowed_hosts", multiple=True, help="Further name for the Host header.")
@click.option("--tls-certificate", type=ExistingFile(), help="PEM, with its chain: serve by HTTPS.")
@click.option("--tls-key", type=ExistingFile(), help="PEM, of the certificate.")
@click.option("--log-level", type=click.Choice(["debug", "info", "warning", "error"]))
@click.option("--log-format", type=click.Choice(["json", "text"]))
@click.option("--announce", is_flag=True, help="Print the URL as one JSON line on stdout when ready.")
@click.option("--workers", hidden=True, expose_value=False, callback=gone("workers"))
def command(
    config_file: Path | None,
    announce: bool,
    allowed_hosts: tuple[str, ...],
    **flags: Any,
) -> int:
    """Run the service. Settings: flags over ROBOMEND_* over --config over defaults; see `robomend config`."""
    from robomend.logs import configure

    settings, _ = read_settings(config_file, allowed_hosts=allowed_hosts or None, **flags)
    configure(settings.log_level, settings.log_format)
    allow_connections()
    if not memory_unlimited():
        share_arenas()
    with asyncio.Runner(loop_factory=loop_factory()) as runner:
        return runner.run(serve(settings, announce=announce))


def loop_factory() -> Any:
    """Return uvloop's, or asyncio's own where there is none."""
    try:
        import uvloop
    except ImportError:
        return None
    return uvloop.new_event_loop


def allow_connections() -> None:
    """Let this process have as many open files as it may: each robot and each stream is one.

    The usual soft limit of 1024 is for programs that still use select(); ours do not.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = OPEN_FILES if hard == resource.RLIM_INFINITY else min(OPEN_FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def settle() -> None:
    """What is loaded by now stays, and is never looked at again; from now on Python looks by GARBAGE."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*GARBAGE)
    gc.enable()


def tell(url: str, *, announce: bool) -> None:
    """Say where the service is."""
    if announce:
        click.echo(json.dumps({"url": url, "docs": f"{url}/docs"}))
    else:
        click.echo(f"robomend serves {url} (docs: {url}/docs)", err=True)


async def serve(settings: Settings, *, announce: bool) -> int:
    """Serve until a signal comes; return the exit code."""
    gc.disable()  # until `settle`: a tenth of the time that loading takes
    from robomend.api.runtime import Runtime, any_key
    from robomend.api.server import InitSystem, check_exposure, make_server
    from robomend.repairs.repairs import make_repairs

    check_exposure(settings, await any_key(settings))
    runtime, init_system = Runtime(settings, make_repairs), InitSystem()

    def ready(url: str) -> None:
        runtime.planners.start()  # it warms up now instead of at the first repair
        settle()
        tell(url, announce=announce)
        init_system.ready()

    if not memory_unlimited():
        check_room("the service", THREADS, FIRST_MEGABYTES)
    server = make_server(runtime, ready)
    await server.serve()
    return 0 if server.started else STARTUP_FAILED
