"""An operator: asks for health and readiness, and sets and lifts the stop; how long each answer takes.

    python -m robomend_bench.service.prober URL LOOKS < key.json     until its input ends

A process of its own beside a load: in the generator's it would also measure how busy that one is. Each third
request comes on a connection that is used again, the others on one of their own, as clients do both.
"""

from __future__ import annotations

import http.client
import itertools
import json
import sys
import threading
import time
from dataclasses import asdict

from robomend_bench.service.measure import Latency
from robomend_bench.service.wire import address

EVERY_S = 0.05
ANSWER_S = 120.0
AGAIN = 3

LOOKS = (("GET /healthz", "GET", "/healthz"), ("GET /readyz", "GET", "/readyz"))
STOPS = (
    ("POST /stop", "POST", "/api/v1/stop"),
    ("DELETE /stop", "DELETE", "/api/v1/stop?reason=bench"),
)


def probe(url: str, key: str, over: threading.Event, errors: list[str], looks: int = 1) -> dict[str, Latency]:
    """Ask again and again until `over`; return how long each kind of request took.

    Args:
        key: none if empty.
        errors: what went wrong is appended.
        looks: at health and readiness, for each stop that is set and lifted.
    """
    times: dict[str, list[float]] = {}
    kept = http.client.HTTPConnection(*address(url), timeout=ANSWER_S)
    wanted = (*LOOKS * looks, *STOPS)
    for number in itertools.count():
        if over.is_set():
            break
        turn, kind = divmod(number, len(wanted))
        name, method, path = wanted[kind]
        again = (number + turn) % AGAIN == AGAIN - 1  # each kind in its turn
        if again:
            name = f"{name}, connection used again"
        try:
            status, took_s = ask(kept if again else None, url, key, method, path)
        except (OSError, http.client.HTTPException) as error:
            errors.append(f"{name}: {type(error).__name__}: {error}")
            kept.close()
            continue
        times.setdefault(name, []).append(took_s)
        if status not in ({200, 503} if path == "/readyz" else {200, 202}):
            errors.append(f"{name}: {status}")
        over.wait(EVERY_S)
    kept.close()
    return {name: Latency.of(found) for name, found in sorted(times.items())}


def ask(
    kept: http.client.HTTPConnection | None, url: str, key: str, method: str, path: str
) -> tuple[int, float]:
    """Ask on this connection, or on one of its own if it is None; return the status and how long it took."""
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    body = None
    if method == "POST":
        body, headers["Content-Type"] = b'{"reason": "bench"}', "application/json"
    connection = kept or http.client.HTTPConnection(*address(url), timeout=ANSWER_S)
    try:
        if kept is not None and kept.sock is None:
            # A request of another kind comes first, so that the service's event loop has the connection.
            kept.request("GET", "/version-info")
            kept.getresponse().read()
        began = time.perf_counter()
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        answer.read()
        return answer.status, time.perf_counter() - began
    finally:
        if kept is None:
            connection.close()


def main(url: str, looks: str) -> None:
    """See the module."""
    key, over, errors = json.loads(sys.stdin.readline()), threading.Event(), list[str]()

    def wait() -> None:
        sys.stdin.read()
        over.set()

    threading.Thread(target=wait, daemon=True).start()
    times = probe(url, key, over, errors, int(looks))
    print(json.dumps({"times": {name: asdict(latency) for name, latency in times.items()}, "errors": errors}))


if __name__ == "__main__":
    main(*sys.argv[1:])
