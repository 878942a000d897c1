"""A loaded model, ready to use: clauses for the engines, parts for the repair, a vocabulary for
observations; and the model that a robot or a question makes of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from robomend.errors import UnknownComponent
from robomend.model.clauses import Assertion
from robomend.model.cnf import HealthCnf
from robomend.model.components import ComponentModel
from robomend.model.formulas import Formula, Interlock
from robomend.model.loops import Loop
from robomend.model.packed import supposed
from robomend.model.vocabulary import Vocabulary
from robomend_client.literals import Atom


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
    act_when: Interlock | None = None  # None: actions may be sent at any time
    loops: tuple[Loop, ...] = ()  # its topics that need each other in circles
    conditions: Mapping[tuple[str, str], Formula] = field(default_factory=dict)
    """(function, variant) -> its `when`, ground, with comparisons of readings (robomend.model.functions)."""

    @cached_property
    def outside(self) -> tuple[Atom, ...]:
        """The topics that nobody in the model publishes, as what is observed of them."""
        if self.parts is None:
            return ()
        published = {topic for node in self.parts.nodes.values() for topic in node.publishes}
        return tuple(Atom("ok", (topic,)) for topic in self.parts.topics if topic not in published)

    def extended(self, assertions: Iterable[Assertion] = (), expected_stopped: Iterable[str] = ()) -> System:
        """Return the system with assertions as further rules, for a robot on which these components are
        meant to be stopped or off; names that are no components count for nothing. What is large is left
        packed (robomend.model.packed), for whoever diagnoses to make.
        """
        cnf = supposed(self.cnf, tuple(expected_stopped), tuple(assertions))
        return self if cnf is self.cnf else replace(self, cnf=cnf)

    def named(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return components as the model writes them: a leading `/`, as in ROS, is dropped.

        Raises:
            UnknownComponent: the model has none of this name.
        """
        found = tuple(name.lstrip("/") or name for name in names)
        for name in found:
            if name not in self.cnf.health:
                raise UnknownComponent(name, frozenset(self.cnf.components))
        return found


def variant(version: str, assertions: Sequence[Assertion] = (), expected_stopped: Iterable[str] = ()) -> str:
    """Return a version for what `System.extended` makes of a version: equal versions are equal clauses."""
    stopped = sorted(expected_stopped)
    if not assertions and not stopped:
        return version
    said = [[assertion.name, assertion.text] for assertion in assertions]
    return f"{version}+{hashlib.sha256(json.dumps([stopped, said]).encode()).hexdigest()[:16]}"
