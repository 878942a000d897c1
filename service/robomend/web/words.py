"""States and what is waited for, in words for people."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robomend.planning.plan import action_title, in_prose
from robomend.repairs.headline import question
from robomend.repairs.states import RepairState, StepState
from robomend.store.records import AuditEntry
from robomend_client.counts import counted, first_few

Json = Mapping[str, Any]

MANY = 4
"""Names in one sentence; of more the number is told."""

REPAIR_STATES: dict[str, str] = {
    RepairState.WAITING: "waiting for its turn, or for observers",
    RepairState.PLANNING: "planning",
    RepairState.AWAITING_APPROVAL: "awaiting approval",
    RepairState.RUNNING: "running",
    RepairState.VERIFYING: "looking whether it helped",
    RepairState.REPAIRED: "repaired, and seen to work",
    RepairState.UNCONFIRMED: "not confirmed: nobody has seen that it works",
    RepairState.ESCALATED: "a person is needed",
    RepairState.CANCELLED: "cancelled",
    RepairState.FAILED: "failed: a part of the service did not work",
}
"""As people read them; one that is not here is shown as it is called."""


def without(reason: str, bad: Sequence[str]) -> str:
    """Return why a diagnosis was chosen, without its components in front, which are named right before, and
    without a cost that nothing is compared with.
    """
    names = f"{', '.join(bad)}: "
    reason = reason[len(names) :] if bad and reason.startswith(names) else reason
    return LONE_COST.sub("", reason)


LONE_COST = re.compile(r" at cost [\d.]+$")


def repair_state(state: str) -> str:
    """Return a repair's state as people read it."""
    return REPAIR_STATES.get(state, state)


def layers(plan: Sequence[Json]) -> list[list[Json]]:
    """Return the steps of a plan by when they can begin: those of one layer run side by side."""
    depth: dict[int, int] = {}
    found: list[list[Json]] = []
    for step in plan:
        at = depth[step["index"]] = 1 + max((depth.get(before, -1) for before in step["after"]), default=-1)
        while len(found) <= at:
            found.append([])
        found[at].append(step)
    return found


ENDED: dict[str, str] = {RepairState.CANCELLED: "was cancelled", RepairState.FAILED: "failed"}


def listed(names: Sequence[str], most: int = MANY) -> str:
    """Return names as in a sentence."""
    return first_few(names, most)


@dataclass(frozen=True, slots=True)
class FoldedEntry:
    """A line of the audit log: an entry, and the transitions of the same thing that it stands for."""

    entry: AuditEntry
    before: Sequence[AuditEntry]  # newest first

    @property
    def reasons(self) -> list[str]:
        """Return what was said of why, each once, the newest last."""
        said = (LONE_COST.sub("", one.reason) for one in (self.entry, *self.before) if one.reason)
        return list(dict.fromkeys(said))[::-1]


def folded(entries: Sequence[AuditEntry], machine: str) -> list[FoldedEntry]:
    """Return a page of the audit log, newest first: what the machine did to one repair, its actions included,
    between two things that people did to it, is one line, at its newest.
    """
    lines: list[FoldedEntry] = []
    open_: dict[str, list[AuditEntry]] = {}
    of_robot: dict[str | None, list[AuditEntry]] = {}  # the line of its repair: no two run at once
    for entry in entries:
        if entry.actor != machine:
            if open_.pop(entry.subject, None) is not None:
                of_robot.pop(entry.robot, None)
            lines.append(FoldedEntry(entry, ()))
        elif entry.action.startswith("action.") and entry.robot in of_robot:
            of_robot[entry.robot].append(entry)
        elif entry.subject in open_ and entry.action.startswith("repair."):
            open_[entry.subject].append(entry)
        else:
            rest: list[AuditEntry] = []
            if entry.action.startswith("repair."):
                open_[entry.subject] = of_robot[entry.robot] = rest
            lines.append(FoldedEntry(entry, rest))
    return lines


def did(action: str) -> str:
    """Return an entry's action without its subject: `repair.approve` is "approve"."""
    return action.partition(".")[2].replace("-", " ") or action


def size(count: int) -> str:
    """Return a number of bytes with its unit."""
    for unit, of in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= of:
            return f"{count / of:.1f} {unit}"
    return f"{count} bytes"


def duration(seconds: float) -> str:
    """Return a time span with its unit, as exact as a person needs it."""
    if seconds < 0.001:
        return "under 1 ms"
    if seconds < 1:
        return f"{seconds * 1000:.0f} ms"
    if seconds < 60:
        return f"{seconds:.1f} s"
    if seconds < 3600:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 2 * 86400 else f"{seconds / 86400:.0f} days"


def waits_for(repair: Json | None, *, healthy: bool | None, policy: str) -> tuple[str, bool]:
    """Return what a robot waits for now, empty for nothing, and whether that is a person.

    Args:
        repair: the robot's newest.
        healthy: None where that is not known.
    """
    if repair is not None and repair["finished_ns"] is None:
        return _of_open(repair)
    if healthy is None and repair is not None and repair["state"] == RepairState.UNCONFIRMED:
        return f"a look: {in_prose(repair['reason'])}", True
    if healthy is not False:
        return "", False
    if policy == "observe":
        return "a person: robomend only observes it", True
    if repair is not None and repair["state"] in {RepairState.ESCALATED, RepairState.UNCONFIRMED}:
        return f"a person: {in_prose(repair['reason']) or 'the last repair did not help'}", True
    if repair is not None and repair["state"] in ENDED:
        reason = f": {in_prose(repair['reason'])}" if repair["reason"] else ""
        return f"a person: the last repair {ENDED[repair['state']]}{reason}", True
    return "", False


def _of_open(repair: Json) -> tuple[str, bool]:
    state, reason = repair["state"], repair["reason"]
    if state == RepairState.AWAITING_APPROVAL:
        steps = len(repair["plan"])
        plan = f" of a plan of {counted(steps, 'action')}" if steps else ""
        return f"approval{plan}", True
    if state == RepairState.WAITING and repair["waiting_for"]:
        probe = repair["probe"]
        if probe is not None and repair["waiting_for"] == [probe["atom"]]:
            return f"a look: {question(probe['atom'])}", True
        return f"observations: {listed(repair['waiting_for'])}", False
    if state == RepairState.RUNNING:
        running = [step for step in repair["plan"] if step["state"] == StepState.RUNNING]
        at_work = [action_title(step["name"], step["parameters"]) for step in running]
        return f"its repair: {listed(at_work)}" if at_work else "its repair", False
    told = reason if state == RepairState.WAITING and reason else REPAIR_STATES.get(state, state)
    return str(told), False
