"""SIGTERM: whoever waits is answered, and the service ends well before its graceful time is over."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

import httpx
from tests.api.conftest import TEDUSAR
from tests.api.test_process import served
from tests.waiting import until


def test_long_polls_of_agents_and_diagnoses_are_answered_at_the_end(tmp_path: Path) -> None:
    with served(tmp_path) as (process, url):
        with httpx.Client(base_url=f"{url}/api/v1", timeout=60) as http:
            http.put("/models/m", json={"source": TEDUSAR})
            assert http.put("/robots/r1", json={"model": "m"}).status_code == 201
        answers: dict[str, int] = {}

        def wait(path: str) -> None:
            method, _, place = path.partition(" ")
            answers[path] = httpx.request(
                method, f"{url}/api/v1/robots/r1/{place}", timeout=60, json=body if method == "POST" else None
            ).status_code

        body = {"agent": "onboard", "wait_s": 50}
        paths = ("POST actions/next", "GET diagnosis?wait_s=50&after=1000")
        threads = [threading.Thread(target=wait, args=(path,)) for path in paths]
        for thread in threads:
            thread.start()
        metrics = f"{url}/metrics"
        until(lambda: "robomend_waiting 2.0" in httpx.get(metrics, timeout=60).text, "they wait")
        process.send_signal(signal.SIGTERM)
        for thread in threads:
            thread.join(60)
        assert answers == {paths[0]: 204, paths[1]: 200}
        assert process.wait(60) == 0
    assert "unforeseen" not in (tmp_path / "log").read_text()
