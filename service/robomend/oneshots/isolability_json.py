"""Isolability as JSON, the same from `robomend model check --isolability` and over HTTP."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from robomend.diagnosis.isolability.analysis import Ambiguity, DoubleFaults, Isolability
from robomend.diagnosis.isolability.words import group_words, sentences, suggestions, undetectable_words
from robomend.model.system import System

MOST_IN_MATRIX = 500
"""Faults of a matrix that is written; a larger one is left out (null)."""

Words = Callable[[Ambiguity, System], Iterator[str]]


def isolability_json(found: Isolability, system: System) -> dict[str, Any]:
    """Return what can be detected and told apart, what would split the rest, and all of it in words."""
    return {
        "observed": [str(atom) for atom in found.observed],
        "unused": [str(atom) for atom in found.unused],
        "faults": [
            {"components": list(fault), "detectable": detectable}
            for fault, detectable in zip(found.faults, found.detectable, strict=True)
        ],
        "matrix": list(found.matrix) if len(found.matrix) <= MOST_IN_MATRIX else None,
        "groups": [_group(group, system, group_words) for group in found.ambiguities],
        "undetectable": [_group(group, system, undetectable_words) for group in found.undetectable],
        "double": None if found.double_faults is None else _double(found.double_faults, system),
        "exact_by": found.exact_by,
        "complete": found.complete,
        "elapsed_s": round(found.elapsed_s, 6),
        "text": sentences(found, system),
    }


def _group(group: Ambiguity, system: System, words: Words) -> dict[str, Any]:
    further = group.further
    return {
        "faults": [list(fault) for fault in group.faults],
        "rivals": [list(fault) for fault in group.rivals],
        "further": None
        if further is None
        else {
            "atoms": [str(atom) for atom in further.atoms],
            "cost_s": further.cost_s,
            "left": [{"fault": list(fault), "rival": list(rival)} for fault, rival in further.left],
            "all_looked_at": group.all_looked_at,
        },
        "suggestions": [{"add": one.add, "watch": str(one.watch)} for one in suggestions(group, system)],
        "text": "\n".join(words(group, system)),
    }


def _double(doubles: DoubleFaults, system: System) -> dict[str, Any]:
    return {
        "faults": [
            {"components": list(fault), "detectable": detectable}
            for fault, detectable in zip(doubles.faults, doubles.detectable, strict=True)
        ],
        "groups": [_group(group, system, group_words) for group in doubles.ambiguities],
        "complete": doubles.complete,
    }
