"""`robomend attach`: from a running robot, or its recordings, to the first true word.

find ──► listen ──► draft ──► files in DIR ──► service, agent ──► the page
                                                    │
                        nodes and topics that come later and are steady: joined
"""

from __future__ import annotations

import asyncio
import contextlib
import difflib
import fcntl
import logging
import os
import re
import socket
import sys
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.model_from_ros import FILE, with_files
from robomend.errors import BackendError, InputError, RobomendError
from robomend_batch import detached
from robomend_client.counts import first_few, listed

if TYPE_CHECKING:
    from robomend.cli.interrupts import Interrupts
    from robomend.cli.stage import Stage
    from robomend.model.from_graph import Entries
    from robomend_batch.learn.gathering import Gathered
    from robomend_client.bridges.hearing import Hearing
    from robomend_client.ros_graph import Heard, HeardDevice, Table, UsualRate

FROM_ENVIRONMENT = "environment"
"""The value of --ros1 and --ros2 without one."""

ROUTER = "tcp/localhost:7447"
"""Where rmw_zenoh's router is."""

PIP = f"{sys.executable} -m pip install"
"""Into the environment that we run in, which need not be the shell's."""

DEFAULT_PORT = 8600
FIND_S, FIND_MOST_S = 3.0, 13.0
"""Who is there is found after so long; on a busy network, or of a robot that is just starting, later."""

FIND_LOOK_S = 0.1

NAMED = 5
"""Nodes and topics that a line names."""

HEARD_S = 1.0
"""So long after a robot's first node was seen, what is latched has come, and listening begins …"""

BEHIND_S = 10.0
"""… unless topics are still being connected, as of a robot of hundreds: until none was for so long."""

SHORT_S = 10.0
"""From recordings of less than that hardly a rate is told."""

SERVICE_S = 120.0
SHOW_S = 0.5
LOOK_S = 0.5
JOIN_LOOK_S = 5.0
ROWS = 24
LINES_S = 10.0
"""Between two lines where there is no terminal to draw on."""

PLUGGED = ("serial", "v4l", "input")
"""Kinds of devices that udev names by what is written on them, in /dev."""

LONGEST_FOLDER = 60
"""Below it fits the path of a Unix socket."""

CLOSE = 0.1
"""Of a number: the same robot, listened to again, gives no other files for less."""

NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")

VARIABLES = (
    *("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS"),
    *("RMW_IMPLEMENTATION", "CYCLONEDDS_URI", "ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME"),
)
"""Of the environment: by them a robot is found, or is not."""


@dataclass(frozen=True)
class Wanted:
    """What was asked for."""

    folder: Path
    name: str
    seconds: float
    ros1: str | None
    ros2: str | None
    namespace: str
    url: str | None
    key: str | None
    update: bool
    detach: bool = False
    zenoh: str | None = None
    launch: tuple[Path, ...] = ()
    analyzers: tuple[Path, ...] = ()
    devices: bool = False


@click.command("attach", short_help="Watch a running robot; nothing need be written before.")
@click.argument("folder", metavar="[DIR]", required=False, type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--ros1", metavar="[URI]", is_flag=False, flag_value=FROM_ENVIRONMENT, help="Only a robot with ROS 1."
)
@click.option(
    "--ros2", metavar="[DOMAIN]", is_flag=False, flag_value=FROM_ENVIRONMENT, help="Only a robot with ROS 2."
)
@click.option(
    "--zenoh",
    metavar="[ENDPOINT]",
    is_flag=False,
    flag_value=ROUTER,
    help=f"Only a robot with ROS 2 over zenoh, there ({ROUTER}).",
)
@click.option(
    "--bag",
    "bags",
    multiple=True,
    type=click.Path(path_type=Path, exists=True),
    help="Healthy recordings instead (.bag, .mcap, .db3, folders); repeatable. Nothing is started.",
)
@click.option(
    "--seconds",
    type=click.FloatRange(5, 86400),
    default=60,
    show_default=True,
    help="How long to listen; longer is calmer.",
)
@click.option("--launch", multiple=True, type=FILE, help="A launch file of it: what is not there is asked.")
@click.option(
    "--analyzers", multiple=True, type=FILE, help="Of its diagnostic_aggregator: names of statuses."
)
@click.option(
    "--devices",
    is_flag=True,
    help="Propose hardware: what /diagnostics and ros2_control name, and what is plugged in here.",
)
@click.option("--name", help="The robot's name.  [default: DIR's]")
@click.option("--namespace", default="/", help="Only the nodes in here, of several robots in one domain.")
@click.option("--url", envvar="ROBOMEND_URL", help="A service that runs, instead of one of its own.")
@click.option("--key", envvar="ROBOMEND_KEY", help="Of role operator, for --url.")
@click.option("--update", is_flag=True, help="Write what has changed into files that are there.")
@click.option("--detach", is_flag=True, help="Leave it running, as units of your systemd.")
def command(
    folder: Path | None,
    ros1: str | None,
    ros2: str | None,
    zenoh: str | None,
    bags: tuple[Path, ...],
    launch: tuple[Path, ...],
    analyzers: tuple[Path, ...],
    devices: bool,
    seconds: float,
    name: str | None,
    namespace: str,
    url: str | None,
    key: str | None,
    update: bool,
    detach: bool,
) -> int:
    """Find a running robot, listen to it, and watch it from then on.

    Its model, its agent's file and its configuration are written into DIR; then the service and the agent are
    started, which only observe. Ctrl-C ends both. The robot should be healthy while it is listened to: what
    looked odd is asked.

    \b
    robomend attach
    robomend attach --ros2 7 rover
    robomend attach --bag good.mcap rover
    """
    from robomend.cli.init.described import model_file
    from robomend.cli.init.robot import ROBOT
    from robomend.cli.interrupts import Interrupted, Interrupts

    if sum(one is not None for one in (ros1, ros2, zenoh)) + bool(bags) > 1:
        raise click.UsageError("give one of --ros1, --ros2, --zenoh and --bag")
    folder = folder or Path(name or "robot")
    known = _said(folder, "robot")
    if known and name and name != known:
        raise InputError(f"{folder} has the files of {known!r}, not of {name!r}: name another folder")
    robot = known or name or folder.resolve().name
    if not ROBOT.match(robot):
        raise InputError(f"{robot!r} is no robot's name: letters, digits and . _ - (64 at most); see --name")
    asked = folder, robot, seconds, ros1, ros2, namespace, url, key, update
    wanted = Wanted(*asked, detach, zenoh, launch, analyzers, devices)
    if detach and bags:
        raise click.UsageError("--bag starts nothing that --detach could leave running")
    if detach:
        detached.check()
    if bags:
        found, heard = heard_of_bags(bags)
        if heard.seconds < SHORT_S:
            short = f"{heard.seconds:.2g} s are recorded, too little for most rates"
            click.echo(f"note: {short}: give logs of a minute or more", err=True)
        _write(wanted, heard.within(namespace), _url(wanted), logs=found)
        files = f"-m {quote(str(folder / model_file(robot)))} --observers {quote(str(folder / 'agent.yaml'))}"
        if not re.search("^(topics|observers):", (folder / "agent.yaml").read_text("utf-8"), re.MULTILINE):
            click.echo("note: nothing in the recordings can be watched: give longer ones", err=True)
            return 0
        click.echo(f"next, over the logs that you doubt: robomend-batch run LOGS {files} -o found")
        return 0
    with Interrupts() as interrupts, _alone(folder):
        attached = _Attached(wanted, interrupts)
        try:
            if url is not None:
                _reach(url, key)
            attached.run_detached() if detach else attached.run()
        except Interrupted as interrupted:
            click.echo("ended: all that was started is gone", err=True)
            return 0 if attached.watches else 128 + interrupted.number
    return 0


# --- the whole --------------------------------------------------------------------------------------------


class _Attached:
    """One robot, from finding it to the end."""

    def __init__(self, wanted: Wanted, interrupts: Interrupts) -> None:
        self.wanted = wanted
        self.watches = False
        self._interrupts = interrupts
        self._began_s = time.monotonic()
        self._written: dict[str, str] = {}  # file -> what we wrote
        self._loading: Any = None  # the agent's process, which loads what it needs while we listen
        self._asked = ""  # whether bounds get tighter: a question of the model …
        self._asked_of: dict[str, UsualRate] = {}  # … by what the agent had heard then
        self._ask_at_s = 0.0  # when it has heard so much, it is asked again

    def run(self) -> None:
        """Find, listen, write, start, watch; until a signal comes."""
        from robomend.cli.stage import PartFailed, Stage, environment, python, show

        wanted = self.wanted
        key = {"ROBOMEND_KEY": wanted.key} if wanted.key else {}
        with Stage(wanted.folder, {**environment(), **key}, self._interrupts) as stage:
            service, url = None, wanted.url or ""

            def start_service(port: int) -> Any:
                serve = ["serve", "--port", str(port), "--data", str(wanted.folder / "data"), "--announce"]
                return stage.start("service", python("robomend", *serve), announces=True)

            if wanted.url is None:  # it loads while we listen
                service = start_service(_free_port(wanted.folder))
            found, heard = asyncio.run(self._listen(stage))
            heard = replace(heard, usual=usual_of(wanted.folder))
            if service is not None:
                try:
                    url = str(stage.announced(service, SERVICE_S)["url"])
                except PartFailed:
                    if _known_port(wanted.folder):
                        raise
                    stage.end(service)  # somebody else may have taken the port meanwhile
                    url = str(stage.announced(start_service(0), SERVICE_S)["url"])
            self._written = _write(wanted, heard, url)
            self._put(url)
            agent = self._start_agent(stage)
            page = f"{url}/ui/robots/{wanted.name}"
            click.echo(f"the page: {page}")
            click.echo("It only observes. Ctrl-C ends it; `robomend attach --help` says what else it does.")
            where = "" if url == f"http://127.0.0.1:{DEFAULT_PORT}" else f" --url {url}"
            click.echo(f"What in its model is only believed: robomend drill {wanted.name} --plan{where}")
            show(page)
            self.watches = True
            asyncio.run(self._watch(stage, url, found, heard, agent))

    def run_detached(self) -> None:
        """Find, listen, write; what watches from then on runs as units of the user's systemd.

        Raises:
            BackendError: systemd does not start it.
        """
        wanted, folder = self.wanted, self.wanted.folder.resolve()
        service, agent = detached.names(wanted.name)

        def port() -> int:
            return (_known_port(folder) if detached.runs(service) else _free_port(folder)) or _any_port()

        if wanted.url is None:
            port()  # who has it is said before a minute is spent
        _, heard = asyncio.run(self._listen(None))
        heard = replace(heard, usual=usual_of(folder))
        url = wanted.url or f"http://127.0.0.1:{port()}"  # somebody else may have taken it meanwhile
        self._written = _write(wanted, heard, url)
        said = {name: os.environ[name] for name in VARIABLES if os.environ.get(name)}
        if wanted.key:
            secret = folder / "agent.env"
            secret.touch(mode=0o600)
            secret.write_text(f"ROBOMEND_KEY={wanted.key}\n", "utf-8")
        if wanted.url is None:
            serve = ["robomend", "serve", "--port", url.rpartition(":")[2], "--data", str(folder / "data")]
            detached.start(service, detached.unit_text(wanted.name, folder, serve, {}))
        self._put(url)
        watch = ["robomend_client.agent.main", str(folder / "agent.yaml")]
        detached.start(agent, detached.unit_text(wanted.name, folder, watch, said))
        units = agent if wanted.url is not None else f"{service} {agent}"
        click.echo(f"the page: {url}/ui/robots/{wanted.name}")
        click.echo(f"It only observes, and goes on. It ends with: systemctl --user disable --now {units}")
        self.watches = True

    def _start_agent(self, stage: Stage) -> Any:
        """Start the agent, or have the one begin that was started while we listened."""
        agent, self._loading = self._loading, None
        if agent is None:
            return stage.start("agent", self._agent())
        stage.begin(agent)
        return agent

    def _agent(self, *more: str) -> list[str]:
        from robomend.cli.stage import python

        return python("robomend_client.agent.main", *more, str(self.wanted.folder / "agent.yaml"))

    def _put(self, url: str) -> None:
        """Tell the service of the robot, again while a busy computer does not let it answer."""
        began_s, unanswered = time.monotonic(), False
        while True:
            self._interrupts.check()
            try:
                return self._put_once(url)
            except (BackendError, InputError) as error:
                unanswered = unanswered or isinstance(error, BackendError)
                # What was not answered may act in the middle of the next try, which is refused then.
                if not unanswered or time.monotonic() - began_s > SERVICE_S:
                    raise
            self._interrupts.wait(LOOK_S)

    def _put_once(self, url: str) -> None:
        """Tell the service of the robot, as the files say: a new version of what it has already."""
        from robomend.cli.init.described import model_file
        from robomend.cli.remote.connection import asking
        from robomend.cli.robot_file import read_robot
        from robomend_client.rest.errors import NotFound

        config = read_robot(self.wanted.folder / "robot.yaml")
        model = str(config.get("model", self.wanted.name))
        file = self.wanted.folder / model_file(model)

        def version(ask: Callable[[str], Any], name: str) -> str | None:
            try:
                return str(ask(name).version)
            except NotFound:
                return None

        with asking(url, self.wanted.key) as client:
            if file.exists():
                self._take_answers(client, model, file)
                client.put_model(model, file.read_text("utf-8"), version=version(client.model, model))
            client.put_robot(self.wanted.name, config, version(client.robot, self.wanted.name))

    def _take_answers(self, client: Any, model: str, file: Path) -> None:
        """Write into the model's file what was answered on the page meanwhile."""
        from robomend.model.answers import answers_of, with_answers
        from robomend_client.rest.errors import NotFound

        try:
            stored = str(client.model(model).value["source"])
        except NotFound:
            return
        text = file.read_text("utf-8")
        answered = with_answers(text, answers_of(stored))
        if answered != text:
            _replace(file, answered)
            if self._written.get(file.name) == text:
                self._written[file.name] = answered
            click.echo(f"answered on the page, and written into {file}")

    # --- listening -------------------------------------------------------------------------------------

    async def _listen(self, stage: Stage | None) -> tuple[Callable[..., Hearing], Heard]:
        """Find the robot and listen to it; return how to listen to it again, and what was heard.

        Meanwhile what comes after it is loaded, and an agent on the stage, if there is one.

        Raises:
            InputError: no robot was found, or several.
            Interrupted: a signal came.
        """
        candidates, why_not = await _candidates(self.wanted)
        hearings = {name: make() for name, make in candidates.items()}
        tasks = {name: asyncio.create_task(hearing.run()) for name, hearing in hearings.items()}
        try:
            name, began_s = await self._find(hearings, tasks, why_not)
            for other in tasks.keys() - {name}:
                tasks[other].cancel()
            if stage is not None:
                ready = ("--ready-for", next(iter(hearings[name].origin)))
                self._loading = stage.start("agent", self._agent(*ready), waits=True)
            loading = asyncio.create_task(asyncio.to_thread(load_later))
            heard = await self._hear(hearings[name], tasks[name], began_s)
            await loading
        finally:
            for task in tasks.values():
                task.cancel()
            await asyncio.gather(*tasks.values(), return_exceptions=True)
        return candidates[name], heard

    async def _find(
        self, hearings: Mapping[str, Hearing], tasks: Mapping[str, asyncio.Task[None]], why_not: list[str]
    ) -> tuple[str, float]:
        """Return where the robot is, and since when it is listened to."""
        waited_s, looked_s = 0.0, time.monotonic()
        seen_s: dict[str, float] = {}
        heard_s: dict[str, float] = {}
        behind_s: dict[str, tuple[int, float]] = {}  # how many topics at least, and since when
        if hearings:
            click.echo(f"looking for a robot: {', '.join(hearings)} …", err=True)
        there: dict[str, list[str]] = {}
        while (waited_s < FIND_MOST_S or there) and hearings:
            self._interrupts.check()
            before_s, looked_s = looked_s, time.monotonic()
            waited_s += min(looked_s - before_s, 2 * FIND_LOOK_S)  # a busy computer finds later
            for name, task in tasks.items():
                if task.done() and (error := task.exception()) is not None:
                    raise BackendError(f"{name}: {error}") from error
            there = {name: own_nodes(hearing.graph.nodes) for name, hearing in hearings.items()}
            there = {name: nodes for name, nodes in there.items() if nodes}
            now_s = time.monotonic()
            for name in there:
                waits_s = now_s - seen_s.setdefault(name, now_s)
                behind = hearings[name].behind
                if behind < behind_s.get(name, (behind + 1, now_s))[0]:
                    behind_s[name] = behind, now_s
                ready = waits_s > HEARD_S and (not behind or now_s - behind_s[name][1] > BEHIND_S)
                if name not in heard_s and ready:
                    heard_s[name] = now_s
                    hearings[name].begin()
            if waited_s > FIND_S and there:
                if len(there) > 1:
                    listed = "; ".join(f"{name} ({len(nodes)} nodes)" for name, nodes in there.items())
                    raise InputError(f"there are robots at {listed}: choose by --ros1 or --ros2")
                if (name := next(iter(there))) in heard_s:
                    return name, heard_s[name]
            await asyncio.sleep(FIND_LOOK_S)
        told = "; ".join([*(f"{name}: no node" for name in hearings), *why_not])
        variables = ", ".join(f"{name}={os.environ[name]}" for name in VARIABLES if os.environ.get(name))
        hint = (
            "ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE must be the robot's, ROS_MASTER_URI its master"
        )
        raise InputError(f"no robot was found. {told}. Set are: {variables or 'none of ROS_…'}. {hint}")

    async def _hear(self, hearing: Hearing, task: asyncio.Task[None], began_s: float) -> Heard:
        from robomend.cli.init.described import model_file

        wanted = self.wanted
        files = wanted.folder / model_file(wanted.name)
        if files.exists() and not wanted.update:
            click.echo(f"{files} is there: what comes now is compared with it, and changes nothing", err=True)
        else:
            click.echo(
                "what comes now is taken as normal: the robot should be well, and do its work", err=True
            )
        with _table() as shown:
            while (left_s := began_s + wanted.seconds - time.monotonic()) > 0:
                self._interrupts.check()
                if task.done():
                    task.result()
                shown(hearing, wanted.seconds - left_s, wanted.seconds)
                await asyncio.sleep(min(SHOW_S, left_s))
        if silent := sorted(topic for topic, ear in hearing.ears.items() if not ear.count):
            click.echo(f"nothing came on {first_few(silent, NAMED)}", err=True)
        heard = hearing.heard().within(wanted.namespace)
        alike = alike_namespaces(own_nodes(heard.graph.nodes))
        if len(alike) > 1:
            names = ", ".join(alike)
            click.echo(
                f"note: {names} have nodes of the same names. If they are robots of their own, "
                f"--namespace {alike[0]} takes one",
                err=True,
            )
        return heard

    # --- watching --------------------------------------------------------------------------------------

    async def _watch(
        self, stage: Stage, url: str, make: Callable[..., Hearing], heard: Heard, agent: Any
    ) -> None:
        """Say how the robot is, whenever that changes, and have joined what comes later."""
        from robomend.cli.init.described import model_file
        from robomend_client.rest import Client, ClientError

        said, file = "", model_file(self.wanted.name)
        later = make(frozenset(heard.graph.publishers))
        listening = asyncio.create_task(later.run())
        looked_s = time.monotonic()
        try:
            with Client(url, self.wanted.key, timeout_s=10.0) as client:
                while True:
                    self._interrupts.check()
                    stage.check()
                    with contextlib.suppress(ClientError):
                        now, headline = await asyncio.to_thread(_state, client, self.wanted.name)
                        if now != said:
                            after_s = time.monotonic() - self._began_s
                            click.echo(f"{time.strftime('%H:%M:%S')} ({after_s:.0f} s) {now}")
                            if ":" in now:
                                click.echo(f"    {headline}")
                            said = now
                    if time.monotonic() - looked_s > JOIN_LOOK_S and not listening.done():
                        looked_s = time.monotonic()
                        with contextlib.suppress(ClientError):
                            self._take_answers(client, self.wanted.name, self.wanted.folder / file)
                        more = joined(heard, later.heard().within(self.wanted.namespace), self.wanted.seconds)
                        if more is not None and self._unchanged():
                            new = sorted(more.graph.nodes - heard.graph.nodes)
                            click.echo(f"joined: {', '.join(node.removeprefix('/') for node in new)}")
                            heard = more
                            agent = self._anew(stage, agent, heard, url)
                        usual = self._usual(heard, client)
                        if usual:
                            heard = replace(heard, usual=usual)
                            agent = self._anew(stage, agent, heard, url)
                            click.echo("tighter bounds are taken over, as was answered on the page")
                    await asyncio.sleep(LOOK_S)
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)

    def _anew(self, stage: Stage, agent: Any, heard: Heard, url: str) -> Any:
        """Write the files anew, and begin with them; return the new agent."""
        self._written = _write(replace(self.wanted, update=True), heard, url, quietly=True)
        stage.end(agent)
        self._put(url)
        return self._start_agent(stage)

    def _usual(self, heard: Heard, client: Any) -> dict[str, UsualRate]:
        """Ask on the page whether bounds get tighter by what the agent heard since; return that once somebody
        has said yes, and nothing before.
        """
        from robomend.cli.init.described import model_file
        from robomend.model.answers import answers_of, asking, with_answers
        from robomend.model.from_graph import TIGHTER, first_model, tighter_question

        usual = usual_of(self.wanted.folder)
        longest_s = max((one.seconds for one in usual.values()), default=0.0)
        file = self.wanted.folder / model_file(self.wanted.name)
        if not self._unchanged():
            return {}
        text = file.read_text("utf-8")
        said = {asked: answer for asked, answer in answers_of(text).others.items() if TIGHTER in asked}
        if self._asked in said:
            self._asked = ""
            return self._asked_of if said.popitem()[1] == "yes" else {}
        if said or self._asked or longest_s < self._ask_at_s:
            return {}
        question = tighter_question(first_model(heard, self.wanted.name), usual)
        if question:
            stored = client.model(self.wanted.name)
            text = asking(with_answers(text, answers_of(str(stored.value["source"]))), question)
            client.put_model(self.wanted.name, text, version=str(stored.version))
            _replace(file, text)
            self._written[file.name] = text
            self._asked, self._asked_of = question, usual
            click.echo(f"asked on the page: {question}")
        self._ask_at_s = 2 * longest_s
        return {}

    def _unchanged(self) -> bool:
        """Whether the files are as we wrote them: those that a person has changed are the person's."""
        texts = {name: self.wanted.folder / name for name in self._written}
        return bool(texts) and all(
            path.exists() and path.read_text("utf-8") == self._written[name] for name, path in texts.items()
        )


def _reach(url: str, key: str | None) -> None:
    """Ask a service for its version, before a minute is spent.

    Raises:
        BackendError, InputError: it does not answer, or not to this key.
    """
    from robomend.cli.remote.connection import asking

    with asking(url, key) as client:
        client.robots(limit=1)


def load_later() -> None:
    """Load what is needed once a robot was heard; on a busy computer that takes seconds."""
    from robomend.cli.init.described import Described, files_of
    from robomend.cli.remote import connection  # noqa: F401  # for _put
    from robomend.cli.schema import FILES, schema_text
    from robomend_client import rest  # noqa: F401  # for _watch
    from robomend_client.ros_graph import Heard, RosGraph

    graph = RosGraph({"/topic": frozenset({"/node"})})
    files_of(Described("robot", heard=Heard(graph, "nowhere"), policy="observe"))
    for file in FILES:
        schema_text(file)


def plugged_in(folder: Path = Path("/dev")) -> dict[str, HeardDevice]:
    """Return the serial ports and cameras of this computer, by the names that udev gives them."""
    from robomend_client.bridges.processes import has_file_open
    from robomend_client.ros_graph import HeardDevice

    found = {}
    for kind in PLUGGED:
        for link in sorted((folder / kind / "by-id").glob("*")):
            used = has_file_open(link)
            said = f"{link}, which {used} has open" if used else str(link)
            found[link.name] = HeardDevice(said)
    return found


def _state(client: Any, robot: str) -> tuple[str, str]:
    """Return how the robot is, in a few words and in a sentence."""
    read = client.robot(robot).value
    state = str(read["state"])
    result = client.diagnosis(robot).get("result") or {}
    bad = [listed(one["bad"]) for one in result.get("diagnoses", ()) if one["bad"]]
    more = f" (or {len(bad) - 1} more)" if len(bad) > 1 else ""
    return f"{state}: {bad[0]}{more}" if bad else state, str(read["headline"])


# --- what is there ----------------------------------------------------------------------------------------


async def _candidates(wanted: Wanted) -> tuple[dict[str, Callable[..., Hearing]], list[str]]:
    """Return where a robot may be, each with how to listen there, and why it is not elsewhere.

    Raises:
        InputError: what --ros1 or --ros2 says cannot be.
    """
    found: dict[str, Callable[..., Hearing]] = {}
    why_not = []
    if wanted.zenoh is not None:
        domain, endpoint = _domain(None), wanted.zenoh
        if not all(map(find_spec, ("zenoh", "xxhash", "rosbags"))):
            return {}, [f"zenoh needs what is installed with: {PIP} 'robomend-client[zenoh]'"]
        from robomend_client.bridges.hearing import ZenohHearing

        return {f"domain {domain} at {endpoint}": lambda known=(): ZenohHearing(domain, endpoint, known)}, []
    if wanted.ros1 is None:
        domain = _domain(wanted.ros2)
        if find_spec("cyclonedds") and find_spec("rosbags"):
            from robomend_client.bridges.hearing import Ros2Hearing

            found[f"domain {domain} of ROS 2"] = lambda known=(): Ros2Hearing(domain, known)
        else:
            why_not.append(f"ROS 2 needs what is installed with: {PIP} 'robomend-client[ros2]'")
    if wanted.ros2 is None:
        from robomend_client.bridges.ros1.master import Master
        from robomend_client.bridges.ros1.xmlrpc import OutOfReach, PeerError, address_of

        given = None if wanted.ros1 in (None, FROM_ENVIRONMENT) else wanted.ros1
        uri = given or os.environ.get("ROS_MASTER_URI") or "http://localhost:11311/"
        try:
            address_of(uri)
            await Master(uri, "/robomend_attach").graph(types=False)
        except OutOfReach as error:
            raise InputError(f"--ros1: {error}") from error
        except PeerError as error:
            why_not.append(f"the master at {uri}: {error}")
        else:
            if find_spec("rosbags"):
                from robomend_client.bridges.hearing import Ros1Hearing

                found[f"the master at {uri}"] = lambda known=(): Ros1Hearing(uri, known)
            else:
                why_not.append(f"ROS 1 needs what is installed with: {PIP} 'robomend-client[ros1]'")
    return found, why_not


def _domain(said: str | None) -> int:
    given = said if said not in (None, FROM_ENVIRONMENT) else os.environ.get("ROS_DOMAIN_ID") or "0"
    if not given.isdecimal() or int(given) > 232:
        raise InputError(f"{given!r} is no domain of ROS 2, from 0 to 232; DIR stands before --ros2")
    return int(given)


def own_nodes(nodes: frozenset[str]) -> list[str]:
    """Return the robot's own nodes."""
    from robomend.model.from_graph import is_tool

    return sorted(node for node in nodes if not is_tool(node))


def alike_namespaces(nodes: list[str]) -> list[str]:
    """Return namespaces of which another one has mostly nodes of the same names: robots, or twin devices."""
    inside: dict[str, set[str]] = {}
    for node in nodes:
        first, slash, rest = node.strip("/").partition("/")
        if slash:
            inside.setdefault(first, set()).add(rest)
    return sorted(
        name
        for name, found in inside.items()
        if any(
            other != name and len(found & others) > max(1, min(len(found), len(others)) / 2)
            for other, others in inside.items()
        )
    )


def heard_of_bags(bags: tuple[Path, ...]) -> tuple[Gathered, Heard]:
    """Return what recordings hold: one by one, and as if somebody had listened to one after the other.

    Raises:
        InputError: none of them can be read.
    """
    from robomend_batch.found import find_logs
    from robomend_batch.learn.gathering import gather, heard_of

    names, problems = find_logs(map(str, bags))
    for place, reason in problems:
        click.echo(f"note: {place}: {reason}", err=True)
    found = gather(names, lambda log: click.echo(f"read: {log}", err=True))
    for problem in found.problems.json():
        click.echo(
            f"{'bad' if problem['bad'] else 'note'}: {problem['place']}: {problem['reason']}", err=True
        )
    if not found.spans_ns:
        raise InputError("there is nothing to learn from")
    return found, heard_of(found)


def joined(before: Heard, now: Heard, seconds: float) -> Heard | None:
    """Return what was heard with the nodes that came later and stayed; None: there are none.

    A topic that was there and silent stays silent by design: that it came once does not mean that it must.

    Args:
        now: of the same robot, without the topics that were heard before.
        seconds: how long a node must have been there, and its topics have come.
    """
    from robomend.model.from_graph import steady
    from robomend_client.ros_graph import HeardTopic

    known = before.graph.nodes
    nodes = {
        node
        for node in own_nodes(now.graph.nodes - known - now.gone)
        if now.ended_ns - now.since_ns.get(node, now.ended_ns) >= seconds * 1e9
    }
    if not nodes:
        return None
    ahead_ns = now.ended_ns - before.ended_ns
    topics = {}
    for name, topic in now.topics.items():
        if now.graph.publishers.get(name, frozenset()) & nodes:
            settled_now = not isinstance(steady(topic, now.ended_ns), str) and topic.span_s >= seconds / 2
            topics[name] = HeardTopic(latched=topic.latched)
            if settled_now:
                topics[name] = replace(
                    topic,
                    first_ns=topic.first_ns - ahead_ns,
                    last_ns=topic.last_ns - ahead_ns,
                    stamps=tuple(stamp - ahead_ns for stamp in topic.stamps),
                )
    graph, new = before.graph, now.graph

    def table(old: Table, found: Table) -> Table:
        more = {name: found_nodes & nodes for name, found_nodes in found.items() if found_nodes & nodes}
        return {name: old.get(name, frozenset()) | more.get(name, frozenset()) for name in {**old, **more}}

    merged = replace(
        graph,
        publishers=table(graph.publishers, new.publishers),
        subscribers=table(graph.subscribers, new.subscribers),
        services=table(graph.services, new.services),
        types={**new.types, **graph.types},
    )
    return replace(before, graph=merged, topics={**topics, **before.topics}, gone=before.gone - nodes)


# --- files ------------------------------------------------------------------------------------------------


def _said(folder: Path, key: str) -> str | None:
    """Return what a folder's agent.yaml says under a key, if there is a word."""
    file = folder / "agent.yaml"
    if not file.exists():
        return None
    from robomend_client.yaml_tree import Mapping as Tree
    from robomend_client.yaml_tree import Scalar, YamlError, read_tree

    try:
        tree = read_tree(file.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{file} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{file} is no text (UTF-8): move it away") from error
    except YamlError as error:
        raise InputError(f"{file}: {error}") from error
    found = tree.items.get(key) if isinstance(tree, Tree) else None
    return found.text if isinstance(found, Scalar) else None


def usual_of(folder: Path) -> dict[str, UsualRate]:
    """Return what the folder's agent wrote down of its topics; nothing, where there was none."""
    from robomend_client.agent.usual import FILE, read_usual

    return read_usual(folder / (_said(folder, "state_dir") or "robomend-agent-state") / FILE)


def _url(wanted: Wanted) -> str:
    return wanted.url or f"http://127.0.0.1:{DEFAULT_PORT}"


def _known_port(folder: Path) -> int:
    """Return the port of this computer that the folder's agent knows, else 0."""
    file = folder / "agent.yaml"
    known = re.search(r"127\.0\.0\.1:(\d+)", file.read_text("utf-8")) if file.exists() else None
    return int(known[1]) if known else 0


def _any_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _free_port(folder: Path) -> int:
    """Return the port that the folder's agent knows, else the usual one, else 0: any that is free.

    Raises:
        InputError: the folder's is taken.
    """
    known = _known_port(folder)
    port = known or DEFAULT_PORT
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            if known:
                why = (
                    f"port {port}, which {folder / 'agent.yaml'} names, is taken: another service runs there"
                )
                raise InputError(f"{why}; --url http://127.0.0.1:{port} uses it") from error
            return 0
    return port


def _write(
    wanted: Wanted, heard: Heard, url: str, *, quietly: bool = False, logs: Gathered | None = None
) -> dict[str, str]:
    """Write the robot's files, and show what would change of those that are there; return what they say now;
    nothing, where one of them says something else.

    Args:
        logs: in which it was heard, and was healthy: the observers are run over them before.

    Raises:
        InputError: what was heard makes no model, or a file cannot be written.
    """
    from robomend.cli.init.described import Described, files_of, model_file
    from robomend.cli.schema import FILES, schema_name, schema_text
    from robomend.model.answers import answers_of, with_answers
    from robomend.model.from_graph import first_model

    bus = "tcp:127.0.0.1:0" if len(str(wanted.folder.resolve())) > LONGEST_FOLDER else None
    heard = with_files(heard, wanted.launch, wanted.analyzers)
    heard = replace(heard, devices={**plugged_in(), **heard.devices} if wanted.devices else {})
    said = Described(wanted.name, heard=heard, origin=heard.origin, url=url, bus=bus, policy="observe")
    first = first_model(heard, wanted.name)
    if logs is not None:
        _try(first.entries, heard, wanted.name, logs)
    texts = files_of(said, first)
    texts |= {schema_name(file): schema_text(file) for file in FILES if file != "observers"}
    written, others, before, path = {}, False, "", wanted.folder
    try:
        for name, text in texts.items():
            path = wanted.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            old = path.read_text("utf-8") if path.exists() else None
            if old is not None and name == model_file(wanted.name):
                before = old
                text = with_answers(text, answers_of(old))
            new = text if old is None else settled(old, text)
            if name.startswith("schemas/"):
                if old is None:
                    _replace(path, new)
                continue
            written[name] = new
            if old == new:
                continue
            if old is not None:
                if not quietly:
                    _show_diff(path, old, new)
                if not wanted.update:
                    others = True
                    continue
            _replace(path, new)
            if not quietly:
                click.echo(f"wrote {path.absolute()}", err=True)
    except OSError as error:
        raise InputError(f"{error.filename or path} cannot be written: {error.strerror}") from error
    if others and not quietly:
        gone = _gone(before, texts[model_file(wanted.name)])
        not_there = f"; not there now: {first_few(gone, NAMED)}" if gone else ""
        click.echo(f"{wanted.folder} stays as it is{not_there}; --update takes over what was heard", err=True)
    return {} if others else written


def _gone(old: str, new: str) -> list[str]:
    """Return the nodes of a model that another has not; none, of what is no model any more."""
    from robomend.model.loading import load_text

    try:
        before, after = (load_text(text).parts for text in (old, new))
    except RobomendError:
        return []
    return [] if before is None or after is None else sorted(before.nodes.keys() - after.nodes.keys())


def _try(entries: Entries, heard: Heard, name: str, logs: Gathered) -> None:
    """Have observers call nothing false of the healthy logs that they are made from."""
    from robomend.model.from_graph import Entries
    from robomend_batch.learn.gathering import NO_GRAPH
    from robomend_batch.learn.learning import PER_HOUR, calm, draft_of

    def learned(without: Collection[int]) -> Entries:
        found = draft_of(logs, heard, NO_GRAPH, PER_HOUR, name, without).entries
        return Entries(found.topics, evidence=found.evidence)  # of other observers the model says less

    calm(logs, entries, learned)
    for told, (_, _, why) in entries.doubtful.items():
        click.echo(f"doubtful: {told}: {why}: it is left as a comment", err=True)


def _replace(path: Path, text: str) -> None:
    beside = path.with_suffix(".tmp")
    beside.write_text(text, "utf-8")
    beside.replace(path)


def _show_diff(path: Path, old: str, new: str) -> None:
    lines = difflib.unified_diff(
        old.splitlines(keepends=True), new.splitlines(keepends=True), str(path), f"{path} as heard now"
    )
    click.echo("".join(lines), nl=False)


def settled(old: str, new: str) -> str:
    """Return a new text with the old lines wherever they say about the same: numbers within CLOSE."""
    kept: dict[str, list[str]] = {}
    for line in old.splitlines():
        kept.setdefault(NUMBER.sub("#", line), []).append(line)
    lines = []
    for line in new.splitlines():
        alike = kept.get(NUMBER.sub("#", line), [])
        for candidate in alike:
            if line.lstrip().startswith("#") or _close(candidate, line):
                alike.remove(candidate)
                line = candidate
                break
        lines.append(line)
    return "\n".join(lines) + "\n"


def _close(one: str, other: str) -> bool:
    """Whether the numbers of two lines that are alike otherwise are, without their comments."""
    pairs = zip(NUMBER.findall(_code(one)), NUMBER.findall(_code(other)), strict=False)
    return all(abs(float(a) - float(b)) <= CLOSE * max(abs(float(a)), abs(float(b))) for a, b in pairs)


def _code(line: str) -> str:
    return line.partition("    #")[0]


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Hold the folder: a second attach there would take its files and its port.

    Raises:
        InputError: somebody holds it, or it cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / ".attach.lock").open("a+")
    except OSError as error:
        raise InputError(f"{folder} cannot be written to: {error.strerror}") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            lock.seek(0)
            raise InputError(
                f"{folder}: `robomend attach` runs there already (process {lock.read()})"
            ) from error
        lock.truncate(0)
        lock.write(str(os.getpid()))
        lock.flush()
        logging.basicConfig(filename=folder / "attach.log", format="%(asctime)s %(levelname)s %(message)s")
        yield


# --- what people see --------------------------------------------------------------------------------------


@contextmanager
def _table() -> Iterator[Callable[[Hearing, float, float], None]]:
    """A live table on a terminal, a line now and then elsewhere."""
    from rich.console import Console
    from rich.live import Live

    console = Console(stderr=True)
    if not console.is_terminal or console.is_dumb_terminal:
        shown_s = [float("-inf")]

        def line(hearing: Hearing, passed_s: float, all_s: float) -> None:
            if passed_s - shown_s[0] >= LINES_S or shown_s[0] < 0:
                shown_s[0] = passed_s
                click.echo(_told(hearing, passed_s, all_s), err=True)

        yield line
        return
    with Live(console=console, transient=True, refresh_per_second=4) as live:
        yield lambda hearing, passed_s, all_s: live.update(_rows(hearing, passed_s, all_s))


def _told(hearing: Hearing, passed_s: float, all_s: float) -> str:
    heard = sum(1 for ear in hearing.ears.values() if ear.count)
    nodes = len(own_nodes(hearing.graph.nodes))
    messages = sum(ear.count for ear in hearing.ears.values())
    return (
        f"listening, {passed_s:.0f} of {all_s:.0f} s: {nodes} nodes, {heard} of {len(hearing.ears)} topics "
        f"heard, {messages:,} messages"
    )


def _rows(hearing: Hearing, passed_s: float, all_s: float) -> Any:
    from rich.table import Table

    table = Table(title=_told(hearing, passed_s, all_s), title_justify="left", box=None)
    for column in ("topic", "Hz", "messages", "published by"):
        table.add_column(column, justify="right" if column in ("Hz", "messages") else "left")
    loudest = sorted(hearing.ears.items(), key=lambda one: (-one[1].count, one[0]))
    for topic, ear in loudest[:ROWS]:
        nodes = ", ".join(sorted(hearing.graph.publishers.get(topic, ())))
        table.add_row(topic, f"{ear.count / max(passed_s, 1):.3g}", str(ear.count), nodes[:60])
    if len(loudest) > ROWS:
        table.add_row(f"and {len(loudest) - ROWS} more", "", "", "")
    return table
