"""A service with one of each thing that pages show, for those who look at all of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.api.conftest import TEDUSAR, Service
from tests.api.conftest import running as serving
from tests.batches.conftest import SCAN, ended, form
from tests.robomend_board.processes import running as board_running
from tests.waiting import until
from tests.web.test_benchmarks_page import RUN
from tests.web.test_robot import FIVE_KEY, ODD

from robomend.settings import Settings
from robomend_bench.charts import cactus
from robomend_bench.tables import markdown

NO_NODES = """
robomend: 1
name: devices
hardware:
  lamp: {channel: 3}
  fan: {}
"""


@contextmanager
def everything(root: Path) -> Iterator[Service]:
    """Serve it until the block ends; nobody has a key yet."""
    reports, logs = root / "reports", root / "logs"
    for folder in (reports, logs):
        folder.mkdir(parents=True)
    (reports / "iscas85-first.md").write_text(markdown(RUN))
    (reports / "iscas85-first-cactus.svg").write_text(cactus(RUN))
    (logs / "a.ndjson").write_text(SCAN)
    settings = Settings.model_validate(
        {
            "port": 0,
            "data": root / "data",
            "benchmark_folder": reports,
            "batch_folder": logs,
            "sign_ins_per_minute": 1e6,
            "notify": [{"name": "duty", "url": "http://127.0.0.1:9/told", "secret": "s"}],
            "webhook_hosts": ["127.0.0.1"],
        }
    )
    with board_running("--on", "2,7") as board, serving(settings, repairs=True) as service:
        for name, source in (
            ("tedusar", TEDUSAR),
            ("odd", ODD),
            ("clauses", FIVE_KEY),
            ("devices", NO_NODES),
        ):
            assert service.api("PUT", f"/models/{name}", json={"source": source}).is_success
        newer = {"source": TEDUSAR.replace("rviz: {}", "rviz: {publishes: [picture]}")}
        assert service.api("PUT", "/models/tedusar", json=newer, headers={"If-Match": "*"}).is_success
        service.with_robot("ill")
        service.with_robot("cancelled")
        service.with_robot("silent")
        service.with_robot("watched", policy="observe")
        service.with_robot("wired", board={"host": "127.0.0.1", "port": board.port, "protected": [2]})
        for robot in ("odd", "clauses", "devices"):
            body = {"model": robot, "policy": "observe"}
            assert service.api("PUT", f"/robots/{robot}", json=body).is_success
        service.observe("not ok(map)", "on(hokuyo)", robot="ill", source="general_observer")
        service.observe("not on(jaguar)", robot="cancelled")
        service.observe("not ok(map)", "not ok(odom)", robot="watched")
        service.observe("not ok(y)", robot="clauses")
        service.observe("not on(lamp)", robot="devices")
        batch = service.api("POST", "/batches", **form(("a.ndjson", SCAN), reason="last night")).json()["id"]

        def waits(robot: str) -> list[str]:
            found = service.api("GET", f"/robots/{robot}/repairs").json()["items"]
            return [one["id"] for one in found if one["state"] == "awaiting-approval"]

        until(lambda: waits("ill") and waits("cancelled"), "plans wait for a yes", 60)
        decision = {"decision": "cancel", "reason": "not today"}
        assert service.api("POST", f"/repairs/{waits('cancelled')[0]}", json=decision).is_success
        assert ended(service, batch)["state"] == "done"
        yield service
