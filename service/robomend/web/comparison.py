"""Two versions of a model, compared by what they mean and not by their text.

What a person wants to know before a robot follows the new one: which components and rules came or went,
what can be observed now, and which faults can be told apart that could not, or the other way round.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from robomend.model.components import Component
from robomend.model.system import System

WORDS = {"+": "always", "~": "by some symptoms only", "-": "never", "?": "not known"}
"""The marks of an isolability matrix."""


@dataclass(frozen=True)
class Difference:
    """What came and what went, in the order of the models."""

    came: tuple[str, ...] = ()
    went: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.came or self.went)


@dataclass(frozen=True)
class ModelDifference:
    """What differs between two systems."""

    components: Difference
    changed: tuple[tuple[str, str, str, str], ...]  # component, key, before, after
    rules: Difference
    observables: Difference

    def __bool__(self) -> bool:
        return bool(self.components or self.changed or self.rules or self.observables)


def compare(before: System, after: System) -> ModelDifference:
    """Return what differs between two versions, whatever their formats."""
    return ModelDifference(
        _difference(before.cnf.components, after.cnf.components),
        _changed(_parts(before), _parts(after)),
        _difference([rule.text for rule in before.cnf.rules], [rule.text for rule in after.cnf.rules]),
        _difference([str(atom) for atom in before.cnf.atoms], [str(atom) for atom in after.cnf.atoms]),
    )


def _difference(before: Sequence[str], after: Sequence[str]) -> Difference:
    """Return what is there more often than before, and what less often."""
    came, went = Counter(after) - Counter(before), Counter(before) - Counter(after)
    return Difference(tuple(came.elements()), tuple(went.elements()))


def _parts(system: System) -> Mapping[str, Component]:
    return {} if system.parts is None else system.parts.parts


def _changed(
    before: Mapping[str, Component], after: Mapping[str, Component]
) -> tuple[tuple[str, str, str, str], ...]:
    """Return the keys in which components that are in both differ; their lines do not count."""
    found = []
    for name, new in after.items():
        old = before.get(name)
        if old is None:
            continue
        if type(old) is not type(new):
            found.append((name, "kind", old.what, new.what))
            continue
        for one in fields(new):
            was, now = getattr(old, one.name), getattr(new, one.name)
            if one.name != "line" and was != now:
                found.append((name, one.name, _said(was), _said(now)))
    return tuple(found)


def _said(value: object) -> str:
    if value is None or value == () or value == {}:
        return "–"
    if isinstance(value, Mapping):
        return "; ".join(f"{key}: {_said(each)}" for key, each in value.items())
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


@dataclass(frozen=True)
class IsolabilityChange:
    """How the single faults of components that both versions have can be told from one another."""

    detectable: Difference
    pairs: tuple[tuple[str, str, str, str], ...]  # fault, the other, before, after
    better: int
    worse: int


ORDER = "-?~+"
"""The marks, from what tells nothing apart to what always does."""


def isolability_change(before: Mapping[str, Any], after: Mapping[str, Any]) -> IsolabilityChange | None:
    """Return what changed between two reports (robomend.oneshots.solvers); None: too large for a
    matrix.
    """
    old, new = _marks(before), _marks(after)
    if old is None or new is None:
        return None
    pairs = []
    better = worse = 0
    for pair, mark in new.items():
        was = old.get(pair)
        if was is not None and was != mark:
            pairs.append((*pair, WORDS[was], WORDS[mark]))
            better += ORDER.index(mark) > ORDER.index(was)
            worse += ORDER.index(mark) < ORDER.index(was)
    found = [[name for name, good in _detectable(report).items() if good] for report in (before, after)]
    return IsolabilityChange(_difference(*found), tuple(pairs), better, worse)


def _names(report: Mapping[str, Any]) -> list[str]:
    return [" + ".join(fault["components"]) for fault in report["faults"]]


def _detectable(report: Mapping[str, Any]) -> dict[str, bool | None]:
    return dict(zip(_names(report), (fault["detectable"] for fault in report["faults"]), strict=True))


def _marks(report: Mapping[str, Any]) -> dict[tuple[str, str], str] | None:
    if report["matrix"] is None:
        return None
    names = _names(report)
    return {
        (one, other): row[column]
        for one, row in zip(names, report["matrix"], strict=True)
        for column, other in enumerate(names)
        if one != other
    }
