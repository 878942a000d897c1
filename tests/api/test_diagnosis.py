"""Diagnoses on change: coalesced, debounced, published once, and never one robot's burden on another."""

from __future__ import annotations

import io
import pickle
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from tests.api.conftest import TEDUSAR, Service, StartService, bad_sets
from tests.waiting import until

from robomend.diagnosis.result import DiagnosisResult, Options
from robomend.errors import WorkerTimeout
from robomend.metrics import Metrics
from robomend.model.cnf import HealthCnf
from robomend.model.loading import load_text
from robomend.oneshots.solvers import SolverWorkers
from robomend.robots.diagnoser import Diagnoser
from robomend.robots.diagnosing import PATIENCE
from robomend.robots.readers import SHORT_MODEL
from robomend.settings import Settings
from robomend.workers import process
from robomend_client.literals import Literal, fails


@pytest.fixture(autouse=True, scope="module")
def _model(service: Service) -> None:
    service.with_robot("first")


def published(service: Service, robot: str) -> list[dict[str, Any]]:
    """Return the diagnoses that were published, oldest first."""
    found = service.api("GET", f"/robots/{robot}/history", params={"kind": "diagnosis", "limit": 1000}).json()
    return [line["data"] for line in reversed(found["items"])]


def test_a_long_poll_ends_with_the_news_or_with_what_there_is(service: Service) -> None:
    service.with_robot("poll")
    service.observe("ok(scan)", robot="poll")
    service.diagnosis("poll", wait_s=60, after=0)
    began = time.monotonic()
    assert service.diagnosis("poll", wait_s=0.2, after=1)["revision"] == 1
    assert time.monotonic() - began >= 0.2
    timer = threading.Timer(0.2, lambda: service.observe("not ok(scan)", robot="poll"))
    timer.start()
    found = service.diagnosis("poll", wait_s=20)
    timer.join()
    assert found["revision"] == 2
    assert bad_sets(found)[0] == {"hokuyo"}


def test_what_says_the_same_is_no_event(service: Service) -> None:
    service.with_robot("same")
    for sentence in ("not ok(scan)", "not ok(map)", "not ok(scan)", "running(rviz)"):
        service.observe(sentence, robot="same")
    service.diagnosis("same", wait_s=60, after=2)
    found = published(service, "same")
    assert [one["result"]["diagnoses"][0]["bad"] for one in found] in ([[], ["hokuyo"]], [["hokuyo"]])


def test_contradictory_observations_are_an_answer_of_their_own(service: Service) -> None:
    source = "robomend: 1\nname: c\nhardware:\n  a: {channel: 1}\nnodes: {}\nrules: ['on(a)']\n"
    assert service.api("PUT", "/models/contradicted", json={"source": source}).status_code == 201
    service.api("PUT", "/robots/contra", json={"model": "contradicted"})
    service.observe("not on(a)", robot="contra")
    found = service.diagnosis("contra", wait_s=60, after=0)
    assert found["result"] is None
    assert found["fault"]["code"] == "contradictory-model"
    assert "on(a)" in found["fault"]["detail"]


def test_what_flaps_is_debounced_but_not_for_ever(service: Service) -> None:
    service.with_robot("flapping", debounce_s=0.1)
    service.observe("ok(scan)", robot="flapping")
    service.diagnosis("flapping", wait_s=60, after=0)
    asked, answered = [time.monotonic()], [time.monotonic()]
    while asked[-1] - asked[0] < 1.5:
        asked.append(time.monotonic())
        service.observe("ok(scan)" if len(asked) % 2 else "not ok(scan)", robot="flapping")
        answered.append(time.monotonic())
    spans = zip(asked, answered[1:], strict=False)
    quiet = sum(after - before >= 0.1 for before, after in spans)  # where the computer was elsewhere
    for_ever = (answered[-1] - asked[0]) / (PATIENCE * 0.1)
    assert 1 <= len(published(service, "flapping")) <= 2 + for_ever + quiet


def test_a_period_diagnoses_without_a_change(service: Service) -> None:
    def made() -> float:
        text = service.http.get("/metrics").text
        lines = [line for line in text.splitlines() if line.startswith("robomend_diagnoses_total{")]
        return sum(float(line.split()[-1]) for line in lines)

    service.with_robot("periodic", period_s=0.05)
    before = made()
    until(lambda: made() >= before + 3, "it is diagnosed again and again")
    assert service.api("DELETE", "/robots/periodic", headers={"If-Match": "*"}).status_code == 204


def test_what_if_is_asked_without_a_robot(service: Service) -> None:
    ask = {"model": "tedusar", "observations": ["not ok(map)"]}
    every = service.api("POST", "/diagnoses", json=ask).json()
    assert ["hector_mapping"] in [one["bad"] for one in every["diagnoses"]]
    what_if = service.api("POST", "/diagnoses", json={**ask, "healthy": ["hector_mapping"]}).json()
    assert ["hector_mapping"] not in [one["bad"] for one in what_if["diagnoses"]]
    assert len(what_if["diagnoses"]) == len(every["diagnoses"]) - 1
    inline = service.api("POST", "/diagnoses", json={"source": TEDUSAR, "observations": ["not ok(map)"]})
    assert inline.json()["diagnoses"] == every["diagnoses"]
    for conflicts, told in (("all", True), (False, False)):
        answer = service.api("POST", "/diagnoses", json={**ask, "options": {"conflicts": conflicts}}).json()
        assert answer["conflicts_all"] == bool(answer["conflicts"]) == told
    for wrong, status in (
        ({"model": "none"}, 404),
        ({}, 422),
        ({"model": "tedusar", "source": TEDUSAR}, 422),
        ({"model": "tedusar", "healthy": ["nobody"]}, 422),
        ({"model": "tedusar", "observations": ["ok(scan)", "not ok(scan)"]}, 422),
        ({"model": "tedusar", "options": {"engine": "none"}}, 422),
        ({"model": "tedusar", "options": {"conflicts": "most"}}, 422),
    ):
        assert service.api("POST", "/diagnoses", json=wrong).status_code == status


LONG = f"{TEDUSAR}\n{'# read by a worker' * SHORT_MODEL}\n"


@pytest.mark.parametrize(
    "asked",
    [
        {"observations": ["not ok(map)"]},
        {"observations": ["not ok(scan) or not ok(odom)", "ok(odom)"], "abnormal": ["imu"]},
        {"observations": ["not ok(map)"], "healthy": ["/hector_mapping"], "options": {"limit": 1}},
        {"observations": ["forall n in nodes: running(n)", "not ok(scan)"]},
        {"healthy": ["nobody"]},
        {"healthy": ["imu"], "abnormal": ["imu"]},
        {"observations": ["ok(scan)", "not ok(scan)"]},
        {"observations": ["ok(scan"]},
        {"observations": ["ok(nothing)"]},
        {"observations": [" ".join(f"forall v{i} in nodes:" for i in range(8)) + " running(v0)"]},
        {"options": {"engine": "none"}},
    ],
)
def test_a_long_text_is_answered_like_a_short_one(service: Service, asked: dict[str, Any]) -> None:
    short, long = (
        service.api("POST", "/diagnoses", json={"source": source, **asked}) for source in (TEDUSAR, LONG)
    )
    told = [{**one.json(), "elapsed_s": None, "request_id": None} for one in (short, long)]
    assert long.status_code == short.status_code
    assert told[1] == told[0]


def test_what_a_long_text_says_never_comes_into_the_service(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: set[str] = set()

    class Watched(pickle.Unpickler):
        def find_class(self, module: str, name: str) -> Any:
            seen.add(name)
            return super().find_class(module, name)

    class Pickles:
        """The module, as the service's end of a worker uses it."""

        UnpicklingError = pickle.UnpicklingError

        @staticmethod
        def loads(data: bytes) -> Any:
            return Watched(io.BytesIO(data)).load()

    monkeypatch.setattr(process, "pickle", Pickles)
    asked = service.api("POST", "/diagnoses", json={"source": LONG, "observations": ["not ok(map)"]})
    assert asked.json()["diagnoses"]
    assert {"PackedQuestion", "Options"} <= seen <= {"PackedQuestion", "Options", "frozenset"}
    service.api("PUT", "/models/long", json={"source": LONG})  # who keeps it has it
    assert "Vocabulary" in seen


def test_a_node_that_is_meant_to_be_stopped_is_neither_blamed_nor_started(service: Service) -> None:
    body = {"model": "tedusar", "observations": ["not running(rviz)", "not running(hector_mapping)"]}
    with_rviz = service.api("POST", "/plans", json=body).json()
    without = service.api("POST", "/plans", json={**body, "expected": {"stopped": ["rviz"]}}).json()
    assert set(with_rviz["choice"]["bad"]) == {"rviz", "hector_mapping"}
    assert without["choice"]["bad"] == ["hector_mapping"]
    assert [step["text"] for step in without["plan"]["steps"]] == ["start_node(hector_mapping)"]


def test_probes_tell_the_diagnoses_apart(service: Service) -> None:
    service.with_robot("probed")
    service.observe("not ok(scan)", robot="probed")
    found = service.api("GET", "/robots/probed/probes").json()
    assert found["entropy_bits"] == pytest.approx(1.0)
    assert found["probes"][0]["gain_bits"] > 0
    told_apart = found["probes"][0]["if_true"] + found["probes"][0]["if_false"]
    assert told_apart in ([["hokuyo"]], [["hokuyo_node"]])


class SlowWorkers(SolverWorkers):
    """Workers that never answer in time, and write down what they were asked."""

    def __init__(self) -> None:
        self.asked = 0

    async def diagnose(
        self,
        key: str,
        engine: str,
        cnf: HealthCnf,
        literals: frozenset[Literal],
        options: Options,
        deadline_s: float,
    ) -> DiagnosisResult:
        self.asked += 1
        raise WorkerTimeout("no answer in time")


@pytest.mark.anyio
async def test_a_large_model_never_runs_on_the_event_loop(tmp_path: Path) -> None:
    workers = SlowWorkers()
    system = load_text(TEDUSAR)
    small = Diagnoser(Settings(data=tmp_path), Metrics(), workers)
    observed = [fails("ok", "scan")]
    answer = await small.diagnose("v1", system, observed, "sat", Options())
    assert answer.result is not None
    assert workers.asked == 0
    again = await small.diagnose("v1", system, observed, "sat", Options())
    assert again is answer  # exact cache
    large = Diagnoser(Settings(data=tmp_path, inline_components=5), Metrics(), workers)
    for attempt in (1, 2):  # a failure is not remembered
        answer = await large.diagnose("v1", system, observed, "sat", Options())
        assert answer.fault is not None
        assert answer.fault.code == "worker-timeout"
        assert workers.asked == attempt
    small.close()
    large.close()


def test_a_slow_model_is_slow_alone(start: StartService) -> None:
    """A model whose diagnoses take seconds, beside a robot that is answered meanwhile."""
    service = start(inline_components=20)
    service.with_robot("quick")
    names = ", ".join(f"h{number}: {{}}" for number in range(60))
    rules = [f"not ab(h{a}) and not ab(h{b}) -> ok(p)" for a in range(60) for b in range(a)]
    source = (
        f"robomend: 1\nname: slow\nhardware: {{{names}}}\nnodes: {{}}\nproperties: {{p: {{}}}}\nrules:\n"
        + "".join(f'  - "{rule}"\n' for rule in rules)
    )
    assert service.api("PUT", "/models/slow", json={"source": source}).status_code == 201
    config = {"model": "slow", "diagnosis": {"timeout_s": 3}}
    assert service.api("PUT", "/robots/slow", json=config).status_code == 201
    service.observe("not ok(p)", robot="slow")
    for number in range(10):
        service.observe("ok(scan)" if number % 2 else "not ok(scan)", robot="quick")
        assert service.diagnosis("quick", wait_s=60, after=number)["revision"] == number + 1
    found = service.diagnosis("slow", wait_s=30, after=0)
    assert found["revision"] == 1
    assert found["result"]["diagnoses"] or found["result"]["stopped_by"] == "time"


def test_a_node_that_is_meant_to_be_stopped_is_no_fault_and_the_answer_says_so(service: Service) -> None:
    service.with_robot("resting", expected={"stopped": ["rviz"]})
    service.observe("not running(rviz)", "not running(hector_mapping)", robot="resting")
    found = service.diagnosis("resting", after=0, wait_s=60)
    assert bad_sets(found) == [{"hector_mapping"}]
    assert found["expected_stopped"] == ["rviz"]
    robot = service.api("GET", "/robots/resting")
    wanted = {"model": "tedusar", "expected": {"stopped": []}}
    service.api("PUT", "/robots/resting", json=wanted, headers={"If-Match": robot.headers["etag"]})
    for _ in range(100):
        found = service.diagnosis("resting", wait_s=0.1)
        if not found["expected_stopped"]:
            break
    assert bad_sets(found) == [{"rviz", "hector_mapping"}]


def test_assertions_join_a_new_version_of_the_model_too(start: StartService) -> None:
    service = start()
    service.with_robot()
    body = {"assertions": {"none": "not on(jaguar) and not on(hokuyo)"}}
    assert service.api("POST", "/robots/r1/observations", json=body).status_code == 200
    assert bad_sets(service.diagnosis(after=0, wait_s=60)) == [{"jaguar", "hokuyo"}]
    changed = TEDUSAR.replace("  rviz: {}\n", "")
    service.api("PUT", "/models/tedusar", json={"source": changed}, headers={"If-Match": "*"})
    for _ in range(100):
        good = service.diagnosis(wait_s=0.1)["result"]["diagnoses"][0]["good"]
        if "rviz" not in good:
            break
    assert "rviz" not in good
