"""`model check`: what a model leaves out. Nothing here is wrong, and yet worth knowing before the first
fault."""

from __future__ import annotations

from collections.abc import Iterator

from robomend.model.schemes import publishers_of
from robomend.model.system import System
from robomend_client.literals import Atom

SHOWN = 20


def check(system: System) -> tuple[str, ...]:
    """Return every doubt about a model, as sentences; loading's own warnings come first."""
    return (*system.warnings, *unblamable(system), *unused(system), *partial_priors(system))


def unblamable(system: System) -> Iterator[str]:
    """Components that occur in no clause: no observation can ever lead to them."""
    used = {abs(literal) for clause in system.cnf.clauses for literal in clause}
    names = [name for name, variable in system.cnf.health.items() if variable not in used]
    for name in names[:SHOWN]:
        driven = system.parts is not None and name in system.parts.hardware
        remedy = "; with `blame_hardware: true` its driver's clauses can" if driven else ""
        yield f"no rule can blame {name}{remedy}"
    if len(names) > SHOWN:
        yield f"and {len(names) - SHOWN} more components that no rule can blame"


def unused(system: System) -> Iterator[str]:
    """Declared names that no clause and no other entry mentions."""
    model = system.parts
    if model is None:
        mentioned = set(system.cnf.atoms)
        idle = sorted(str(atom) for atom in system.vocabulary.atoms - mentioned)
        if idle:
            more = f" and {len(idle) - SHOWN} more" if len(idle) > SHOWN else ""
            yield f"no rule mentions {', '.join(idle[:SHOWN])}{more}: observing it says nothing"
        return
    atoms = set(system.cnf.atoms)
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
    for name in model.hardware:
        if name not in driven and name not in feeders:
            yield f"hardware {name}: no node drives it"


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
