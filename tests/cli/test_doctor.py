"""`robomend doctor`: what it says of the database, and of a robot."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import socket
from importlib.metadata import version
from pathlib import Path

import pytest
from tests.api.conftest import running

from robomend.cli.commands import run
from robomend.settings import Settings
from robomend.store import Store


async def said_of_the_database(folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the finding on the database, asked in another event loop, as another process would."""
    await asyncio.to_thread(run, ["doctor", "--data", str(folder), "--format", "json"])
    checks = json.loads(capsys.readouterr().out)["checks"]
    [detail] = [check["detail"] for check in checks if check["name"] == "database"]
    return str(detail)


@pytest.mark.anyio
async def test_the_database_is_named_with_the_services_that_use_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(f"sqlite:///{tmp_path}/robomend.db")
    await store.start()
    async with asyncio.timeout(60):
        while not await store.ownership.instances():
            await asyncio.sleep(0.01)
    assert f"(process {os.getpid()})" in await said_of_the_database(tmp_path, capsys)
    await store.close()
    assert "used by" not in await said_of_the_database(tmp_path, capsys)


def said_of_the_port(
    port: int, folder: Path, patch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> tuple[bool, str]:
    patch.setenv("ROBOMEND_PORT", str(port))
    run(["doctor", "--data", str(folder), "--format", "json"])
    checks = json.loads(capsys.readouterr().out)["checks"]
    [found] = [check for check in checks if check["name"] == "port"]
    return found["ok"], found["detail"]


def test_a_port_that_our_service_has_is_as_it_should_be_and_one_that_another_program_has_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(Settings(port=0, data=tmp_path)) as service:
        port = int(service.url.rpartition(":")[2])
        ok, said = said_of_the_port(port, tmp_path, monkeypatch, capsys)
        assert (ok, said) == (True, f"127.0.0.1:{port}: a service runs there, robomend {version('robomend')}")
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        monkeypatch.setattr("robomend.cli.doctor.ANSWER_S", 0.1)
        ok, said = said_of_the_port(port, tmp_path, monkeypatch, capsys)
        assert not ok
        assert "another program has it: choose --port" in said


def said_of_the_robot(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str]]:
    """Return the exit code and what is said of the robot."""
    code = run(["doctor", "--format", "json", *arguments])
    checks = json.loads(capsys.readouterr().out)["checks"]
    return code, [check["detail"] for check in checks if check["name"].startswith("robot ")]


def test_a_service_that_runs_is_asked_about_a_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(Settings(port=0, data=tmp_path)) as service:
        service.with_robot()
        found = said_of_the_robot(["--robot", "r1", "--url", service.url], capsys)
        headline = service.api("GET", "/robots/r1").json()["headline"]
        assert found == (1, [headline, "nobody looks at r1"])  # what the service says, see repairs_double.py
        monkeypatch.setenv("ROBOMEND_URL", service.url)
        code, said = said_of_the_robot(["--robot", "r2"], capsys)
        assert code == 1
        assert "r2" in said[0]
    code, said = said_of_the_robot(["--robot", "r1", "--url", "http://127.0.0.1:1"], capsys)
    assert (code, len(said)) == (1, 1)


def test_without_a_service_the_database_says_what_it_knows_of_a_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(Settings(port=0, data=tmp_path)) as service:
        service.with_robot(observed=["ok(scan)"])
        service.with_robot("r2", board={"host": "127.0.0.1", "port": 1}, observed=["ok(scan)"])
    _, said = said_of_the_robot(["--robot", "r1", "--data", str(tmp_path)], capsys)
    assert said[0].startswith("power_up: nobody carries it out: the robot has no `board`")
    assert "nobody reports ok(scan), which `observed` says that observers do" in said
    _, said = said_of_the_robot(["--robot", "r2", "--data", str(tmp_path)], capsys)
    assert not [one for one in said if "nobody carries it out" in one]


def said_of_the_growth(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[bool, str]:
    """Return the finding on how fast the database grows."""
    run(["doctor", "--data", str(folder), "--format", "json"])
    checks = json.loads(capsys.readouterr().out)["checks"]
    [found] = [check for check in checks if check["name"] == "growth"]
    return found["ok"], found["detail"]


def test_how_fast_the_database_grows_is_told_for_each_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert said_of_the_growth(tmp_path, capsys) == (True, "nothing is in the history yet")
    with running(Settings(port=0, data=tmp_path)) as service:
        service.with_robot("walker")
        service.observe("not running(rviz)", robot="walker")
    ok, said = said_of_the_growth(tmp_path, capsys)
    assert ok
    assert "walker" in said
    assert "once what is written is what retention removes" in said
    usage = shutil.disk_usage(tmp_path)
    full = usage._replace(free=1000)  # bytes
    monkeypatch.setattr(shutil, "disk_usage", lambda _: full)
    ok, said = said_of_the_growth(tmp_path, capsys)
    assert not ok
    assert "the disk is full in 0 days" in said
