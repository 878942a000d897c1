"""The messages that the bridge publishes, in types that every ROS 2 has: nothing is built for the robot.

/diagnosis      std_msgs/String, JSON: the minimal diagnoses, also when all is well
/diagnostics    diagnostic_msgs/DiagnosticArray
/observations   std_msgs/String: `ok(scan) and not ok(odom)`
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from robomend_client.bridges.ros2.cdr import CdrWriter
from robomend_client.bridges.telling import statuses

STRING = "std_msgs/String"
DIAGNOSTICS = "diagnostic_msgs/DiagnosticArray"
MOST_DIAGNOSES = 100


def observations(said: Sequence[str], time_ns: int) -> bytes:
    return _string(" and ".join(said))


def diagnosis(result: Mapping[str, Any], time_ns: int) -> bytes:
    """Return what HTTP has under `result`, with the time."""
    rows = [
        {"bad": list(d["bad"]), "good": list(d["good"]), "text": d.get("text") or ""}
        for d in result["diagnoses"][:MOST_DIAGNOSES]
    ]
    complete = bool(result.get("complete", False)) and len(rows) == len(result["diagnoses"])
    return _string(json.dumps({"time_ns": time_ns, "complete": complete, "diagnoses": rows}))


def diagnostics(result: Mapping[str, Any] | None, why_none: str, time_ns: int) -> bytes:
    writer = CdrWriter()
    writer.u32(time_ns // 10**9)
    writer.u32(time_ns % 10**9)
    writer.text("")  # the frame
    found = statuses(result, why_none)
    writer.u32(len(found))
    for status in found:
        writer.u8(status["level"])
        for name in ("name", "message", "hardware_id"):
            writer.text(status[name])
        writer.u32(len(status["values"]))
        for pair in status["values"]:
            writer.text(pair["key"])
            writer.text(pair["value"])
    return writer.message()


def _string(text: str) -> bytes:
    writer = CdrWriter()
    writer.text(text)
    return writer.message()
