"""A real agent under a real service: nodes are killed, topics fall silent, and events say when it was known.

Agent, nodes and service run on this machine; the time of an event is the one at which the service accepted
the report.
"""

from __future__ import annotations

import json
import os
import queue
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from robomend_bench.service.process import children, memory_mb
from robomend_client.bus import Bus
from robomend_client.events import Event, Kind
from robomend_client.observers import Rate
from robomend_client.rest.errors import ClientError
from robomend_client.rest.sync import Client

WITHIN_S = 60.0
"""Everything waited for takes seconds at most; this is for a machine that others use."""

PERIOD_S = 0.1

TRIES = 5
"""To see a topic fall silent that was on time until then."""


class NotTold(Exception):
    """What was waited for did not come in time."""


class Watcher:
    """Who listens to the service: what it holds of one robot."""

    def __init__(self, url: str, robot: str, *kinds: Kind) -> None:
        """`kinds` are the events that are heard beside observations."""
        self.client = Client(url)
        self._robot = robot
        self._kinds = (Kind.OBSERVATIONS, *kinds)
        self._events: queue.Queue[Event] = queue.Queue()
        self._holds: dict[str, bool] = {}

    def listen(self) -> None:
        """Begin; the robot is there."""
        threading.Thread(target=self._listen, daemon=True).start()

    def told(self, wanted: dict[str, bool]) -> int:
        """Wait until the service holds this; return when it accepted the last of it.

        Raises:
            NotTold: it did not come.
        """
        deadline = time.monotonic() + WITHIN_S
        at_ns = time.time_ns()
        while not wanted.items() <= self._holds.items():
            event = self._next(deadline)
            if event is None:
                missing = sorted(f"{atom}: {sign}" for atom, sign in wanted.items() - self._holds.items())
                raise NotTold(", ".join(missing[:5]))
            at_ns = int(event.data.get("accepted_ns") or event.time_ns)
        return at_ns

    @contextmanager
    def running(
        self, folder: Path, settings: Mapping[str, Any], known: dict[str, bool]
    ) -> Iterator[subprocess.Popen[bytes]]:
        """Run an agent until the service holds this, and go on; it is gone afterwards."""
        file = folder / "agent.yaml"
        file.write_text(json.dumps({"state_dir": str(folder / "state"), **settings}))
        with (folder / "agent.log").open("wb") as log:
            command = [sys.executable, "-m", "robomend_client.agent.main", str(file)]
            process = subprocess.Popen(command, stderr=log)
        try:
            self.told(known)
            yield process
        finally:
            process.terminate()
            process.wait(WITHIN_S)

    def _next(self, deadline: float) -> Event | None:
        """Return the next event, what it says of observations noted; None: there was none by then."""
        try:
            event = self._events.get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            return None
        if event.kind is Kind.OBSERVATIONS:
            for literal in event.data["changed"]:
                self._holds[literal.removeprefix("not ")] = not literal.startswith("not ")
        return event

    def _listen(self) -> None:
        try:
            for event in self.client.events(self._robot, after=0):
                if event.kind in self._kinds:
                    self._events.put(event)
        except ClientError:
            pass  # the service has gone, at the end


class Rig(Watcher):
    """A robot of so many nodes that publish a topic each, its agent, and who listens to the service."""

    def __init__(self, url: str, folder: Path, count: int, topics: Sequence[str] = ("topic",)) -> None:
        """`topics` are those of each node, after its name."""
        super().__init__(url, "bench")
        self._url = url
        self._folder = folder
        self._nodes = [f"node{number}" for number in range(count)]
        self._bus = f"unix:{folder}/bus"
        nodes: dict[str, Any] = {
            node: {"publishes": {f"{node}_{topic}": [] for topic in topics}} for node in self._nodes
        }
        self.client.put_model("bench", json.dumps({"robomend": 1, "name": "bench", "nodes": nodes}))
        self.client.put_robot("bench", {"model": "bench", "policy": "observe"})
        self.listen()

    def agent(self) -> AbstractContextManager[subprocess.Popen[bytes]]:
        """Run the agent with all nodes until they are known to run."""
        settings = {
            "robot": "bench",
            "service": {"url": self._url},
            "bus": {"listen": self._bus},
            "topics": {f"{node}_topic": {"first_s": 86400} for node in self._nodes},
            "processes": {node: {"command": ["sleep", "86400"], "start": True} for node in self._nodes},
        }
        return self.running(self._folder, settings, {f"running({node})": True for node in self._nodes})

    def killed_s(self, agent: subprocess.Popen[bytes], seed: int) -> list[float]:
        """Kill each node, one after another; return the times until the service knew, sorted."""
        draw = random.Random(seed)
        pids = {_environment(pid).get("ROBOMEND_NODE"): pid for pid in _below(agent.pid)}
        found = []
        for node in self._nodes:
            time.sleep(draw.uniform(0.1, 0.3))  # anywhere in the agent's periods
            began_ns = time.time_ns()
            os.kill(pids[node], signal.SIGKILL)
            found.append((self.told({f"running({node})": False}) - began_ns) / 1e9)
        return sorted(found)

    def silent_s(self, seed: int) -> list[float]:
        """Let all topics come at 10 Hz and fall silent one by one; return the times until that was known."""
        draw = random.Random(seed)
        topics = [f"{node}_topic" for node in self._nodes]
        silent: set[str] = set()
        last_ns: dict[str, int] = {}
        one_of_us = threading.Lock()
        end = threading.Event()

        def talk() -> None:
            bus = Bus(self._bus, WITHIN_S)
            due = time.monotonic()
            while not end.is_set():
                for topic in topics:
                    with one_of_us:
                        if topic not in silent:
                            last_ns[topic] = time.time_ns()
                            bus.publish(topic)
                due = max(due + PERIOD_S, time.monotonic())
                end.wait(due - time.monotonic())
            bus.close()

        def switch(topic: str) -> int:
            with one_of_us:
                silent.symmetric_difference_update({topic})
                return last_ns[topic]

        thread = threading.Thread(target=talk)
        thread.start()
        found = []
        try:
            self.told({f"ok({topic})": True for topic in topics})
            for topic in topics:
                time.sleep(draw.uniform(0.1, 0.3))  # anywhere in the agent's periods
                found.append(self.silence_s(topic, partial(switch, topic)))
        finally:
            end.set()
            thread.join()
        return sorted(found)

    def silence_s(self, topic: str, switch: Callable[[], int]) -> float:
        """Silence a topic; return the time from its last message until the service knew.

        Where its silence is known too early for that, it was late before its last message, as a busy
        computer makes it: then once more.

        Args:
            switch: silences it, and when called again lets it talk; returns when its last message was.
        """
        for tries_left in reversed(range(TRIES)):
            self.told({f"ok({topic})": True})
            last_ns = switch()
            seconds = (self.told({f"ok({topic})": False}) - last_ns) / 1e9
            if seconds >= Rate().silence or not tries_left:
                break
            switch()
        return seconds


def settled_mb(pid: int) -> float:
    """Return the resident memory of a process that has nothing new to do."""
    time.sleep(3.0)  # buffers, connections and a few heartbeats
    return memory_mb(pid)


def _below(pid: int) -> list[int]:
    """Return the processes that this one has started, and they in turn."""
    found = children(pid)
    return [*found, *(one for child in found for one in _below(child))]


def _environment(pid: int) -> dict[str, str]:
    pairs = Path(f"/proc/{pid}/environ").read_bytes().decode(errors="replace").split("\0")
    return {name: value for name, _, value in (pair.partition("=") for pair in pairs)}


def row(seconds: list[float]) -> dict[str, Any]:
    """Return what is told of sorted times."""
    middle = seconds[len(seconds) // 2]
    return {"count": len(seconds), "median_s": round(middle, 3), "max_s": round(seconds[-1], 3)}
