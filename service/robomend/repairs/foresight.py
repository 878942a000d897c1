"""What will not work, or not be noticed, on a robot as it is configured and observed now: in sentences.

What can be known for good is refused when the robot is configured (robomend.robots.configuring); the rest
depends on what changes afterwards: the model, the service's settings, who reports and who asks for work.
GET /robots/{id} and `robomend doctor --robot` list it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

from robomend.entry import Entry
from robomend.errors import RobomendError
from robomend.model.components import ComponentModel
from robomend.model.schemes import publishers_of
from robomend.observations.language import parse
from robomend.observations.obs import Contradiction
from robomend.planning.policy import NODE_ACTIONS, POWER_ACTIONS
from robomend.planning.problem import Offers
from robomend.repairs.execution_values import Timing, timings
from robomend.repairs.executors.registry import EXECUTORS, Surroundings, kind_of
from robomend.repairs.headline import starved, starving, told
from robomend.robots.clock import CLOCK
from robomend.robots.configuration import RobotConfig
from robomend.robots.robot import Robot
from robomend_client.counts import first_few
from robomend_client.literals import Atom
from robomend_client.readings import Symptom

ROOM = 1.5
"""By so much a start may take longer than the model says (robomend.robots.start_ups)."""

TOO_LONG = 5
"""What the model says is wrong if it is so many times as long as what was seen."""

SHOWN = 10
"""Names that a sentence lists."""

WITHOUT_NS = 3 * 10**9
"""An output that came for so long while an input was silent does not rest on it: no queue holds so much."""


@dataclass(frozen=True, slots=True)
class Asked:
    """Which agents of a robot have asked for work lately."""

    hosts: Collection[str | None]  # None: an agent that said no host
    within_s: float
    offers: Offers | None = None  # what they say they can do; None: one may be there that was not heard


def findings(
    state: Robot, faults: Iterable[str], actions: Iterable[str], around: Surroundings, asked: Asked | None
) -> list[str]:
    """Return what is to be known of a robot before a fault; nothing where all is well.

    Args:
        faults: what would be refused if the robot were configured now (robomend.robots.configuring).
        actions: the names of its domain's.
        around: with the robot's board, if one is configured.
        asked: None where nobody can know, as the service is not asked.
    """
    now_ns = CLOCK.now_ns()
    found = [*faults, *(told(starving(*one), now_ns) for one in starved(state))]
    found += [*contradicted(state), *_unheard(state), *_of_one_name(state)]
    if state.config.policy != "observe" and state.system.parts is not None:
        found += _carried_out(state, actions, around, asked)
        found += _slow(state)
        if (why := state.interlocked()) is not None:
            found.append(f"nothing is sent to the robot now: {why}")
    return [*found, *_unobserved(state), *_not_active(state)]


def doubts(parts: ComponentModel | None, entries: Iterable[Entry]) -> list[dict[str, str]]:
    """Return the arrows of a model that what is known contradicts: outputs that came while what they are said
    to rest on was silent; each as JSON.
    """
    known = {entry.atom: entry for entry in entries}
    found = []
    for name, node in (parts.nodes if parts is not None else {}).items():
        for topic, inputs in node.publishes.items():
            out = known.get(Atom("ok", (topic,)))
            if out is None or not out.positive or out.since_ns is None:
                continue
            for one in inputs:
                given = known.get(Atom("ok", (one,)))
                if given is None or given.positive or given.onset_ns is None or given.reading is None:
                    continue
                silent = given.reading.symptom is Symptom.SILENT
                if silent and out.since_ns - given.onset_ns >= WITHOUT_NS:
                    text = f"{name} was healthy without {one}: that {topic} rests on it may be wrong"
                    found.append({"node": name, "topic": topic, "input": one, "text": text})
    return found


def _not_active(state: Robot) -> Iterator[str]:
    for name, function in state.function_states().items():
        if function.unknown:
            yield f"{function.unknown}: it is not changed before one is, as active({name}, …)"


def contradicted(state: Robot) -> list[str]:
    """Say about what sources contradict each other now; no act follows from that."""
    return [_who_says_what(one) for one in state.obs.contradictions(CLOCK.now_ns())]


def _who_says_what(one: Contradiction) -> str:
    yes, no = (_some(map(_said, words)) for words in (one.holds, one.fails))
    what = "it is unknown: `believe` or `bad_wins` of the robot says who counts"
    if one.believed is not None:
        what = f"{one.believed.source} is believed"
    where = ""
    if one.atom.predicate == "ok":
        heard, not_heard = (_some(entry.source for entry in words) for words in (one.holds, one.fails))
        where = f"; seen from {heard}, not from {not_heard}: look at what is between them"
    return f"sources contradict each other about {one.atom}: {yes}, {no}{where}; {what}"


def _said(entry: Entry) -> str:
    measured = f" ({entry.reading})" if entry.reading else ""
    return f"{entry.source} reports {entry.literal}{measured}"


def _unheard(state: Robot) -> Iterator[str]:
    if state.config.believe:
        known = state.obs.sources() | state.sight.sources()
        if missing := [source for source in state.config.believe if source not in known]:
            yield f"`believe` names {_some(missing)}, and no source of that name has reported anything yet"


def _of_one_name(state: Robot) -> Iterator[str]:
    remedy = "give each its own (`agent:` of the agent's file)"
    for agent, hosts in state.sight.declared.of_one_name():
        where = " and ".join("a host that is not said" if host is None else repr(host) for host in hosts)
        yield f"two agents call themselves {agent!r}, on {where}: {remedy}"
    for source in state.sight.twins.names(CLOCK.now_ns()):
        yield (
            f"the source {source!r} contradicts itself by evidence from the same time, as two agents of one "
            f"name do: {remedy}"
        )


def _carried_out(
    state: Robot, actions: Iterable[str], around: Surroundings, asked: Asked | None
) -> Iterator[str]:
    config, parts = state.config, state.system.parts
    assert parts is not None
    by_agent: list[str] = []
    for action in _needed(state, actions):
        kind, options = kind_of(action, config.actions)
        try:
            made = EXECUTORS.load(kind)(action, options, around)
        except RobomendError as error:
            yield str(error)
            continue
        if kind == "agent":
            by_agent.append(action)
        if made is None:
            yield (
                f"{action}: nobody carries it out: the robot has no `board`; configure one, or another "
                f"`actions.{action}.executor`"
            )
    if asked is None or not by_agent:
        return
    what = ", ".join(by_agent)
    if not asked.hosts:
        yield (
            f"{what}: no agent of this robot has asked for work within {asked.within_s:.0f} s: start "
            "robomend-agent on it"
        )
    elif None not in asked.hosts:
        hosts = {node.host for node in parts.nodes.values() if node.restartable and node.host is not None}
        for host in sorted(hosts - set(asked.hosts)):
            yield (
                f"{what}: no agent on host {host!r}, where the model has nodes, has asked for work within "
                f"{asked.within_s:.0f} s"
            )
    if asked.offers is not None:
        yield from _nobody_does(parts, by_agent, asked.offers)


def _nobody_does(parts: ComponentModel, by_agent: Iterable[str], offers: Offers) -> Iterator[str]:
    """Name what no plan will have: what a plan may need, and none of the agents that are there does."""
    nodes = [name for name, node in parts.nodes.items() if node.restartable]
    devices = [name for name in parts.hardware if parts.switchable(name)]
    for action in by_agent:
        if action in NODE_ACTIONS | POWER_ACTIONS:
            of = nodes if action in NODE_ACTIONS else devices
            if left := [name for name in of if offers.why_nobody(action, (name,))]:
                yield f"{action} of {_some(left)}: no agent of this robot offers it, and no plan will have it"
        elif not offers.any_does(action):
            yield f"{action}: no agent of this robot offers it, and no plan will have it"


def _slow(state: Robot) -> Iterator[str]:
    """Compare how long starts and boots took with the model and the configured time-outs."""
    parts, seen = state.system.parts, state.sight.start_ups
    assert parts is not None
    awaited_s = timings(state.config.actions, ()).get("start_node", Timing()).effect_timeout_s
    for name, node in parts.nodes.items():
        took_s = seen.seen_s(node, powered=False)
        said_s, limit = (awaited_s, "`effect_timeout_s` of start_node")
        if node.start_s is not None:
            said_s, limit = node.start_s * ROOM, "its `start_s`"
        if took_s > said_s:
            yield (
                f"{name}: a start took {took_s:.1f} s, which is longer than {limit} allows ({said_s:g} s); "
                "it is waited for as long as such starts are remembered: write "
                f"`start_s: {math.ceil(took_s)}` in its model"
            )
        if node.start_s is not None and took_s and node.start_s > TOO_LONG * max(took_s, 1.0):
            yield (
                f"{name}: its `start_s` is {node.start_s:g}, and the longest of its latest starts took "
                f"{took_s:.1f} s: a start in vain is waited for too long"
            )
        devices = [parts.hardware[device] for device in node.drives]
        powered_s = seen.seen_s(node, powered=True)
        boots_s = max((device.boot_s or 0.0 for device in devices), default=0.0)
        if powered_s > max(took_s, awaited_s) and powered_s > boots_s * ROOM:
            said = f"the model says {boots_s:g} s" if boots_s else "the model says no `boot_s`"
            yield (
                f"{name}: after {_some(node.drives)} got its power it took {powered_s:.1f} s until it was "
                f"heard, and {said}: a driver that is started too early may stay mute"
            )


def _needed(state: Robot, actions: Iterable[str]) -> list[str]:
    """Return the actions that a plan for this robot may hold."""
    config, parts = state.config, state.system.parts
    assert parts is not None
    aside: set[str] = set()
    if not any(parts.switchable(name) for name in parts.hardware):
        aside |= POWER_ACTIONS
    if not any(node.restartable for node in parts.nodes.values()):
        aside |= NODE_ACTIONS
    return [name for name in actions if name not in aside and (config.allow is None or name in config.allow)]


def _unobserved(state: Robot) -> Iterator[str]:
    observed = _observed(state.config, state)
    silent = [str(atom) for atom in sorted(observed) if state.obs.get(atom) is None]
    if silent:
        yield f"nobody reports {_some(silent)}, which `observed` says that observers do"
    parts = state.system.parts
    if parts is None:
        return
    topics = [
        topic
        for topic in publishers_of(parts)
        if (atom := Atom("ok", (topic,))) not in observed and state.obs.get(atom) is None
        if topic not in parts.topics or not parts.topics[topic].silent
    ]
    if topics:
        yield (
            f"topic{'s' if len(topics) > 1 else ''} {_some(topics)}: not in `observed`, and never reported; "
            f"nobody would notice {'their' if len(topics) > 1 else 'its'} silence"
        )


def _observed(config: RobotConfig, state: Robot) -> frozenset[Atom]:
    found: set[Atom] = set()
    for sentence in dict.fromkeys(config.observed):
        try:
            found.update(literal.atom for literal in parse(sentence, state.system.vocabulary))
        except RobomendError:  # a name that the model has lost: the check of names says so
            continue
    return frozenset(found)


def _some(names: Iterable[str]) -> str:
    return first_few(list(names), SHOWN)
