"""Models and robots as resources: versions, ETags, pages, and what a change does to a running robot."""

from __future__ import annotations

from typing import Any

import pytest
from tests.api.conftest import TEDUSAR, Service, bad_sets

from robomend.api.routers import robots


def test_a_model_is_created_read_and_replaced_with_its_etag(service: Service) -> None:
    made = service.api("PUT", "/models/read", json={"source": TEDUSAR})
    assert made.status_code == 201
    etag = made.headers["etag"]
    read = service.api("GET", "/models/read")
    assert read.headers["etag"] == etag
    assert read.json()["source"] == TEDUSAR
    assert "jaguar" in read.json()["components"]

    changed = {"source": TEDUSAR + "\n# a remark\n"}
    assert service.api("PUT", "/models/read", json=changed).status_code == 428
    stale = service.api("PUT", "/models/read", json=changed, headers={"If-Match": '"x"'})
    assert (stale.status_code, stale.json()["code"]) == (412, "precondition-failed")
    again = service.api("PUT", "/models/read", json=changed, headers={"If-Match": etag})
    assert again.status_code == 200
    assert again.headers["etag"] != etag
    only_new = service.api("PUT", "/models/read", json=changed, headers={"If-None-Match": "*"})
    assert (only_new.status_code, only_new.json()["code"]) == (412, "precondition-failed")
    versions = service.api("GET", "/models/read/versions").json()["items"]
    assert [version["number"] for version in versions] == [2, 1]


def test_the_model_that_a_robot_follows_is_told_as_propositions_and_clauses(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    service.with_robot("followed")
    told = service.api("GET", "/robots/followed/model").json()
    assert (told["model"], told["ab"], told["nab"], told["neg_prefix"]) == ("tedusar", "AB", "NAB", "not_")
    assert len(told["rules"]) == 18
    assert "NAB(hokuyo_node)->running(hokuyo_node)" in told["rules"]
    assert "ok(scan)" in told["props"]
    assert service.api("GET", "/robots/nobody/model").status_code == 404
    monkeypatch.setattr(robots, "MOST_CLAUSES", 17)
    large = service.api("GET", "/robots/followed/model")
    assert (large.status_code, large.json()["code"]) == (413, "too-large")


def test_a_bad_model_is_refused_with_its_line_and_the_old_one_stays(service: Service) -> None:
    service.with_robot("kept")
    bad = "robomend: 1\nname: x\nhardware:\n  a: {channel: 1}\n  b: {channel: 1}\n"
    answer = service.api("PUT", "/models/tedusar", json={"source": bad}, headers={"If-Match": "*"})
    assert answer.status_code == 422
    assert answer.json()["code"] == "bad-model"
    assert answer.json()["line"] in {4, 5}
    assert service.api("GET", "/models/tedusar").json()["source"] == TEDUSAR


def test_rules_that_contradict_one_another_are_warned_of(service: Service) -> None:
    clash = 'robomend: 1\nname: x\nnodes: {n: {}}\nproperties: {p: {}}\nrules: ["ok(p)", "not ok(p)"]\n'
    made = service.api("PUT", "/models/clash", json={"source": clash})
    assert made.status_code == 201
    (warning,) = made.json()["warnings"]
    assert warning.startswith("no diagnosis will ever be found")
    assert service.api("GET", "/models/clash").json()["warnings"] == [warning]


def test_a_component_that_no_rule_can_blame_is_warned_of_when_the_model_is_saved(service: Service) -> None:
    source = "robomend: 1\nname: x\nhardware: {pc: {}}\nnodes: {n: {publishes: {t: []}}}\n"
    made = service.api("PUT", "/models/x", json={"source": source})
    assert made.status_code == 201
    (warning,) = made.json()["warnings"]
    assert warning.startswith("no rule can blame pc")
    assert service.api("GET", "/models/x").json()["warnings"] == [warning]


def test_a_resource_is_created_only_where_there_is_none(service: Service) -> None:
    new = {"If-None-Match": "*"}
    assert service.api("PUT", "/models/once", json={"source": TEDUSAR}, headers=new).status_code == 201
    assert service.api("PUT", "/models/once", json={"source": TEDUSAR}, headers=new).status_code == 412
    assert service.api("PUT", "/robots/once", json={"model": "once"}, headers=new).status_code == 201
    again = service.api("PUT", "/robots/once", json={"model": "once"}, headers=new)
    assert (again.status_code, again.json()["code"]) == (412, "precondition-failed")


def test_a_put_whose_answer_got_lost_is_asked_for_again_and_changes_nothing_more(service: Service) -> None:

    def twice(path: str, body: Any, **headers: str) -> tuple[int, str]:
        first, again = (service.api("PUT", path, json=body, headers=headers) for _ in range(2))
        assert (again.status_code, again.json()) == (first.status_code, first.json())
        return first.status_code, first.headers["etag"]

    assert twice("/models/lost", {"source": TEDUSAR})[0] == 201
    created, etag = twice("/robots/lost", {"model": "lost"})
    changed = {"model": "lost", "policy": "observe"}
    assert (created, twice("/robots/lost", changed, **{"If-Match": etag})[0]) == (201, 200)
    told = service.api("GET", "/audit", params={"robot": "lost"}).json()["items"]
    assert [one["action"] for one in told] == ["robot.put"] * 2
    assert (
        service.api("PUT", "/robots/lost", json={"model": "lost"}, headers={"If-Match": etag}).status_code
        == 412
    )


@pytest.mark.parametrize("tag", ['W/"x"', '"x", "y"', "x", '"*"', ""])
def test_an_etag_is_one_strong_one(service: Service, tag: str) -> None:
    made = service.api("PUT", "/models/m", json={"source": TEDUSAR}, headers={"If-Match": tag})
    assert made.status_code == 422


def test_a_model_in_use_is_not_deleted(service: Service) -> None:
    service.api("PUT", "/models/used", json={"source": TEDUSAR})
    service.api("PUT", "/robots/user", json={"model": "used"})
    assert service.api("DELETE", "/models/used").status_code == 428
    assert service.api("DELETE", "/models/used", headers={"If-Match": "*"}).status_code == 409
    assert service.api("DELETE", "/robots/user", headers={"If-Match": "*"}).status_code == 204
    assert service.api("DELETE", "/models/used", headers={"If-Match": "*"}).status_code == 204
    assert service.api("GET", "/models/used").status_code == 404
    assert service.api("GET", "/robots/user/diagnosis").status_code == 404


def test_a_robot_is_checked_against_its_model(service: Service) -> None:
    service.with_robot("known")
    for wrong, words in (
        ({"expected": {"stopped": ["nobody"]}}, "nobody"),
        ({"diagnosis": {"engine": "nobody"}}, "diagnosis.engine"),
        ({"planner": "nobody"}, "planner"),
        (
            {"actions": {"reset": {"executor": {"kind": "agnet"}}}},
            "actions.reset.executor.kind: no executor is named 'agnet': "
            "choose one of board, agent, process, webhook",
        ),
        ({"domain": "(define (domain robot-repair) (:action"}, "domain:1"),
        ({"protected": ["nobody"]}, "nobody"),
        ({"observed": ["on(nobody)"]}, "nobody"),
        ({"policy": "never"}, "policy"),
        ({"polcy": "auto"}, "polcy"),
        ({"model": "unheard-of"}, "unheard-of"),
    ):
        answer = service.api("PUT", "/robots/r9", json={"model": "tedusar", **wrong})
        assert answer.status_code in {404, 422}
        assert words in answer.text
    assert service.api("GET", "/robots/r9").status_code == 404


def test_a_new_version_diagnoses_anew_without_losing_obs(service: Service) -> None:
    service.api("PUT", "/models/newer", json={"source": TEDUSAR})
    service.api("PUT", "/robots/anew", json={"model": "newer"})
    service.observe("not on(jaguar)", "ok(odom)", robot="anew")
    before = service.diagnosis("anew", wait_s=60, after=0)
    assert before["result"]["diagnoses"][0]["bad"] == ["jaguar"]
    more = TEDUSAR.rstrip() + '\nrules:\n  - "not ab(imu) -> on(jaguar)"\n'
    service.api("PUT", "/models/newer", json={"source": more}, headers={"If-Match": "*"})
    for _ in range(100):
        after = service.diagnosis("anew", wait_s=0.1)
        if after["model_version"] != before["model_version"]:
            break
    assert after["revision"] == before["revision"]
    assert bad_sets(after) == [{"jaguar", "imu"}]


def test_replacing_a_robot_keeps_obs_and_tells_its_followers(service: Service) -> None:
    service.with_robot("replaced")
    service.observe("not ok(scan)", robot="replaced")
    etag = service.api("GET", "/robots/replaced").headers["etag"]
    body = {"model": "tedusar", "policy": "observe"}
    answer = service.api("PUT", "/robots/replaced", json=body, headers={"If-Match": etag})
    assert answer.status_code == 200
    assert answer.json()["config"]["policy"] == "observe"
    assert answer.json()["revision"] == 1
    assert (
        service.api("GET", "/robots/replaced/observations").json()["observations"][0]["literal"]
        == "not ok(scan)"
    )
    noted = service.api("GET", "/audit", params={"robot": "replaced"}).json()["items"]
    assert [entry["action"] for entry in noted] == ["robot.put", "observations.report", "robot.put"]
    assert noted[0]["before"]["policy"] == "approve"


CALL_HUMAN = """
(define (domain robot-repair)
  (:action call_human
    :parameters (?c - component)
    :precondition (bad ?c)
    :effect (and (good ?c) (not (bad ?c)) (increase (total-cost) 500))))
"""


def test_the_secret_of_a_webhook_is_shown_to_nobody_and_kept(service: Service) -> None:
    hook = {"executor": {"kind": "webhook", "options": {"url": "https://example.org/", "secret": "s3cr3t"}}}
    service.with_robot("hooked", actions={"call_human": hook}, domain=CALL_HUMAN)
    shown = service.api("GET", "/robots/hooked")
    options = shown.json()["config"]["actions"]["call_human"]["executor"]["options"]
    assert options == {"url": "https://example.org/", "secret": "**********"}

    body = shown.json()["config"] | {"policy": "observe"}
    assert service.api("PUT", "/robots/hooked", json=body).status_code == 428
    put = service.api("PUT", "/robots/hooked", json=body, headers={"If-Match": shown.headers["etag"]})
    assert put.status_code == 200
    stored = service.run(service.runtime.robots.memory.robot("hooked")).config
    assert stored.policy == "observe"
    assert stored.actions["call_human"]["executor"]["options"]["secret"] == "s3cr3t"

    never = service.api("PUT", "/robots/never", json=body)
    assert (never.status_code, never.json()["code"]) == (422, "bad-input")
    assert service.api("GET", "/robots/never").status_code == 404
    gone = service.api("DELETE", "/robots/hooked", headers={"If-Match": "*"})
    assert gone.status_code == 204
    told = service.api("GET", "/audit", params={"robot": "hooked"})
    assert len(told.json()["items"]) == 3
    assert "s3cr3t" not in shown.text + put.text + told.text


def test_a_program_that_the_settings_do_not_name_is_refused_when_the_robot_is_put(service: Service) -> None:
    service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    actions = {"start_node": {"executor": {"kind": "process", "options": {"program": "roslaunch"}}}}
    refused = service.api("PUT", "/robots/programmed", json={"model": "tedusar", "actions": actions})
    assert (refused.status_code, refused.json()["code"]) == (422, "bad-input")
    said = "actions.start_node: the service's settings name no program 'roslaunch' (programs: none)"
    assert refused.json()["detail"].startswith(said)
    assert service.api("GET", "/robots/programmed").status_code == 404


@pytest.mark.parametrize("kind", ["application/yaml", "text/yaml", "application/x-yaml", "text/plain"])
def test_a_model_may_come_as_the_text_itself(service: Service, kind: str) -> None:
    name = "raw-" + kind.replace("/", "-")
    headers = {"Content-Type": f"{kind}; charset=utf-8"}
    made = service.api("PUT", f"/models/{name}", content=TEDUSAR.encode(), headers=headers)
    assert made.status_code == 201
    assert made.json()["source"] == TEDUSAR
    assert service.api("GET", f"/models/{name}").json()["components"] == made.json()["components"]


def test_a_text_that_is_none_or_no_model_is_refused(service: Service) -> None:
    headers = {"Content-Type": "application/yaml"}
    for body, status in ((b"", 422), (b"\xff\xfe", 400), (b"robomend: 1\nhardware: [", 422)):
        answer = service.api("PUT", "/models/raw-bad", content=body, headers=headers)
        assert answer.status_code == status, answer.text
    assert (
        service.api(
            "PUT", "/models/raw-bad", content=b"<a/>", headers={"Content-Type": "text/xml"}
        ).status_code
        == 415
    )
