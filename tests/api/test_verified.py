"""Verified means verified at the HTTP door: what was last said to be bad and has lapsed since is neither
repaired nor healthy; and those who report more rarely than the lifetimes they give are no end of alarms.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.api.conftest import CERTIFICATES, Service, running
from tests.waiting import until

from robomend.settings import Settings

MODEL = """
robomend: 1
name: cameras
nodes:
  cam_left: {publishes: {left: []}}
  cam_right: {publishes: {right: []}}
  merge: {publishes: {depth: [left, right]}}
"""

PERIOD_OF = {0.5: 0.6, 2.0: 2.3}
"""Lifetime -> after how long each reporter speaks again."""


class Robot:
    """Three reporters, each out of step with the others, and an agent; `cam_left` never starts."""

    def __init__(self, url: str, lifetime_s: float) -> None:
        self._url = url
        self._lifetime_s = lifetime_s
        self._over = threading.Event()
        self.broken = True

    def said(self) -> dict[str, list[str]]:
        left = "not " if self.broken else ""
        return {
            "left": [f"{left}running(cam_left)", f"{left}ok(left)"],
            "right": ["running(cam_right)", "ok(right)"],
            "merge": ["running(merge)", f"{left}ok(depth)"],
        }

    @contextmanager
    def running(self) -> Iterator[Robot]:
        work = [threading.Thread(target=self._act)]
        work += [threading.Thread(target=self._report, args=(n, who)) for n, who in enumerate(self.said())]
        for thread in work:
            thread.start()
        try:
            yield self
        finally:
            self._over.set()
            for thread in work:
                thread.join(30)

    def _report(self, number: int, who: str) -> None:
        period_s = PERIOD_OF[self._lifetime_s]
        with httpx.Client(base_url=self._url, timeout=60, verify=CERTIFICATES) as client:
            self._over.wait(number * period_s / 7)
            while not self._over.wait(period_s):  # time itself: it speaks more rarely than it is believed
                body = {"observations": self.said()[who], "source": who, "lifetime_s": self._lifetime_s}
                answer = client.post("/api/v1/robots/r1/observations", json=body)
                assert answer.status_code in {200, 503}, answer.text  # 503: the disk is slow just now

    def _act(self) -> None:
        with httpx.Client(base_url=self._url, timeout=60, verify=CERTIFICATES) as client:
            while not self._over.is_set():
                wanted = {"agent": "onboard", "wait_s": 0.5}
                answer = client.post("/api/v1/robots/r1/actions/next", json=wanted).raise_for_status()
                if answer.status_code == 200 and (order := answer.json()).get("id"):
                    path = f"/api/v1/actions/{order['id']}/result"
                    client.post(path, json={"code": 0, "message": "started"}).raise_for_status()


@contextmanager
def cameras(path: Path, lifetime_s: float) -> Iterator[tuple[Service, Robot]]:
    with running(Settings(port=0, data=path), repairs=True) as service:
        service.api("PUT", "/models/cameras", json={"source": MODEL})
        bounds = {"executor": {"kind": "agent"}, "timeout_s": 2.0, "effect_timeout_s": 1.0}
        config = {
            "model": "cameras",
            "policy": "auto",
            "observed": [
                *(f"running({n})" for n in ("cam_left", "cam_right", "merge")),
                "ok(left)",
                "ok(right)",
            ],
            "observed_timeout_s": 8.0,
            "detection_s": 0.2,
            "limits": {"attempts_per_hour": 100, "rounds": 2},
            "actions": dict.fromkeys(("start_node", "stop_node"), bounds),
        }
        made = service.api("PUT", "/robots/r1", json=config)
        assert made.status_code == 201, made.text
        yield service, Robot(service.url, lifetime_s)


def ended(service: Service) -> list[dict[str, Any]]:
    """Return the repairs that have ended."""
    found = service.api("GET", "/robots/r1/repairs").json()["items"]
    return [one for one in found if one["finished_ns"] is not None]


@pytest.mark.parametrize("lifetime_s", [0.5, pytest.param(2.0, marks=pytest.mark.long)])
def test_what_was_last_said_to_be_bad_is_never_repaired_nor_healthy(
    tmp_path: Path, lifetime_s: float
) -> None:
    states: list[str] = []

    def looked(service: Service) -> bool:
        states.append(service.api("GET", "/robots/r1").json()["state"])
        return bool(ended(service)) and time.monotonic() > last_s

    with cameras(tmp_path, lifetime_s) as (service, robot), robot.running():
        last_s = 0.0
        until(lambda: "unhealthy" in states or looked(service), "the fault is seen", 60)
        until(lambda: looked(service), "a repair has ended", 180)
        last_s = time.monotonic() + 8 * PERIOD_OF[lifetime_s]  # it goes on being bad, now and then unheard of
        until(lambda: looked(service), "no end of repairs", 60)
        repairs = ended(service)
        assert "healthy" not in states
        assert not {one["state"] for one in repairs} & {"repaired"}, repairs[0]["reason"]
        assert len(repairs) <= 2, [one["reason"] for one in repairs]  # the next one after a minute
        robot.broken = False
        until(
            lambda: service.api("GET", "/robots/r1").json()["state"] == "healthy",
            "all was seen to be well",
            60,
        )
