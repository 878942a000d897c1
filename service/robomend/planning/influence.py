"""What an act may change besides its effects: the names that whatever is observed of is in doubt after it.

    acted on ──fed by──► hardware ──driven by──► nodes ──publish──► topics ──rest on──► further topics, values

What the theory derives from all good components and not without those acted on is the core of it. That alone
misses topics which need each other in circles, or an input from outside: nothing is derived of them. So it is
followed along the model's own arrows, and what the user's rules conclude of those acted on is added, also
where they ask for something that is only observed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from robomend.model.components import ComponentModel
from robomend.planning.prediction import Theory
from robomend_client.literals import Atom


def touched(parts: ComponentModel, acted_on: Iterable[str]) -> frozenset[str]:
    """Return the components acted on, what hangs on them, and the topics and values that rest on them."""
    acted = set(acted_on)
    begun = published(parts, acted)
    topics = begun | _growing(begun, _inputs(parts))
    values = {name for name, value in parts.values.items() if value.topic in topics}
    return frozenset(acted | _hung_on(parts, acted) | topics | values)


def needed(parts: ComponentModel, topics: Iterable[str]) -> dict[str, frozenset[str]]:
    """Return for each of the topics those that it needs, directly or by way of others."""
    inputs, found = _inputs(parts), {}
    for topic in topics:
        before, pending = set[str](), [topic]
        while pending:
            new = inputs.get(pending.pop(), set()) - before
            before |= new
            pending += new
        found[topic] = frozenset(before)
    return found


def _inputs(parts: ComponentModel) -> dict[str, set[str]]:
    """Return topic -> its inputs, whoever publishes it."""
    found: dict[str, set[str]] = {}
    for node in parts.nodes.values():
        for topic, inputs in node.publishes.items():
            found.setdefault(topic, set()).update(inputs)
    return found


def published(parts: ComponentModel, acted_on: Iterable[str]) -> frozenset[str]:
    """Return the topics that the components publish, or the drivers of what hangs on them."""
    acted = set(acted_on)
    hardware = _hung_on(parts, acted)
    publishers = (n for name, n in parts.nodes.items() if name in acted or hardware.intersection(n.drives))
    return frozenset(topic for node in publishers for topic in node.publishes)


def _hung_on(parts: ComponentModel, acted: Collection[str]) -> set[str]:
    """Return the hardware among the components, and what it feeds."""
    hardware = acted & parts.hardware.keys()
    return hardware | _growing(hardware, {name: device.fed_by for name, device in parts.hardware.items()})


def put_out(parts: ComponentModel, components: Iterable[str]) -> frozenset[str]:
    """Return the components, the topics that they or their drivers publish, and the values in those."""
    names = set(components)
    topics = published(parts, names)
    return frozenset(names | topics | {name for name, value in parts.values.items() if value.topic in topics})


def reaches(parts: ComponentModel, acted_on: Collection[str], others: Collection[str]) -> bool:
    """Return whether an act on components can change, by the model, how others work: along its arrows, or as
    they get their power from the same.
    """
    tied = {name for name, node in parts.nodes.items() if not set(acted_on).isdisjoint(node.tied_to)}
    if not (touched(parts, acted_on) | tied).isdisjoint(put_out(parts, others)):
        return True
    return not _power_of(parts, acted_on).isdisjoint(_power_of(parts, others))


def _power_of(parts: ComponentModel, components: Iterable[str]) -> set[str]:
    """Return the devices among the components, those that they drive, and what feeds them."""
    names = set(components)
    names |= {device for name in names & parts.nodes.keys() for device in parts.nodes[name].drives}
    devices = names & parts.hardware.keys()
    return devices | {feeder for device in devices for feeder in parts.feeders(device)}


def influenced(
    parts: ComponentModel, theory: Theory, acted_on: Collection[str], known: Iterable[Atom]
) -> frozenset[Atom]:
    """Return those of the known atoms whose truth an act on these components may change."""
    names = touched(parts, acted_on)
    good = parts.components
    lost = theory.derived(good) - theory.derived(name for name in good if name not in acted_on)
    derived = {literal.atom for literal in lost} | theory.concluded(acted_on)
    return frozenset(atom for atom in known if atom in derived or names.intersection(atom.args))


def _growing(begun: Collection[str], needs: Mapping[str, Iterable[str]]) -> set[str]:
    """Return what needs one of these, directly or by way of others."""
    needed_by: dict[str, list[str]] = {}
    for name, needed in needs.items():
        for one in needed:
            needed_by.setdefault(one, []).append(name)
    found: set[str] = set()
    pending = list(begun)
    while pending:
        for name in needed_by.get(pending.pop(), ()):
            if name not in found:
                found.add(name)
                pending.append(name)
    return found
