"""A bridge in the test's own event loop, and what it delivers."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

from tests.ros1 import Robot
from tests.ros2 import Ros2Robot
from tests.waiting import eventually
from tests.zenoh_robot import ZenohRobot

from robomend_client.agent.feeds import load_feed
from robomend_client.observers import Contact, Publishers
from robomend_client.python310 import end
from robomend_client.yaml_reader import read


class Heard:
    """What a bridge delivered, by source, and what it said in the log."""

    def __init__(self) -> None:
        self.values: dict[str, list[Any]] = {}
        self.sights: dict[str, list[Contact]] = {}
        self.publishers: dict[str, tuple[str, ...]] = {}
        self.why: dict[str, dict[str, str]] = {}  # why nodes do not run, of the newest table
        self.log: list[str] = []
        self.task: asyncio.Task[None] | None = None
        self.listener: Callable[[str, object, int | None], None] | None = None  # hears it all, too

    def deliver(self, source: str, value: object, time_ns: int | None) -> None:
        if self.listener is not None:
            self.listener(source, value, time_ns)
        if isinstance(value, Publishers):
            self.publishers[source] = value.nodes
        elif isinstance(value, Contact):
            self.sights.setdefault(source, []).append(value)
        else:
            if source == "nodes" and isinstance(value, Mapping):
                self.why = {name: dict(one) for name, one in value.items() if isinstance(one, Mapping)}
                value = {name: False if isinstance(one, Mapping) else one for name, one in value.items()}
            self.values.setdefault(source, []).append(value)

    def sees(self, source: str) -> bool:
        """Return whether somebody looks at a source, as far as the bridge has said."""
        return self.sights.get(source, [Contact.BACK])[-1] is Contact.BACK

    def count(self, source: str) -> int:
        return len(self.values.get(source, ()))

    def last(self, source: str) -> Any:
        return self.values.get(source, [None])[-1]

    async def more(self, source: str, times: int = 3) -> None:
        """Wait for samples that are yet to come."""
        wanted = self.count(source) + times
        await self.until(lambda: self.count(source) >= wanted, f"{times} more of {source}")

    async def told(self, part: str) -> None:
        """Wait for a line in the log."""
        await self.until(lambda: self.lines(part), f"{part!r} in the log: {self.log}")

    async def runs(self, wanted: Mapping[str, bool | None]) -> None:
        """Wait until the table of nodes says so of these; one that is not in it does not run."""

        def said() -> bool:
            table = self.last("nodes")
            return table is not None and all(table.get(node, False) is runs for node, runs in wanted.items())

        await self.until(said, f"{wanted}, not {self.last('nodes')}")

    async def until(self, true: Callable[[], object], what: str) -> None:
        """Wait until something holds, while the bridge works."""
        task = self.task
        assert task is not None
        await eventually(lambda: true() or task.done(), what, 60)
        assert not task.done(), task.exception()

    def lines(self, part: str) -> list[str]:
        return [line for line in self.log if part in line]


class _Log(logging.Handler):
    def __init__(self, lines: list[str]) -> None:
        super().__init__()
        self.lines = lines

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


@asynccontextmanager
async def hearing(folder: Path, origin: str, keys: str, *sources: str) -> AsyncIterator[Heard]:
    """Run a bridge whose section has these keys, and that observers want these sources of."""
    file = folder / f"{origin}.yaml"
    file.write_text(keys)
    section = read(file)
    feed = load_feed(origin)(section, folder, frozenset(sources))
    section.finish()
    heard = Heard()
    handler = _Log(heard.log)
    logger = logging.getLogger("robomend_client.bridges")
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    task = heard.task = asyncio.create_task(feed.run(heard.deliver))
    try:
        yield heard
        assert not task.done(), task.exception()
    finally:
        await end([task])
        logger.removeHandler(handler)


def listening(
    robot: Robot | Ros2Robot | ZenohRobot, *sources: str, more: str = ""
) -> AbstractAsyncContextManager[Heard]:
    """Run the bridge to a robot; `more` are further keys of its section."""
    if isinstance(robot, Robot):
        origin, folder, keys = "ros1", robot.master.folder, f"master: '{robot.master.uri}'"
    elif isinstance(robot, Ros2Robot):
        origin, folder, keys = "ros2", robot.folder, f"domain: {robot.domain}\ndiscovery: localhost"
    else:
        origin, folder, keys = "zenoh", robot.folder, f"connect: ['{robot.endpoint}']\ndiscovery_s: 0.5"
    return hearing(folder, origin, f"{keys}\nname: robomend_test\n{more}\n", *sources)
