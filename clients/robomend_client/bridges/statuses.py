"""A diagnosis as diagnostic statuses, for the aggregators of ROS: one for each component.

    ERROR   bad in every diagnosis        OK      bad in none
    WARN    bad in some, or others may be found that do not blame it

Without a diagnosis there is one STALE status, which says why.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

OK, WARN, ERROR, STALE = range(4)
MOST_STATUSES = 1000


def statuses(result: Mapping[str, Any] | None, why_none: str) -> list[dict[str, Any]]:
    """Return the statuses, each with the fields of a DiagnosticStatus."""
    if result is None:
        return [{"level": STALE, "name": "robomend", "message": why_none, "hardware_id": "", "values": []}]
    return [_status(name, result) for name in _components(result)][:MOST_STATUSES]


def _components(result: Mapping[str, Any]) -> list[str]:
    found = {name for one in result["diagnoses"] for name in (*one["bad"], *one["good"])}
    return sorted(found)


def _status(name: str, result: Mapping[str, Any]) -> dict[str, Any]:
    diagnoses = result["diagnoses"]
    blaming = [one for one in diagnoses if name in one["bad"]]
    values = {}
    if not blaming:
        level, message = OK, "works"
    else:
        certain = len(blaming) == len(diagnoses) and result.get("complete", False)
        level, message = (ERROR, "broken") if certain else (WARN, "perhaps broken")
        values["in diagnoses"] = f"{len(blaming)} of {len(diagnoses)}"
        values |= {
            f"diagnosis {n}": one.get("text") or ", ".join(one["bad"]) for n, one in enumerate(blaming[:5], 1)
        }
        because = [c.get("text", "") for c in result.get("conflicts", ()) if name in c["components"]]
        values |= {f"because {n}": text for n, text in enumerate(because[:5], 1) if text}
    return {
        "level": level,
        "name": f"robomend: {name}",
        "message": message,
        "hardware_id": name,
        "values": [{"key": key, "value": value} for key, value in values.items()],
    }
