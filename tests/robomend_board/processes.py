"""Running emulators for tests, and an independent client that knows nothing but bytes."""

from __future__ import annotations

import contextlib
import json
import select
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from tests.forked import popen

END_S = 20.0


@dataclass
class Running:
    """An emulator in its own process, ready."""

    process: subprocess.Popen[str]
    port: int
    control_port: int

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(END_S)


def start(*options: str, port: int = 0) -> Running:
    """Start `robomend-board` and wait for its line of JSON."""
    process = popen(
        [sys.executable, "-m", "robomend_board.main", "--port", str(port), "--control-port", "0", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    if not select.select([process.stdout], [], [], END_S)[0]:
        process.kill()
        raise AssertionError("the emulator did not get ready")
    ready = json.loads(process.stdout.readline())
    assert ready["ready"] is True
    return Running(process, ready["port"], ready["control_port"])


@contextlib.contextmanager
def running(*options: str, port: int = 0) -> Iterator[Running]:
    """An emulator that is gone afterwards."""
    emulator = start(*options, port=port)
    try:
        yield emulator
    finally:
        emulator.kill()
        if emulator.process.stdout is not None:
            emulator.process.stdout.close()


class RawClient:
    """Sends and expects bytes, written as hex; shares no code with the codec."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), END_S)
        self.greeting = b""

    def send(self, frame: str) -> None:
        self.socket.sendall(bytes.fromhex(frame))

    def read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            piece = self.socket.recv(size - len(data))
            if not piece:
                raise ConnectionError("closed by the board")
            data += piece
        return data

    def frame(self) -> bytes:
        """Read one frame: four bytes, of which the last two are the length, low byte first."""
        head = self.read(4)
        return head + self.read(head[2] + 256 * head[3])

    def ask(self, frame: str) -> str:
        """Send a command; return the next frame that is no broadcast, as hex."""
        self.send(frame)
        while (answer := self.frame())[1] == 2:
            pass
        return answer.hex(" ").upper()

    def ends(self) -> bool:
        """Whether the board closes the connection; what is still under way is thrown away."""
        try:
            while self.socket.recv(65536):
                pass
        except TimeoutError:
            return False
        except OSError:
            return True
        return True

    def __enter__(self) -> RawClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()


class Control:
    """A JSON-lines connection to the control port."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), END_S)
        self._stream = self._socket.makefile("rw", encoding="utf-8")

    def say(self, line: str) -> None:
        self._stream.write(line + "\n")
        self._stream.flush()

    def line(self) -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(self._stream.readline())
        return answer

    def ask(self, **request: Any) -> dict[str, Any]:
        self.say(json.dumps(request))
        return self.line()

    def __enter__(self) -> Control:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()
        self._socket.close()
