"""A robot's innards in time: processes, devices, topics. Pure: it is told the time, and draws from a seed.

    advance(now_s) ──► messages, in the order of their times ──► on_message(topic, time_s)
    plant, order, relay ──► the state changes at once, or when the order's time has passed

A topic is published in its rhythm while its publisher runs, speaks and has warmed up, its devices have power
and have booted, and every input was heard of lately. So silence travels down a chain input by input, and
comes back the same way. What acts and faults change is in condition.py; here are only their times.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from functools import partial
from heapq import heappop, heappush
from typing import Any

from robomend_bench.faults import condition, kinds
from robomend_bench.faults.anatomy import SILENCE_PERIODS, Anatomy
from robomend_bench.faults.condition import HEALTHY, Act, NodeCondition, State
from robomend_bench.faults.kinds import Fault
from robomend_client.actions import OK
from robomend_client.bridges.medkit.faults import Faults, read_fault

JITTER = 0.03
"""Standard deviation of a message's lateness, in periods."""

KICK_PERIODS = 5
"""A node that kicks publishes every so many periods although its inputs are silent."""

RECONNECTS_S = 1.0
"""How long a driver that reconnects by itself takes, from when its device works."""

LIVES_S = 20.0
"""How long each process of a program lives that ends again and again."""

WAVE_S = 7.0
"""The period of values that go up and down."""

AGENT_SWITCHES_S = 0.05
"""How long a switch takes that the robot's own computer does."""

Answer = Callable[[int, str], None]


class Body:
    """See the module. Messages go to `on_message`, every change of the state to `on_state`."""

    def __init__(
        self,
        anatomy: Anatomy,
        seed: str,
        start_s: float,
        on_message: Callable[[str, float], None],
        on_state: Callable[[float, State], None] = lambda at_s, state: None,
        on_return: Callable[[str, float, float], None] = lambda topic, last_s, at_s: None,
        *,
        slowness: float = 1.0,
    ) -> None:
        """`on_return` is told of a topic that was silent; `slowness` multiplies how long nodes take to start
        and to warm up.
        """
        self.anatomy = anatomy
        self.state: State = HEALTHY
        self.now_s = start_s
        self._answers: list[Act] = []  # what was done, in order
        self.latched: set[str] = set()  # topics of which a message is kept for who comes later
        self.hiccups = False  # now and then a message comes late, within what its observer tolerates
        self._slowness = slowness
        self._chance = random.Random(f"body {seed}")
        self._on_message = on_message
        self._on_state = on_state
        self._on_return = on_return
        self._events: list[tuple[float, int, str | Callable[[], None]]] = []
        self._number = 0
        self._last: dict[str, float] = dict.fromkeys(anatomy.topics, start_s)
        self._ticks: dict[str, int] = dict.fromkeys(anatomy.topics, 0)
        self._warm: dict[str, float] = dict.fromkeys(anatomy.nodes, -math.inf)
        self._up: dict[str, float] = dict.fromkeys(anatomy.devices, -math.inf)
        self._from: dict[str, float] = {}  # topic -> when its publisher can publish it; inf: not as it is
        self._half: frozenset[str] = frozenset()
        self._fast: frozenset[str] = frozenset()
        self._doubled: frozenset[str] = frozenset()
        self._still: dict[str, float] = {}  # topic -> since when its values stand still
        self._reconnected: dict[str, float] = {}  # node -> when it is with its device again
        self._settle()
        for topic in anatomy.topics.values():
            if topic.latched:
                self._at(start_s, partial(self._latch, topic.name))
            else:
                self._at(start_s + self._chance.random() * topic.period_s, topic.name)

    # --- time

    def advance(self, now_s: float) -> None:
        """Let time pass up to `now_s`."""
        events = self._events
        while events and events[0][0] <= now_s:
            at_s, _, what = heappop(events)
            self.now_s = max(at_s, self.now_s)
            if isinstance(what, str):
                self._tick(what, at_s)
            else:
                what()
        self.now_s = max(now_s, self.now_s)

    def _at(self, at_s: float, what: str | Callable[[], None]) -> None:
        self._number += 1
        heappush(self._events, (at_s, self._number, what))

    # --- messages

    def _tick(self, topic: str, at_s: float) -> None:
        described = self.anatomy.topics[topic]
        self._at(at_s + described.period_s, topic)
        tick = self._ticks[topic] = self._ticks[topic] + 1
        if topic in self._doubled:
            self._at(
                at_s + 0.5 * described.period_s,
                partial(self._publish, topic, at_s + 0.5 * described.period_s),
            )
        if at_s < self._from.get(topic, -math.inf) or (topic in self._half and tick % 2):
            return
        node = self.anatomy.publisher.get(topic)
        if node is not None:
            publisher = self.anatomy.nodes[node]
            fresh = all(self._heard(i, at_s) for i in publisher.publishes[topic])
            if not fresh and not (publisher.kicks and tick % KICK_PERIODS == 0):
                return
        self._publish(topic, at_s)
        if topic in self._fast:
            self._at(
                at_s + 0.5 * described.period_s,
                partial(self._publish, topic, at_s + 0.5 * described.period_s),
            )

    def _publish(self, topic: str, at_s: float) -> None:
        described = self.anatomy.topics[topic]
        late_s = abs(self._chance.gauss(0.0, JITTER)) * described.period_s
        if self.hiccups and self._chance.random() < 0.02:
            late_s += self._chance.random() * hiccup_s(described.rate_hz, described.tolerance_hz)
        if not self._heard(topic, at_s):
            self._on_return(topic, self._last[topic], at_s + late_s)
        self._last[topic] = max(self._last[topic], at_s + late_s)
        self._on_message(topic, self._last[topic])

    def _latch(self, topic: str) -> None:
        if self.anatomy.publisher[topic] not in self.running():
            return
        self.latched.add(topic)
        self._last[topic] = self.now_s
        self._on_message(topic, self.now_s)

    def values(self, topic: str, at_s: float) -> Mapping[str, object]:
        """Return the fields of a message that was sent at a time."""
        at_s = min(at_s, self._still.get(topic, at_s))
        return {field: self._value(what, at_s) for field, what in self.anatomy.topics[topic].values.items()}

    def _value(self, what: str | float, at_s: float) -> object:
        match what:
            case "wave":
                return math.sin(at_s * math.tau / WAVE_S)
            case "clock":
                return at_s
            case "whole seconds":
                return math.floor(at_s)
            case str() if what.startswith("medkit of "):
                device = what.removeprefix("medkit of ")
                return gateway_of(device, condition.device_in(self.state, device).complains)
            case str():
                device = what.removeprefix("status of ")
                level = int(condition.device_in(self.state, device).complains)
                return {"name": device, "level": level, "message": "", "values": []}
            case _:
                return what

    def _heard(self, topic: str, at_s: float) -> bool:
        if self.anatomy.topics[topic].latched:
            return True
        return self._last[topic] >= at_s - SILENCE_PERIODS * self.anatomy.topics[topic].period_s

    # --- faults

    def plant(self, fault: Fault) -> None:
        """A fault begins now."""
        self._change(kinds.begin(self.anatomy, self.state, fault))

    def lift(self, fault: Fault) -> None:
        """A fault that comes and goes has gone."""
        self._change(kinds.lifted(self.anatomy, self.state, fault))

    def relay(self, device: str, on: bool) -> None:
        """A relay has moved, on a board that is not in here."""
        if condition.device_in(self.state, device).on == on:
            return
        if on:
            self._change(condition.after(self.anatomy, self.state, Act("power_up", (device,)))[0])
        else:
            self._change(condition.lost_power(self.anatomy, self.state, device))

    def power_down(self) -> None:
        """Every process ends: the robot is to be booted."""
        for node in self.anatomy.nodes:
            self._change(condition.ended(self.state, node))
        self._up = {name: self.now_s + device.boot_s for name, device in self.anatomy.devices.items()}
        self._settle()

    # --- acts

    def order(self, act: Act, answer: Answer) -> Callable[[], None]:
        """An act begins now; `answer` is told its code when it is done. Returns what withdraws it."""
        withdrawn = False

        def done() -> None:
            if withdrawn:
                return
            before = self.state
            state, code = condition.after(self.anatomy, before, act)
            if act.name == "start_node" and state != before:
                node = self.anatomy.nodes[act.parameters[0]]
                self._warm[node.name] = self.now_s + self._slowness * node.warm_s
                self._reconnected.pop(node.name, None)
                if self.would_fail(act):
                    state = condition.disconnected(state, node.name)
                if condition.node_in(state, node.name).short_lived:
                    self._at(self.now_s + LIVES_S, partial(self._ends, node.name, len(self._answers)))
                for topic in node.publishes:
                    if self.anatomy.topics[topic].latched:
                        self._at(self._warm[node.name], partial(self._latch, topic))
            self._answers.append(act)
            self._change(state)
            answer(code, _told(act, code))

        def withdraw() -> None:
            nonlocal withdrawn
            withdrawn = True

        self._at(self.now_s + self._takes_s(act), done)
        return withdraw

    def would_fail(self, act: Act) -> bool:
        """Whether an act would come too early: the start of a driver whose device has not booted."""
        if act.name != "start_node":
            return False
        node = self.anatomy.nodes[act.parameters[0]]
        return node.hasty and any(self.now_s < self._up[device] for device in node.drives)

    def _ends(self, node: str, started: int) -> None:
        """A process has lived for long enough, unless it has been stopped since."""
        if all(node not in act.parameters for act in self._answers[started + 1 :]):
            self._change(condition.ended(self.state, node))

    def _takes_s(self, act: Act) -> float:
        node = self.anatomy.nodes.get(act.parameters[0])
        if act.name == "start_node" and node is not None:
            condition_now = condition.node_in(self.state, node.name)
            return 0.0 if condition_now.running else self._slowness * node.start_s
        if act.name == "stop_node" and node is not None:
            return node.stop_s
        return AGENT_SWITCHES_S

    # --- the state

    def running(self) -> frozenset[str]:
        """Return the nodes that run."""
        stopped = {
            name for name, wrong in self.state if isinstance(wrong, NodeCondition) and not wrong.running
        }
        return frozenset(self.anatomy.nodes.keys() - stopped)

    def on(self, device: str) -> bool:
        """Return where a device's relay is."""
        return condition.device_in(self.state, device).on

    def _change(self, state: State) -> None:
        if state == self.state:
            return
        before = self.state
        self.state = state
        for name, device in self.anatomy.devices.items():
            had = condition.supplied(self.anatomy, before, name)
            has = condition.supplied(self.anatomy, state, name)
            if has and not had:
                self._up[name] = self.now_s + device.boot_s
                for driver in self.anatomy.drivers[name]:
                    if self.anatomy.nodes[driver].reconnects:
                        self._reconnected[driver] = self._up[name] + RECONNECTS_S
        self._settle()
        self._on_state(self.now_s, state)

    def _settle(self) -> None:
        """Find out from when on each topic can be published in the present state."""
        state, anatomy = self.state, self.anatomy
        half: list[str] = []
        fast: list[str] = []
        doubled: list[str] = []
        still: dict[str, float] = {}
        for name, node in anatomy.nodes.items():
            wrong = condition.node_in(state, name)
            able = wrong.speaks and all(condition.works(anatomy, state, device) for device in node.drives)
            booted = [self._up[condition.source(anatomy, state, device)] for device in node.drives]
            again_s = self._reconnected.get(name, -math.inf)
            from_s = max([self._warm[name], again_s, *booted]) if able else math.inf
            for topic in node.publishes:
                self._from[topic] = from_s
            if wrong.mood is condition.Mood.WRONG:
                half += node.publishes
            if wrong.mood is condition.Mood.FAST:
                fast += node.publishes
            if wrong.mood is condition.Mood.STILL:
                still |= {topic: self._still.get(topic, self.now_s) for topic in node.publishes}
            if wrong.doubled:
                doubled += node.publishes
        self._half, self._fast, self._doubled = frozenset(half), frozenset(fast), frozenset(doubled)
        self._still = still


def gateway_of(device: str, complains: bool) -> list[dict[str, Any]]:
    """Return what the bridge to a ros2_medkit gateway says of two robots with a driver of one name each.

    Real gateways name apps by their whole names, and reporters of faults by those of the graph.
    """
    faults = Faults()
    faults.have({f"{robot}_{device}_driver": "" for robot in ("here", "there")})
    fault = {
        "fault_code": "NO_REASON",
        "severity": "ERROR",
        "status": "CONFIRMED",
        "reporting_sources": [f"/here/{device}_driver"],
    }
    faults.stand([read_fault(fault)] if complains else [])
    return faults.statuses()


def hiccup_s(rate_hz: float, tolerance_hz: float, window: int = 10) -> float:
    """Return how late one message may be so that the rate over every window stays within the tolerance.

    It is lower over the windows that end with that message, and higher over the one that begins with it.
    """
    lower_s = (window - 1) * (1 / (rate_hz - tolerance_hz) - 1 / rate_hz)
    higher_s = (window - 1) * (1 / rate_hz - 1 / (rate_hz + tolerance_hz))
    return 0.8 * min(lower_s, higher_s)


def _told(act: Act, code: int) -> str:
    if code == OK:
        return f"{act} done"
    if act.name == "start_node":
        return f"{act.parameters[0]} ended at once, exit code 127"
    return f"{act} failed"
