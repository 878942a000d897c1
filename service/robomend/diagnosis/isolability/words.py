"""The answer in sentences: what to watch, and what a rule of one's own could add.

A rule helps where the model has no observable left: `not ab(camera) -> ok(current,camera)` makes the
current of its channel rest on the camera alone, so that it tells the camera from all else. A pair of
related values (clause scheme 6) rests on the two nodes that publish them, and tells either from the rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from robomend.diagnosis.isolability.analysis import Ambiguity, Isolability
from robomend.model.components import ComponentModel
from robomend.model.functions import left_without, spoken_of
from robomend.model.schemes import publishers_of
from robomend.model.system import System
from robomend.model.vocabulary import ACTIVE
from robomend_client.counts import counted, first_few
from robomend_client.literals import Atom, quote

SHOWN = 12
"""Names in one sentence."""


SELF_TEST = "self_test"
"""A property that is suggested where the model has none."""


@dataclass(frozen=True, slots=True)
class Suggestion:
    """Something that could be added to the model, and what to watch then."""

    add: str  # a rule, or `related: [v, w]`
    watch: Atom


def watched(atom: Atom, parts: ComponentModel | None) -> str:
    """Return what is watched to observe an atom, e.g. `the current of channel 4`."""
    args = atom.args
    match atom.predicate, args:
        case "on", (device,):
            where = _channel(device, parts)
            return f"whether {device} is on{f' ({where})' if where else ''}"
        case "running", (node,):
            return f"whether {node} runs"
        case "ok", ("current", device):
            return f"the current of {_channel(device, parts) or device}"
        case "ok", ("CPU", node):
            return f"the processor time of {node}"
        case "ok", ("Mem", node):
            return f"the memory of {node}"
        case "ok", (topic,):
            return topic
        case "ok", (name, component) if name == SELF_TEST:
            return f"a self-test of {component}, or what another sensor says of the same"
        case "ok", (name, component):
            return f"the {name} of {component}"
        case "matched", (one, other):
            return f"whether {one} and {other} go together"
        case "inc" | "dec" | "const", (value,):
            return f"the trend of {value}"
    return str(atom)


def suggestions(group: Ambiguity, system: System) -> tuple[Suggestion, ...]:
    """Return what could be added so that the faults of a group are told apart; nothing for other models than
    component models, and for double faults.
    """
    parts = system.parts
    if parts is None or any(len(fault) > 1 for fault in group.faults):
        return ()
    used = frozenset(system.cnf.atoms)
    names = [fault[0] for fault in group.faults]
    others = {*names, *(name for rival in group.rivals for name in rival)}
    found: list[Suggestion] = []
    for name in names:
        for atom in _own(name, parts):
            if atom not in used:
                found.append(Suggestion(f"not ab({quote(name)}) -> {atom}", atom))
                break
        found += _trends(name, others, parts, used)
    return tuple(found)


def _own(name: str, parts: ComponentModel) -> Iterator[Atom]:
    """Yield what could be observed of one component alone, the usual first."""
    if name in parts.hardware:
        if parts.switchable(name):
            yield Atom("ok", ("current", name))
            yield Atom("on", (name,))
        for prop in parts.properties:
            yield Atom("ok", (prop, name))
        yield Atom("ok", (SELF_TEST, name))  # of what has no channel nobody sees whether it is on
    else:
        yield Atom("running", (name,))
        yield Atom("ok", ("CPU", name))


def _trends(
    name: str, others: Iterable[str], parts: ComponentModel, used: frozenset[Atom]
) -> Iterator[Suggestion]:
    """Yield the first related pair that rests on a node and on one outside the group."""
    node = parts.nodes.get(name)
    if node is None:
        return
    publishers = publishers_of(parts)
    outside = frozenset(others)
    for own in parts.values.values():
        if own.topic not in node.publishes or len(publishers[own.topic]) > 1:
            continue
        for value in parts.values.values():
            nodes = publishers.get(value.topic, [])
            first, second = sorted((own.name, value.name))
            atom = Atom("matched", (first, second))
            if len(nodes) == 1 and nodes[0].name not in outside and atom not in used:
                yield Suggestion(f"related: [[{first}, {second}]]", atom)
                return


def sentences(found: Isolability, system: System) -> list[str]:
    """Return the answer for people, the whole first, then group by group."""
    return [
        *summary(found, system),
        *(told for group in found.ambiguities for told in group_words(group, system)),
        *(told for group in found.undetectable for told in undetectable_words(group, system)),
        *(_double_words(found, system) if found.double_faults is not None else ()),
    ]


def summary(found: Isolability, system: System) -> Iterator[str]:
    """Yield how many faults can be detected and told apart, and what stands in the way of a whole answer."""
    count = len(found.faults)
    shown = sum(1 for known in found.detectable if known)
    apart = sum(
        1
        for known, row in zip(found.detectable, found.matrix, strict=True)
        if known and "-" not in row and "?" not in row
    )
    always = sum(
        1
        for known, row in zip(found.detectable, found.matrix, strict=True)
        if known and set(row) <= {"+", "="}
    )
    yield (
        f"{shown} of {counted(count, 'single fault')} can be detected by "
        f"{counted(len(found.observed), 'observable')}: {always} always told from every other fault, "
        f"{apart - always} by some symptoms only, {shown - apart} not"
    )
    alike = [
        f"{_fault(found.faults[i])} / {_fault(found.faults[j])}"
        for i, row in enumerate(found.matrix)
        for j, place in enumerate(row)
        if i < j and place == "~" == found.matrix[j][i]
    ]
    if alike:
        yield (f"told apart by some symptoms only: {_some(alike)}")
    if not found.complete:
        yield "time ran out: what is not known is marked ?, and not every group was looked at"
    of_functions = spoken_of(system.conditions)
    chooses = [atom for atom in found.unused if atom.predicate == ACTIVE or atom in of_functions]
    if chooses:
        yield f"{_some(map(str, chooses))}: decides how functions work, and tells no fault from another"
    if idle := [atom for atom in found.unused if atom not in chooses]:
        yield f"no rule mentions {_some(map(str, idle))}: observing it adds nothing"


def group_words(group: Ambiguity, system: System) -> Iterator[str]:
    """Yield what cannot be told apart, what to watch, and what would remain."""
    faults = [_fault(fault) for fault in group.faults]
    rivals = [_fault(fault) for fault in group.rivals]
    if len(faults) > 1:
        text = f"{_some(faults)} cannot be told apart"
        if rivals:
            text += f", nor from {_some(rivals, 'or')}"
    else:
        text = f"{faults[0]} cannot be told from {_some(rivals, 'or')}"
    yield text + _remedy(group, system)
    yield from _left(group, system)
    yield from _whichever(group, system)


def _whichever(group: Ambiguity, system: System) -> Iterator[str]:
    """Yield how the functions work without all that cannot be told apart."""
    parts = system.parts
    if parts is None or not parts.functions:
        return
    names = {name for fault in (*group.faults, *group.rivals) for name in fault}
    for function, variant in left_without(names, parts).items():
        how = "has no variant left" if variant is None else f"can work by {variant}"
        yield f"  whichever it is, {function} {how}"


def undetectable_words(group: Ambiguity, system: System) -> Iterator[str]:
    """Yield that a fault shows nothing, and what would show it."""
    yield f"a fault of {_fault(group.faults[0])} cannot be detected{_remedy(group, system)}"
    yield from _left(group, system)


def _remedy(group: Ambiguity, system: System) -> str:
    further = group.further
    if further is None:
        return " (there was no time to look for what would help)"
    if not further.atoms:
        return ""
    what = [watched(atom, system.parts) for atom in further.atoms]
    partly = " (it helps in part)" if further.left else ""
    return f": watch {_some(what)}; {further.cost_s:g} s{partly}"


def _left(group: Ambiguity, system: System) -> Iterator[str]:
    """Yield what no observable of the model tells apart, with what could be added."""
    further = group.further
    if further is None or not further.left:
        return
    pairs = [
        f"{_fault(fault)} from {_fault(rival) if rival else 'a healthy robot'}"
        for fault, rival in further.left
    ]
    yield f"  no observable of the model tells {_some(pairs)}"
    left = {fault for fault, _ in further.left}
    stuck = Ambiguity(tuple(sorted(left)), group.rivals, None)
    for suggestion in suggestions(stuck, system)[:SHOWN]:
        yield f"  `{suggestion.add}` would: watch {watched(suggestion.watch, system.parts)}"


def _double_words(found: Isolability, system: System) -> Iterator[str]:
    doubles = found.double_faults
    assert doubles is not None
    shown = sum(doubles.detectable)
    more = "" if doubles.complete else " (there are more)"
    yield (
        f"double faults: of {len(doubles.faults)} compared{more}, "
        f"{shown} can be seen to be double, "
        f"{shown - len(doubles.ambiguities)} of these told from every other fault that was compared"
    )
    for group in doubles.ambiguities[:SHOWN]:
        yield from group_words(group, system)
    if len(doubles.ambiguities) > SHOWN:
        yield f"and {len(doubles.ambiguities) - SHOWN} more double faults that cannot be told from others"


def _channel(device: str, parts: ComponentModel | None) -> str:
    hardware = None if parts is None else parts.hardware.get(device)
    return "" if hardware is None or hardware.channel is None else f"channel {hardware.channel}"


def _fault(names: Sequence[str]) -> str:
    return " with ".join(names)


def _some(names: Iterable[str], word: str = "and") -> str:
    known = list(names)
    if len(known) > SHOWN:
        return first_few(known, SHOWN)
    if len(known) < 2:
        return "".join(known)
    return f"{', '.join(known[:-1])} {word} {known[-1]}"
