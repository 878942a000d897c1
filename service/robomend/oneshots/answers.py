"""A diagnosis result as JSON values, the same over HTTP, in events and from the commands."""

from __future__ import annotations

from typing import Any

from robomend.diagnosis.explanations import explain_diagnosis, what_was_learned
from robomend.diagnosis.result import DiagnosisResult


def result_json(result: DiagnosisResult) -> dict[str, Any]:
    """Return an engine's answer; `elapsed_s` is the diagnosis alone."""
    return {
        "diagnoses": [
            {
                "bad": list(diagnosis.bad),
                "good": list(result.good(diagnosis)),
                "probability": diagnosis.probability,
                "modes": dict(diagnosis.modes),
                "text": explain_diagnosis(diagnosis, result.conflicts),
            }
            for diagnosis in result.diagnoses
        ],
        "complete": result.complete,
        "stopped_by": result.stopped_by,
        "conflicts": [
            {
                "components": list(conflict.components),
                "observations": [str(literal) for literal in conflict.observations],
                "rules": list(conflict.rules),
                "text": conflict.text,
                "minimal": conflict.minimal,
            }
            for conflict in result.conflicts
        ],
        "elapsed_s": result.elapsed_s,
        "unused": [str(literal) for literal in result.unused],
        "count": result.count,
        "factored": [
            [
                {
                    "component": factor.component,
                    "alternatives": list(factor.alternatives),
                    "sets": [list(together) for together in factor.sets],
                }
                for factor in row
            ]
            for row in result.factored
        ],
        "conflicts_complete": result.conflicts_complete,
        "cleared": dict(result.cleared),
        "learned": what_was_learned(result.conflicts, result.learned),
    }
