"""robomend-agent CONFIG.yaml: the robot's side of robomend, on one host.

Exit codes: 0 ended as asked, 2 the configuration is at fault, 3 a part of the machine is (the state directory
is in use, a part that is installed apart is missing, …).
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from itertools import islice, product
from pathlib import Path

from robomend_client.agent.config import AgentConfig, load
from robomend_client.agent.executors.base import Executors
from robomend_client.agent.executors.program import Program, missing
from robomend_client.agent.feeds import EXTRAS, MissingExtra, load_feed
from robomend_client.buffer import BufferInUse
from robomend_client.yaml_reader import ConfigError

SHOWN = 100
"""Choices of parameters of an action of which it is said what would be sent."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="robomend-agent",
        description="Reports what a robot's observers see, and does what robomend asks for.",
    )
    parser.add_argument("config", type=Path, metavar="CONFIG.yaml", help="what to run, watch and report")
    parser.add_argument(
        "--check", action="store_true", help="say what the configuration means, look for its programs, end"
    )
    parser.add_argument(
        "--ready-for",
        choices=EXTRAS,
        help="load this feed already, and read the file when a line comes on standard input",
    )
    parser.add_argument("--quiet", action="store_true", help="log warnings and errors only")
    parser.add_argument("--verbose", action="store_true", help="log every step")
    options = parser.parse_args(arguments)
    level = logging.DEBUG if options.verbose else logging.WARNING if options.quiet else logging.INFO
    logging.basicConfig(
        stream=sys.stderr, level=level, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    for chatty in ("httpx", "httpcore", "asyncio"):  # a line for every request, ten times a second
        logging.getLogger(chatty).setLevel(logging.WARNING)
    if options.ready_for and not _told(options.ready_for):
        return 0
    try:
        config = load(options.config)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except MissingExtra as error:
        print(f"{options.config}: {error}", file=sys.stderr)
        return 3
    if options.check:
        print(describe(config))
        faults = list(missing_programs(config, options.config))
        print(*faults, sep="\n", end="\n" * bool(faults), file=sys.stderr)
        return 3 if faults else 0
    try:
        asyncio.run(_run(config))
    except (OSError, BufferInUse) as error:
        print(f"robomend-agent: {error}", file=sys.stderr)
        return 3
    return 0


def describe(config: AgentConfig) -> str:
    """Return what a configuration means, for people."""
    lines = [
        f"agent {config.agent} of robot {config.robot}, service {config.service.url}",
        f"bus: {'joins' if config.joins_bus else 'listens on'} {config.bus}",
        f"state: {config.state_dir}",
    ]
    lines += [f"topic {name}: {rate.rate_hz:g} ± {rate.tolerance_hz:g} Hz" for name, rate in config.topics]
    topics = {name for name, _ in config.topics}
    for spec in config.observers:
        if spec.name in topics and spec.kind == "general":
            continue
        observer = spec.make()
        lines.append(
            f"observer {spec.name} ({spec.kind}): {', '.join(map(str, spec.atoms))}; "
            f"detection within {observer.detection_s:g} s, settling within {observer.settling_s:g} s"
        )
    lines += [f"process {spec.name}: {' '.join(spec.command)}" for spec in config.processes]
    for executor in Executors(config.agent, [action.make() for action in config.actions]):
        lines += [f"action {offer}" for offer in Executors(config.agent, [executor]).can]
        if (would := getattr(executor, "would", None)) is not None:
            choices = islice(product(*executor.parameters), SHOWN)
            lines += [f"  {executor.name}({', '.join(one)}): {would(one)}" for one in choices]
    return "\n".join(lines)


def missing_programs(config: AgentConfig, file: Path) -> Iterator[str]:
    """Yield which programs of a configuration cannot be started on this computer."""
    for spec in config.processes:
        if (why := missing(spec.command[0], spec.directory, dict(spec.environment))) is not None:
            yield f"{file}: processes.{spec.name}.command: {why}"
    for action in config.actions:
        executor = action.make()
        if isinstance(executor, Program) and (why := executor.missing()) is not None:
            yield f"{file}: actions.{executor.name}.command: {why}"


def import_lean() -> None:
    """Let httpx leave out its command line, which takes 6 MB where rich and pygments are installed."""
    sys.modules["httpx._main"] = None  # type: ignore[assignment]  # None: it is not to be found


def _told(feed: str) -> bool:
    """Load what an agent needs that has this feed, and wait for a line; return whether one came."""
    import_lean()
    with suppress(MissingExtra):  # the file may not want it
        load_feed(feed)
    for module in ("robomend_client.agent.agent", "rosbags.typesys"):
        with suppress(ImportError):
            import_module(module)
    return bool(sys.stdin.readline())


async def _run(config: AgentConfig) -> None:
    import_lean()
    from robomend_client.agent.agent import Agent

    agent = Agent(config)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, agent.stop)
    await agent.run()


if __name__ == "__main__":
    sys.exit(main())
