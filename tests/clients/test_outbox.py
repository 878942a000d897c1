"""Observations on their way to a service that may be away: in order, once, and bounded."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.clients.service_double import ServiceDouble

from robomend_client.buffer import DiskBuffer
from robomend_client.outbox import Outbox
from robomend_client.rest import NEVER, AsyncClient

Steps = Callable[[Callable[..., Any]], None]


@pytest.fixture
def outbox(service: ServiceDouble, tmp_path: Path) -> Callable[[Steps], DiskBuffer]:
    """Run `steps` with a function that calls a method of the outbox; return its buffer."""

    def run(steps: Steps) -> DiskBuffer:
        loop = asyncio.new_event_loop()
        client = AsyncClient(service.url, timeout_s=60, retry=NEVER)
        box = Outbox(client, "r", DiskBuffer(tmp_path / "buffer", max_bytes=2048))
        steps(lambda name, *args, **options: loop.run_until_complete(getattr(box, name)(*args, **options)))
        loop.run_until_complete(client.close())
        loop.close()
        box.buffer.close()
        return box.buffer

    return run


def said(service: ServiceDouble) -> list[str]:
    return [sentence for batch in service.batches() for sentence in batch["observations"]]


def test_a_lost_answer_does_not_make_an_observation_count_twice(
    service: ServiceDouble, outbox: Callable[[Steps], DiskBuffer]
) -> None:
    def steps(do: Callable[..., Any]) -> None:
        left: list[tuple[int, Any]] = [(503, {})]
        service.answers = lambda method, path: left.pop() if left else None
        assert not do("observe", ["ok(a)"])
        assert do("flush")

    outbox(steps)
    keys = [headers["idempotency-key"] for headers in service.headers]
    assert len(keys) == 2
    assert len(set(keys)) == 1


def test_what_the_service_refuses_does_not_hold_up_the_rest(
    service: ServiceDouble, outbox: Callable[[Steps], DiskBuffer]
) -> None:
    def steps(do: Callable[..., Any]) -> None:
        service.down()
        do("observe", ["ok("])
        do("observe", ["ok(b)"])
        service.up()
        left = [(422, {"code": "bad-observation"})]
        service.answers = lambda method, path: left.pop() if left else None
        assert do("flush")

    assert len(outbox(steps)) == 0
    assert said(service) == ["ok(b)"]


@pytest.mark.parametrize("status", [401, 404, 429, 507])
def test_what_an_operator_can_mend_keeps_the_observations(
    service: ServiceDouble, outbox: Callable[[Steps], DiskBuffer], status: int
) -> None:
    def steps(do: Callable[..., Any]) -> None:
        left = [(status, {"code": "x"})]
        service.answers = lambda method, path: left.pop() if left else None
        assert not do("observe", ["ok(a)"])
        assert do("flush")

    outbox(steps)
    assert said(service) == ["ok(a)"]


def test_a_heartbeat_does_not_wait_on_the_disk(
    service: ServiceDouble, outbox: Callable[[Steps], DiskBuffer]
) -> None:
    def steps(do: Callable[..., Any]) -> None:
        service.down()
        assert not do("observe", ["ok(a)"], buffered=False)

    assert len(outbox(steps)) == 0
