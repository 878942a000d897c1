"""The messages that the bridge publishes and serves, in the formats of the published system and of ROS.

Source: the message definitions of tug_ist_diagnosis_msgs (float32 stamps, as released: its own subscribers
compare md5 sums), diagnostic_msgs and actionlib_msgs. rosbags is imported when the first is made.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import lru_cache
from typing import Any

from robomend_client.bridges.measured import row_of
from robomend_client.bridges.ros1.messages import full_name
from robomend_client.bridges.ros1.publication import MessageType
from robomend_client.bridges.telling import statuses

HEADER = "uint32 seq\ntime stamp\nstring frame_id\n"
GOAL_STATUS = (
    "uint8 PENDING=0\nuint8 ACTIVE=1\nuint8 PREEMPTED=2\nuint8 SUCCEEDED=3\nuint8 ABORTED=4\n"
    "uint8 REJECTED=5\nuint8 PREEMPTING=6\nuint8 RECALLING=7\nuint8 RECALLED=8\nuint8 LOST=9\n"
    "actionlib_msgs/GoalID goal_id\nuint8 status\nstring text\n"
)

PACKAGE = "tug_ist_diagnosis_msgs"
GOAL, RESULT, FEEDBACK = (f"{PACKAGE}/DiagnosisRepairAction{part}" for part in ("Goal", "Result", "Feedback"))
MODEL = f"{PACKAGE}/SystemModelResult"
MODEL_RESULT, MODEL_FEEDBACK = (f"{PACKAGE}/SystemModelAction{part}" for part in ("Result", "Feedback"))
CANCEL, STATUSES = "actionlib_msgs/GoalID", "actionlib_msgs/GoalStatusArray"
OBSERVATIONS, DIAGNOSIS = f"{PACKAGE}/Observations", f"{PACKAGE}/Diagnosis"
BOARD = f"{PACKAGE}/DBoardMeasurments"
DIAGNOSTICS = "diagnostic_msgs/DiagnosticArray"

ACTION_HEAD = "std_msgs/Header header\n"

DEFINITIONS = {
    "std_msgs/Header": HEADER,
    "diagnostic_msgs/KeyValue": "string key\nstring value\n",
    "diagnostic_msgs/DiagnosticStatus": (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\n"
        "string hardware_id\ndiagnostic_msgs/KeyValue[] values\n"
    ),
    DIAGNOSTICS: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
    OBSERVATIONS: "float32 out_time\nstring[] obs\n",
    f"{PACKAGE}/DiagnosisResults": "string[] good\nstring[] bad\n",
    DIAGNOSIS: f"float32 o_time\n{PACKAGE}/DiagnosisResults[] diag\n",
    f"{PACKAGE}/Channel": "int32 id\nstring dev_connected\nint32 status\nfloat32 current\nfloat32 voltage\n",
    CANCEL: "time stamp\nstring id\n",
    "actionlib_msgs/GoalStatus": GOAL_STATUS,
    STATUSES: "std_msgs/Header header\nactionlib_msgs/GoalStatus[] status_list\n",
    f"{PACKAGE}/DiagnosisRepairGoal": "string[] parameter\n",
    f"{PACKAGE}/DiagnosisRepairResult": "int32 result\n",
    f"{PACKAGE}/DiagnosisRepairFeedback": "int32 feedback\n",
    GOAL: f"{ACTION_HEAD}actionlib_msgs/GoalID goal_id\n{PACKAGE}/DiagnosisRepairGoal goal\n",
    RESULT: f"{ACTION_HEAD}actionlib_msgs/GoalStatus status\n{PACKAGE}/DiagnosisRepairResult result\n",
    FEEDBACK: f"{ACTION_HEAD}actionlib_msgs/GoalStatus status\n{PACKAGE}/DiagnosisRepairFeedback feedback\n",
    MODEL: "string ab\nstring nab\nstring neg_prefix\nstring[] rules\nstring[] props\n",
    MODEL_RESULT: f"{ACTION_HEAD}actionlib_msgs/GoalStatus status\n{MODEL} result\n",
    BOARD: f"float32 o_time\n{PACKAGE}/Channel[] channel\n",
}


@lru_cache(maxsize=1)
def _store() -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, full_name(name)))
    return store


@lru_cache(maxsize=64)
def message_type(name: str) -> MessageType:
    """Return what the header of a connection says of a type."""
    definition, md5 = _store().generate_msgdef(full_name(name), ros_version=1)
    return MessageType(name, md5, definition)


def encode(name: str, value: Mapping[str, Any]) -> bytes:
    """Return the bytes of a message; what `value` leaves out is empty or 0."""
    return bytes(_store().serialize_ros1(_made(full_name(name), value), full_name(name)))


def decode(name: str, body: bytes) -> Any:
    """Return a message of one of these types.

    Raises:
        Exception: the bytes are none; rosbags raises what it likes.
    """
    return _store().deserialize_ros1(body, full_name(name))


def _made(name: str, value: Mapping[str, Any]) -> Any:
    store = _store()
    kind = store.types[name]
    _, definition = store.fielddefs[name]
    given = {}
    for field, node in definition:
        given[field] = _part(node, value.get(field))
    return kind(**{field.name: given[field.name] for field in fields(kind) if field.name in given})


def _part(node: Any, value: Any) -> Any:
    """Return a field's value as rosbags wants it; `node` is its type: kind, and what it is made of."""
    kind, inside = node
    if kind == 1:  # a base type: its name and the longest string
        return ("" if inside[0] == "string" else 0) if value is None else value
    if kind == 2:  # another message
        return _made(inside, value or {})
    element, _ = inside
    return [_part(element, item) for item in value or ()]


def stamp(time_ns: int) -> dict[str, int]:
    """Return a ROS time."""
    return {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}


def observations(sentences: Sequence[str], time_ns: int) -> bytes:
    return encode(OBSERVATIONS, {"out_time": time_ns / 1e9, "obs": list(sentences)})


def diagnosis(result: Mapping[str, Any], time_ns: int) -> bytes | None:
    """Return /diagnosis: all minimal diagnoses, each with good and bad; nothing when all is well."""
    diagnoses = result["diagnoses"]
    if not any(one["bad"] for one in diagnoses):
        return None
    rows = [{"good": list(d["good"]), "bad": list(d["bad"])} for d in diagnoses]
    return encode(DIAGNOSIS, {"o_time": time_ns / 1e9, "diag": rows})


def board(channels: Sequence[Mapping[str, Any]], time_ns: int) -> bytes:
    """Return /board_measurments; of a channel of which nothing is known, there is no row."""
    rows = [row_of(channel) for channel in channels if channel["on"] is not None]
    return encode(BOARD, {"o_time": time_ns / 1e9, "channel": rows})


def diagnostics(result: Mapping[str, Any] | None, why_none: str, time_ns: int) -> bytes:
    """Return /diagnostics: see telling.py."""
    found = statuses(result, why_none)
    return encode(DIAGNOSTICS, {"header": {"stamp": stamp(time_ns)}, "status": found})
