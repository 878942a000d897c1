"""The compiled system description: clauses over health variables, each with the rule that it came from.

    variables 1 … n          health: variable i is true when COMPS[i-1] is healthy, so `-i` is AB(c)
    n+1 … n+len(atoms)       the atoms that observations and rules speak of
    above                    auxiliary variables of rules that are not clauses; never observed, never shown

A clause is a tuple of non-zero integers, as in DIMACS. `origins[k]` is the index in `rules` of the rule
that clause k came from, so that a conflict can be told in the model's words. Engines read this class and
nothing else of a model.

Source: R. Reiter. A theory of diagnosis from first principles. AIJ 32(1), 1987 (SD, COMPS, AB).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from robomend_client.literals import Atom, Literal

Clause = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule of the system description, as people read it."""

    text: str  # e.g. "not ab(hector_mapping) and ok(scan) -> ok(map)"
    source: str  # "scheme 1" … "scheme 6", "user rule 2", "five-key rule 7", "gate 10", "feed", "mode"
    line: int | None = None  # in the model's file, from 1

    def __reduce__(self) -> tuple[type[Rule], tuple[str, str, int | None]]:
        return Rule, (self.text, self.source, self.line)  # half of what pickling the fields by name takes


@dataclass(frozen=True, slots=True)
class Output:
    """What a component puts out, as far as it can be observed: see robomend.diagnosis.ranking."""

    atom: Atom  # ok(t)
    by: str  # the node that publishes it
    inputs: tuple[Atom, ...] = ()  # what it rests on

    def __reduce__(self) -> tuple[type[Output], tuple[Atom, str, tuple[Atom, ...]]]:
        return Output, (self.atom, self.by, self.inputs)


PARTIAL = 0.2
"""How often what is broken is so in part only, unless the model says otherwise."""


@dataclass(frozen=True)
class HealthCnf:
    """SD as clauses, COMPS as its first variables.

    Values only: it pickles, and two equal models compile equal.
    """

    name: str
    components: tuple[str, ...]
    atoms: tuple[Atom, ...]
    clauses: tuple[Clause, ...]
    origins: tuple[int, ...]  # parallel to clauses
    rules: tuple[Rule, ...]
    variables: int  # the highest variable, auxiliary ones included
    priors: Mapping[str, float] = field(default_factory=dict)  # P(AB(c)), 0 < p < 1; missing: no prior
    costs: Mapping[Atom, float] = field(default_factory=dict)  # of observing, in seconds, > 0; missing: 1
    modes: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Fault modes: component -> mode name -> the variable that is true in that mode.

    AB(c) implies exactly one of them; "unknown" is among them unless the model calls its modes exhaustive.
    """
    weak: bool = True
    """A weak fault model: no rule has AB in its premise and nothing follows from being abnormal."""
    circuit: bool = False
    """Each component is a gate with one output; cone reasoning may apply (see robomend.diagnosis)."""
    inputs: tuple[Atom, ...] = ()
    outputs: tuple[Atom, ...] = ()
    """Of a circuit: its primary nets, in the order of the file. A net may be both."""
    puts_out: Mapping[str, tuple[Output, ...]] = field(default_factory=dict)
    """Component -> the outputs that are bad when it fails as a whole; of component models."""
    partial: float = PARTIAL  # P(a component that fails does so in part only)

    @cached_property
    def health(self) -> Mapping[str, int]:
        """Component -> its health variable."""
        return {component: index for index, component in enumerate(self.components, 1)}

    @cached_property
    def atom_variable(self) -> Mapping[Atom, int]:
        """Atom -> its variable. Atoms that no clause mentions are absent: they are kept in OBS, unused."""
        first = len(self.components) + 1
        return {atom: index for index, atom in enumerate(self.atoms, first)}

    @cached_property
    def publishers(self) -> Mapping[Atom, tuple[str, ...]]:
        """Output -> the nodes that put it out."""
        found: dict[Atom, dict[str, None]] = {}
        for outputs in self.puts_out.values():
            for output in outputs:
                found.setdefault(output.atom, {})[output.by] = None
        return {atom: tuple(by) for atom, by in found.items()}

    @cached_property
    def clauses_of_rule(self) -> Mapping[str, tuple[Clause, ...]]:
        """Rule text -> the clauses that came from rules of that text."""
        found: dict[str, list[Clause]] = {}
        for clause, origin in zip(self.clauses, self.origins, strict=True):
            found.setdefault(self.rules[origin].text, []).append(clause)
        return {text: tuple(clauses) for text, clauses in found.items()}

    def literal(self, literal: Literal) -> int | None:
        """Return the signed variable of an observed literal, or None when no rule mentions its atom."""
        variable = self.atom_variable.get(literal.atom)
        if variable is None:
            return None
        return variable if literal.positive else -variable

    def literal_of(self, variable: int) -> Literal:
        """Return a signed health or atom variable as a literal, e.g. `ab(jaguar)`, `not ok(scan)`."""
        index = abs(variable) - 1
        if index < len(self.components):
            return Literal(Atom("ab", (self.components[index],)), variable < 0)
        return Literal(self.atoms[index - len(self.components)], variable > 0)

    def word(self, variable: int) -> str:
        """Return the same in the model's words."""
        return str(self.literal_of(variable))
