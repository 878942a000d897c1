"""`model check`: what a model leaves out. Nothing is wrong with it, and yet worth knowing before a fault."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from pysat.solvers import Solver

from robomend.model.components import Node
from robomend.model.functions import needs_of, spoken_of
from robomend.model.schemes import publishers_of
from robomend.model.system import System
from robomend_client.counts import counted, first_few
from robomend_client.literals import Atom

SHOWN = 20


def check(system: System) -> tuple[str, ...]:
    """Return every doubt about a model, as sentences; loading's own warnings come first."""
    return (
        *system.warnings,
        *contradictory(system),
        *unblamable(system),
        *excused(system),
        *coarse(system),
        *unused(system),
        *self_locking(system),
        *without_alternative(system),
        *partial_priors(system),
    )


UNBOUNDED = -1


def contradictory(system: System, conflicts: int = UNBOUNDED) -> Iterator[str]:
    """Rules that contradict one another: whatever is abnormal, or when every component is healthy.

    `conflicts` bounds each of at most 42 searches; where one does not come to an end, nothing is said.
    """
    cnf = system.cnf
    # A rule counts while its selector is assumed, so that the solver says which of them clash.
    selectors = range(cnf.variables + 1, cnf.variables + 1 + len(cnf.rules))
    with Solver("g4") as solver:
        solver.conf_budget(conflicts)
        for clause, origin in zip(cnf.clauses, cnf.origins, strict=True):
            solver.add_clause([*clause, -selectors[origin]])
        if clash := _clash(solver, [], selectors):
            yield (
                "no diagnosis will ever be found: these rules contradict one another, whatever is abnormal; "
                f"mend one of them: {_rules_of(system, clash, selectors)}"
            )
        elif clash := _clash(solver, list(cnf.health.values()), selectors):
            yield (
                "no robot will ever be healthy: when every component is, these rules contradict one another: "
                f"{_rules_of(system, clash, selectors)}"
            )


def _clash(solver: Solver, healthy: list[int], selectors: range) -> list[int]:
    """Return selectors of rules that have no model together, none to spare up to SHOWN; empty: they have."""
    if solver.solve_limited([*healthy, *selectors]) is not False:
        return []
    clash = [literal for literal in solver.get_core() or () if literal in selectors]
    for selector in clash[:SHOWN]:
        rest = [other for other in clash if other != selector]
        if solver.solve_limited([*healthy, *rest]) is False:
            clash = rest
    return clash


def _rules_of(system: System, clash: list[int], selectors: range) -> str:
    rules = [system.cnf.rules[selectors.index(selector)] for selector in sorted(clash)]
    places = [f"{rule.source}, line {rule.line}" if rule.line else rule.source for rule in rules]
    said = [f"{rule.text} ({place})" for rule, place in zip(rules, places, strict=True)]
    return first_few(said, SHOWN, "; ")


def unblamable(system: System) -> Iterator[str]:
    """Components that occur in no clause: no observation can ever lead to them."""
    used = {abs(literal) for clause in system.cnf.clauses for literal in clause}
    names = [name for name, variable in system.cnf.health.items() if variable not in used]
    for name in names[:SHOWN]:
        driven = system.parts is not None and name in system.parts.hardware
        remedy = "; with `blame_hardware: true` its driver's clauses can" if driven else ""
        yield f"no rule can blame {name}{remedy}"
    if len(names) > SHOWN:
        yield f"and {counted(len(names) - SHOWN, 'more component')} that no rule can blame"


def excused(system: System, topics: Collection[str] | None = None) -> Iterator[str]:
    """Published topics, or those of `topics`, whose silence nobody can be blamed for, until something else is
    observed.

    With every component healthy, such a topic may be silent all the same: it waits for an input that no node
    publishes, or for itself, in a circle. The six schemes say so; whoever writes the model seldom means it.
    """
    model = system.parts
    if model is None:
        return
    publishers = publishers_of(model)
    free = _unforced(system, publishers)
    by_cause: dict[str, list[str]] = {}
    for topic in free if topics is None else [one for one in free if one in topics]:
        by_cause.setdefault(_waits_for(topic, free, publishers), []).append(topic)
    for cause, topics in by_cause.items():
        named = f"topic{'s' if len(topics) > 1 else ''} {first_few(topics, SHOWN)}"
        yield f"{named}: {cause}, so that silence alone blames nobody{_until(cause)}"


def _until(cause: str) -> str:
    if cause.startswith("waits for itself"):
        return " until the robot was seen with the circle up"
    return "; observe what is waited for as well"


def _unforced(system: System, publishers: Mapping[str, list[Node]]) -> dict[str, None]:
    """Return the published topics that may be silent though every component is healthy."""
    cnf = system.cnf
    found: dict[str, None] = {}
    with Solver("g4", bootstrap_with=cnf.clauses) as solver:
        healthy = list(cnf.health.values())
        for topic in publishers:
            variable = cnf.atom_variable.get(Atom("ok", (topic,)))
            if variable is not None and solver.solve([*healthy, -variable]):
                found[topic] = None
    return found


def _waits_for(topic: str, free: Mapping[str, None], publishers: Mapping[str, list[Node]]) -> str:
    """Say why a topic may be silent, by going from input to input to where it begins."""
    path: dict[str, None] = {}
    while topic not in path:
        path[topic] = None
        inputs = [name for node in publishers[topic] for name in node.publishes[topic]]
        outside = [name for name in inputs if name not in publishers]
        if outside:
            return f"waits for {', '.join(outside)}, which no node publishes"
        waiting = [name for name in inputs if name in free]
        if not waiting:
            return "a rule allows it to be silent"
        topic = waiting[0]
    trail = list(path)
    circle = trail[trail.index(topic) :]
    first = circle.index(min(circle))  # the same words, wherever the circle was entered
    circle = circle[first:] + circle[: first + 1]
    return f"waits for itself, in a circle ({' ← '.join(circle)})"


def coarse(system: System) -> Iterator[str]:
    """Circles of topics within circles: one clause for all of them."""
    for loop in system.loops:
        if loop.nested:
            shown = ", ".join(loop.topics[:SHOWN]) + (" …" if len(loop.topics) > SHOWN else "")
            yield (
                f"topics {shown} need each other in more than one circle: once they were up, the silence of "
                f"any of them blames one of all {len(loop.components)} components in it, no fewer"
            )


def unused(system: System) -> Iterator[str]:
    """Declared names that no clause and no other entry mentions."""
    model = system.parts
    if model is None:
        mentioned = set(system.cnf.atoms)
        idle = sorted(str(atom) for atom in system.vocabulary.atoms - mentioned)
        if idle:
            yield f"no rule mentions {first_few(idle, SHOWN)}: observing it says nothing"
        return
    atoms = {
        *system.cnf.atoms,
        *(() if system.act_when is None else system.act_when.atoms),
        *spoken_of(system.conditions),
    }
    publishers = publishers_of(model)
    for topic in model.topics:
        if topic not in publishers and Atom("ok", (topic,)) not in atoms:
            yield f"topic {topic}: no node publishes it, and no rule mentions it"
    indexed = {atom.args[0] for atom in atoms if atom.predicate == "ok" and len(atom.args) > 1}
    for name in model.properties:
        if Atom("ok", (name,)) not in atoms and name not in indexed:
            yield f"property {name}: no rule mentions ok({name}), so observing it says nothing"
    spoken = {arg for atom in atoms if atom.predicate != "ok" for arg in atom.args}
    for name in model.values:
        if name not in spoken:
            yield f"value {name}: no related pair and no rule mentions it"
    driven = {device for node in model.nodes.values() for device in node.drives}
    feeders = {feeder for device in model.hardware.values() for feeder in device.fed_by}
    ruled = _in_user_rules(system)
    hosts = {part.host for part in model.nodes.values()}
    for name in model.computers:
        if name not in hosts:
            yield f"computer {name}: no node has it as its `host`, so its load explains nothing"
    for name in model.hardware:
        if name in model.computers:
            continue
        if name not in driven and name not in feeders and name not in ruled:
            yield f"hardware {name}: no node drives it, and no rule mentions it"


def _in_user_rules(system: System) -> set[str]:
    """Return the components that rules of the user's own blame."""
    cnf = system.cnf
    return {
        cnf.components[abs(literal) - 1]
        for clause, origin in zip(cnf.clauses, cnf.origins, strict=True)
        if cnf.rules[origin].source.startswith("user rule")
        for literal in clause
        if abs(literal) <= len(cnf.components)
    }


def self_locking(system: System) -> Iterator[str]:
    """An `act_when` that speaks of what a repair itself takes away: then nothing could be repaired."""
    model = system.parts
    if model is None or system.act_when is None:
        return
    publishers = publishers_of(model)
    for atom in system.act_when.atoms:
        name = atom.args[-1] if atom.args else ""
        nodes = publishers.get(name, []) if atom.predicate == "ok" else []
        by = [node.name for node in nodes] or [name] * (atom.predicate in {"on", "running"})
        if by:
            yield (
                f"act_when speaks of {atom}: while {' or '.join(by)} is broken or being repaired it may not "
                "be observed, and then nothing is sent; observe it by other means"
            )


def without_alternative(system: System) -> Iterator[str]:
    """Functions of which one component's fault leaves no variant."""
    model = system.parts
    if model is None:
        return
    for function in model.functions.values():
        needed = [
            frozenset(need.component for need in needs_of(variant, model) if need.component is not None)
            for variant in function.variants.values()
        ]
        shared = sorted(frozenset.intersection(*needed))
        if shared:
            yield (
                f"function {function.name}: every variant needs {', '.join(shared[:SHOWN])}; without it none "
                "is left"
            )
        if len(function.variants) > 1 and not any(variant.do for variant in function.variants.values()):
            yield f"function {function.name}: no variant has acts (`do:`), so that nothing can change it"
        elif len(function.variants) > 1:
            for variant in function.variants.values():
                if not variant.do:
                    yield f"{function.name}.{variant.name} has no acts (`do:`), so that nothing changes to it"


def partial_priors(system: System) -> Iterator[str]:
    """Priors on some components only."""
    priors = system.cnf.priors
    without = [name for name in system.cnf.components if name not in priors]
    if priors and without:
        some = ", ".join(without[:5]) + ("…" if len(without) > 5 else "")
        yield (
            f"{len(without)} of {len(system.cnf.components)} components have no prior ({some}): "
            "a diagnosis that blames one has no probability"
        )
