"""A simulated robot in real time: body, board and agents, and the record of what happens to it.

    tick ──► body ──► messages ──► observers ──► literals ──► reporters ──► service
    service ──► agents and board ──► acts ──► body

Messages carry the time at which they were due, not that at which the bench got round to them, and are fed
before anybody is asked: when the bench is late, no observer sees silence. It is noted how late it was.
"""

from __future__ import annotations

import asyncio
import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from robomend.board.codec import Code
from robomend_bench.faults.agents import HostAgent
from robomend_bench.faults.anatomy import Anatomy
from robomend_bench.faults.body import Body
from robomend_bench.faults.classes import Scenario
from robomend_bench.faults.condition import Act, State
from robomend_bench.faults.kinds import Fault
from robomend_bench.faults.observing import HostObservers, Preset
from robomend_bench.faults.record import (
    SECOND_EAR,
    Acted,
    Arrived,
    Credited,
    Diagnosed,
    Record,
    RepairSeen,
)
from robomend_bench.faults.robot import Robot
from robomend_board.board import Board, ChannelState
from robomend_board.faults import Fault as BoardFault
from robomend_board.loads import Load, Rig, Supply
from robomend_board.server import Emulator
from robomend_client.actions import ActionResult
from robomend_client.events import Event, Kind
from robomend_client.literals import Atom, Literal, parse_atom
from robomend_client.observers import Change, Contact
from robomend_client.rest.asynchronous import AsyncClient

# --- the robot's power board: the project's emulator on a socket, its relays tied to the simulated devices.
#
#     service ── TCP ──► emulator ──► relay moves ──► body: the device has power, or has not
#     a fault of a relay ──► emulator: it opens, or sticks
#
# A board hangs on one robot. What the service commands is told to `on_command`; what the bench does is not.

Command = Callable[[str, bool, int], None]
"""Device, on, and the board's answer: 0, or the code of its refusal."""


class RobotBoard:
    """One board; call `open` before anything else, `close` in the end."""

    def __init__(self, anatomy: Anatomy, on_relay: Callable[[str, bool], None], on_command: Command) -> None:
        self._devices = {d.channel: d.name for d in anatomy.devices.values() if d.channel is not None}
        self._channels = {name: channel for channel, name in self._devices.items()}
        self._on_relay = on_relay
        rig = Rig(Supply(), tuple(Load(steady_a=0.3) for _ in range(anatomy.channels)))
        self._board = _Told(rig, self._devices, on_command)
        self._emulator = Emulator(self._board)
        self._emulator.watchers.add(self._moved)

    async def open(self) -> int:
        """Listen on a free port of this computer and return it."""
        await self._emulator.listen("127.0.0.1", 0)
        return self._emulator.port

    async def close(self) -> None:
        """Drop the clients and close the port."""
        await self._emulator.close()

    def trip(self, device: str, *, for_ever: bool = False) -> None:
        """A relay opens by itself, and sticks if it is to be for ever."""
        channel = self._channels[device]
        self._board.ours = True
        try:
            self._emulator.switch(channel, False)
        finally:
            self._board.ours = False
        if for_ever:
            self._board.set_fault(BoardFault("stuck", channel), self._emulator.now_s())
            self._emulator.settle()

    def untrip(self, device: str) -> None:
        """It closes again by itself."""
        self._board.ours = True
        try:
            self._emulator.switch(self._channels[device], True)
        finally:
            self._board.ours = False

    def _moved(self, changed: dict[int, ChannelState]) -> None:
        for channel, state in changed.items():
            if channel in self._devices:
                self._on_relay(self._devices[channel], state.on)


class _Told(Board):
    """A board that tells what it is commanded."""

    def __init__(self, rig: Rig, devices: dict[int, str], on_command: Command) -> None:
        super().__init__(rig, on=devices)
        self.ours = False  # what moves now was moved by the bench
        self._named = devices
        self._on_command = on_command

    def switch(self, number: int, state: int, now_s: float) -> Code:
        code = super().switch(number, state, now_s)
        if not self.ours and number in self._named:
            self._on_command(self._named[number], bool(state), int(code))
        return code


Clock = Callable[[], float]


class LiveRobot:
    """See the module. `id` is the robot's name at the service."""

    def __init__(
        self,
        robot: Robot,
        scenario: Scenario,
        record: Record,
        preset: Preset,
        id: str,
        clients: tuple[AsyncClient, AsyncClient],
        folder: Path,
        clock: Clock,
    ) -> None:
        self.id = id
        self.robot = robot
        self.record = record
        self.scenario = scenario
        self._anatomy = robot.anatomy
        self._preset = preset
        self._clock = clock
        self._where: dict[str, list[tuple[str | None, HostObservers]]] = {}
        self._unheard: set[str | None] = set()
        self._clients, self._folder = clients, folder
        self._held: dict[str | None, list[tuple[str, float]]] = {}  # of agents that are held up
        self._posted: dict[Atom, Literal] = {}
        self._due: list[tuple[float, Callable[[], None]]] = []
        self.zero_s = clock()
        self.last_s = self.zero_s  # when something last happened
        self.body = Body(
            self._anatomy,
            str(record.trial),
            self.zero_s,
            self._message,
            self._state,
            self._return,
            slowness=scenario.slowness,
        )
        self._board = (
            RobotBoard(self._anatomy, self._relay, self._command)
            if self._anatomy.power == "board" and any(d.switchable for d in self._anatomy.devices.values())
            else None
        )
        self.agents = [
            HostAgent(
                id,
                host,
                clients,
                folder,
                knows(robot, host),
                self._carry_out,
                scenario.reporting,
                self._arrived,
            )
            for host in self._anatomy.hosts
        ]

    # --- beginning and end

    async def open(self) -> dict[str, Any] | None:
        """Open the board, if there is one; return where it is, as the robot's configuration says it."""
        if self._board is None:
            return None
        return {"host": "127.0.0.1", "port": await self._board.open()}

    def start_agent(self, agent: HostAgent) -> None:
        """Start an agent with observers that have seen nothing yet."""
        now_s = self._clock()
        observers = HostObservers(
            self._anatomy, agent.host, self._preset, now_s, self.scenario.blind, time.time() - now_s
        )
        agent.start(observers)
        self._listen()
        for topic in self.body.latched & observers.topics:
            observers.message(topic, now_s)

    def add_ear(self, topic: str) -> None:
        """A second agent begins, which is to hear one topic and hears nothing of it."""
        now_s = self._clock()
        only = replace(
            self._anatomy,
            nodes={},
            devices={},
            aspects=(),
            topics={topic: self._anatomy.topics[topic]},
        )
        agent = HostAgent(
            self.id, SECOND_EAR, self._clients, self._folder, (), self._carry_out, noted=self._arrived
        )
        observers = HostObservers(only, None, self._preset, now_s, None, time.time() - now_s)
        observers.topics.clear()
        self.agents.append(agent)
        agent.start(observers)

    async def stop_agent(self, agent: HostAgent) -> None:
        """End an agent; the robot's processes go on."""
        await agent.stop()
        self._listen()

    async def close(self) -> None:
        """End everything."""
        for agent in self.agents:
            await agent.stop()
        if self._board is not None:
            await self._board.close()

    def begin(self) -> None:
        """From now on the record's times count."""
        shift_s = self._clock() - self.zero_s
        self.zero_s += shift_s
        self.record.shift(-shift_s)
        self.record.late_s = self.record.starved_s = 0.0

    def observed(self) -> list[Literal]:
        """Return the literals that this robot's observers and its board will report."""
        blind = self.scenario.blind
        missing = Atom("ok", (blind.topic,)) if blind is not None and blind.how == "missing" else None
        return [literal for literal in self._anatomy.healthy if literal.atom != missing]

    def _listen(self) -> None:
        self._where = {}
        for agent in self.agents:
            if agent.observers is not None:
                for topic in agent.observers.topics:
                    self._where.setdefault(topic, []).append((agent.host, agent.observers))

    # --- time

    def tick(self, now_s: float, late_s: float) -> None:
        """Let time pass; `late_s`: how much later this comes than it should."""
        self.record.late_s = max(self.record.late_s, late_s)
        due = [what for at_s, what in self._due if at_s <= now_s]
        self._due = [(at_s, what) for at_s, what in self._due if at_s > now_s]
        self.body.advance(now_s)
        for what in due:
            what()
        running = self.body.running()
        on = {device: self.body.on(device) for device in self._anatomy.devices}
        for agent in self.agents:
            if agent.observers is None or agent.reporter is None or agent.host in self._held:
                continue
            changes = agent.observers.check(now_s, running, on)
            if changes:
                agent.reporter.report(changes)
                self._note_said(now_s, changes)

    def later(self, after_s: float, what: Callable[[], None]) -> None:
        """Do something so many seconds from now."""
        self._due.append((self._clock() + after_s, what))

    def at_s(self) -> float:
        """Return the record's time."""
        return self._clock() - self.zero_s

    def note(self, text: str) -> None:
        """Note something for people."""
        self.record.notes.append((self.at_s(), text))

    # --- faults

    def plant(self, fault: Fault) -> None:
        """A fault begins."""
        self.body.advance(self._clock())
        self.happened()
        self.record.faults.append((self.at_s(), fault))
        self.body.plant(fault)
        if self._board is not None and fault.kind in ("off", "off for ever", "brown-out"):
            self._board.trip(fault.component, for_ever=fault.kind == "off for ever")

    def lift(self, fault: Fault) -> None:
        """A fault that comes and goes has gone."""
        self.body.advance(self._clock())
        self.note(f"{fault} has gone by itself")
        self.body.lift(fault)
        if self._board is not None and fault.kind == "brown-out":
            self._board.untrip(fault.component)

    def hold_up(self, host: str | None, *, wholly: bool = False) -> None:
        """An agent is held up: what is sent to it waits, and it does nothing; `wholly`: nor does it send."""
        self._held[host] = []
        self.record.held_up.append((host, self.at_s(), math.inf))
        for agent in self.agents:
            if wholly and agent.host == host:
                for line in agent.lines:
                    line.open.clear()

    def cut_off(self, host: str | None, *, cut: bool) -> None:
        """Nothing of a host reaches anybody, or does again."""
        for agent in self.agents:
            if agent.host == host:
                for line in agent.lines:
                    line.cut = cut

    def unheard(self, host: str | None, *, begins: bool) -> None:
        """A host's bridge is no part of its middleware for a while, or is again: what is sent is lost."""
        (self._unheard.add if begins else self._unheard.discard)(host)
        for agent in self.agents:
            if agent.host == host and agent.observers is not None:
                agent.observers.look(Contact.LOST if begins else Contact.BACK, self._clock())

    def resume(self, host: str | None) -> None:
        """It goes on; what has waited arrives now."""
        now_s = self._clock()
        for number, (name, began_s, ended_s) in enumerate(self.record.held_up):
            if name == host and ended_s == math.inf:
                self.record.held_up[number] = (host, began_s, self.at_s())
        for agent in self.agents:
            if agent.host == host:
                for line in agent.lines:
                    line.open.set()
        self.body.advance(now_s)
        for agent in self.agents:
            if agent.host == host and agent.observers is not None:
                agent.observers.lapse(now_s)
        for topic, at_s in self._held.pop(host):
            for _, observers in self._where.get(topic, ()):
                observers.message(topic, now_s, self.body.values(topic, at_s))

    def disturb_observer(self) -> None:
        """What is the matter with the scenario's faulty observer begins."""
        for agent in self.agents:
            if agent.observers is not None:
                agent.observers.faulty = True

    # --- what comes from the body and the board

    def _message(self, topic: str, at_s: float) -> None:
        values = self.body.values(topic, at_s)
        for host, observers in self._where.get(topic, ()):
            if host in self._unheard:
                continue
            if host in self._held:
                self._held[host].append((topic, at_s))
            else:
                observers.message(topic, at_s, values)

    def _state(self, at_s: float, state: State) -> None:
        self.happened()
        self.record.states.append((at_s - self.zero_s, state))

    def _return(self, topic: str, last_s: float, at_s: float) -> None:
        self.record.silences.append((topic, last_s - self.zero_s, at_s - self.zero_s))

    def _relay(self, device: str, on: bool) -> None:
        self.body.advance(self._clock())
        self.body.relay(device, on)

    def _command(self, device: str, on: bool, code: int) -> None:
        act = Act("power_up" if on else "shutdown", (device,))
        self.happened()
        self.record.acts.append(Acted(self.at_s(), act, "board", code))

    def _arrived(self, agent: str, batch: Mapping[str, Any], took_s: float) -> None:
        """A batch of an agent has arrived at the service, which took so long to answer."""
        literals = tuple(
            Literal(parse_atom(text.removeprefix("not ")), not text.startswith("not "))
            for text in batch.get("observations", ())
        )
        gone = tuple(map(parse_atom, batch.get("unknown", ())))
        now_s, lifetime_s = self.at_s(), float(batch["lifetime_s"])
        said_s = now_s - (time.time_ns() - int(batch["time"])) / 1e9
        arrived = Arrived(now_s, agent, literals, gone, lifetime_s, now_s - took_s, said_s)
        self.record.arrived.append(arrived)

    def _note_said(self, now_s: float, changes: Sequence[Change]) -> None:
        new: dict[Atom, Literal] = {}
        for change in changes:
            if change.value is None:
                self._posted.pop(change.atom, None)
            elif self._posted.get(change.atom) != change.value:
                self._posted[change.atom] = new[change.atom] = change.value
        if new:
            self.record.said.append((now_s - self.zero_s, tuple(new.values())))

    # --- what comes from the service

    async def _carry_out(self, act: Act, agent: str) -> ActionResult:
        self.body.advance(self._clock())
        self.happened()
        acted = Acted(self.at_s(), act, f"agent {agent}")
        self.record.acts.append(acted)
        done: asyncio.Future[ActionResult] = asyncio.get_running_loop().create_future()

        def answer(code: int, message: str) -> None:
            acted.code, acted.message, acted.done_s = code, message, self.at_s()
            if not done.done():
                done.set_result(ActionResult(code, message))

        withdraw = self.body.order(act, answer)
        try:
            return await done
        finally:
            if not done.done() or done.cancelled():
                withdraw()

    def credited(self, repair: Mapping[str, Any]) -> list[Credited]:
        """Return the rounds of a repair, as HTTP shows it, of which it is said that they helped."""
        ahead_s = time.time() - self._clock() + self.zero_s
        found = []
        for one in repair["rounds"]:
            sent = [step for step in one["plan"] if step.get("sent_ns") is not None]
            if one.get("helped") and sent:  # of a round under way nothing is said yet
                times = [step["sent_ns"] / 1e9 - ahead_s for step in sent]
                ends = [(step.get("ended_ns") or step["sent_ns"]) / 1e9 - ahead_s for step in sent]
                parts = tuple({name for step in sent for name in re.findall(r"[\w-]+", step["text"])[1:]})
                found.append(Credited(min(times), max(ends), parts))
        return found

    def event(self, event: Event, at_s: float) -> None:
        """The service told something of this robot; `at_s` is on the bench's clock."""
        data = event.data
        if event.kind is Kind.DIAGNOSIS:
            self.happened()
            result, fault = data.get("result"), data.get("fault")
            bads = tuple(tuple(d["bad"]) for d in result["diagnoses"]) if result else ()
            why = "" if result else str(fault)
            self.record.diagnoses.append(Diagnosed(at_s - self.zero_s, bads, why))
        elif event.kind is Kind.ROBOT and data.get("what") == "health":
            self.happened()
            self.record.unknown.append((at_s - self.zero_s, tuple(data["unknown"])))
        elif event.kind is Kind.REPAIR:
            self.happened()
            diagnosis = data.get("diagnosis") or {}
            self.record.repairs.append(
                RepairSeen(
                    at_s - self.zero_s,
                    str(data["id"]),
                    str(data["state"]),
                    tuple(diagnosis.get("bad", ())),
                    int(data.get("round") or 0),
                    str(data.get("reason") or ""),
                    tuple(str(step.get("text", "")) for step in data.get("plan", ())),
                )
            )

    def happened(self) -> None:
        """Something has: nobody knows yet what comes of it."""
        self.last_s = self._clock()


def knows(robot: Robot, host: str | None) -> set[Act]:
    """Return the acts that the agent of a host can do."""
    anatomy = robot.anatomy
    first = anatomy.hosts[0]
    found = {
        Act(name, (node.name,))
        for node in anatomy.nodes.values()
        if (node.host or first) == host
        for name in ("start_node", "stop_node")
    }
    devices = [device for device in anatomy.devices.values() if (device.host or first) == host]
    if anatomy.power == "agent":
        switches = product(("power_up", "shutdown"), (d.name for d in devices if d.switchable))
        found |= {Act(name, (device,)) for name, device in switches}
    found |= {Act("switch_to_spare", (d.name, d.spare)) for d in devices if d.spare is not None}
    return found | {Act("reset_bus", (d.bus,)) for d in devices if d.bus is not None}
