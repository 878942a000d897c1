"""A diagnosis result as JSON: the same from the command, over HTTP, in events, in the history and from logs.

To add a field: here, and in `ResultOut` (robomend.api.schemas.diagnosis), which describes it in OpenAPI;
tests/api/test_one_shape.py holds the two together. `elapsed_s` stays last: the text before it is equal
for equal answers, whatever time they took.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from robomend.diagnosis.explanations import explain_diagnoses, what_was_learned
from robomend.diagnosis.result import DiagnosisResult

LAST = ',"elapsed_s":'

_compact = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode


def result_json(result: DiagnosisResult) -> dict[str, Any]:
    """Return a result as JSON values; the indices in `resolves` are those of `conflicts`."""
    return _json(result, [list(result.good(diagnosis)) for diagnosis in result.diagnoses])


def result_text(result: DiagnosisResult, quoted: Mapping[str, str]) -> str:
    """Return `result_json` as compact text, quickly.

    Most of the text is what is good, again for each diagnosis: it is put together from quoted names.

    Args:
        result: an answer.
        quoted: each component -> itself as JSON text; see `quoted_names`.
    """
    hole = '"good":null'  # in a name or a sentence its quotation marks would be escaped
    first, *rest = _compact(_json(result, [None] * len(result.diagnoses))).split(hole)
    pieces = [first]
    for diagnosis, following in zip(result.diagnoses, rest, strict=True):
        bad = set(diagnosis.bad)
        good = ",".join([text for name, text in quoted.items() if name not in bad])
        pieces += '"good":[', good, "]", following
    return "".join(pieces)


def quoted_names(components: tuple[str, ...]) -> dict[str, str]:
    """Return each component with its name as JSON text."""
    return {name: _compact(name) for name in components}


def timeless(text: str) -> str:
    """Return the text of a result up to the time that it took."""
    return text.rpartition(LAST)[0]


def timed(text: str, elapsed_s: float) -> str:
    """Return what `timeless` left of a result with a time of its own."""
    return f"{text}{LAST}{elapsed_s:.6f}}}"


def _json(result: DiagnosisResult, good: list[Any]) -> dict[str, Any]:
    texts = explain_diagnoses(result.diagnoses, result.conflicts)
    return {
        "diagnoses": [
            {
                "bad": list(diagnosis.bad),
                "good": others,
                "probability": diagnosis.probability,
                "modes": dict(diagnosis.modes),
                "resolves": list(diagnosis.resolves),
                "text": text,
            }
            for diagnosis, others, text in zip(result.diagnoses, good, texts, strict=True)
        ],
        "complete": result.complete,
        "stopped_by": result.stopped_by,
        "smallest_proved": result.smallest_proved,
        "size_at_least": result.size_at_least,
        "size_at_most": result.size_at_most,
        "conflicts": [
            {
                "components": list(conflict.components),
                "observations": [str(literal) for literal in conflict.observations],
                "rules": list(conflict.rules),
                "text": conflict.text,
                "unmet": None if conflict.unmet is None else str(conflict.unmet),
                "minimal": conflict.minimal,
            }
            for conflict in result.conflicts
        ],
        "conflicts_complete": result.conflicts_complete,
        "conflicts_all": result.conflicts_all,
        "learned": what_was_learned(result.conflicts),
        "cleared": dict(result.cleared),
        "unused": [str(literal) for literal in result.unused],
        "unexplored": result.unexplored,
        "factored": [
            [
                {
                    "component": factor.component,
                    "alternatives": list(factor.alternatives),
                    "sets": [list(together) for together in factor.sets],
                }
                for factor in product
            ]
            for product in result.factored
        ],
        "count": result.count,
        "elapsed_s": round(result.elapsed_s, 6),
    }
