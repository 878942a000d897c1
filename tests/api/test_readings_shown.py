"""What was measured is wherever the fault is shown: a rate, a current, a line of a log; each place."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.api.conftest import Service, running
from tests.clients.observers.test_readings import BAD, bad_of
from tests.clients.running_agent import agent, config
from tests.notifications.receivers import Hook, MailServer, serving
from tests.robomend_batch.running import batch_run, logs
from tests.waiting import until

from robomend.cli.commands import run
from robomend.settings import Settings
from robomend_batch.commands import batch
from robomend_client.observers.base import SECOND
from robomend_client.observers.recording import Recording
from robomend_client.rest import Client

MODEL = """
robomend: 1
name: every
hardware: {motor: {}}
nodes:
  n: {publishes: {scan: [], odom: [], imu: []}}
  camera: {}
  laser: {}
properties: {d: {}, a: {}, p: {}, dock: {}, current: {}, goals: {}, log: {}, lifecycle: {}, moves: {},
  age: {}, publishers: {}, qos: {}, restarts: {}}
values: {x: {topic: odom, field: x}, y: {topic: imu, field: y}}
related: [[x, y]]
rules:
  - "not ab(n) -> ok(d) and ok(a) and ok(p) and ok(goals,dock) and ok(moves,imu) and ok(age,scan)"
  - "not ab(n) -> ok(publishers,odom) and ok(qos,scan) and not const(x)"
  - "not ab(camera) -> ok(log,camera) and ok(lifecycle,camera)"
  - "not ab(laser) -> ok(restarts,laser)"
  - "not ab(motor) -> ok(current,motor)"
"""

PLACES = {
    "observations", "history", "event", "status", "robot page", "notification", "mail", "account",
    "repair page", "repair", "batch", "batch report",
}  # fmt: skip


FAULTS = ["approval", "escalated"]


@pytest.fixture(scope="module")
def hook() -> Iterator[Hook]:
    server = Hook()
    with serving(server):
        yield server


@pytest.fixture(scope="module")
def mail() -> Iterator[MailServer]:
    server = MailServer()
    with serving(server):
        yield server


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory, hook: Hook, mail: MailServer) -> Iterator[Service]:
    told = {
        "data": tmp_path_factory.mktemp("shown"),
        "port": 0,
        "notify": [
            {"name": "hook", "url": f"http://{hook.host}/told", "secret": "s", "about": FAULTS},
            {"name": "duty", "mail": ["duty@robots.example"], "about": FAULTS},
        ],
        "webhook_hosts": [hook.host],
        "mail_server": mail.address,
        "mail_from": "robomend@robots.example",
        "mail_tls": "none",
    }
    with running(Settings.model_validate(told), repairs=True) as service:
        assert service.api("PUT", "/models/every", json={"source": MODEL}).status_code in (200, 201)
        yield service


@pytest.mark.timeout(300)
@pytest.mark.parametrize("kind", ["general", "hardware", "rosout", "restarts"])
def test_what_was_measured_is_wherever_the_fault_is_shown(
    kind: str,
    service: Service,
    hook: Hook,
    mail: MailServer,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    start_ns = round(BAD[kind][2][0][0] * SECOND)
    written = Recording(tmp_path / "robot.jsonl", start_ns, 1 << 20)
    agents_file, found = bad_of(kind, tmp_path, written)
    written.close(round((BAD[kind][2][-1][0] + 0.05) * SECOND))
    text = str(next(iter(found.values())))
    robot = f"r-{kind}"
    config = {"model": "every", "policy": "approve", "detection_s": 0}
    assert service.api("PUT", f"/robots/{robot}", json=config).status_code == 201
    with Client(service.url) as client:
        revision = client.observe(robot, list(found), readings=list(found.values()))["revision"]
        assert client.diagnosis(robot, wait_s=60, after=revision - 1)["fault"] is None
        until(lambda: any(one["robot"] == robot for one in hook.told), "a notification", 120)
        until(lambda: texts(mail, robot), "a mail", 120)
        event = next(one for one in client.events(robot, after=0) if one.kind == "observations")
        [repair] = client.repairs(robot, limit=1)["items"]
        record = client.repair(repair["id"])
    shown: dict[str, str] = {
        "observations": service.api("GET", f"/robots/{robot}/observations").text,
        "history": service.api("GET", f"/robots/{robot}/history").text,
        "event": json.dumps(event.data, ensure_ascii=False),
        "robot page": html.unescape(service.http.get(f"/ui/robots/{robot}").text),
        "repair page": html.unescape(service.http.get(f"/ui/repairs/{repair['id']}").text),
        "notification": str([one["text"] for one in hook.told if one["robot"] == robot]),
        "mail": "".join(texts(mail, robot)),
        "repair": json.dumps(record, ensure_ascii=False),
    }
    for place, line in (("status", ["status", robot]), ("account", ["repairs", repair["id"]])):
        capsys.readouterr()
        assert run([*line, "--url", service.url]) == 0
        shown[place] = " ".join(capsys.readouterr().out.split())
    (tmp_path / "every.yaml").write_text(MODEL)
    out = tmp_path / "out"
    given = tmp_path / "robot.jsonl", "--observers", agents_file
    assert batch_run(out, *given, model=tmp_path / "every.yaml") == 0
    [log] = logs(out)
    shown["batch"] = str([one["reading"] for one in log["readings"] if one["literal"] in found])
    assert run(["report", str(out), "--file", str(tmp_path / "report.html")], batch) == 0
    shown["batch report"] = html.unescape((tmp_path / "report.html").read_text())
    assert shown.keys() == PLACES
    missing = {place: said[:1500] for place, said in shown.items() if text not in said}
    assert not missing, text


@pytest.mark.timeout(300)
def test_what_a_driver_printed_as_it_died_is_on_page_status_and_mail(
    service: Service, mail: MailServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A driver that cannot open its device, under a real agent: the sentence has the program's last line."""
    said = "cannot open /dev/lidar: No such device"
    command = ["sh", "-c", f"echo starting; echo '{said}' >&2; exit 1"]
    robot = "r-driver"
    put = service.api(
        "PUT", f"/robots/{robot}", json={"model": "every", "policy": "approve", "detection_s": 0}
    )
    assert put.status_code == 201
    processes = {"laser": {"command": command, "start": True}}
    with agent(config(tmp_path, service.url, processes, robot=robot)):
        until(lambda: any(said in mails for mails in texts(mail, robot)), "a mail with its words", 120)
        page = html.unescape(service.http.get(f"/ui/robots/{robot}").text)
        assert run(["status", robot, "--url", service.url]) == 0
    status = " ".join(capsys.readouterr().out.split())
    sentence = f"laser is not running since \\d\\d:\\d\\d:\\d\\d \\(exit code 1: (?:starting; )?{said}\\)"
    for place in (page, status, *texts(mail, robot)[:1]):
        found = " ".join(re.sub("<[^>]*>", "", place).split())
        assert re.search(sentence, found), found[:3000]


def texts(mail: MailServer, robot: str) -> list[str]:
    """Return the mails that a robot is the subject of."""
    found = [letter for _, letter in mail.mails if robot in str(letter["Subject"])]
    return [f"{letter['Subject']}\n{letter.get_content()}" for letter in found]
