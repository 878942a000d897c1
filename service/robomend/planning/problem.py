"""From a diagnosis to a planning problem: pure, no search, no planner.

    OBS ∪ bad(c) ∪ good(c) of a diagnosis ──► completed initial state, goal (good c) for what is meant to work

The paper's initial state is OBS ∪ {bad, good} (section IV-E); planners read what is absent as false, so it is
completed until exactly one of on/off, running/stopped and good/bad holds for each component:

    unobserved         true for good components; for bad ones assumed true, and the assumption is listed
    no channel         hardware without one is on
    stopped or off     implies bad: what does not run does not work, whatever the diagnosis blames
    tied to a stopped  implies bad: it holds a connection to a process that is gone, and must restart
    lingers            stopped, and not known to have ended: it is stopped before it is started
    node that starts   after it, as it must after one that a plan stops

A bad component of unknown state is taken to be on: shutdown and power_up then also mend one that was off,
while the opposite guess would send a command without effect.

Static facts come from the model: `drives` and `tied` as written; `loses` of drivers that do not reconnect;
`fed_by` up the whole chain of feeders, so that it leads to every channel that the device loses its power
with; `hangs_on` of devices without channel: the nearest channels up the chain, with which they come back by
themselves. `needs(n, m)` holds when something that n publishes rests on a topic of m, or n is tied to m.
Cycles of topics are normal, so within a strongly connected component of `needs` there is no order to keep.
A remedy of the model is an object, named as its act, `clear_costmap(planner)`; it rests on what its
components drive, are fed by and need.
Facts of predicates that the domain does not declare are left out, so one builder serves every domain.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from robomend.errors import DomainError, UnknownComponent
from robomend.model.components import KINDS, ComponentModel, Hardware, Node, Remedy
from robomend.model.loops import strong_components
from robomend.planning.domain.values import PAIRS, Declared, Domain
from robomend.planning.protection import protection
from robomend_client.actions import offered
from robomend_client.counts import first_few
from robomend_client.literals import Atom, Literal
from robomend_client.near import did_you_mean

# --- who of a robot's agents can do what, by action and parameter: what nobody can do is not planned.
#
# An agent says with each poll what it is handed (robomend.repairs.agent_queue holds it to that); an action
# that none of them is handed would wait for its time-out, and then not have been done. Pure; values only.

NAMED = 5
"""Parameters that a reason lists of an agent; the rest is counted."""


@dataclass(frozen=True, slots=True)
class Offer:
    """What one agent says."""

    agent: str
    host: str | None = None
    can: frozenset[str] | None = None  # None: anything


@dataclass(frozen=True, slots=True)
class Offers:
    """Who can carry out what now."""

    agents: tuple[Offer, ...]
    actions: frozenset[str]  # those that agents carry out, if all that are there are among them
    hosts: Mapping[str, str | None] = field(default_factory=dict)  # component -> whose agents act on it
    by_hand: Mapping[str, str] = field(default_factory=dict)  # action -> why only a person can do it

    def any_does(self, name: str) -> bool:
        """Return whether an agent does an action at all, on whatever."""
        return name not in self.actions or any(
            agent.can is None or name in agent.can or any(one.startswith(f"{name}:") for one in agent.can)
            for agent in self.agents
        )

    def why_nobody(self, name: str, parameters: Sequence[str]) -> str | None:
        """Return why an action would find nobody, or None.

        Of a host none of whose agents was heard nothing is known: one may be about to come back.
        """
        if name not in self.actions or name in self.by_hand:
            return self.by_hand.get(name)
        host = next((self.hosts[each] for each in parameters if self.hosts.get(each)), None)
        there = [agent for agent in self.agents if host is None or agent.host == host]
        if not there or any(offered(agent.can, name, parameters) for agent in there):
            return None
        said = "; ".join(f"{agent.agent} does {_listed(name, agent.can or ())}" for agent in there[:NAMED])
        more = f" and {len(there) - NAMED} more agents" if len(there) > NAMED else ""
        return f"no agent{f' on {host}' if host else ''} offers it ({said}{more})"


def _listed(name: str, can: frozenset[str] | tuple[()]) -> str:
    """Return on what an agent does an action."""
    said = (one.partition(":")[2] for one in can if one.startswith(f"{name}:"))
    on = sorted(f"({one.replace(',', ', ')})" if "," in one else one for one in said)
    if not on:
        return f"no {name}"
    return f"{name} of {first_few(on, NAMED)}"


@dataclass(frozen=True, slots=True)
class Restrictions:
    """What a plan must leave alone, and what nobody can do."""

    expected_stopped: tuple[str, ...] = ()
    """Components that are meant to be off: no goal, not needed by others, touched by nothing but the user's
    own actions (a spare that stands in)."""
    quarantined: tuple[str, ...] = ()
    """Components that must not be tried again now: no goal, never touched, but for what loses its connection
    or its like when what is bad is repaired: its own repairs failed under another diagnosis."""
    protected: tuple[str, ...] = ()  # never shut down nor stopped, besides what the model marks
    avoided: tuple[tuple[str, str], ...] = ()  # ground actions, as `power_up(lidar)`, and why
    forbidden: tuple[tuple[str, str], ...] = ()  # actions by name, on whatever, and why
    offers: Offers | None = None  # what the robot's agents say they can do; None: nobody knows
    lingering: tuple[str, ...] = ()  # nodes that may still be there where they are observed not to run


UNRESTRICTED = Restrictions()


Fact = tuple[str, ...]
"""A ground atom as (predicate, arguments…): cheaper to hash than Atom by far."""

REMEDY, MEND = "remedy", "mend"
"""The type of what the model offers under `remedies`, and the action that all of it is to a planner."""

REMEDY_COST = 2.0
"""Of that action in pddl/repair.pddl."""


@dataclass(frozen=True)
class RepairProblem:
    """A planning problem in the model's own names; values only."""

    name: str
    objects: Mapping[str, str]  # name -> type; components first, in the order of the model
    initial: frozenset[Fact]
    goal: tuple[Fact, ...]
    components: frozenset[str] = frozenset()
    assumed: tuple[Literal, ...] = ()  # facts of bad components that nobody observed
    excluded: tuple[str, ...] = ()  # left out of the goal, and left alone
    idle: frozenset[str] = frozenset()  # of these, those meant to be off: the user's actions may use them
    protected: Mapping[str, str] = field(default_factory=dict)  # never shut down -> why
    avoided: Mapping[str, str] = field(default_factory=dict)  # ground action as text -> why it is not used
    forbidden: Mapping[str, str] = field(default_factory=dict)  # action by name -> why it is not used
    offers: Offers | None = None  # what agents say they can do; None: nobody knows
    costs: Mapping[str, float] = field(
        default_factory=dict
    )  # factor for actions on this component, or remedy
    acts: Mapping[str, tuple[str, tuple[str, ...]]] = field(
        default_factory=dict
    )  # remedy -> what is asked for

    def as_pddl(self, name: str, parameters: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
        """Return an act as the domain has it: that of a remedy is `mend(clear_costmap(planner))`."""
        act = f"{name}({', '.join(parameters)})"
        return (MEND, (act,)) if act in self.acts else (name, parameters)


def repair_problem(
    model: ComponentModel,
    domain: Domain,
    observed: Iterable[Literal],
    bad: Collection[str],
    restrictions: Restrictions = UNRESTRICTED,
) -> RepairProblem:
    """Return the problem of making every component good, starting from OBS and one diagnosis.

    Args:
        observed: OBS; literals of predicates that the domain does not declare are skipped.
        bad: the diagnosis; every other component is taken to be good.

    Raises:
        UnknownComponent: a name above is no component of the model.
        DomainError: an object or fact of the user's text does not fit the model.
    """
    components = model.components
    known = frozenset(components)
    for name in (*bad, *restrictions.expected_stopped, *restrictions.quarantined, *restrictions.protected):
        if name not in known:
            raise UnknownComponent(name, known)
    seen = {literal.atom: literal.positive for literal in observed}
    facts: set[Fact] = set()
    assumed: list[Literal] = []
    blamed = frozenset(bad)

    def active(predicate: str, name: str, switchable: bool) -> bool:
        """Whether the component is on or runs, as seen or assumed."""
        atom = Atom(predicate, (name,))
        if atom in seen:
            return seen[atom]
        if name in blamed and switchable:
            assumed.append(Literal(atom))
        return True

    for name, hardware in model.hardware.items():
        is_on = hardware.channel is None or active("on", name, True)
        facts.update([("on", name)] if is_on else [("off", name), ("not_on", name)])
        if hardware.channel is not None:
            facts.add(("switchable", name))
        facts.update(("fed_by", name, feeder) for feeder in model.feeders(name))
        if hardware.channel is None:
            nearest = _feeders(model, hardware)
            facts.update(("hangs_on", name, feeder) for feeder in nearest if model.switchable(feeder))
        facts.add(("good" if is_on and name not in blamed else "bad", name))
    aside = frozenset(restrictions.expected_stopped)
    needs = {pair for pair in needs_of(model) if pair[1] not in aside}
    shielded = protection(model, restrictions.protected)
    cut_off: frozenset[str] = frozenset()
    if "tied" in domain.predicates:
        left_alone = aside | frozenset(restrictions.quarantined)
        ended = [n for n in model.nodes if seen.get(Atom("running", (n,))) is False and n not in left_alone]
        cut_off = _cut_off(model, ended, aside | shielded.keys())
    for name, node in model.nodes.items():
        runs = active("running", name, node.restartable)
        facts.update([("running", name)] if runs else [("stopped", name), ("not_running", name)])
        if not runs and name in restrictions.lingering:
            facts.add(("lingers", name))
        if node.restartable:
            facts.add(("restartable", name))
        facts.update(("drives", name, device) for device in node.drives)
        if not node.reconnects:
            facts.update(("loses", name, device) for device in node.drives)
        facts.update(("tied", name, other) for other in node.tied_to)
        facts.add(("good" if runs and name not in blamed | cut_off else "bad", name))
    facts.update(("needs", node, other) for node, other in needs)
    for kind in KINDS:
        for name in () if kind in {Hardware, Node} else model.of(kind):
            works = active(kind.state, name, True)
            facts.update([(kind.state, name)] if works else [(lost, name) for lost in kind.lost])
            facts.add(("good" if works and name not in blamed else "bad", name))

    # A domain of somebody else's may not know every kind.
    objects = {
        name: kind.what if kind.what in domain.supertype else "component"
        for kind in KINDS
        for name in model.of(kind)
    }
    remedies = {} if REMEDY not in domain.supertype else {str(one): one for one in model.remedies}
    for act, remedy in remedies.items():
        if remedy.name in domain.schemas:
            raise DomainError(
                f"{remedy.name!r} is a remedy of the model, and an action of its domain as well"
            )
        objects[act] = REMEDY
        facts.update(_remedy_facts(model, act, remedy, needs, aside))
    _add_objects(objects, domain, known)
    _add_facts(facts, domain, objects)
    _add_observed(facts, domain, objects, seen)
    alone = frozenset(restrictions.quarantined) - _dragged_along(model, blamed) - cut_off
    excluded = tuple(name for name in components if name in aside or name in alone)
    parts = model.parts
    return RepairProblem(
        name=model.name,
        objects=objects,
        initial=frozenset(fact for fact in facts if fact[0] in domain.predicates),
        goal=tuple(("good", name) for name in components if name not in excluded),
        components=known,
        assumed=tuple(assumed),
        excluded=excluded,
        idle=aside,
        protected=shielded,
        avoided=dict(restrictions.avoided),
        forbidden=dict(restrictions.forbidden),
        offers=restrictions.offers,
        costs={
            **{name: part.cost for name, part in parts.items() if part.cost is not None},
            **{act: _factor(model, remedy) for act, remedy in remedies.items()},
        },
        acts={act: (remedy.name, remedy.parameters) for act, remedy in remedies.items()},
    )


def needs_of(model: ComponentModel) -> frozenset[tuple[str, str]]:
    """Return the pairs (n, m) where node n rests on a topic of m, or is tied to it; cycles left out."""
    publishers: dict[str, list[str]] = {}
    for name, node in model.nodes.items():
        for topic in node.publishes:
            publishers.setdefault(topic, []).append(name)
    successors: dict[str, list[str]] = {}
    for name, node in model.nodes.items():
        inputs = dict.fromkeys(topic for topics in node.publishes.values() for topic in topics)
        others = [other for topic in inputs for other in publishers.get(topic, ()) if other != name]
        successors[name] = [*others, *node.tied_to]
    cluster = strong_components(successors)
    return frozenset(
        (name, other)
        for name, others in successors.items()
        for other in others
        if cluster[name] != cluster[other]
    )


def _remedy_facts(
    model: ComponentModel,
    act: str,
    remedy: Remedy,
    needs: Collection[tuple[str, str]],
    aside: Collection[str],
) -> Iterator[Fact]:
    """Yield what the domain must know of a remedy."""
    rests_on = set(remedy.needs)
    for name in remedy.mends:
        yield "mends", act, name
        if (node := model.nodes.get(name)) is not None:
            yield "begins" if remedy.starts else "asks", act, name
            rests_on.update(node.drives, (other for one, other in needs if one == name))
        elif name in model.hardware:
            rests_on.update(model.feeders(name))
    for name in rests_on.difference(remedy.mends, aside):
        yield "rests_on", act, name
    for name in remedy.restarts:
        yield "upsets", act, name


def _factor(model: ComponentModel, remedy: Remedy) -> float:
    """Return how many times the domain's cost it has: its own, or else as its component says."""
    if remedy.cost is not None:
        return remedy.cost / REMEDY_COST
    return model.parts[remedy.mends[0]].cost or 1.0


def _dragged_along(model: ComponentModel, bad: frozenset[str]) -> frozenset[str]:
    """Return the nodes that must be restarted when bad devices are repaired, less those that are bad."""
    cut = {name for name in model.hardware if name in bad or not bad.isdisjoint(model.feeders(name))}
    found = {
        name for name, node in model.nodes.items() if not node.reconnects and cut.intersection(node.drives)
    }
    while more := {name for name, node in model.nodes.items() if not found.isdisjoint(node.tied_to)} - found:
        found |= more
    return frozenset(found) - bad


def _cut_off(model: ComponentModel, ended: Collection[str], kept: Collection[str]) -> frozenset[str]:
    """Return the nodes that are tied to one that is to be started anew, and to what must restart for that.

    `kept`: may not be stopped, and stay as they are; what they were tied to is gone in any case.
    """
    starting = frozenset(name for name in ended if model.nodes[name].restartable)
    found = set(starting)
    while (
        more := {
            name
            for name, node in model.nodes.items()
            if node.restartable and name not in kept and not found.isdisjoint(node.tied_to)
        }
        - found
    ):
        found |= more
    return frozenset(found) - starting


def _feeders(model: ComponentModel, device: Hardware) -> list[str]:
    """Return what feeds a device, directly or through devices that have no channel of their own."""
    found = list(device.fed_by)
    for name in found:  # grows on the way
        feeder = model.hardware[name]
        if feeder.channel is None:
            found.extend(other for other in feeder.fed_by if other not in found)
    return found


def _add_objects(objects: dict[str, str], domain: Domain, components: frozenset[str]) -> None:
    """Add the user's objects and the domain's constants; one may give a component a narrower type."""
    folded: dict[str, str] = {}
    for name in objects:
        folded.setdefault(name.lower(), name)
    declared = [Declared((name, kind), (False, False), 0, None) for name, kind in domain.constants.items()]
    for one in (*declared, *domain.objects):
        written, kind = one.words
        name = written if written in objects or one.quoted[0] else folded.get(written, written)
        if name not in objects:
            if domain.is_a(kind, "component"):
                raise DomainError(
                    f"{written!r} is declared a {kind}, but the model has no such component",
                    one.file,
                    one.line,
                )
            objects[name] = kind
            folded.setdefault(name.lower(), name)
        elif domain.is_a(kind, objects[name]):
            objects[name] = kind
        elif not domain.is_a(objects[name], kind):
            raise DomainError(f"{name!r} is a {objects[name]}, not a {kind}", one.file, one.line)


def _add_facts(facts: set[Fact], domain: Domain, objects: Mapping[str, str]) -> None:
    """Add the user's init, with names looked up in the model."""
    folded: dict[str, str] = {}
    for name in objects:
        folded.setdefault(name.lower(), name)
    for one in domain.facts:
        predicate = domain.predicates[one.words[0]]
        names: list[str] = []
        for word, quoted, wanted in zip(one.words[1:], one.quoted[1:], predicate.types, strict=True):
            name = word if word in objects or quoted else folded.get(word, word)
            if name not in objects:
                raise DomainError(
                    f"{word!r} is neither a component of the model nor in (:objects …)"
                    f"{did_you_mean(word, objects)}",
                    one.file,
                    one.line,
                )
            if not domain.is_a(objects[name], wanted):
                raise DomainError(
                    f"{predicate.name} wants a {wanted} here, and {name} is a {objects[name]}",
                    one.file,
                    one.line,
                )
            names.append(name)
        facts.add((predicate.name, *names))


COMPLETED = frozenset(name for pair in PAIRS for name in pair)
"""Predicates that the completion above decides."""


def _add_observed(
    facts: set[Fact], domain: Domain, objects: Mapping[str, str], seen: Mapping[Atom, bool]
) -> None:
    """Let OBS speak for the user's own predicates: the paper's I = OBS ∪ …"""
    for atom, positive in seen.items():
        predicate = domain.predicates.get(atom.predicate)
        if predicate is None or atom.predicate in COMPLETED or len(predicate.types) != len(atom.args):
            continue
        if all(
            name in objects and domain.is_a(objects[name], wanted)
            for name, wanted in zip(atom.args, predicate.types, strict=True)
        ):
            fact = (atom.predicate, *atom.args)
            facts.add(fact) if positive else facts.discard(fact)


# --- a repair problem as PDDL text, for people and for other planners.
#
# Names that are no PDDL words, or that differ in case only, become `o7`; a comment says what each stands
# for.

WORD = re.compile(r"[A-Za-z][A-Za-z0-9_-]*\Z")


def problem_text(domain: Domain, problem: RepairProblem, goal: Iterable[Fact]) -> str:
    """Return the problem file that goes with `domain.pddl`."""
    names = pddl_names(problem.objects)
    renamed = [f";; {word} is {name}" for name, word in names.items() if word != name.lower()]
    lines = [
        ";; Made by robomend. Protected and excluded components are not expressed here: their shutdown and",
        ";; stop actions are left out before planning.",
        *renamed,
        f"(define (problem {_word(problem.name)})",
        f"  (:domain {domain.name})",
        "  (:objects",
    ]
    by_type: dict[str, list[str]] = {}
    for name, kind in problem.objects.items():
        if name not in domain.constants:
            by_type.setdefault(kind, []).append(names[name])
    lines += [f"    {' '.join(members)} - {kind}" for kind, members in by_type.items()]
    lines[-1] += ")"
    lines.append("  (:init")
    lines += [f"    {_fact(fact, names)}" for fact in sorted(problem.initial)]
    lines += ["    (= (total-cost) 0))", "  (:goal (and"]
    lines += [f"    {_fact(fact, names)}" for fact in goal]
    lines += ["  ))", "  (:metric minimize (total-cost)))", ""]
    return "\n".join(lines)


def pddl_names(objects: Iterable[str]) -> dict[str, str]:
    """Return object -> its word in the problem file, each word once."""
    found: dict[str, str] = {}
    taken: set[str] = set()
    for index, name in enumerate(objects):
        word = name.lower()
        if not WORD.match(name) or word in taken:
            word = f"o{index}"
            while word in taken:
                word += "x"
        taken.add(word)
        found[name] = word
    return found


def _word(name: str) -> str:
    return name.lower() if WORD.match(name) else "robot"


def _fact(fact: Fact, names: dict[str, str]) -> str:
    return f"({' '.join((fact[0], *(names[name] for name in fact[1:])))})"
