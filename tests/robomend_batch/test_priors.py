"""From confirmed faults, and from the service's own history, to priors and to diagnoses of what was."""

from __future__ import annotations

import asyncio
import json
import random
from pathlib import Path

import pytest
from tests.robomend_batch.running import TEDUSAR, batch_run, logs, ndjson, spans
from tests.store.examples import entry, observe, with_robots

from robomend.cli.commands import run as robomend
from robomend.store import Store, Transaction, attempts
from robomend.store.records import StoredAttempt
from robomend_batch.commands import batch
from robomend_batch.priors import DAY_NS, Confirmed, priors, wilson
from robomend_client.observers.base import SECOND

Capture = pytest.CaptureFixture[str]


def estimated(capsys: Capture, *given: object) -> dict[str, dict[str, float]]:
    assert robomend(["priors", *map(str, given), "-m", TEDUSAR, "--format", "ndjson"], batch) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    return {line["component"]: line for line in lines}


@pytest.fixture(scope="module")
def history(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export of a service with two robots; a repair of the one helped, another did not."""
    folder = tmp_path_factory.mktemp("service")

    async def fill() -> None:
        store = Store(f"sqlite:///{folder}/robomend.db")
        await store.start()
        await with_robots(store, "r1", "r2")
        await observe(store, "r1", entry("odom", time_ns=10 * SECOND), entry("scan", time_ns=10 * SECOND))
        lost = entry("odom", False, time_ns=12 * SECOND, expires_ns=15 * SECOND)
        await observe(store, "r1", lost)
        await observe(store, "r2", entry("scan", False, time_ns=20 * SECOND))
        await observe(store, "r1", entry("odom", time_ns=18 * SECOND))
        fence = await store.ownership.acquire("r1")
        assert fence is not None

        def repaired(tx: Transaction) -> None:
            for bad, helped, of_drill in (
                ("jaguar", True, {}),
                ("hokuyo", False, {}),
                ("jaguar", True, {}),
                ("hokuyo", True, {"drill": "d-1"}),
            ):
                acts, now_ns = (f"power_up({bad})",), tx.now_ns
                tried = StoredAttempt("r1", (bad,), acts, helped, True, None, now_ns, of_drill)
                attempts.remember(tx, tried, fence=fence)

        await store.write(repaired)
        await store.close()

    asyncio.run(fill())
    file = folder / "history.ndjson"
    assert robomend(["export", "--data", str(folder), "-o", str(file)]) == 0
    return file


def test_the_history_of_a_service_is_diagnosed_robot_by_robot(history: Path, tmp_path: Path) -> None:
    assert batch_run(tmp_path / "out", history) == 0
    assert [one["log"] for one in logs(tmp_path / "out")] == [f"{history}#r1", f"{history}#r2"]
    assert spans(tmp_path / "out") == [
        (10.0, 12.0, "healthy", [[]]),
        (12.0, 15.0, "faulty", [["jaguar"], ["jaguar_node"]]),
        (15.0, 18.0, "healthy", [[]]),
        (20.0, 20.0, "faulty", [["hokuyo"], ["hokuyo_node"]]),
    ]


def test_what_was_observed_during_a_drill_is_no_fault_of_the_robot(history: Path, tmp_path: Path) -> None:
    lines = history.read_text().splitlines(keepends=True)
    for open_, ends_s, first_until_s in ((False, 16, 18.0), (True, 11, 10.0), (False, 11, 12.0)):
        row = {"robot": "r1", "open": open_, "created_ns": 11 * SECOND, "updated_ns": ends_s * SECOND}
        drilled = tmp_path / f"{open_}{ends_s}.ndjson"
        line = json.dumps({"table": "drills", "row": row}, separators=(",", ":"))  # as an export has it
        drilled.write_text("".join([*lines[:-1], f"{line}\n", lines[-1]]))
        assert batch_run(tmp_path / drilled.stem, drilled) == 0
        assert spans(tmp_path / drilled.stem)[0] == (10.0, first_until_s, "healthy", [[]])


def test_a_history_that_is_cut_off_is_diagnosed_up_to_there(history: Path, tmp_path: Path) -> None:
    lines = history.read_text().splitlines(keepends=True)
    at = next(number for number, line in enumerate(lines) if '"table":"events"' in line)
    cut = tmp_path / "cut.ndjson"
    cut.write_text("".join(lines[: at + 1]) + lines[at + 1][:40])
    assert batch_run(tmp_path / "out", cut) == 2
    (told,) = logs(tmp_path / "out")
    assert (told["state"], told["intervals"]) == ("ended-early", {"healthy": 1})


def test_the_days_on_which_repairs_helped_make_the_priors(history: Path, capsys: Capture) -> None:
    found = estimated(capsys, history)
    days = found["jaguar"]["occasions"]
    assert days in (2, 3)  # of two robots; midnight may have passed
    assert found["jaguar"]["faults"] == 1  # two repairs of one day
    assert found["hokuyo"]["faults"] == 0  # it did not help, but where its fault was planted
    assert found["jaguar"]["prior"] == pytest.approx(1.5 / (days + 1))
    assert found["hokuyo"]["prior"] == pytest.approx(0.5 / (days + 1))


def test_a_list_is_counted_among_the_logs_of_a_run(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    files = [ndjson(folder / f"{number}.ndjson", (0.0, "ok(odom)"), (1.0, "ok(odom)")) for number in range(9)]
    assert batch_run(tmp_path / "out", folder) == 0
    confirmed = tmp_path / "confirmed.csv"
    confirmed.write_text(
        f"log,component,by\n{files[0]},jaguar,ada\n{files[1]},jaguar,ada\n{files[1]},hokuyo,ada\n"
    )
    capsys.readouterr()
    found = estimated(capsys, confirmed, "--results", tmp_path / "out")
    assert (found["jaguar"]["prior"], found["hokuyo"]["prior"], found["imu"]["prior"]) == (0.25, 0.15, 0.05)
    assert found["jaguar"]["low"] < 2 / 9 < found["jaguar"]["high"]
    assert robomend(["priors", str(confirmed), "-m", TEDUSAR, "-r", str(tmp_path / "out")], batch) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("of 9 logs; 95% intervals\n")
    assert "jaguar                        2  0.25" in shown
    line = ["priors", str(confirmed), "-m", TEDUSAR, "-r", str(tmp_path / "out"), "--format", "yaml"]
    assert robomend(line, batch) == 0
    assert '"jaguar": {prior: 0.25}    # 2 of 9; 0.063 to 0.55\n' in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("log,component\nnowhere,jaguar\n", "confirmed.csv:2: nowhere is none of the logs"),
        ("log,component\nLOG,jagaur\n", "the model has no component jagaur"),
        ("log,part\nLOG,jaguar\n", "confirmed.csv:2: a `log` and a `component` are needed"),
        ("log,component\nLOG\n", "confirmed.csv:2: 1 cells, and 2 columns"),
    ],
)
def test_what_cannot_be_counted_is_refused(text: str, why: str, tmp_path: Path, capsys: Capture) -> None:
    log = ndjson(tmp_path / "a.ndjson", (0.0, "ok(odom)"))
    assert batch_run(tmp_path / "out", log) == 0
    confirmed = tmp_path / "confirmed.csv"
    confirmed.write_text(text.replace("LOG", str(log)))
    assert robomend(["priors", str(confirmed), "-m", TEDUSAR, "-r", str(tmp_path / "out")], batch) == 2
    assert why in capsys.readouterr().err
    assert robomend(["priors", str(confirmed), "-m", TEDUSAR], batch) == 2
    assert "a list needs --results" in capsys.readouterr().err


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    chance = random.Random(1)
    held = 0
    for _ in range(2000):
        truth = chance.uniform(0.005, 0.3)
        k = sum(chance.random() < truth for _ in range(100))
        low, high = wilson(k, 100, 0.95)
        held += low <= truth <= high
    assert 0.93 <= held / 2000 <= 0.97


def test_what_never_failed_has_a_small_prior_and_not_none() -> None:
    days = frozenset(f"r1 {day}" for day in range(1000))
    (one,) = priors(["a"], Confirmed(days, {}, "robot-days"))
    assert one.prior == pytest.approx(0.0005, rel=0.01)
    assert one.low == 0 < one.prior < one.high < 0.005
    assert DAY_NS == 86400 * SECOND
