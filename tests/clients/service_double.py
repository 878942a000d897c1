"""A test double of the service: a real HTTP server on a loopback socket that knows the agent's routes and
records what it is told. It decides nothing; the real service is tested with the agent elsewhere.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from tests.network import own_port
from tests.waiting import until


@dataclass
class Posted:
    """One request with a body."""

    path: str
    body: Any
    key: str | None
    at_s: float


@dataclass
class ServiceDouble:
    """What it was told, and what it is to answer."""

    port: int = 0
    posted: list[Posted] = field(default_factory=list)
    actions: list[dict[str, Any]] = field(default_factory=list)  # asked for, not yet acknowledged
    lock: threading.Lock = field(default_factory=threading.Lock)
    answers: Callable[[str, str], tuple[int, Any] | None] = lambda method, path: None
    agents: set[str] = field(default_factory=set)
    polls: list[dict[str, Any]] = field(default_factory=list)
    settle: dict[str, Any] | None = None  # what every poll is told until its agent has acted on it
    seen_keys: set[str] = field(default_factory=set)
    withdrawn: set[str] = field(default_factory=set)  # actions whose feedback is answered with 409
    moments: dict[str, dict[str, Any]] = field(default_factory=dict)  # key -> its newest frame
    recordings: dict[str, bytes] = field(default_factory=dict)  # key -> what has come
    repeated: int = 0  # requests whose Idempotency-Key came before
    headers: list[dict[str, str]] = field(default_factory=list)
    _server: ThreadingHTTPServer | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def up(self) -> None:
        """Listen; on the same port as before, if there was one."""
        double = self

        class Handler(_Handler):
            service = double

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            allow_reuse_address = True

            def handle_error(self, request: object, client_address: object) -> None:
                """A client that was killed is nothing to write home about."""

        self.port = self.port or own_port()
        self._server = Server(("127.0.0.1", self.port), Handler)
        threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True).start()

    def down(self) -> None:
        """Stop listening, and cut what is open."""
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None

    @property
    def is_up(self) -> bool:
        return self._server is not None

    # --- what the tests ask -------------------------------------------------------------------------

    def batches(self) -> list[dict[str, Any]]:
        """Return the bodies of observations, in the order of their arrival."""
        return [p.body for p in tuple(self.posted) if p.path.endswith("/observations")]

    def holds(self) -> dict[str, bool]:
        """Return the newest sign of each atom that was reported, by arrival."""
        now: dict[str, bool] = {}
        for batch in self.batches():
            for sentence in batch["observations"]:
                now[sentence.removeprefix("not ")] = not sentence.startswith("not ")
        return now

    def signs(self) -> dict[str, bool | None]:
        """Return the same, and None of each atom that was reported to be unknown since."""
        now: dict[str, bool | None] = {}
        for batch in self.batches():
            for sentence in batch["observations"]:
                now[sentence.removeprefix("not ")] = not sentence.startswith("not ")
            now.update(dict.fromkeys(batch.get("unknown", ())))
        return now

    def result(self, action_id: str) -> dict[str, Any] | None:
        """Return the first result of an action, or None while there is none."""
        for p in tuple(self.posted):
            if p.path == f"/api/v1/actions/{action_id}/result":
                return dict(p.body)
        return None

    def feedback(self, action_id: str) -> str:
        """Return all that an agent said while it acted."""
        path = f"/api/v1/actions/{action_id}/feedback"
        return "; ".join(str(p.body["message"]) for p in tuple(self.posted) if p.path == path)

    def results(self, action_id: str) -> int:
        return sum(p.path == f"/api/v1/actions/{action_id}/result" for p in tuple(self.posted))

    def ask(self, action_id: str, name: str, *parameters: str, timeout_s: float = 60.0) -> None:
        action = {"id": action_id, "name": name, "parameters": list(parameters), "timeout_s": timeout_s}
        with self.lock:
            self.actions.append(action)

    def acknowledged(self, path: str) -> None:
        """A feedback or a result came in: its action is not given out any more."""
        action_id = path.split("/")[-2]
        with self.lock:
            self.actions = [action for action in self.actions if action["id"] != action_id]

    def do(self, action_id: str, name: str, *parameters: str, timeout_s: float = 60.0) -> dict[str, Any]:
        """Ask for an action and return its result."""
        self.ask(action_id, name, *parameters, timeout_s=timeout_s)
        eventually(lambda: self.result(action_id) is not None, f"a result of {action_id}")
        result = self.result(action_id)
        assert result is not None
        return result


class _Handler(BaseHTTPRequestHandler):
    service: ServiceDouble
    protocol_version = "HTTP/1.1"
    timeout = 30
    wbufsize = 65536  # one packet an answer: two would wait for each other (Nagle, delayed ACK), 40 ms

    def do_GET(self) -> None:
        url = urlsplit(self.path)
        path = unquote(url.path)
        if self._answered("GET", path):
            return
        if path.endswith("/actions/next"):
            query = parse_qs(url.query)
            self._next_action(query["agent"][0], float(query["wait_s"][0]))
        else:
            self._send(404, {"code": "not-found", "detail": f"the double has no {path}"})

    def _next_action(self, agent: str, wait_s: float) -> None:
        self.service.agents.add(agent)
        deadline = time.monotonic() + min(wait_s, 1.0)
        while self.service.is_up and time.monotonic() < deadline:
            settle = {} if self.service.settle is None else {"settle": self.service.settle}
            if actions := tuple(self.service.actions):
                self._send(200, actions[0] | settle)
                return
            if settle and self.service.polls[-1].get("settled") != settle["settle"]["n"]:
                self._send(200, settle)
                return
            time.sleep(0.01)
        self._send(204, None)

    def do_POST(self) -> None:
        path = unquote(urlsplit(self.path).path)
        length = int(self.headers.get("content-length", 0))
        data = self.rfile.read(length)
        if len(data) < length:  # the client was killed in the middle of it
            self.close_connection = True
            return
        key = self.headers.get("Idempotency-Key")
        if self._answered(self.command, path):
            return
        if not self.service.is_up:
            self.close_connection = True
            return
        if path.endswith("/moments"):
            moment = json.loads(data)
            self.service.moments[moment["key"]] = moment
            have = len(self.service.recordings.setdefault(moment["key"], b""))
            self._send(200, {"id": f"m-{moment['key']}", "have": have})
            return
        if path.endswith("/recording"):
            key = path.split("/")[-2].removeprefix("m-")
            at = int(parse_qs(urlsplit(self.path).query)["at"][0])
            if at == len(self.service.recordings[key]):
                self.service.recordings[key] += data
            self._send(200, {"have": len(self.service.recordings[key])})
            return
        if path.endswith("/actions/next"):
            poll = json.loads(data)
            self.service.polls.append(poll)
            self._next_action(poll["agent"], poll["wait_s"])
            return
        if path.endswith("/feedback") and path.split("/")[-2] in self.service.withdrawn:
            self._send(409, {"code": "conflict", "detail": "it has its result already"})
            return
        if key in self.service.seen_keys:
            self.service.repeated += 1
        elif key:
            self.service.seen_keys.add(key)
        if path.endswith(("/feedback", "/result")):
            self.service.acknowledged(path)
        try:
            body = json.loads(data or b"null")
        except ValueError:
            body = data.decode()
        self.service.posted.append(Posted(path, body, key, time.monotonic()))
        self._send(200, {"revision": len(self.service.posted), "changed": []})

    do_PUT = do_POST  # noqa: N815  # http.server's names
    do_DELETE = do_POST  # noqa: N815  # likewise

    def _answered(self, method: str, path: str) -> bool:
        self.service.headers.append({name.lower(): value for name, value in self.headers.items()})
        answer = self.service.answers(method, path)
        if answer is not None:
            self._send(*answer)
        return answer is not None

    def _send(self, status: int, body: Any) -> None:
        data = b"" if body is None else json.dumps(body).encode()
        kind = "application/json" if status < 400 else "application/problem+json"
        try:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(data)))
            for name, value in (body or {}).get("headers", {}).items() if isinstance(body, dict) else ():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(data)
        except OSError:
            self.close_connection = True  # the client went away, or was killed

    def log_message(self, format: str, *args: object) -> None:
        pass


@contextmanager
def service_double() -> Iterator[ServiceDouble]:
    service = ServiceDouble()
    service.up()
    try:
        yield service
    finally:
        service.down()


eventually = until
