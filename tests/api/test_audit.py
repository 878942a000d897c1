"""Every writing route leaves its name in the audit log: who, what, why. A table, walked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, get_args

import pytest
from tests.api.conftest import TEDUSAR, Service, running, sign_in
from tests.api.test_described import described
from tests.waiting import until

from robomend.api.schemas.audit import AuditOut
from robomend.drills.record import DrillState
from robomend.repairs.states import RepairState
from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK
from robomend.security import API, RULES, Role
from robomend.settings import Settings
from robomend.store import Transaction, agent_actions, attempts
from robomend.store.records import Quarantine

ASKS = {
    ("POST", f"{API}/diagnoses"),
    ("POST", f"{API}/plans"),
    ("POST", f"{API}/models/{{name}}/isolability"),
    ("POST", f"{API}/robots/{{robot}}/plans"),
}
"""They ask, and write nothing."""

TOLD_ELSEWHERE = {
    # Each second of an action: its first is told as `action.taken`, the latest is in the step.
    ("POST", f"{API}/actions/{{action}}/feedback"),
    # Reports, as observations are; the robot's first report of an hour is told.
    ("POST", f"{API}/robots/{{robot}}/moments"),
    ("PUT", f"{API}/robots/{{robot}}/moments/{{moment}}/recording"),
    # Changes of the configuration: tests/repairs/test_changes.py has what is told of a yes and a no.
    ("POST", f"{API}/changes/{{change}}"),
}

ASKING = f"""{TEDUSAR}
# It was made by listening for 60 s.
# Questions that listening does not answer:
#   scan was silent all the time: is that so by design?
"""

BOARD = {"host": "127.0.0.1", "port": 1}
"""Nobody listens there: what was asked for is told all the same, and that it failed."""


@dataclass(frozen=True)
class Step:
    """A request, and what the audit log says of it."""

    rule: tuple[str, str]
    said: str  # the action in the log
    role: Role = Role.OPERATOR
    body: Any = None
    places: dict[str, str] = field(default_factory=dict)
    reason: str = "spring cleaning"
    in_body: bool = False  # the reason
    headers: dict[str, str] = field(default_factory=dict)

    @property
    def form(self) -> bool:
        """Whether it is a form of the page."""
        return self.rule[1].startswith("/ui/")


ANY = {"If-Match": "*"}
PLACES = {
    "name": "tedusar",
    "robot": "r1",
    "channel": "3",
    "component": "jaguar",
    "assertion": "hint",
    "recipient": "duty",
}

NOBODY = {"name": "duty", "url": "http://127.0.0.1:1/", "secret": "s3cret"}
"""Is told, but is not there."""


def rule(method: str, path: str) -> tuple[str, str]:
    return method, f"{API}{path}"


STEPS = (
    Step(rule("POST", "/session"), "session.begin", reason=""),
    Step(rule("DELETE", "/session"), "session.end", reason=""),
    Step(("POST", "/ui/sign-in"), "session.begin", reason=""),
    Step(("POST", "/ui/sign-out"), "session.end", body={}, reason=""),
    Step(rule("PUT", "/models/{name}"), "model.put", body={"source": TEDUSAR}),
    Step(("POST", "/ui/models"), "model.put", body={"name": "formed", "source": ASKING}, in_body=True),
    Step(
        ("POST", "/ui/models/{name}/answers"),
        "model.put",
        body={"question": "scan was silent all the time: is that so by design?", "answer": "yes"},
        places={"name": "formed"},
        in_body=True,
    ),
    Step(
        rule("PUT", "/robots/{robot}"),
        "robot.put",
        body={"model": "tedusar", "board": BOARD, "hold_s": 86400, "observed": ["ok(map)"]},
    ),
    Step(
        rule("POST", "/robots/{robot}/drills"),
        "drill.create",
        body={"fault": "device-unplugged", "component": "hokuyo"},
        in_body=True,
    ),
    Step(rule("POST", "/drills/{drill}"), "drill.cancel", body={"decision": "cancel"}, in_body=True),
    Step(rule("POST", "/drills/{drill}"), "drill.abandon", body={"decision": "abandon"}, in_body=True),
    Step(
        ("POST", "/ui/robots/{robot}/drills"),
        "drill.create",
        body={"fault": "device-unplugged", "component": "hokuyo"},
        in_body=True,
    ),
    Step(("POST", "/ui/drills/{drill}"), "drill.cancel", body={"decision": "cancel"}, in_body=True),
    Step(rule("POST", "/drills/{drill}"), "drill.abandon", body={"decision": "abandon"}, in_body=True),
    Step(
        rule("POST", "/robots/{robot}/observations"),
        "observations.report",
        Role.ROBOT,
        {"observations": ["not ok(scan)"], "source": "laser"},
        reason="",
    ),
    Step(
        rule("POST", "/robots/{robot}/observations"),
        "observations.report",
        body={"observations": ["ok(odom)"]},
        reason="",
    ),
    Step(
        ("POST", "/ui/robots/{robot}/observations"),
        "observations.report",
        Role.ADMIN,  # a key is told of once a minute
        {"observation": "ok(odom)"},
        reason="",
    ),
    Step(
        rule("POST", "/robots/{robot}/observations"),
        "assertion.put",
        Role.ROBOT,
        {"assertions": {"hint": "ok(scan) or ok(odom)"}},
        reason="",
    ),
    Step(rule("DELETE", "/robots/{robot}/assertions/{assertion}"), "assertion.withdraw", Role.ROBOT),
    Step(rule("POST", "/robots/{robot}/actions/next"), "action.taken", Role.ROBOT, {"agent": "a"}, reason=""),
    Step(rule("POST", "/actions/{action}/result"), "action.reported", Role.ADMIN, {"code": 0}, reason=""),
    Step(rule("POST", "/robots/{robot}/repairs"), "repair.create", body={}, in_body=True),
    Step(rule("POST", "/repairs/{repair}"), "repair.cancel", body={"decision": "cancel"}, in_body=True),
    Step(
        rule("POST", "/robots/{robot}/sovd/operations/repair/executions"),
        "repair.create",
        body={"parameters": {"reason": "spring cleaning"}},
    ),
    Step(rule("POST", "/repairs/{repair}"), "repair.cancel", body={"decision": "cancel"}, in_body=True),
    Step(("POST", "/ui/robots/{robot}/repairs"), "repair.create", body={}, in_body=True),
    Step(("POST", "/ui/repairs/{repair}"), "repair.cancel", body={"decision": "cancel"}, in_body=True),
    Step(
        rule("PUT", "/robots/{robot}/board/channels/{channel}"),
        "channel.off",
        body={"on": False},
        in_body=True,
    ),
    Step(
        ("POST", "/ui/robots/{robot}/board/{channel}"),
        "channel.off",
        Role.ADMIN,
        body={"on": "no"},
        in_body=True,
    ),
    Step(
        rule("POST", "/robots/{robot}/quarantine/{component}/release"),
        "quarantine.release",
        body={},
        in_body=True,
    ),
    Step(
        ("POST", "/ui/robots/{robot}/release"),
        "quarantine.release",
        body={"component": "jaguar"},
        in_body=True,
    ),
    Step(
        rule("POST", "/notifications/recipients/{recipient}/test"),
        "notification.test",
        Role.ADMIN,
        reason="",
    ),
    Step(("POST", "/ui/notifications"), "notification.test", Role.ADMIN, {"recipient": "duty"}, reason=""),
    Step(
        rule("POST", "/batches"),
        "batch.create",
        body={"model": "tedusar", "logs": ["a.ndjson"]},
        in_body=True,
    ),
    Step(rule("DELETE", "/batches/{batch}"), "batch.cancel"),
    Step(
        ("POST", "/ui/batches"),
        "batch.create",
        body={"model": "tedusar", "paths": "a.ndjson"},
        in_body=True,
    ),
    Step(("POST", "/ui/batches/{batch}"), "batch.cancel", body={}, in_body=True),
    Step(("POST", "/ui/keys"), "key.create", Role.ADMIN, {"role": "viewer"}, in_body=True),
    Step(("POST", "/ui/keys/{key}"), "key.revoke", Role.ADMIN, body={}, in_body=True),
    Step(rule("POST", "/stop"), "stop.set", body={}, in_body=True),
    Step(rule("DELETE", "/stop"), "stop.lifted"),
    Step(("POST", "/ui/stop"), "stop.set", body={}, in_body=True),
    Step(("POST", "/ui/stop"), "stop.lifted", body={"active": "no"}, in_body=True),
    Step(rule("DELETE", "/robots/{robot}"), "robot.delete", headers=ANY),
    Step(rule("DELETE", "/models/{name}"), "model.delete", headers=ANY),
)


def test_the_table_has_every_route_that_changes_something() -> None:
    changing = {rule for rule in RULES if rule[0] not in {"GET", "HEAD"}}
    assert changing == {step.rule for step in STEPS} | ASKS | TOLD_ELSEWHERE


def queue(action: str, tx: Transaction) -> None:
    """Queue an action for the robot's agent."""
    agent_actions.queue(tx, action, "r1", host=None, name="start_node", parameters=["rviz"], timeout_s=60)


class Walk:
    """A service with real repairs, and a key of each role."""

    def __init__(self, service: Service) -> None:
        self.service = service
        self.keys = {role: service.key(role, "r1" if role is Role.ROBOT else None) for role in Role}
        self.places = dict(PLACES)
        self.cookie: str | None = None

    def name(self, role: Role) -> str:
        return f"{role}-{self.keys[role][-8:]}"

    def get(self, path: str) -> Any:
        """Read something as the admin."""
        head = {"Authorization": f"Bearer {self.keys[Role.ADMIN]}"}
        return self.service.api("GET", path, headers=head).json()

    def log(self) -> list[dict[str, Any]]:
        """Return the audit log, newest first."""
        return list(self.get("/audit")["items"])

    def drill(self) -> dict[str, Any]:
        """Return the drill that was asked for."""
        return dict(self.get(f"/drills/{self.places['drill']}"))

    def repairs(self) -> list[dict[str, Any]]:
        """Return the robot's repairs, newest first."""
        return list(self.get("/robots/r1/repairs")["items"])

    def prepare(self, step: Step) -> None:
        """Bring about what a request needs that no request brings about."""
        if step.said == "action.taken":
            self._write(partial(queue, "x:0"))
            self.places["action"] = "x:0"
        elif step.said == "drill.create":
            if "drill" in self.places:
                until(lambda: self.drill()["finished_ns"] is not None, "the drill before has ended")
            batch = Batch(("ok(map)",), source="test", time_ns=CLOCK.now_ns())
            self.service.run(self.service.runtime.robots.observe("r1", batch))
        elif step.said == "drill.cancel":  # one that waits still would be withdrawn, and have nothing to undo
            until(lambda: self.drill()["state"] == "planting", "the drill is taken up")
        elif step.said == "drill.abandon":
            until(lambda: self.drill()["state"] == "undoing", "the drill is cancelled")
        elif step.said == "observations.report":
            until(lambda: self.drill()["finished_ns"] is not None, "the drill has ended")
        elif step.said == "quarantine.release":
            ownership = self.service.runtime.store.ownership
            until(lambda: "r1" in ownership.held, "nobody owns r1")
            entry = Quarantine("r1", "jaguar", "three failures", 3, 1, None)
            self._write(lambda tx: attempts.put_quarantine(tx, entry, fence=ownership.held["r1"]))
        elif step.rule == rule("POST", "/batches"):
            self.service.run(self.service.runtime.batches.close())  # it is to be cancelled before it is done
        elif step.said == "robot.delete" or step.rule == ("POST", "/ui/robots/{robot}/repairs"):
            until(lambda: all(one["finished_ns"] for one in self.repairs()), "a repair is open")

    def take(self, step: Step) -> None:
        """Make the request."""
        method, template = step.rule
        if template in {f"{API}/session", "/ui/sign-in"} and method == "POST":
            if step.form:
                form = {"key": self.keys[step.role]}
                answer = self.service.http.post(template, data=form, headers={"Origin": self.service.url})
                assert answer.status_code == 303
                self.service.http.cookies.clear()
                self.cookie = answer.headers["set-cookie"].partition(";")[0]
                return
            self.cookie = sign_in(self.service, self.keys[step.role]).headers["set-cookie"].partition(";")[0]
            return
        head = {"Authorization": f"Bearer {self.keys[step.role]}", **step.headers}
        if template in {f"{API}/session", "/ui/sign-out"}:
            assert self.cookie is not None
            head = {"Cookie": self.cookie, "Origin": self.service.url}
        params = {"reason": step.reason} if step.reason and not step.in_body else {}
        body = {**step.body, "reason": step.reason} if step.in_body else step.body
        path = template.format(**{**self.places, **step.places})
        sent: dict[str, Any] = {"data": body} if step.form else {"json": body}
        if step.rule == ("POST", "/ui/batches"):
            sent["files"] = {"observers": ("", b"")}  # a form with files, of which none was chosen
        if step.rule == ("POST", "/ui/sign-out"):
            head["Content-Type"] = "application/x-www-form-urlencoded"  # of an empty body
        answer = self.service.http.request(method, path, headers=head, params=params, **sent)
        if step.said != "channel.off":  # nobody is there to switch it
            assert answer.status_code < 400, answer.text
        if step.said == "repair.create":
            self.places["repair"] = str(self.repairs()[0]["id"])
        elif step.said == "drill.create":
            self.places["drill"] = next(one["subject"] for one in self.log() if one["action"] == step.said)
        elif step.said == "key.create":
            self.places["key"] = next(one["after"]["id"] for one in self.log() if one["action"] == step.said)
        elif step.said == "batch.create":
            where = answer.headers["location"]
            self.places["batch"] = where.rpartition("/")[2]

    def _write(self, change: Callable[[Transaction], object]) -> None:
        self.service.run(self.service.runtime.store.write(change))


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Walk]:
    folder = tmp_path_factory.mktemp("logs")
    (folder / "a.ndjson").write_text("")
    values = {"port": 0, "data": tmp_path_factory.mktemp("audit"), "batch_folder": folder}
    told = {"notify": [NOBODY], "webhook_hosts": ["127.0.0.1:1"]}
    with running(Settings.model_validate({**values, **told}), repairs=True) as service:
        yield Walk(service)


def test_each_change_has_its_name_and_its_reason(walk: Walk) -> None:
    for step in STEPS:
        walk.prepare(step)
        before = {entry["id"] for entry in walk.log()}
        walk.take(step)

        def noted(step: Step = step, before: set[int] = before) -> dict[str, Any] | None:
            new = [entry for entry in walk.log() if entry["id"] not in before]
            return next((entry for entry in new if entry["action"] == step.said), None)

        until(noted, f"{step.said} is not in the audit log")
        entry = noted()
        assert entry is not None
        as_described(entry)
        assert (step.said, entry["actor"]) == (step.said, walk.name(step.role))
        assert (step.said, entry["reason"]) == (step.said, step.reason)
        if "{robot}" in step.rule[1] or "{action}" in step.rule[1]:
            assert entry["robot"] == "r1"


def as_described(entry: dict[str, Any]) -> None:
    """See that one type is that of the entry's action, and that nothing comes that it does not describe."""
    kinds = get_args(AuditOut.model_fields["root"].annotation)
    [kind] = [
        kind for kind in kinds if entry["action"] in kind.model_json_schema()["properties"]["action"]["enum"]
    ]
    described(kind, entry)


def test_each_state_has_its_entry_described() -> None:
    actions = [
        action
        for kind in get_args(AuditOut.model_fields["root"].annotation)
        for action in kind.model_json_schema()["properties"]["action"]["enum"]
    ]
    assert len(actions) == len(set(actions))
    said = {step.said for step in STEPS}
    assert {*said, *(f"repair.{one}" for one in RepairState), *(f"drill.{one}" for one in DrillState)} - {
        "repair.waiting",
        "drill.waiting",
    } <= set(actions)


def keyed(service: Service, role: Role) -> tuple[str, dict[str, str]]:
    key = service.key(role, "r1" if role is Role.ROBOT else None)
    return f"{role}-{key[-8:]}", {"Authorization": f"Bearer {key}"}


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    with running(Settings(port=0, data=tmp_path), repairs=True) as service:
        service.with_robot("r1")
        yield service


def test_the_history_has_the_key_of_each_batch_and_the_log_does_not_drown_in_them(service: Service) -> None:
    robot, head = keyed(service, Role.ROBOT)
    olga, operator = keyed(service, Role.OPERATOR)
    _, admin = keyed(service, Role.ADMIN)
    sent = [("not ok(scan)", head), ("ok(scan)", head), ("not ok(odom)", operator), ("ok(odom)", operator)]
    for sentence, who in sent:
        body = {"observations": [sentence]}
        assert service.api("POST", "/robots/r1/observations", json=body, headers=who).status_code == 200
    history = service.api("GET", "/robots/r1/history", headers=admin).json()["items"]
    assert [line["data"]["by"] for line in history] == [olga, olga, robot, robot]
    assert {o["source"] for line in history for o in line["data"]["observations"]} == {olga, robot}
    log = service.api("GET", "/audit", headers=admin).json()["items"]
    reports = [entry for entry in log if entry["action"] == "observations.report"]
    assert [entry["actor"] for entry in reports] == [olga, robot]
    assert [entry["after"]["observations"] for entry in reports] == [["not ok(odom)"], ["not ok(scan)"]]
    assert [entry["after"]["in_place_of_the_robot"] for entry in reports] == [True, False]


def test_a_result_in_a_robots_place_says_whose_it_is(service: Service) -> None:
    robot, head = keyed(service, Role.ROBOT)
    ada, admin = keyed(service, Role.ADMIN)
    for action in ("x:0", "x:1"):
        service.run(service.runtime.store.write(partial(queue, action)))
    said = {"code": 0, "message": "started"}
    own = service.api("POST", "/actions/x:0/result", json=said, headers=head).json()
    others = service.api("POST", "/actions/x:1/result", json=said, headers=admin).json()
    assert own["message"] == "started"
    assert others["message"] == f"started (said by {ada} in the robot's place)"
    log = service.api("GET", "/audit", headers=admin).json()["items"]
    reported = [entry for entry in log if entry["action"] == "action.reported"]
    assert [(entry["actor"], entry["after"]["action"]) for entry in reported] == [
        (ada, "x:1"),
        (robot, "x:0"),
    ]
    assert [entry["after"]["in_place_of_the_robot"] for entry in reported] == [True, False]
