"""Somebody who talks on an agent's bus."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.clients.running_agent import agent, config
from tests.network import own_port

from robomend_client.bus import Bus, BusGone


class Talker:
    """Publishes topics at 10 Hz, from a thread, until it is told to be silent."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._topics: dict[str, dict[str, Any]] = {}
        self._saying = threading.Lock()
        self._said_ns = 0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def say(self, topic: str, **message: Any) -> None:
        self._topics[topic] = message

    def hush(self, topic: str) -> int:
        """Be silent on a topic; return a time after which nothing is said on it but what is under way."""
        with self._saying:
            del self._topics[topic]
            return self._said_ns

    def close(self) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        bus: Bus | None = None
        due = time.monotonic()
        while not self._end.wait(max(0.0, due - time.monotonic())):
            due = max(due + 0.1, time.monotonic() - 0.05)
            try:
                bus = bus or Bus(self._address)
                with self._saying:
                    self._said_ns = time.time_ns()
                    for topic, message in tuple(self._topics.items()):
                        bus.publish(topic, **message)
            except BusGone:
                bus = None


@contextmanager
def watching(
    folder: Path, url: str, environment: Mapping[str, str] | None = None, **more: Any
) -> Iterator[tuple[subprocess.Popen[bytes], Talker]]:
    """Run an agent with these sections, and somebody who talks on its bus."""
    address = f"tcp:127.0.0.1:{own_port()}"
    file = config(folder, url, more.pop("processes", {}), bus={"listen": address}, **more)
    with agent(file, environment) as process:
        talker = Talker(address)
        try:
            yield process, talker
        finally:
            talker.close()
