"""Moments of faults: what agents hand in, who may see it, and what goes when there is no room."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import httpx
from tests.api.conftest import Service, StartService
from tests.clients.talker import watching
from tests.waiting import until

from robomend.store import schema

AT_NS = 1764000000000000000


def moment(key: str = "k1", **more: Any) -> dict[str, Any]:
    """Return the body of a moment."""
    return {
        "agent": "onboard",
        "key": key,
        "at_ns": AT_NS,
        "literals": [{"literal": "not ok(scan)", "reading": "0 of 10 Hz for 2.1 s"}],
        "frame": {
            "topics": [{"topic": "/scan", "type": "sensor_msgs/LaserScan", "messages": []}],
            "series": [{"source": "scan", "kind": "rate", "at_s": [-2, -1, 0], "values": [10, 10, 0]}],
            "logs": [{"node": "hokuyo_node", "lines": ["cannot open <b>/dev/lidar</b>"]}],
            "processes": [{"node": "hokuyo_node", "pid": None, "about": "exit code 1"}],
        },
        **more,
    }


def keep(service: Service, robot: str, key: str = "k1", **more: Any) -> str:
    answer = service.api("POST", f"/robots/{robot}/moments", json=moment(key, **more))
    assert answer.status_code == 200, answer.text
    return str(answer.json()["id"])


def put_piece(service: Service, robot: str, one: str, at: int, size: int, data: bytes) -> httpx.Response:
    return service.api(
        "PUT",
        f"/robots/{robot}/moments/{one}/recording",
        params={"at": at, "size": size},
        content=data,
        headers={"Content-Type": "application/octet-stream"},
    )


def listed(service: Service, robot: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = service.api("GET", f"/robots/{robot}/moments").json()["items"]
    return found


def rows(service: Service, table: str) -> int:
    return int(
        service.run(
            service.runtime.store.read(lambda view: len(view.rows(schema.metadata.tables[table].select())))
        )
    )


def test_a_moment_is_kept_once_and_its_newest_frame_until_it_is_complete(service: Service) -> None:
    service.with_robot("m1")
    one = keep(service, "m1", complete=False)
    assert keep(service, "m1", complete=True, frame={"notes": ["all of it"]}) == one
    assert keep(service, "m1", complete=False, frame={"notes": ["a late one"]}) == one
    [line] = listed(service, "m1")
    assert line["id"] == one
    assert line["literals"][0]["reading"] == "0 of 10 Hz for 2.1 s"
    assert line["recording_bytes"] is None
    found = service.api("GET", f"/moments/{one}").json()
    assert found["frame"]["notes"] == ["all of it"]
    assert found == service.api("GET", f"/moments/{one}.json").json()
    assert service.api("GET", f"/moments/{one}.mcap").status_code == 404


def test_a_recording_comes_in_pieces_of_which_none_counts_twice(service: Service) -> None:
    service.with_robot("m2")
    one = keep(service, "m2")
    whole = bytes(range(256)) * 10
    for at, upto in ((0, 1000), (0, 1000), (2000, 2560), (1000, 2000), (1000, 2000)):
        have = put_piece(service, "m2", one, at, len(whole), whole[at:upto]).json()["have"]
    assert have == 2000
    assert service.api("GET", f"/moments/{one}.mcap").status_code == 409  # not all has come
    assert listed(service, "m2")[0]["recording_bytes"] is None
    assert put_piece(service, "m2", one, 2000, len(whole) + 1, b"x").status_code == 409
    assert put_piece(service, "m2", one, 2000, len(whole), b"x" * 600).status_code == 422
    assert put_piece(service, "m2", one, 2000, len(whole), whole[2000:]).json() == {"have": 2560}
    answer = service.api("GET", f"/moments/{one}.mcap")
    assert answer.content == whole
    assert answer.headers["content-disposition"].startswith("attachment")
    assert listed(service, "m2")[0]["recording_bytes"] == len(whole)
    # What its agent says again after that does not lose it.
    assert service.api("POST", "/robots/m2/moments", json=moment()).json()["have"] == len(whole)


def test_an_agent_that_says_the_same_key_as_anothers_has_a_moment_of_its_own(service: Service) -> None:
    service.with_robot("m3")
    service.with_robot("m4")
    mine = keep(service, "m3")
    assert len({mine, keep(service, "m4"), keep(service, "m3", agent="arm")}) == 3
    assert put_piece(service, "m4", mine, 0, 3, b"abc").status_code == 404


def test_what_an_agent_hands_in_is_taken_whatever_the_robot_says(service: Service, tmp_path: Path) -> None:
    service.with_robot("tedusar")
    odd = {
        "nan": float("nan"),
        "markup": "<script>",
        "bytes": "\x00\x1b[31m\u202e" * 500,
        "long": ["x"] * 3000,
    }
    topics: dict[str, Any] = {"odom": {"rate_hz": 10, "tolerance_hz": 5}}
    shouts = "import time; print('\\x00\\x07' * 3000 + '<i>'); print('y' * 10**6); time.sleep(99)"
    processes = {"hokuyo_node": {"command": [sys.executable, "-c", shouts], "start": True}}
    more: dict[str, Any] = {"processes": processes, "moments": {"after_s": 1.5}}
    with watching(tmp_path, service.url, topics=topics, **more) as (_, talker):
        talker.say("odom", data=odd)
        until(lambda: "ok(odom)" in shown(service), "ok(odom)")
        talker.hush("odom")
        until(lambda: any(one["complete"] for one in listed(service, "tedusar")), "a moment")
        log = (tmp_path / "agent.log").read_text()
    assert "refused a moment" not in log
    found = service.api("GET", f"/moments/{listed(service, 'tedusar')[0]['id']}").json()["frame"]
    [odom] = [one for one in found["topics"] if one["topic"] == "odom"]
    assert "<script>" in odom["messages"][-1]["text"]
    [said] = found["logs"]
    assert said["node"] == "hokuyo_node"
    page = service.http.get("/ui/robots/tedusar").text
    assert "<script>" not in page
    assert "\u202e" not in page


def shown(service: Service) -> list[str]:
    found = service.api("GET", "/robots/tedusar/observations").json()["observations"]
    return [one["literal"] for one in found]


def test_what_no_robot_has_or_nobody_may_see_is_refused(start: StartService) -> None:
    service = start()
    service.with_robot("r1")
    service.with_robot("r2")
    one = keep(service, "r2")
    assert service.api("POST", "/robots/nobody/moments", json=moment()).status_code == 404
    assert service.api("GET", "/robots/nobody/moments").status_code == 404
    assert service.api("GET", "/moments/m-nothing").status_code == 404
    keys = {role: service.key(role, "r1" if role == "robot" else None) for role in ("robot", "viewer")}
    heads = {role: {"Authorization": f"Bearer {key}"} for role, key in keys.items()}
    body = moment("k2")
    assert service.api("POST", "/robots/r1/moments", json=body, headers=heads["robot"]).status_code == 200
    assert service.api("GET", "/robots/r1/moments", headers=heads["robot"]).status_code == 200
    for path in (f"/robots/r2/moments/{one}/recording?at=0&size=1", "/robots/r2/moments"):
        method = "PUT" if "recording" in path else "POST"
        assert service.api(method, path, json=body, headers=heads["robot"]).status_code == 403
    for path in ("/robots/r2/moments", f"/moments/{one}", f"/moments/{one}.json", f"/moments/{one}.mcap"):
        assert service.api("GET", path, headers=heads["robot"]).status_code == 403
        assert service.api("GET", path).status_code == 401
    assert service.api("GET", f"/moments/{one}", headers=heads["viewer"]).status_code == 200
    assert service.api("POST", "/robots/r1/moments", json=body, headers=heads["viewer"]).status_code == 403


def test_what_is_too_large_or_no_moment_is_refused(start: StartService) -> None:
    service = start(max_recording_mb=0.001, max_body_bytes=20_000)
    service.with_robot("r1")
    one = keep(service, "r1")
    assert put_piece(service, "r1", one, 0, 2000, b"x").status_code == 413
    assert service.api("POST", "/robots/r1/moments", json=moment(x="y" * 30_000)).status_code == 413
    odd: tuple[dict[str, Any], ...] = (
        {"key": "../../etc"},
        {"at_ns": -1},
        {"literals": []},
        {"frame": {"logs": [{"node": "n", "lines": ["x" * 1001]}]}},
        {"frame": {"series": [{"source": "s", "kind": "value", "at_s": ["x"], "values": [1]}]}},
    )
    for more in odd:
        assert service.api("POST", "/robots/r1/moments", json=moment(**more)).status_code == 422, more
    text = service.api("PUT", f"/robots/r1/moments/{one}/recording?at=0&size=5", json={})
    assert text.status_code == 415


def test_the_oldest_go_when_a_robot_has_too_many_or_all_take_too_much(start: StartService) -> None:
    service = start(moments_kept=3, moments_mb=0.05, max_recording_mb=1)
    for robot in ("r1", "r2"):
        service.with_robot(robot)
    lone = keep(service, "r2")
    kept = [keep(service, "r1", f"k{number}") for number in range(5)]
    assert [line["id"] for line in listed(service, "r1")] == kept[:1:-1]
    assert service.api("GET", f"/moments/{kept[0]}").status_code == 404
    # Room for a recording is made by the robot that takes most, and not by the newest.
    assert put_piece(service, "r1", kept[3], 0, 30_000, bytes(30_000)).json() == {"have": 30_000}
    assert put_piece(service, "r1", kept[4], 0, 45_000, bytes(45_000)).json() == {"have": 45_000}
    assert [line["id"] for line in listed(service, "r1")] == [kept[4]]
    assert [line["id"] for line in listed(service, "r2")] == [lone]
    assert service.api("GET", f"/moments/{kept[4]}.mcap").content == bytes(45_000)


def test_moments_go_with_their_robot_and_with_time_and_their_pieces_too(start: StartService) -> None:
    service = start()
    for robot in ("r1", "r2"):
        service.with_robot(robot)
        put_piece(service, robot, keep(service, robot), 0, 3, b"abc")
    head = {"If-Match": "*"}
    assert service.api("DELETE", "/robots/r1", headers=head).status_code == 204
    assert (rows(service, "moments"), rows(service, "moment_pieces")) == (1, 4)
    prune(service, days=30)
    assert (rows(service, "moments"), rows(service, "moment_pieces")) == (1, 2)
    prune(service, days=0)
    assert (rows(service, "moments"), rows(service, "moment_pieces")) == (0, 0)


def prune(service: Service, days: float) -> None:
    from robomend.store import pruning
    from robomend.store.records import Retention

    service.run(pruning.prune(service.runtime.store, Retention(moments_days=days)))


def test_pages_and_figures_have_a_moment_and_its_part_alone(service: Service) -> None:
    """How it looks: tests/web/test_moments_page.py."""
    service.with_robot("m5")
    assert "The moment it turned bad" not in service.http.get("/ui/robots/m5").text
    one = keep(service, "m5")
    page = service.http.get(f"/ui/moments/{one}").text
    assert "cannot open &lt;b&gt;/dev/lidar&lt;/b&gt;" in page
    assert "0 of 10 Hz for 2.1 s" in page
    parts = service.http.get("/ui/robots/m5", headers={"Robomend-Parts": "moments"}).text
    assert 'data-part="moments"' in parts
    assert service.http.get("/ui/moments/m-nothing").status_code == 404
    assert 'robomend_moment_bytes_total{of="recordings"}' in service.http.get("/metrics").text
