"""`robomend doctor`: look at everything the service needs, and say what to do where something is amiss."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import json
import platform
import shutil
import socket
import ssl
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from robomend.cli.config import read_settings, settings_options
from robomend.cli.remote.connection import asking, format_option, service_options
from robomend.cli.remote.names import RobotName
from robomend.errors import RobomendError
from robomend_client.counts import counted, first_few

if TYPE_CHECKING:
    from http.client import HTTPConnection

    from robomend.robots.robot import Robot
    from robomend.settings import Settings


AMISS = 1
FREE_BYTES = 100 << 20
ANSWER_S = 3.0
ANYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1", "[::]": "::1"}
"""Where a service that listens everywhere is asked."""

SHOWN = 5
"""Robots whose growth is told, those with most."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at."""

    name: str
    ok: bool
    detail: str


@click.command("doctor")
@settings_options
@click.option("--robot", type=RobotName(), metavar="ID", help="Look at this robot as well.")
@service_options("viewer", default=None)
@format_option()
def command(
    config_file: Path | None,
    data: Path | None,
    database: str | None,
    robot: str | None,
    url: str | None,
    key: str | None,
    format_: str,
) -> int:
    """Check this installation: Python, data files, solver, planner,
    database, port. 1 if something is amiss.

    With --robot, also what will not work or not be noticed on that robot: actions that nobody carries out,
    observers and topics that nobody reports, names that its model does not have. A service that runs
    (--url, or ROBOMEND_URL) knows as well which agents ask for work.
    """
    settings, _ = read_settings(config_file, data=data, database=database)
    findings = []
    for finding in _looks(settings, robot, url, key):
        findings.append(finding)
        if format_ != "json":  # at once: whoever waits sees for what
            click.echo(f"{'ok   ' if finding.ok else 'AMISS'}  {finding.name}: {finding.detail}")
    if format_ == "json":
        table = [{"name": f.name, "ok": f.ok, "detail": f.detail} for f in findings]
        click.echo(json.dumps({"ok": all(f.ok for f in findings), "checks": table}))
    return 0 if all(finding.ok for finding in findings) else AMISS


def _looks(settings: Settings, robot: str | None, url: str | None, key: str | None) -> Iterator[Finding]:
    if robot is not None and url is not None:
        yield from _asked(robot, url, key)
        return
    yield from examine(settings)
    if robot is not None:
        try:
            yield from _findings(robot, _read(robot, settings))
        except (RobomendError, OSError) as error:
            yield Finding(f"robot {robot}", False, str(error))


def examine(settings: Settings) -> Iterator[Finding]:
    """Yield what each look found; one that fails does not end the rest."""
    checks: tuple[tuple[str, Callable[[Settings], str]], ...] = (
        ("python", _python),
        ("data files", _data_files),
        ("solver", _solver),
        ("planner", _planner),
        ("disk", _disk),
        ("database", _database),
        ("growth", _growth),
        ("keys", _keys),
        ("port", _port),
    )
    for name, look in checks:
        try:
            yield Finding(name, True, look(settings))
        except (RobomendError, OSError, ImportError, Amiss) as error:
            yield Finding(name, False, str(error))


def _findings(robot: str, said: Sequence[str]) -> Iterator[Finding]:
    """Yield what there is to say of a robot, one finding each."""
    name = f"robot {robot}"
    for sentence in said:
        yield Finding(name, False, sentence)
    if not said:
        yield Finding(name, True, "nothing stands in the way of a repair, and everything is observed")


class Amiss(Exception):
    """A look found something that the service cannot work with."""


def _python(_: Settings) -> str:
    return f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"


def _data_files(_: Settings) -> str:
    from robomend.resources import resource

    return f"pddl/repair.pddl at {resource('pddl', 'repair.pddl')}"


def _solver(_: Settings) -> str:
    from robomend.diagnosis.engines import make_engine
    from robomend.model.loading import load_model
    from robomend.resources import resource
    from robomend_client.literals import fails

    system = load_model(resource("examples", "tedusar.yaml"))
    engine = make_engine("sat", system.cnf)
    try:
        found = engine.diagnose([fails("ok", "scan")])
    finally:
        engine.close()
    return f"{len(found.diagnoses)} diagnoses of the example in {found.elapsed_s * 1000:.1f} ms"


def _planner(_: Settings) -> str:
    from robomend.model.loading import load_model
    from robomend.planning.planner_pool import PlannerPool
    from robomend.planning.planning import PlanOptions
    from robomend.resources import resource
    from robomend_client.literals import fails

    parts = load_model(resource("examples", "tedusar.yaml")).parts
    if parts is None:
        raise Amiss("the example model has lost its parts")
    pool = PlannerPool(size=1, spare=0, at_once=False)
    try:
        options = PlanOptions(timeout_s=30.0)
        plan = pool.plans_now(parts, [fails("on", "hokuyo")], [("hokuyo",)], options)[0]
    finally:
        pool.close()
    return f"{plan.outcome} by {plan.planner} in a worker process: {counted(len(plan.steps), 'step')}"


def _disk(settings: Settings) -> str:
    if settings.database is not None:
        return "the database is elsewhere"
    folder = settings.data.expanduser()
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    if free < FREE_BYTES:
        raise Amiss(
            f"{free >> 20} MB free in {folder}; below {FREE_BYTES >> 20} MB writes will soon be refused"
        )
    return f"{free / 1e9:.1f} GB free in {folder}"


def _database(settings: Settings) -> str:
    from robomend.store import events, opened

    async def look() -> str:
        async with opened(settings.database_url) as store:
            kept = await store.read(events.kept)
            others = [
                f"{one.host} (process {one.pid})"
                for one in await store.ownership.instances()
                if one.id != store.ownership.instance
            ]
            used = f"; used by {', '.join(others)}" if others else ""
            kept_events = (
                f"events {kept.oldest} to {kept.newest}" if kept.newest >= kept.oldest else "no events"
            )
            return f"{store.url} answers; {kept_events}{used}"

    return asyncio.run(look())


def _growth(settings: Settings) -> str:
    """Return how fast the database grows, and when the disk is full of it."""
    import time

    from robomend.api.runtime import kept_by
    from robomend.store import opened, pruning

    async def look() -> pruning.Growth:
        async with opened(settings.database_url) as store:
            return await store.read(pruning.measure, time.time_ns())

    found = asyncio.run(look())
    if not found.bytes_a_day:
        return "nothing is in the history yet"
    most = sorted(found.robots.items(), key=lambda item: -item[1])
    shown = first_few([f"{robot} {_mb(size)}" for robot, size in most], SHOWN)
    said = f"{_mb(found.bytes_a_day)} a day, by the last {24 * found.days:.1f} h of history ({shown})"
    kept = found.kept(kept_by(settings))
    if kept is not None:
        said += f"; {_mb(kept)} once what is written is what retention removes"
    if settings.database is not None:
        return said
    path = settings.data.expanduser() / "robomend.db"
    free = shutil.disk_usage(path.parent).free
    days = counted(round(free / found.bytes_a_day), "day")
    if kept is None or kept > free + path.stat().st_size:
        raise Amiss(f"{said}; the disk is full in {days}: make room, or keep less (…_days)")
    return f"{said}; the disk would take {days} of it"


def _mb(size: float) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"


def _keys(settings: Settings) -> str:
    from robomend.api.runtime import any_key
    from robomend.api.server import check_exposure

    found = asyncio.run(any_key(settings))
    check_exposure(settings, found)
    return "keys are needed" if found else "none: whoever can reach the port on this computer is admin"


def _port(settings: Settings) -> str:
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((settings.host.strip("[]"), settings.port))
        except OSError as error:
            where = f"{settings.host}:{settings.port}"
            version = _who_listens(settings) if error.errno == errno.EADDRINUSE else None
            if version is not None:
                return f"{where}: a service runs there, robomend {version}"
            raise Amiss(f"{where}: {error.strerror}; another program has it: choose --port") from error
    return f"{settings.host}:{settings.port} can be listened on"


def _who_listens(settings: Settings) -> str | None:
    """Return the version of the service that has the port; nothing if something else has it."""
    from http.client import HTTPConnection, HTTPSConnection

    host = ANYWHERE.get(settings.host, settings.host).strip("[]")
    # Who has made the certificate is no matter: nothing but a version is believed.
    anybody = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    anybody.check_hostname, anybody.verify_mode = False, ssl.CERT_NONE
    plain = HTTPConnection(host, settings.port, timeout=ANSWER_S)
    over_tls = HTTPSConnection(host, settings.port, timeout=ANSWER_S, context=anybody)
    # What the service was told of TLS is not always told here.
    ways = (plain, over_tls) if settings.tls_certificate is None else (over_tls, plain)
    return next((version for asked in ways if (version := _version(asked)) is not None), None)


def _version(asked: HTTPConnection) -> str | None:
    """Return the version of the service that answers; nothing if none does."""
    from http.client import HTTPException

    try:
        asked.request("GET", "/version-info")
        return str(json.loads(asked.getresponse().read(10_000))["robomend"])
    except (OSError, HTTPException, ValueError, KeyError, TypeError):
        return None
    finally:
        asked.close()


# --- what `robomend doctor --robot` finds out of a robot: from a service that runs, or from the database.


def _asked(robot: str, url: str, key: str | None) -> Iterator[Finding]:
    """Yield what the service at `url` says of the robot: how it is, and what stands in a repair's way."""
    name = f"robot {robot}"
    try:
        with asking(url, key, robot=robot) as client:
            found = client.robot(robot).value
    except (RobomendError, OSError) as error:
        yield Finding(name, False, str(error))
        return
    yield Finding(name, found["healthy"] is not False, found["headline"])
    yield from _findings(robot, found.get("findings", ()))


def _read(robot: str, settings: Settings) -> Sequence[str]:
    """Return what the database says of the robot (NotFound); which agents ask for work it cannot know."""
    return asyncio.run(_read_database(robot, settings))


async def _read_database(robot: str, settings: Settings) -> Sequence[str]:
    from robomend.repairs.agent_queue import AgentQueue
    from robomend.repairs.executors.registry import Surroundings
    from robomend.repairs.foresight import findings
    from robomend.robots import configuring
    from robomend.robots.boards import Boards
    from robomend.robots.memory import Memory
    from robomend.robots.readers import Readers
    from robomend.robots.systems import Systems
    from robomend.store import opened

    async def nothing(_: Robot | str) -> None: ...

    readers = Readers(settings)
    try:
        async with opened(settings.database_url) as store:
            memory = Memory(store, Systems(store, settings, readers), 1, taken_up=nothing, left=nothing)
            state = await memory.robot(robot)
            boards = Boards(
                store,
                lambda robot, said, time_ns: nothing(robot),
                lambda robot, said: None,
                lambda robot, link, why: None,
            )
            around = Surroundings(
                robot=robot,
                board=boards.made(robot, state.config, state.system.parts),
                agents=AgentQueue(store),
                hosts={},
                programs=settings.programs,
                webhook_hosts=settings.webhook_hosts,
                halt=asyncio.Event(),
            )
            faults = await configuring.faults(state.config, state.system, readers)
            actions: Sequence[str] = ()
            with contextlib.suppress(RobomendError):  # its domain is at fault: named already
                actions = await readers.actions(state.config.domain, state.system.parts)
            return findings(state, faults, actions, around, None)
    finally:
        await readers.close()
