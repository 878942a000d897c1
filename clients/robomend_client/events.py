"""The event record: what the service tells its clients, and what it keeps as history.

Events of one service form one log, ordered by `id`. Server-sent events carry `id` as the event id, `kind` as
the event name and the rest as JSON, so that a client that lost its stream resumes with Last-Event-ID.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robomend_client.python310 import StrEnum


class Kind(StrEnum):
    """What happened. New kinds may come; clients skip those that they do not know."""

    OBSERVATIONS = "observations"  # data: revision, changed (literals as text), forgotten, accepted_ns
    DIAGNOSIS = "diagnosis"  # data: revision, result as in GET …/diagnosis
    REPAIR = "repair"  # data: repair id, state, diagnosis, plan, reason
    ACTION = "action"  # data: action id (`repair:step`), name, parameters, state, result, message, feedback
    CONFIGURATION = "configuration"  # data: change id, state, changes (function, from, to), plan, reason
    BOARD = "board"  # data: link state, or channels
    ROBOT = "robot"  # data: what changed (created, updated, deleted, quarantine, owner)
    MODEL = "model"  # data: model name, version
    DRILL = "drill"  # data: drill id, state, fault, component, undo, reason
    MOMENT = "moment"  # data: moment id, at_ns, complete
    BATCH = "batch"  # data: batch id, state
    STOP = "stop"  # data: active, by, reason, since_ns, revision


@dataclass(frozen=True, slots=True)
class Event:
    """One entry of the log."""

    id: int  # increasing, with gaps allowed
    time_ns: int  # integer nanoseconds since the epoch, the service's clock
    kind: Kind
    robot: str | None  # None for events of the whole service
    data: Mapping[str, Any]  # JSON values only
