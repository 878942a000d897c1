"""A cable between browser and service, to be cut, or to let nothing through any more without saying so."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from urllib.parse import urlsplit


class Cable:
    """Hands connections through to a service at an address of its own."""

    def __init__(self, url: str) -> None:
        there = urlsplit(url)
        self._to = (str(there.hostname), int(there.port or 80))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self._whole = threading.Event()  # bytes go through
        self._whole.set()
        self._cut = False
        self._ends: set[socket.socket] = set()
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """End all connections, and every new one at once."""
        self._cut = True
        self._drop()

    def mute(self) -> None:
        """Let nothing through, and keep the connections."""
        self._whole.clear()

    def mend(self) -> None:
        """Let everything through again."""
        self._cut = False
        self._whole.set()

    def close(self) -> None:
        """End it."""
        self._listener.close()
        self.mend()
        self._drop()

    def _drop(self) -> None:
        for end in tuple(self._ends):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # closed
            while True:
                near, _ = self._listener.accept()
                if self._cut:
                    near.close()
                    continue
                far = socket.create_connection(self._to)
                for source, sink in ((near, far), (far, near)):
                    threading.Thread(target=self._hand_on, args=(source, sink), daemon=True).start()

    def _hand_on(self, source: socket.socket, sink: socket.socket) -> None:
        self._ends.add(source)
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                self._whole.wait()
                sink.sendall(data)
        with contextlib.suppress(OSError):
            sink.shutdown(socket.SHUT_WR)
        self._ends.discard(source)
        source.close()


@contextlib.contextmanager
def cable(url: str) -> Iterator[Cable]:
    """A cable to a service until the block ends."""
    made = Cable(url)
    try:
        yield made
    finally:
        made.close()
