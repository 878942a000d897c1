"""Several sources that speak of one thing, seen at the door: OBS, findings, a restart, who is believed."""

from __future__ import annotations

import time
from typing import Any

import pytest
from tests.api.conftest import TEDUSAR, Service, StartService

S = 10**9


def contradict(service: Service, robot: str, lifetime_s: float = 3600) -> None:
    """pc1 hears the scan all the time, pc2 not any more; both say so twice."""
    now = time.time_ns()
    for ago_s, source, sentence, onset_s in (
        (9, "pc1", "ok(scan)", None),
        (8, "pc2", "ok(scan)", None),
        (6, "pc2", "not ok(scan)", 6.5),
        (5, "pc1", "ok(scan)", None),
        (3, "pc2", "not ok(scan)", 6.5),
        (2, "pc1", "ok(scan)", None),
    ):
        answer = service.observe(
            sentence,
            robot=robot,
            source=source,
            time=now - ago_s * S,
            since=[now - ago_s * S - S // 10],
            onset=[None if onset_s is None else now - round(onset_s * S)],
            lifetime_s=lifetime_s,
            readings=[{"value": f"{sentence} by {source}"}],
        )
        assert answer.status_code == 200, answer.text


def scan(service: Service, robot: str) -> dict[str, Any]:
    found = service.api("GET", f"/robots/{robot}/observations").json()["observations"]
    [one] = [one for one in found if one["literal"].endswith("ok(scan)")]
    return dict(one)


def told(service: Service, robot: str) -> list[str]:
    """Return what the diagnosis says about contradictions."""
    found: list[str] = service.diagnosis(robot)["findings"]
    return found


def test_a_contradiction_is_unknown_and_shown_with_what_each_says(service: Service) -> None:
    service.with_robot("two")
    contradict(service, "two")
    one = scan(service, "two")
    assert (one["fresh"], one["contradicted"], one["expires_ns"]) == (False, True, None)
    assert {each["source"]: (each["literal"], each["reading"]["text"]) for each in one["by_source"]} == {
        "pc1": ("ok(scan)", "ok(scan) by pc1"),
        "pc2": ("not ok(scan)", "not ok(scan) by pc2"),
    }
    [found] = told(service, "two")
    assert found.startswith(
        "sources contradict each other about ok(scan): pc1 reports ok(scan) (ok(scan) by pc1)"
    )
    assert service.diagnosis("two", wait_s=20, after=3)["result"]["diagnoses"][0]["bad"] == []
    page = service.http.get("/ui/robots/two").text
    assert "sources contradict each other" in page
    assert "not ok(scan) by pc2" in page


def test_its_beginning_and_end_are_events_and_no_more(service: Service) -> None:
    service.with_robot("news")
    contradict(service, "news")
    service.observe(
        "not ok(scan)", robot="news", source="pc1", since=[time.time_ns() - 1], time=time.time_ns()
    )
    past = service.api("GET", "/robots/news/history", params={"kind": "observations"}).json()["items"]
    # ok; not ok; then unknown; then not ok, as both say. The first report of each source is kept as well.
    assert [line["data"]["revision"] for line in past] == [5, 4, 3, 2, 1]
    assert scan(service, "news")["literal"] == "not ok(scan)"
    assert told(service, "news") == []


def test_a_second_agent_that_never_heard_a_topic_is_no_alarm(start: StartService) -> None:
    service = start()
    service.with_robot("r1")
    seen: set[str] = set()

    def report(source: str, sentence: str, evidence_s: float, reading: dict[str, Any] | None) -> None:
        now = time.time_ns()
        answer = service.observe(
            sentence,
            source=source,
            time=now,
            since=[now - round(evidence_s * S)],
            lifetime_s=60,
            readings=[reading],
        )
        assert answer.status_code == 200, answer.text
        asked = service.diagnosis("r1", wait_s=20, after=answer.json()["revision"] - 1)
        seen.update(*(each["bad"] for each in asked["result"]["diagnoses"]))

    silent = {"value": "0 of 10 Hz for 0.5 s", "symptom": "silent"}
    report("pc1", "ok(scan)", 1.8, None)
    for restarted in (False, True):
        service = start() if restarted else service
        report("pc2", "not ok(scan)", 0.5, silent)
        report("pc1", "ok(scan)", 1.8, None)
        report("pc2", "not ok(scan)", 0.5, silent)
        assert scan(service, "r1")["contradicted"]
    assert seen == set()


def test_a_restart_forgets_neither_contradiction_nor_words(start: StartService) -> None:
    first = start()
    first.with_robot("r1")
    contradict(first, "r1")
    before = scan(first, "r1"), told(first, "r1")
    again = start()
    assert (scan(again, "r1"), told(again, "r1")) == before
    # What one of them repeats does not decide it either.
    now = time.time_ns()
    again.observe(
        "not ok(scan)", source="pc2", time=now, since=[now - 1], onset=[now - 9 * S], lifetime_s=3600
    )
    assert scan(again, "r1")["contradicted"]


@pytest.mark.parametrize(
    ("config", "literal"),
    [
        ({"believe": ["pc2"]}, "not ok(scan)"),
        ({"believe": ["nobody", "pc1"], "bad_wins": True}, "ok(scan)"),
        ({"bad_wins": True}, "not ok(scan)"),
    ],
)
def test_who_is_believed_may_be_configured_before_and_after(
    service: Service, config: dict[str, Any], literal: str
) -> None:
    robot = "-".join(["believed", *config, literal.replace(" ", "").replace("(", "").replace(")", "")])
    service.with_robot(robot)
    contradict(service, robot)
    etag = service.api("GET", f"/robots/{robot}").headers["etag"]
    body = {"model": "tedusar", **config}
    put = service.api("PUT", f"/robots/{robot}", json=body, headers={"If-Match": etag})
    assert put.status_code == 200, put.text
    one = scan(service, robot)
    assert (one["literal"], one["fresh"], one["contradicted"]) == (literal, True, False)
    assert "is believed" in told(service, robot)[0]
    service.with_robot(f"{robot}-2", **config)
    contradict(service, f"{robot}-2")
    assert scan(service, f"{robot}-2")["literal"] == literal


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"believe": "pc1"}, "believe: Input should be a valid list"),
        ({"bad_wins": "yes"}, "bad_wins: Input should be a valid boolean"),
    ],
)
def test_a_malformed_belief_is_refused(service: Service, config: dict[str, Any], words: str) -> None:
    service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    answer = service.api("PUT", "/robots/malformed", json={"model": "tedusar", **config})
    assert answer.status_code == 422
    assert words in answer.json()["detail"]


def test_what_a_source_knows_no_more_is_what_the_other_says(service: Service) -> None:
    service.with_robot("away")
    contradict(service, "away")
    answer = service.observe(robot="away", source="pc1", unknown=["ok(scan)"], time=time.time_ns()).json()
    assert answer["changed"] == ["not ok(scan)"]
    one = scan(service, "away")
    assert (one["literal"], one["source"], one["by_source"]) == ("not ok(scan)", "pc2", [])
    service.observe(robot="away", source="pc2", unknown=["ok(scan)"], time=time.time_ns())
    assert service.api("GET", "/robots/away/observations").json()["observations"] == []


def test_a_clock_that_was_ahead_and_is_set_right_does_not_outlive_what_it_says_then(service: Service) -> None:
    service.with_robot("ahead")
    for _ in range(3):
        service.observe("ok(scan)", robot="ahead", source="pc1", time=time.time_ns() + 40 * S, lifetime_s=60)
    answer = service.observe("not ok(scan)", robot="ahead", source="pc1", time=time.time_ns()).json()
    assert answer["changed"] == ["not ok(scan)"]
    assert scan(service, "ahead")["literal"] == "not ok(scan)"
    service.observe("ok(scan)", robot="ahead", source="person")
    assert scan(service, "ahead")["literal"] == "ok(scan)"
