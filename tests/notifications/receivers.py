"""Who is told: a webhook's receiver and a mail server, real ones, in threads."""

from __future__ import annotations

import json
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from email import message_from_bytes, policy
from email.message import EmailMessage
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


class Hook(ThreadingHTTPServer):
    """Keeps each call; answers with `status`."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Call)
        self.status = 200
        self.calls: list[tuple[dict[str, str], bytes]] = []

    @property
    def host(self) -> str:
        """As the setting webhook_hosts names it."""
        return f"127.0.0.1:{self.server_port}"

    @property
    def told(self) -> list[dict[str, Any]]:
        """All notifications that came, in their order."""
        return [one for _, body in self.calls for one in json.loads(body)["notifications"]]


class _Call(BaseHTTPRequestHandler):
    server: Hook

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.calls.append((dict(self.headers), body))
        self.send_response(self.server.status)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


class MailServer(socketserver.ThreadingTCPServer):
    """Takes mails for everybody, without TLS."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Conversation)
        self.mails: list[tuple[list[str], EmailMessage]] = []

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.server_address[1]}"


class _Conversation(socketserver.StreamRequestHandler):
    server: MailServer

    def handle(self) -> None:
        self._say("220 here")
        to: list[str] = []
        while line := self.rfile.readline():
            word = line.decode().strip()
            if word.upper() == "DATA":
                self._say("354 go on")
                lines = list(iter(self.rfile.readline, b".\r\n"))
                mail = message_from_bytes(b"".join(lines), policy=policy.default)
                assert isinstance(mail, EmailMessage)
                self.server.mails.append((to, mail))
            elif word.upper().startswith("RCPT"):
                to.append(word.partition("<")[2].partition(">")[0])
            elif word.upper() == "QUIT":
                return self._say("221 bye")
            self._say("250 well")
        return None

    def _say(self, line: str) -> None:
        self.wfile.write(f"{line}\r\n".encode())


@contextmanager
def serving(server: socketserver.BaseServer) -> Iterator[None]:
    """Serve in a thread until the block ends."""
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join(60)
        server.server_close()
