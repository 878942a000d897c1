"""The agent's one YAML file.

    robot: tedusar
    agent: onboard                     # this agent's name; several agents of a robot have different ones
    host: pc                           # which of the model's hosts; a robot's only agent leaves it out
    service: {url: "http://127.0.0.1:8080", key_file: key}     # or key_env: ROBOMEND_KEY
    state_dir: state                   # buffer, first results, process table; relative to this file
    bus: {listen: "unix:state/bus"}    # the default; or tcp:HOST:PORT; or join: ADDRESS of another agent's
    report: {heartbeat_s: 1, lifetime_s: 5, buffer_mb: 16}
    when_agent_ends: stop              # or keep: the processes go on, and the next agent adopts them
    rate: {silence_s: 0.5}             # what all topics below have in common
    topics:
      scan: {rate_hz: 10, tolerance_hz: 1}     # from: ros1 where it comes from there
    observers:                         # observers/kinds.py
      odom_yaw: {kind: qualitative, source: "odom:twist.twist.angular.z", slope: 0.1}
    lenient: [ok(scan)]                # atoms of which good news wins where observers disagree
    starved: 0.2                       # kept from the processor for more of the time, it is; false: never
    recording: {file: run.jsonl, mb: 64}   # what the observers are fed with, to be replayed
    moments: {record: true}            # what was there when something turned bad; and raw messages around it
    actions:                           # executors/base.py
      calibrate: {kind: process, command: [calibrate, "{arm}"], parameters: {arm: [left, right]}}
    processes:                         # what may be started and stopped; nothing else may
      hokuyo_node:
        command: [python3, -m, hokuyo, --device, /dev/ttyACM0]  # never goes through a shell
        directory: /opt/robot
        environment: {LANG: C}
        ready: notify                  # systemd's READY=1; or exec; or {output: REGEX}
        start_timeout_s: 10
        stop_grace_s: 2                # from SIGTERM to SIGKILL
        start: false                   # start it with the agent

Every complaint names file, line and key.
"""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

from robomend_client.agent.executors.base import ActionSpec, read_actions
from robomend_client.agent.feeds import BUS, SECTIONS, BrokenFeed, Feed, UnknownFeed, is_own, load_feed
from robomend_client.agent.usage import Usage
from robomend_client.beats import MOST_LATE
from robomend_client.bus import parse_address
from robomend_client.docstrings import documented
from robomend_client.literals import Atom
from robomend_client.observers import PROCESSES, NodeObserver, Rate
from robomend_client.observers.kinds import (
    ObserverSpec,
    observer_spec,
    read_lenient,
    read_observers,
    read_topics,
)
from robomend_client.yaml_reader import Section, read

TOP = {
    "robot": "the robot's id at the service",
    "agent": "this agent's name, by default the host's; several agents of a robot have different ones",
    "host": "which of the model's hosts this is; a robot's only agent leaves it out",
    "service": "where the service is, and the key",
    "state_dir": "folder of buffer, first results and table of processes, relative to this file",
    "bus": "where nodes hand their messages in: listen, or join another agent's",
    "report": "how often the agent reports, and how long that counts",
    "starved": "kept from the processor for more of the time, what comes late is unknown; false: it is late",
    "when_agent_ends": "whether the processes are stopped then, or kept for the next agent to adopt",
    "processes": "the only ones that may be started and stopped, by the model's names of the nodes",
    "actions": "what else the agent can do, by the plan's names",
    "recording": "what the observers are fed with is kept as lines of JSON, to be replayed",
    "moments": "what is kept of the time around a literal that turns bad, for people and for tools",
    "board": "the power board, as the service measures it",
    "ros1": "a robot with ROS 1",
    "ros2": "a robot with ROS 2",
    "zenoh": "a robot with ROS 2 over zenoh",
    "medkit": "a gateway of ros2_medkit",
}
"""What the keys of the file are for."""


@dataclass(frozen=True, slots=True)
class ProcessSpec:
    """A process that the agent may start and stop.

    Attributes:
        command: the program and its arguments, a list that no shell reads.
        directory: working directory, relative to this file; by default the agent's.
        environment: variables beside the agent's own.
        ready: the evidence that it runs: `exec`, it could be executed; `notify`, systemd's READY=1; or a line
            of its output.
        start_timeout_s: a start without that evidence has failed after so many seconds, and is ended.
        stop_grace_s: from SIGTERM to SIGKILL, in seconds.
        start: whether it is started with the agent.
        log_mb: its newest output is kept in files, together of so many megabytes at most; 0: not at all.
    """

    name: str
    command: tuple[str, ...]
    directory: Path | None = None
    environment: tuple[tuple[str, str], ...] = ()
    ready: str = "exec"  # "exec", "notify" or "output"
    ready_output: re.Pattern[bytes] | None = None
    start_timeout_s: float = 10.0
    stop_grace_s: float = 2.0
    start: bool = False
    log_mb: float = 1.0


@dataclass(frozen=True, slots=True)
class Service:
    """Where the service is; the key stays out of every representation.

    Attributes:
        url: the service's, e.g. http://robomend.local:8600.
        key_file: a file whose only line is the bearer key, relative to this file.
        key_env: the environment variable that has the bearer key.
    """

    url: str
    key_file: Path | None = None
    key_env: str | None = None

    def key(self) -> str | None:
        """Return the bearer key, read now: a rotated key needs no new configuration.

        Raises:
            OSError: the file cannot be read.
            ValueError: it holds something that cannot be a key.
        """
        if self.key_file is not None:
            key: str | None = self.key_file.read_text("ascii", errors="replace").strip()
        else:
            key = os.environ.get(self.key_env, "").strip() if self.key_env else None
        if key and not (key.isascii() and key.isprintable()):
            raise ValueError("holds no key: one line of letters, digits and punctuation")
        return key or None


class MomentsConfig(NamedTuple):
    """What is kept of the time around a literal that turns bad.

    Attributes:
        keep: whether there is a freeze frame.
        record: whether the raw messages around it are recorded, too.
        before_s: so many seconds before it.
        after_s: so many seconds after it.
        memory_mb: what the messages may take that are kept for a recording, in megabytes.
        disk_mb: what moments may take that wait for the service, in megabytes.
        per_hour: so many moments in an hour, at most.
    """

    keep: bool = True
    record: bool = False
    before_s: float = 30.0
    after_s: float = 10.0
    memory_mb: float = 24.0
    disk_mb: float = 256.0
    per_hour: float = 20.0


@dataclass(frozen=True, slots=True)
class AgentConfig:
    """All of it, checked."""

    robot: str
    agent: str
    host: str | None
    service: Service
    state_dir: Path
    bus: str
    joins_bus: bool
    heartbeat_s: float
    lifetime_s: float
    buffer_bytes: int
    keep_processes: bool
    topics: tuple[tuple[str, Rate], ...]
    observers: tuple[ObserverSpec, ...]  # those of topics and processes, too
    lenient: frozenset[Atom]
    starved: float | None  # part of the time; None: whatever it is
    feeds: tuple[tuple[Feed, frozenset[str]], ...]  # each with the sources that it feeds
    recording: tuple[Path, int] | None
    moments: MomentsConfig
    processes: tuple[ProcessSpec, ...]
    actions: tuple[ActionSpec, ...]

    def sources(self, own: bool) -> frozenset[str]:
        """Return what the agent itself, or the bus, is to feed observers with."""
        return frozenset(
            source
            for spec in self.observers
            for source in spec.sources
            if (spec.origin == BUS or is_own(source)) and is_own(source) is own
        )


def load(file: Path) -> AgentConfig:
    """Return the configuration in `file`; ConfigError names what is wrong with it and where."""
    return read_config(read(file), file.resolve().parent)


def read_config(top: Section, base: Path) -> AgentConfig:
    """Return the configuration in a section whose paths are relative to `base`.

    Raises:
        ConfigError: it names what is wrong and where.
    """
    for key, kind in {"robomend": "a model", "model": "a robot's configuration"}.items():
        if key in top and "robot" not in top:
            wanted = "an agent's file is wanted, with `robot: ID`, `service:` and `observers:`"
            raise top.error("", f"this is {kind}; {wanted}")
    top.explain(**TOP)
    robot = top.text("robot")
    agent = top.text("agent", socket.gethostname())
    host = top.optional("host")
    service = _service(top.section("service"), base)
    of_unit = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]  # /etc is read-only there
    state_dir = base / top.text("state_dir", of_unit or "robomend-agent-state")
    bus, joins = _bus(top.section("bus"), state_dir)

    report = top.section("report")
    report.explain(
        heartbeat_s="how often the agent says that it is there, and what it observes, in seconds",
        lifetime_s="what was reported holds for so many seconds at the service; by default 5 heartbeats",
        buffer_mb="reports wait in a file of so many megabytes at most while the service is out of reach",
    )
    heartbeat_s = report.number("heartbeat_s", 1.0, least=0.05, most=3600)
    lifetime_s = report.number("lifetime_s", 5 * heartbeat_s, least=0.1, most=86400)
    if lifetime_s < 2 * heartbeat_s:
        raise report.error(
            "lifetime_s", f"must be at least twice heartbeat_s, {heartbeat_s:g}: one may get lost"
        )
    buffer_bytes = int(report.number("buffer_mb", 16, least=0.01, most=65536) * 1024 * 1024)
    report.finish()

    keep = top.choice("when_agent_ends", ("stop", "keep"), "stop") == "keep"
    topics = read_topics(top)
    rates = tuple(topic.observer for topic in topics)
    lenient = read_lenient(top)
    never = "starved" in top and top.text("starved").lower() in ("false", "no")
    starved = None if never else top.number("starved", MOST_LATE, least=0.01, most=1)
    processes = tuple(_process(name, section, base, keep) for name, section in top.sections("processes"))
    given = read_observers(top, base)
    observers = (
        *rates,
        *given,
        *([_nodes(tuple(spec.name for spec in processes))] if processes else []),
    )
    feeds = _feeds(top, base, (*rates, *given))
    _check_own(top, given, processes)
    recording = _recording(top.section("recording"), base)
    moments = _moments(top.section("moments"))
    actions = read_actions(top, base)
    top.finish()
    return AgentConfig(
        robot=robot,
        agent=agent,
        host=host,
        service=service,
        state_dir=state_dir,
        bus=bus,
        joins_bus=joins,
        heartbeat_s=heartbeat_s,
        lifetime_s=lifetime_s,
        buffer_bytes=buffer_bytes,
        keep_processes=keep,
        topics=tuple((topic.name, topic.rate) for topic in topics),
        observers=observers,
        lenient=lenient,
        starved=starved,
        feeds=feeds,
        recording=recording,
        moments=moments,
        processes=processes,
        actions=actions,
    )


def _service(section: Section, base: Path) -> Service:
    section.explain(**documented(Service))
    url = section.text("url")
    if not url.startswith(("http://", "https://")):
        raise section.error("url", f"must start with http:// or https://, not {url!r}")
    if not _names_a_host(url):
        raise section.error("url", f"must be like http://robomend.local:8600, not {url!r}")
    key_file = section.optional("key_file")
    service = Service(url, base / key_file if key_file else None, section.optional("key_env"))
    section.finish()
    try:
        service.key()
    except OSError as error:
        raise section.error("key_file", f"cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise section.error("key_file" if key_file else "key_env", str(error)) from error
    return service


def _names_a_host(url: str) -> bool:
    try:
        parts = urlsplit(url)
        return bool(parts.hostname) and parts.port != 0 and not (parts.query or parts.fragment or " " in url)
    except ValueError:  # a port that is none, a bracket that does not close
        return False


def _bus(section: Section, state_dir: Path) -> tuple[str, bool]:
    section.explain(
        listen="where nodes hand messages in, unix:PATH or tcp:HOST:PORT; by default unix:STATE_DIR/bus",
        join="the address of another agent's bus, where this one gets its messages",
    )
    joins = "join" in section
    key = "join" if joins else "listen"
    address = section.text(key, f"unix:{state_dir}/bus")
    if address.startswith("unix:") and not address.startswith("unix:/"):
        address = f"unix:{state_dir.parent / address.removeprefix('unix:')}"
    try:
        parse_address(address)
    except ValueError as error:
        raise section.error(key, str(error)) from error
    section.finish()
    return address, joins


def _nodes(names: tuple[str, ...]) -> ObserverSpec:
    return observer_spec("processes", "node", BUS, lambda: NodeObserver(names))


def _feeds(
    top: Section, base: Path, observers: Iterable[ObserverSpec]
) -> tuple[tuple[Feed, frozenset[str]], ...]:
    """Return the feeds that observers want beside the bus, each with its section of the file read."""
    wanted: dict[str, set[str]] = {}
    origins: dict[str, str] = {}
    for spec in observers:
        for source in spec.sources:
            if is_own(source):
                continue
            if origins.setdefault(source, spec.origin) != spec.origin:
                section = _section_of(top, spec.name)
                raise section.error("from", f"{source} comes from {origins[source]} for another observer")
            if spec.origin != BUS:
                wanted.setdefault(spec.origin, set()).add(source)
    for origin in SECTIONS:
        if origin in top:
            wanted.setdefault(origin, set())
    feeds = []
    for origin, sources in wanted.items():
        try:
            feed = load_feed(origin)
        except (UnknownFeed, BrokenFeed) as error:
            name = next((spec.name for spec in observers if spec.origin == origin), None)
            if name is None:
                raise top.error(origin, str(error.args[0])) from error
            raise _section_of(top, name).error("from", str(error.args[0])) from error
        section = top.section(origin)
        feeds.append((feed(section, base, frozenset(sources)), frozenset(sources)))
        section.finish()
    return tuple(feeds)


def _section_of(top: Section, name: str) -> Section:
    """Return where an observer is described, among the observers or the topics."""
    entries = (*top.sections("observers"), *((n.removeprefix("/"), s) for n, s in top.sections("topics")))
    return next((section for entry, section in entries if entry == name), top)


def _check_own(top: Section, observers: Iterable[ObserverSpec], processes: Iterable[ProcessSpec]) -> None:
    """Refuse sources that the agent itself would have to have, and has not."""
    nodes = [spec.name for spec in processes]
    for spec in observers:
        for source in spec.sources:
            if not is_own(source) or source == PROCESSES:
                continue
            try:
                Usage([source], nodes)
            except ValueError as error:
                section = next(s for name, s in top.sections("observers") if name == spec.name)
                raise section.error("source", str(error)) from error


def _recording(section: Section, base: Path) -> tuple[Path, int] | None:
    section.explain(
        file="where it is written, relative to this file", mb="the file's size, at most, in megabytes"
    )
    file = section.optional("file")
    most_bytes = int(section.number("mb", 64, least=0.001, most=100_000) * 1024 * 1024)
    section.finish()
    return None if file is None else (base / file, most_bytes)


def _moments(section: Section) -> MomentsConfig:
    section.explain(**documented(MomentsConfig))
    usual = MomentsConfig()
    found = MomentsConfig(
        keep=section.flag("keep", usual.keep),
        record=section.flag("record", usual.record),
        before_s=section.number("before_s", usual.before_s, least=1, most=600),
        after_s=section.number("after_s", usual.after_s, least=0, most=120),
        memory_mb=section.number("memory_mb", usual.memory_mb, least=1, most=4096),
        disk_mb=section.number("disk_mb", usual.disk_mb, least=1, most=100_000),
        per_hour=section.number("per_hour", usual.per_hour, least=0.1, most=3600),
    )
    if found.record and find_spec("mcap") is None:
        raise section.error("record", "needs what is installed with: pip install 'robomend-client[record]'")
    section.finish()
    return found


def _process(name: str, section: Section, base: Path, keep: bool) -> ProcessSpec:
    section.explain(**documented(ProcessSpec))
    command = section.texts(
        "command", "must be a list of the program and its arguments, e.g. [roslaunch, a.launch]"
    )
    directory = section.optional("directory")
    pattern = None
    if section.is_section("ready"):
        output = section.section("ready")
        output.explain(output="a regular expression; what runs has printed a line in which it is found")
        ready = "output"
        try:
            pattern = re.compile(output.text("output").encode())
        except re.error as error:
            raise output.error("output", f"is no regular expression: {error}") from error
        output.finish()
    else:
        ready = section.choice("ready", ("exec", "notify"), "exec", " or {output: REGEX}")
    spec = ProcessSpec(
        name=name,
        command=command,
        directory=base / directory if directory else None,
        environment=tuple(section.section("environment").words().items()),
        ready=ready,
        ready_output=pattern,
        start_timeout_s=section.number("start_timeout_s", 10.0, least=0.01, most=3600),
        stop_grace_s=section.number("stop_grace_s", 2.0, least=0.0, most=600),
        start=section.flag("start", False),
        log_mb=section.number("log_mb", 1.0, least=0.0, most=10_000),
    )
    if keep and spec.ready == "output" and not spec.log_mb:
        raise section.error("log_mb", "must be above 0: the output of what outlives the agent is read there")
    section.finish()
    return spec
