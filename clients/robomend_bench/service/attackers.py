"""Clients that send what takes long to read, to solve or to answer, one request after another.

    python -m robomend_bench.service.attackers URL CLIENTS SEED < keys.json     until its input ends

They are a process of their own, of low priority: attackers sit on other machines, and take no processor time
from the service but by what they ask of it.
"""

from __future__ import annotations

import http.client
import itertools
import json
import os
import random
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from robomend_bench.service.process import model_text
from robomend_bench.service.wire import address

ROBOT = "bench-attacked"
ANSWER_S = 120.0
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


class Crowd:
    """Clients that send one hostile request after another."""

    def __init__(self, url: str, keys: dict[str, str], clients: int, seed: int) -> None:
        self._address = address(url)
        self._keys = keys
        self._ending = threading.Event()
        self._lock = threading.Lock()
        self.answers: dict[str, Counter[int]] = {}
        self.slowest_s: dict[str, float] = {}
        wanted = requests()
        random.Random(seed).shuffle(wanted)
        turns = [itertools.cycle(wanted[index:] + wanted[:index]) for index in range(clients)]
        self._threads = [threading.Thread(target=self._send, args=(turn,), daemon=True) for turn in turns]

    def start(self) -> None:
        """Begin."""
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        """Send nothing more, and wait for what is under way, but not for long."""
        self._ending.set()
        for thread in self._threads:
            thread.join(2.0)

    def _send(self, turn: Iterator[Hostile]) -> None:
        for hostile in turn:
            if self._ending.is_set():
                return
            began = time.perf_counter()
            status = self._ask(hostile)
            took = time.perf_counter() - began
            with self._lock:
                self.answers.setdefault(hostile.name, Counter())[status] += 1
                self.slowest_s[hostile.name] = max(took, self.slowest_s.get(hostile.name, 0.0))

    def _ask(self, hostile: Hostile) -> int:
        headers = {"Authorization": f"Bearer {self._keys[hostile.role]}"}
        if hostile.body:
            headers["Content-Type"] = hostile.content_type
        if hostile.etag:
            headers["If-Match"] = "*"
        connection = http.client.HTTPConnection(*self._address, timeout=ANSWER_S)
        try:
            connection.request(hostile.method, hostile.path, hostile.body or None, headers)
            answer = connection.getresponse()
            answer.read()
            return answer.status
        except OSError:
            return 0
        finally:
            connection.close()


def main() -> None:
    """Attack until the standard input ends, and print what came of it as JSON."""
    url, clients, seed = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    os.nice(NICENESS)
    crowd = Crowd(url, json.loads(sys.stdin.readline()), clients, seed)
    crowd.start()
    sys.stdin.read()
    crowd.end()
    print(json.dumps({"answers": crowd.answers, "slowest_s": crowd.slowest_s}))
    sys.stdout.flush()
    os._exit(0)  # whatever is still under way


if __name__ == "__main__":
    main()
