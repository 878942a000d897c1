"""Follows the service's events on a thread, so that each has the time at which it came."""

from __future__ import annotations

import queue
import threading
import time

from robomend_client.rest.errors import ClientError
from robomend_client.rest.retry import NEVER
from robomend_client.rest.sync import Client
from robomend_demo.record import Heard


class Listener:
    """Hears everything from the beginning of the service's log. It ends when the service does."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._heard: queue.SimpleQueue[Heard] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._listen, name="events", daemon=True)
        self.lost: str | None = None

    def start(self) -> None:
        """Begin; no process may be forked from here on."""
        self._thread.start()

    def take(self) -> list[Heard]:
        """Return what came since the last time."""
        heard = []
        while not self._heard.empty():
            heard.append(self._heard.get_nowait())
        return heard

    def close(self, timeout_s: float = 1.0) -> None:
        """Wait for the thread, which ends with its connection."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    def _listen(self) -> None:
        try:
            with Client(self._url, timeout_s=5.0, retry=NEVER) as client:
                for event in client.events(after=0, patience_s=0.0):
                    self._heard.put(Heard(event, time.time_ns()))
        except ClientError as error:
            self.lost = str(error)
