"""An operator's health, readiness and stop beside others who send what takes long to read or to answer.

    viewer, robot and operator keys ── 20 clients, one hostile request after another ──► the service
    operator ── GET /healthz, GET /readyz, POST and DELETE /stop, 20 a second ─────────► how long each takes

What the operator sees alone is measured first. Attackers are a process of their own, of low priority: they
sit on other machines, and take no processor time from the service but by what they ask of it. So is an
operator beside a load: in the generator's process it would also measure how busy that one is. Each third of
its requests comes on a connection that is used again, the others on one of their own, as clients do both.
"""

from __future__ import annotations

import http.client
import itertools
import json
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection

from robomend_bench.parts import Figures
from robomend_bench.service.process import Served, latency, model_text
from robomend_bench.service.wire import address


@contextmanager
def beside(work: Callable[..., Figures], *arguments: object) -> Iterator[Figures]:
    """Let this work run in a process of its own while the block runs; the figures come after it.

    `work` gets these arguments and an event that is set when it has to end.
    """
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=_work, args=(theirs, work, arguments))
    process.start()
    theirs.close()
    found: Figures = {}
    try:
        ours.recv()  # it is there: to load its code takes a while
        yield found
        ours.send("over")
        found.update(ours.recv())
    finally:
        process.kill()  # what is under way may take minutes
        process.join()


def _work(told: Connection, work: Callable[..., Figures], arguments: tuple[object, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the bench, which ends it
    over = threading.Event()

    def listen() -> None:
        told.recv()
        over.set()

    threading.Thread(target=listen, daemon=True).start()
    told.send("it begins")
    told.send(work(*arguments, over))


# --- the operator

EVERY_S = 0.05
ANSWER_S = 120.0
AGAIN = 3

LOOKS = (("GET /healthz", "GET", "/healthz"), ("GET /readyz", "GET", "/readyz"))
STOPS = (
    ("POST /stop", "POST", "/api/v1/stop"),
    ("DELETE /stop", "DELETE", "/api/v1/stop?reason=bench"),
)


def operator(url: str, key: str, looks: int, over: threading.Event) -> Figures:
    """Ask again and again until `over`, each at least once on a connection of its own and on one kept;
    return how long each kind of request took.

    Args:
        key: none if empty.
        looks: at health and readiness, for each stop that is set and lifted.
    """
    times: dict[str, list[float]] = {}
    errors: list[str] = []
    kept = http.client.HTTPConnection(*address(url), timeout=ANSWER_S)
    wanted = (*LOOKS * looks, *STOPS)
    for number in itertools.count():
        if over.is_set() and number >= AGAIN * len(wanted):
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
    return {"times": {name: latency(found) for name, found in sorted(times.items())}, "errors": errors}


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


# --- hostile requests

ROBOT = "bench-attacked"
NICENESS = 10


@dataclass(frozen=True, slots=True)
class Hostile:
    """One request that is meant to hurt."""

    name: str
    role: str
    method: str
    path: str
    body: bytes = b""
    content_type: str = "application/json"
    etag: bool = False  # replaces something, whatever its version


def requests() -> list[Hostile]:
    """Return the hostile requests of each role."""
    api, own = "/api/v1", f"/api/v1/robots/{ROBOT}"
    one, two = f"{api}/models/hostile", f"{api}/models/heavy"
    nodes = "".join(f"  n{index}: {{publishes: {{t{index}: []}}}}\n" for index in range(100))
    rule = "forall a in nodes, b in nodes: running(a) or ok(t{}) or not running(b)"
    rules = [rule.format(index) for index in range(10)]
    few = "".join(f"  n{index}: {{publishes: {{t{index}: []}}}}\n" for index in range(60))
    quantified = _model(nodes, rules)
    heavy = _model(few, rules)  # as many steps as a model may take
    nested = " ".join(f"forall v{index} in nodes:" for index in range(5)) + " running(v0)"
    pairs = " ".join(f"forall v{index} in nodes:" for index in range(3)) + " running(v0) or running(v1)"
    long = " or ".join(["ok(scan)", "not running(rviz)"] * 130)
    wires = "".join(f"INPUT(i{index})\n" for index in range(30_000))
    gates = "".join(f"g{index} = XOR(i{index}, i{index + 1}, i{index + 2})\n" for index in range(29_000))
    circuit = f"{wires}OUTPUT(g1)\n{gates}"
    five = 'ab: "AB"\nnab: "NAB"\nneg_prefix: "not_"\nprops: []\nrules:\n'
    five += "".join(f'  - "NAB(c{index}),ok(a{index})->ok(b{index})"\n' for index in range(40_000))
    deep = b"[" + b"[],{}," * 150_000 + b"0]"
    escapes = b'{"reason": "' + b"\\u0041" * 160_000 + b'"}'
    many = [f"ok(scan{index})" for index in range(9_000)]
    domain = _domain()
    config = {"model": "tedusar", "policy": "observe"}

    def ask(source: str, *observations: str, **more: object) -> bytes:
        return json.dumps({"source": source, "observations": observations, **more}).encode()

    return [
        Hostile("model beyond its budget", "viewer", "POST", f"{api}/diagnoses", ask(quantified)),
        Hostile("model within its budget", "viewer", "POST", f"{api}/diagnoses", ask(heavy, "not ok(t1)")),
        Hostile("circuit of 29,000 gates", "viewer", "POST", f"{api}/diagnoses", ask(circuit, "v(g1)")),
        Hostile("40,000 rules of five keys", "viewer", "POST", f"{api}/diagnoses", ask(five)),
        Hostile("what if, nested", "viewer", "POST", f"{api}/diagnoses", ask(model_text(), nested, pairs)),
        Hostile("plan of a large model", "viewer", "POST", f"{api}/plans", ask(_fleet(), bad=["n1"])),
        Hostile("JSON of many values", "viewer", "POST", f"{api}/plans", deep),
        Hostile("history", "viewer", "GET", f"{own}/history?kind=diagnosis&limit=1000"),
        Hostile("OpenAPI", "viewer", "GET", "/openapi.json"),
        Hostile("nested assertion", "robot", "POST", f"{own}/observations", _asserted(nested)),
        Hostile("assertion within", "robot", "POST", f"{own}/observations", _asserted(pairs)),
        Hostile("long assertion", "robot", "POST", f"{own}/observations", _asserted(long)),
        Hostile(
            "9,000 unknown names", "robot", "POST", f"{own}/observations", _observed(many, together=False)
        ),
        Hostile("long sentences", "robot", "POST", f"{own}/observations", _observed(_conjunctions())),
        Hostile("stream", "robot", "POST", f"{own}/observations", _stream(), "application/x-ndjson"),
        Hostile("probes", "robot", "GET", f"{own}/probes"),
        Hostile(
            "put a model beyond",
            "operator",
            "PUT",
            one,
            source_body(quantified),
            etag=True,
        ),
        Hostile("put a model within", "operator", "PUT", two, source_body(heavy), etag=True),
        Hostile(
            "put a domain",
            "operator",
            "PUT",
            own,
            json.dumps({**config, "domain": domain}).encode(),
            etag=True,
        ),
        Hostile(
            "put 9,000 observed",
            "operator",
            "PUT",
            own,
            json.dumps({**config, "observed": ["ok(scan)"] * 9_000}).encode(),
            etag=True,
        ),
        Hostile("plan", "operator", "POST", f"{own}/plans", b'{"bad": ["hokuyo"]}'),
        Hostile("long reason", "operator", "POST", f"{api}/robots/{ROBOT}/repairs", escapes),
    ]


def _model(nodes: str, rules: list[str]) -> str:
    return f"robomend: 1\nname: hostile\nnodes:\n{nodes}rules:\n" + "".join(
        f'  - "{rule}"\n' for rule in rules
    )


def _fleet() -> str:
    nodes = "".join(
        f"  n{index}: {{drives: [h{index}], publishes: {{t{index}: []}}}}\n" for index in range(2_000)
    )
    return (
        "robomend: 1\nname: large\nhardware:\n"
        + "".join(f"  h{i}: {{}}\n" for i in range(2_000))
        + f"nodes:\n{nodes}"
    )


def _domain() -> str:
    """Return actions whose parameters are a product of everything, as long as a domain may be."""
    action = (
        "(:action a{} :parameters (?a ?b ?c ?d ?e ?f ?g - component) :precondition (and (bad ?a) (bad ?b))"
        " :effect (and (good ?a) (not (bad ?a))))\n"
    )
    return "(define (domain robot-repair)\n" + "".join(action.format(i) for i in range(1_200)) + ")"


def _asserted(sentence: str) -> bytes:
    return json.dumps({"assertions": {"hint": sentence}}).encode()


def _observed(sentences: list[str], **more: object) -> bytes:
    return json.dumps({"observations": sentences, **more}).encode()


def _conjunctions() -> list[str]:
    return [" and ".join(["ok(scan)"] * 330) + " " * index for index in range(240)]


def _stream() -> bytes:
    line = json.dumps({"observations": ["ok(scan)", "not ok(map)"]}).encode() + b"\n"
    return line * 20_000


def source_body(text: str) -> bytes:
    """Return the body that puts a model."""
    return json.dumps({"source": text}).encode()


# --- the crowd


def attackers(url: str, keys: dict[str, str], clients: int, seed: int, over: threading.Event) -> Figures:
    """Let clients send one hostile request after another until `over`, and one was answered; return how each
    was answered.
    """
    os.nice(NICENESS)
    wanted = requests()
    random.Random(seed).shuffle(wanted)
    lock = threading.Lock()
    answers: dict[str, Counter[int]] = {hostile.name: Counter() for hostile in wanted}
    answered = threading.Event()

    def send(first: int) -> None:
        for hostile in itertools.cycle(wanted[first:] + wanted[:first]):
            status = _attack(url, keys, hostile)
            with lock:
                answers[hostile.name][status] += 1
            answered.set()
            if over.is_set():
                return

    threads = [threading.Thread(target=send, args=(first % len(wanted),)) for first in range(clients)]
    for thread in threads:
        thread.daemon = True
        thread.start()
    over.wait()
    answered.wait(ANSWER_S)  # of low priority, they may not have come to it on a busy computer
    for thread in threads:
        thread.join(2.0)  # whatever is still under way then is left
    with lock:
        return {name: dict(statuses) for name, statuses in sorted(answers.items()) if statuses}


def _attack(url: str, keys: dict[str, str], hostile: Hostile) -> int:
    headers = {"Authorization": f"Bearer {keys[hostile.role]}"}
    if hostile.body:
        headers["Content-Type"] = hostile.content_type
    if hostile.etag:
        headers["If-Match"] = "*"
    connection = http.client.HTTPConnection(*address(url), timeout=ANSWER_S)
    try:
        connection.request(hostile.method, hostile.path, hostile.body or None, headers)
        answer = connection.getresponse()
        answer.read()
        return answer.status
    except OSError:
        return 0
    finally:
        connection.close()


# --- both together

ROLES = ("viewer", "robot", "operator", "admin")

EACH = """import json, sys
from robomend.cli.commands import run
sys.exit(max(map(run, json.loads(sys.argv[1]))))"""
"""The commands of a list, in one interpreter: to load them takes longer than to run them."""


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


def run_attack(process: Served, *, clients: int, seconds: float, seed: int) -> Figures:
    """Measure what the operator sees alone, then in the crowd."""
    keys = make_keys(process)
    _prepare(process.url, keys["operator"])

    def looked(seconds: float) -> Figures:
        over = threading.Event()
        ends = threading.Timer(seconds, over.set)
        ends.start()
        try:
            return operator(process.url, keys["operator"], 1, over)
        finally:
            ends.cancel()

    alone = looked(min(seconds, 10.0))
    with beside(attackers, process.url, keys, clients, seed) as answers:
        attacked = looked(seconds)
    broken = sum(statuses.get(500, 0) for statuses in answers.values())
    errors = [*alone["errors"], *attacked["errors"], *[f"{broken} answers of 500"] * bool(broken)]
    return {
        "alone": alone["times"],
        "attacked": attacked["times"],
        "worst_ms": max(found["max_ms"] for found in attacked["times"].values()),
        "answers": answers,
        "errors": errors,
    }


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
