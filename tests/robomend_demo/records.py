"""A small scenario written down by hand: what the service would have told of it, times in milliseconds."""

from __future__ import annotations

from typing import Any

from robomend_client.events import Event, Kind
from robomend_demo.record import Heard, Record, record

MS = 1_000_000
LAG = 2  # ms from an event's transaction to its arrival


class Writer:
    """Writes events and history lines, with their ids."""

    def __init__(self) -> None:
        self.heard: list[Heard] = []
        self.history: list[dict[str, Any]] = []

    def tell(self, at: int, kind: Kind, **data: Any) -> None:
        event = Event(len(self.heard) + 1, at * MS, kind, "r", data)
        self.heard.append(Heard(event, (at + LAG) * MS))

    def observed(
        self, at: int, revision: int, *literals: str, made: int, forgotten: tuple[str, ...] = ()
    ) -> None:
        """A batch that is accepted at `at`, 1 ms before its transaction; its literals were seen at `made`."""
        self.tell(
            at + 1,
            Kind.OBSERVATIONS,
            revision=revision,
            changed=list(literals),
            forgotten=list(forgotten),
            accepted_ns=at * MS,
        )
        seen = [{"literal": literal, "source": "test", "time_ns": made * MS} for literal in literals]
        line = {"time_ns": at * MS, "data": {"revision": revision, "observations": seen}}
        self.history.append(line)

    def diagnosed(self, at: int, revision: int, *bads: list[str]) -> None:
        result = {"diagnoses": [{"bad": bad} for bad in bads]}
        self.tell(at, Kind.DIAGNOSIS, revision=revision, result=result, fault=None)

    def repair(self, at: int, state: str, rounds: list[dict[str, Any]], **more: Any) -> None:
        plan = rounds[-1]["plan"] if rounds else []
        values = {"id": "x", "reason": "", "waiting_for": [], "created_ns": 0, **more}
        self.tell(at, Kind.REPAIR, state=state, rounds=rounds, round=len(rounds), plan=plan, **values)

    def step(
        self, at: int, text: str, state: str, *, sent: int, ended: int | None, seen: tuple[str, ...]
    ) -> None:
        self.tell(
            at,
            Kind.ACTION,
            repair="x",
            id="x:0",
            index=0,
            text=text,
            state=state,
            result=0,
            message="",
            seen=list(seen),
            missing=[],
            sent_ns=sent * MS,
            ended_ns=None if ended is None else ended * MS,
        )

    def taken(self, at: int) -> None:
        self.tell(at, Kind.ACTION, id="x:0", state="running")


def restarted(name: str = "shut-down", *, late: bool = False) -> Record:
    """A node is dead, is restarted by the agent, and its topic comes back.

    `late`: another diagnosis, which names the node as well, comes right before the plan.
    The robot: dead until seen at 100, at work from 130 (the agent has it) to 400 (the topic is seen again).
    """
    said = Writer()
    said.observed(105, 1, "not running(n)", "not ok(t)", made=100)
    said.diagnosed(106, 1, ["n"])
    said.repair(108, "waiting", [])
    plan = [{"index": 0, "text": "start_node(n)"}]
    first = {"diagnosis": {"bad": ["n"], "good": ["h"]}, "plan": plan, "ending": None}
    if late:
        said.diagnosed(115, 1, ["h"], ["n"])
    said.repair(115, "planning", [first])
    said.repair(118, "running", [first])
    said.step(120, "start_node(n)", "running", sent=120, ended=None, seen=())
    said.taken(130)
    said.observed(305, 2, "running(n)", made=300)
    said.diagnosed(306, 2, ["h"], ["n"])
    said.observed(406, 3, "ok(t)", made=400)
    said.diagnosed(407, 3, [])
    said.step(410, "start_node(n)", "done", sent=120, ended=410, seen=("running(n)", "ok(t)"))
    said.repair(412, "verifying", [{**first, "ending": "done"}])
    said.repair(414, "repaired", [{**first, "ending": "done"}], finished_ns=414 * MS)
    account = ["12:00:00.000 repair x of r begins", "12:00:01.000 repaired"]
    return record(name, 0, said.heard, said.history, ["running(n)", "ok(t)"], account)
