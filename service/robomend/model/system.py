"""A loaded model, ready to use: clauses for the engines, parts for the repair, a vocabulary for
observations."""

from __future__ import annotations

from dataclasses import dataclass

from robomend.model.cnf import HealthCnf
from robomend.model.components import ComponentModel
from robomend.model.vocabulary import Vocabulary


@dataclass(frozen=True)
class System:
    """The system description in every form that the loop needs. Immutable; one per model version."""

    name: str
    format: str  # "component", "five-key" or "bench"
    source: str  # the text it was loaded from, so that it can be stored and served as written
    cnf: HealthCnf
    parts: (
        ComponentModel | None
    )  # None: a circuit or five-key model, which says nothing of what can be repaired
    vocabulary: Vocabulary
    warnings: tuple[str, ...] = ()
