"""`robomend serve`: run the service until a signal ends it."""

from __future__ import annotations

import asyncio
import gc
import json
import os
import resource
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.files import ExistingFile
from robomend.cli.settings_options import read_settings, settings_options
from robomend.room import check_room, memory_unlimited, share_arenas

if TYPE_CHECKING:
    from robomend.figures import SharedFigures
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
@click.option("--workers", type=click.IntRange(1, 64), help="Service processes on this port and database.")
@click.option("--listen-fd", type=int, hidden=True, help="Of a worker: the socket that it inherits.")
@click.option("--parent-fd", type=int, hidden=True, help="Of a worker: its line to its parent.")
@click.option("--figures-fd", type=int, hidden=True, help="Of a worker: the file with the figures of all.")
@click.option("--place", type=int, hidden=True, help="Of a worker: which one it is.")
def command(
    config_file: Path | None,
    announce: bool,
    allowed_hosts: tuple[str, ...],
    listen_fd: int | None,
    parent_fd: int | None,
    figures_fd: int | None,
    place: int | None,
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
        if listen_fd is not None and parent_fd is not None and figures_fd is not None and place is not None:
            return runner.run(work(settings, Inherited(listen_fd, parent_fd, figures_fd, place)))
        if settings.workers > 1:
            return runner.run(supervise(settings, announce=announce))
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
    from robomend.api.init_system import InitSystem

    init_system = InitSystem()

    def told(url: str) -> None:
        tell(url, announce=announce)
        init_system.ready()

    return await _run(settings, told, None)


@dataclass(frozen=True, slots=True)
class Inherited:
    """What a worker has from its parent: descriptors, and which of the workers it is."""

    listen_fd: int
    parent_fd: int
    figures_fd: int
    place: int


async def work(settings: Settings, inherited: Inherited) -> int:
    """Serve an inherited socket as one of several workers."""
    from robomend.api.supervising import Parent
    from robomend.figures import SharedFigures

    parent = Parent(inherited.parent_fd)
    parent.watch()
    figures = SharedFigures(inherited.figures_fd, inherited.place, settings.workers)
    with socket.socket(fileno=inherited.listen_fd) as listener:
        os.set_inheritable(inherited.listen_fd, False)
        beating: asyncio.Task[None] | None = None

        def ready(_: str) -> None:
            nonlocal beating
            parent.ready()
            beating = asyncio.create_task(parent.beat())

        return await _run(settings, ready, [listener], figures)


async def supervise(settings: Settings, *, announce: bool) -> int:
    """Keep several workers alive."""
    from robomend.api.address import url_of
    from robomend.api.init_system import InitSystem
    from robomend.api.supervising import WorkerSupervisor, listening_socket

    with listening_socket(settings) as listener:
        url = url_of(listener.getsockname(), secure=settings.tls_certificate is not None)
        init_system = InitSystem()

        def ready() -> None:
            tell(url, announce=announce)
            init_system.ready()

        supervisor = WorkerSupervisor(settings, listener, sys.argv[1:], ready)
        return await supervisor.run()


async def _run(
    settings: Settings,
    told: Callable[[str], None],
    sockets: list[socket.socket] | None,
    figures: SharedFigures | None = None,
) -> int:
    gc.disable()  # until `settle`: a tenth of the time that loading takes
    from robomend.api.runtime import Runtime, any_key
    from robomend.api.server import check_exposure, make_server
    from robomend.repairs.repairs import make_repairs

    check_exposure(settings, await any_key(settings))
    runtime = Runtime(settings, make_repairs)
    runtime.metrics.shared = figures

    def ready(url: str) -> None:
        runtime.planners.start()  # it warms up now instead of at the first repair
        settle()
        told(url)

    if not memory_unlimited():
        check_room("the service", THREADS, FIRST_MEGABYTES)
    server = make_server(runtime, ready)
    await server.serve(sockets=sockets)
    return 0 if server.started else STARTUP_FAILED
