"""Stop, health and readiness while others send what takes long to read, to solve or to answer.

    viewer, robot and operator keys ── 20 clients, one hostile request after another ──► the service
    operator ── GET /healthz, GET /readyz, POST and DELETE /stop, 20 a second ─────────► how long each takes

The attackers are a process of their own. What the operator sees alone is measured first.
"""

from __future__ import annotations

import http.client
import json
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field

from robomend_bench.service.attackers import ROBOT, source_body
from robomend_bench.service.companion import beside
from robomend_bench.service.measure import Latency
from robomend_bench.service.prober import ANSWER_S, EVERY_S, ask, probe
from robomend_bench.service.process import Served, model_text
from robomend_bench.service.wire import address

ROLES = ("viewer", "robot", "operator", "admin")

EACH = """import json, sys
from robomend.cli.commands import run
sys.exit(max(map(run, json.loads(sys.argv[1]))))"""
"""The commands of a list, in one interpreter: to load them takes longer than to run them."""


@dataclass
class AttackResult:
    """What the operator saw alone and in the crowd, and how the crowd fared."""

    seconds: float
    clients: int
    alone: dict[str, Latency]
    attacked: dict[str, Latency]
    answers: dict[str, dict[str, int]]  # request -> status -> how often
    slowest_s: dict[str, float]
    held: dict[str, float]  # of the service's own metrics
    errors: list[str] = field(default_factory=list)

    @property
    def worst_ms(self) -> float:
        """The slowest answer to an operator in the crowd."""
        return max(latency.max_ms for latency in self.attacked.values())


def make_keys(process: Served) -> dict[str, str]:
    """Create a key of each role in a service's database; return them as soon as it knows them."""
    create = ["keys", "create", "--data", str(process.data), "--format", "json", "--role"]
    commands = [[*create, role, *(["--robot", ROBOT] if role == "robot" else [])] for role in ROLES]
    program = [sys.executable, "-c", EACH, json.dumps(commands)]
    made = subprocess.run(program, capture_output=True, text=True, check=True).stdout
    keys = dict(zip(ROLES, (json.loads(line)["key"] for line in made.splitlines()), strict=True))
    deadline = time.monotonic() + ANSWER_S
    while not all(_known(process.url, key) for key in keys.values()):  # it reads its keys now and then
        if time.monotonic() > deadline:
            raise TimeoutError(f"{process.url} does not know its keys after {ANSWER_S:g} s")
        time.sleep(EVERY_S)
    return keys


def _known(url: str, key: str) -> bool:
    status, _ = ask(None, url, key, "GET", "/api/v1/robots")
    return status != 401


def run_attack(process: Served, *, clients: int, seconds: float, seed: int) -> AttackResult:
    """Measure alone, then in the crowd."""
    keys = make_keys(process)
    _prepare(process.url, keys["operator"])
    errors: list[str] = []
    alone = _operator(process.url, keys["operator"], min(seconds, 10.0), errors)
    with beside("attackers", process.url, str(clients), str(seed), told=keys) as found:
        attacked = _operator(process.url, keys["operator"], seconds, errors)
    answers = {name: dict(sorted(statuses.items())) for name, statuses in sorted(found["answers"].items())}
    broken = sum(statuses.get("500", 0) for statuses in answers.values())
    if broken:
        errors.append(f"{broken} answers of 500")
    slowest = {name: round(took, 2) for name, took in sorted(found["slowest_s"].items())}
    held = _held(process.url, keys["operator"])
    return AttackResult(seconds, clients, alone, attacked, answers, slowest, held, errors)


def _operator(url: str, key: str, seconds: float, errors: list[str]) -> dict[str, Latency]:
    over = threading.Event()
    ends = threading.Timer(seconds, over.set)
    ends.start()
    try:
        return probe(url, key, over, errors)
    finally:
        ends.cancel()


def _prepare(url: str, key: str) -> None:
    put: list[tuple[str, bytes]] = [
        ("/api/v1/models/tedusar", source_body(model_text())),
        ("/api/v1/models/hostile", source_body(model_text())),
        ("/api/v1/models/heavy", source_body(model_text())),
        (f"/api/v1/robots/{ROBOT}", json.dumps({"model": "tedusar", "policy": "observe"}).encode()),
    ]
    for path, body in put:
        connection = http.client.HTTPConnection(*address(url), timeout=ANSWER_S)
        headers = {"Authorization": f"Bearer {key}", "Content-Type": "application/json"}
        connection.request("PUT", path, body, headers)
        answer = connection.getresponse()
        assert answer.status == 201, (path, answer.status, answer.read())
        connection.close()


def _held(url: str, key: str) -> dict[str, float]:
    """Return what the service says of its event loop."""
    connection = http.client.HTTPConnection(*address(url), timeout=ANSWER_S)
    connection.request("GET", "/metrics", headers={"Authorization": f"Bearer {key}"})
    text = connection.getresponse().read().decode()
    connection.close()
    values = dict(line.rsplit(" ", 1) for line in text.splitlines() if line and not line.startswith("#"))
    count = float(values["robomend_loop_delay_seconds_count"])
    within = {
        bound: float(values[f'robomend_loop_delay_seconds_bucket{{le="{bound}"}}'])
        for bound in ("0.005", "0.05")
    }
    return {
        "ticks": count,
        "over_5_ms": count - within["0.005"],
        "over_50_ms": count - within["0.05"],
        "loop_worst_s": float(values["robomend_loop_delay_worst_seconds"]),
    }
