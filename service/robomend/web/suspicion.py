"""What a diagnosis makes of each component, for people: how suspect, and why.

bad        every diagnosis blames it
suspect    some do; its share is the probability, or without priors the part of the diagnoses
good       none does
unknown    there is no diagnosis
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Json = Mapping[str, Any]

LISTED = 50
"""Suspects that are explained one by one."""


@dataclass(frozen=True, slots=True)
class Suspicion:
    """How suspect a component is."""

    state: str
    share: float = 0.0


@dataclass(frozen=True, slots=True)
class Why:
    """Why a component is suspect: the conflicts that name it."""

    component: str
    suspicion: Suspicion
    conflicts: Sequence[Json]
    cleared: str


def suspicions(components: Sequence[str], result: Json | None) -> dict[str, Suspicion]:
    """Return what a result makes of each component."""
    found = [] if result is None else result["diagnoses"]
    if not found:
        return dict.fromkeys(components, Suspicion("unknown"))
    weights = [one.get("probability") for one in found]
    weighed = all(weight is not None for weight in weights) and sum(weights) > 0
    shares: dict[str, float] = {}
    for one, weight in zip(found, weights, strict=True):
        part = weight / sum(weights) if weighed else 1 / len(found)
        for component in one["bad"]:
            shares[component] = shares.get(component, 0.0) + part
    in_all = set(found[0]["bad"]).intersection(*(one["bad"] for one in found))
    return {
        component: Suspicion("bad", 1.0)
        if component in in_all
        else Suspicion("suspect", min(shares[component], 1.0))
        if component in shares
        else Suspicion("good")
        for component in components
    }


def whys(found: Mapping[str, Suspicion], result: Json | None) -> list[Why]:
    """Return what speaks against each suspect, the most suspect first."""
    if result is None:
        return []
    suspects = [name for name, one in found.items() if one.state in {"bad", "suspect"}]
    suspects.sort(key=lambda name: -found[name].share)
    return [
        Why(
            name,
            found[name],
            [each for each in result["conflicts"] if name in each["components"]],
            result["cleared"].get(name, ""),
        )
        for name in suspects[:LISTED]
    ]


def with_priors(result: Json | None) -> bool:
    """Return whether shares are probabilities."""
    found = [] if result is None else result["diagnoses"]
    return bool(found) and all(one.get("probability") is not None for one in found)
