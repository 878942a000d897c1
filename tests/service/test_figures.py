"""/metrics of several workers: added up, sample by sample; each leaves its own for the others."""

from __future__ import annotations

import os
import re
from pathlib import Path

import httpx
import pytest
from tests.api.test_process import served
from tests.waiting import until

from robomend.figures import HEADER, PLACE_BYTES, SharedFigures, added, shared_file
from robomend.metrics import Metrics

COUNT = re.compile(r'^robomend_requests_total\{.*route="/healthz".*\} (\S+)$', re.MULTILINE)


def metrics(requests: int, oldest_s: float) -> bytes:
    """Return the figures of one worker."""
    made = Metrics()
    made.on_demand("robomend_store_oldest_write_seconds", "age", (), lambda: [((), oldest_s)])
    for _ in range(requests):
        made.request("GET", "/healthz", 200, 0.003)
    return made.text()


def test_samples_are_added_and_families_stay_together() -> None:
    other = Metrics()
    other.request("PUT", "/only/here", 200, None)
    text = added([metrics(2, 5.0), metrics(3, 7.0), other.text()]).decode()
    assert COUNT.findall(text) == ["5.0"]
    assert "robomend_store_oldest_write_seconds 7.0" in text
    assert 'route="/only/here"' in text
    assert re.search(r'robomend_request_seconds_bucket\{le="0.005",route="/healthz"\} 5.0', text)
    families = [line.split()[2] for line in text.splitlines() if line.startswith("# TYPE")]
    assert len(families) == len(set(families))
    parts = re.split(r"^# HELP ", text, flags=re.MULTILINE)
    assert next(part for part in parts if part.startswith("robomend_requests_total")).count("\n") == 4


@pytest.fixture
def shared() -> tuple[SharedFigures, SharedFigures, int]:
    descriptor = shared_file()
    return SharedFigures(descriptor, 0, 2), SharedFigures(descriptor, 1, 2), descriptor


def test_what_one_worker_leaves_the_other_finds(shared: tuple[SharedFigures, SharedFigures, int]) -> None:
    one, two, _ = shared
    assert one.others() == []
    two.leave(b"long text")
    two.leave(b"text")
    assert one.others() == [b"text"]
    assert two.others() == []


def test_a_text_that_is_half_written_is_left_out(shared: tuple[SharedFigures, SharedFigures, int]) -> None:
    one, two, descriptor = shared
    two.leave(b"text")
    os.pwrite(descriptor, b"T", PLACE_BYTES + HEADER.size)
    assert one.others() == []


def test_whichever_worker_is_asked_tells_of_all(tmp_path: Path) -> None:
    with served(tmp_path, "--workers", "2") as (_, url):
        for _ in range(30):  # each on a connection of its own, so that both workers are asked
            assert httpx.get(f"{url}/healthz", timeout=20).status_code == 200

        def all_told() -> bool:
            return COUNT.findall(httpx.get(f"{url}/metrics", timeout=20).text) == ["30.0"]

        for _ in range(8):  # whoever is asked; each knows the other's within a second
            until(all_told, "the figures of both workers")
