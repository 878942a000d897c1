"""What can be known of a robot's actions before they are needed: their names, and how many they ground to.

A plan is made in seconds, at 3 a.m.; what can never work is refused when the robot is configured. Pure.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice

from robomend.errors import DomainError, InputError
from robomend.model.components import ComponentModel
from robomend.planning.domain.compilation import Compilation, compile_domain
from robomend.planning.domain.loading import load_domain
from robomend.planning.domain.values import Domain
from robomend.planning.problem import MEND, repair_problem
from robomend.planning.static_facts import Env, StaticFacts
from robomend_client.near import did_you_mean

MOST_WAYS = 1000
"""Ground actions that may achieve one fact: with as many, planning takes about ten seconds on a busy core."""

LOOKED_AT = 5
"""Names that are tried for each place of an effect; components of one kind differ little."""


def check_domain(text: str, model: ComponentModel | None) -> Domain:
    """Return the domain of a robot's own PDDL, if plans can be made with it for this model.

    Raises:
        DomainError: it cannot be read, its init or objects name what the model does not have, or an action
            has so many ground actions that no plan would be found in time.
    """
    domain = load_domain(text, "domain")
    if model is not None:
        facts = StaticFacts(domain, repair_problem(model, domain, (), ()))
        for compilation in compile_domain(domain):
            if any(number > MOST_WAYS for number in _ways(compilation, facts)):
                schema = compilation.schema
                raise DomainError(
                    f"the action {schema.name!r} has {len(schema.parameters)} parameters, which makes more "
                    f"than {MOST_WAYS} ground actions for one effect, too many to plan with; guard the "
                    "parameters with static predicates, such as (spare_for ?s ?h), or leave some out",
                    schema.file,
                    schema.line,
                )
    return domain


def check_names(what: str, names: Iterable[str], domain: Domain, model: ComponentModel | None = None) -> None:
    """Refuse (InputError) names that are no actions of the robot's domain, remedies or acts of its model."""
    own = () if model is None else (*(one.name for one in model.remedies), *model.acts)
    known = dict.fromkeys((*(name for name in domain.schemas if name != MEND), *own))
    for name in names:
        if name not in known:
            raise InputError(
                f"{what}: the robot's domain has no action {name!r}{did_you_mean(name, known)}; "
                f"there are {', '.join(known)}"
            )


def _ways(compilation: Compilation, facts: StaticFacts) -> Iterator[int]:
    """Yield how many ground actions there are for some facts that the action achieves, up to the limit."""
    for effect in compilation.effects:
        variables = compilation.schema.parameters + effect.variables
        kinds = dict(variables)
        terms = [term for term in effect.atom.terms if term in kinds]
        members = sorted(facts.members_of(kinds[terms[0]]))[:LOOKED_AT] if terms else [""]
        for name in members:
            env: Env = {terms[0]: name} if terms else {}
            guards = compilation.guards + effect.guards
            yield sum(1 for _ in islice(facts.bindings(variables, guards, env), MOST_WAYS + 1))
