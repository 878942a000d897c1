"""Scripted stand-ins for the service, on a clock of their own: what can be reached, and what idling gets.

    perfect   does what the cheapest policy does, as soon as the observers have told it all
    sighted   the same, but that an act was in vain it knows when it could be seen, and no sooner
    knowing   knows what is broken from the first symptom on, and awaits only what that has to show: the floor
    idle      does nothing
    respawn, lifecycle, symptom, upstream   what people use today

They see what the service would: literals of the real observers, fed by the same simulated robots. They make
records like those of real trials, much faster, and so test the score itself.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from functools import partial

from robomend_bench.faults.anatomy import Anatomy
from robomend_bench.faults.body import Body
from robomend_bench.faults.classes import Planted
from robomend_bench.faults.condition import Act, abnormal, broken, observed
from robomend_bench.faults.kinds import PASSING
from robomend_bench.faults.observing import HostObservers
from robomend_bench.faults.policy import Belief, Repair
from robomend_bench.faults.record import Acted, Diagnosed, Record, RepairSeen, Trial
from robomend_bench.faults.robot import Robot
from robomend_bench.faults.stretches import STRETCH_BY_NAME
from robomend_bench.faults.trial import Terms, longer_s, robot_of, scenario_of
from robomend_bench.faults.universe import touched
from robomend_client.literals import Atom, Literal

STEP_S = 0.01
BEFORE_S = 4.0
"""The robot runs so long before its fault, that every observer has its verdict."""

AWAIT_S = 5.0
"""How long who acts on symptoms waits for them to go."""

MOST_TRIED = 3
"""How often he does the same to one component."""

STANDINS = ("perfect", "sighted", "knowing", "idle")

IN_USE: Mapping[str, str] = {
    "respawn": "respawn what ended",
    "lifecycle": "lifecycle manager: all down, all up",
    "symptom": "symptom → restart its node",
    "upstream": "most upstream silent component, then one level up",
}
"""What people use today, as further stand-ins."""


def play_with(standin: str, trial: Trial, terms: Terms) -> Record:
    """Play a trial with a stand-in; stretches are undisturbed."""
    kinds = (_Perfect, _Sighted, _Knowing, _Idle, _Respawn, _Lifecycle, _Symptom, _Upstream)
    agents: Mapping[str, type[_Idle]] = dict(zip((*STANDINS, *IN_USE), kinds, strict=True))
    return _Play(robot_of(trial, terms.topics_hz), trial, terms, agents[standin]).run()


class _Play:
    def __init__(self, robot: Robot, trial: Trial, terms: Terms, agent: type[_Idle]) -> None:
        self.robot = robot
        self.scenario = scenario_of(trial)
        self.record = Record(trial, terms.observers, self.scenario.blind)
        self.terms = terms
        self.now_s = -BEFORE_S
        self.held: dict[Atom, Literal] = {}
        self.hosts = [
            HostObservers(robot.anatomy, host, terms.preset, self.now_s, self.scenario.blind)
            for host in robot.anatomy.hosts
        ]
        self.body = Body(
            robot.anatomy,
            str(trial),
            self.now_s,
            self._message,
            lambda at_s, state: self.record.states.append((at_s, state)),
            lambda topic, last_s, at_s: self.record.silences.append((topic, last_s, at_s)),
            slowness=self.scenario.slowness,
        )
        self.agent = agent(self)
        self._due = sorted(self._script(), key=lambda event: event[0])
        self._waiting = [each for each in self.scenario.planted if each.follows_act]

    def run(self) -> Record:
        """Return the record."""
        stretch = STRETCH_BY_NAME.get(self.record.trial.cls)
        last_s = self.terms.most_s if stretch is None else stretch.seconds
        while self.now_s < last_s and not (stretch is None and self._over()):
            self.now_s = round(self.now_s + STEP_S, 3)
            self.body.advance(self.now_s)
            while self._due and self._due[0][0] <= self.now_s:
                _, begins, planted = self._due.pop(0)
                self._begin(begins, planted)
            if self._waiting and self.record.acts:
                self._due = [(self.now_s + each.after_s, True, each) for each in self._waiting]
                self._waiting = []
            self._look()
            self.agent.step()
        self.record.end_s = self.now_s
        return self.record

    def _script(self) -> Iterator[tuple[float, bool, Planted]]:
        for each in self.scenario.planted:
            if not each.follows_act:
                at_s = each.after_s
                yield at_s, True, each
                for number, spell_s in enumerate(each.spells_s):
                    at_s += spell_s
                    yield at_s, bool(number % 2), each

    def _begin(self, begins: bool, planted: Planted) -> None:
        if planted.spells_s and self.record.acts and planted.fault.kind not in PASSING:
            return  # restarted, it is well
        if begins:
            self.record.faults.append((self.now_s, planted.fault))
            self.body.plant(planted.fault)
        else:
            self.body.lift(planted.fault)
        for host in self.hosts:
            host.faulty = True

    def _over(self) -> bool:
        times = [at_s for at_s, _ in self.record.states] + [seen.at_s for seen in self.record.repairs]
        quiet_s = self.terms.quiet_s + longer_s(self.robot, self.scenario)
        quiet = self.now_s - max([0.0, *times]) > quiet_s
        return quiet and not self._due and not self._waiting and not self.agent.busy

    def _message(self, topic: str, at_s: float) -> None:
        for host in self.hosts:
            if topic in host.topics:
                host.message(topic, at_s, self.body.values(topic, at_s))

    def _look(self) -> None:
        anatomy, body = self.robot.anatomy, self.body
        on = {device: body.on(device) for device in anatomy.devices}
        for host in self.hosts:
            new: dict[Atom, Literal] = {}
            for change in host.check(self.now_s, body.running(), on):
                if change.value is None:
                    self.held.pop(change.atom, None)
                else:
                    self.held[change.atom] = new[change.atom] = change.value
            if new:
                self.record.said.append((self.now_s, tuple(new.values())))
        if anatomy.power == "board":
            for device in anatomy.devices.values():
                if device.switchable:
                    atom = Atom("on", (device.name,))
                    self.held[atom] = Literal(atom, on[device.name])


class _Idle:
    """Publishes a diagnosis when something is odd, and leaves it at that."""

    busy = False

    def __init__(self, play: _Play) -> None:
        self.play = play
        play.record.diagnoses.append(Diagnosed(-BEFORE_S, ((),)))

    def step(self) -> None:
        """Look, and act."""


class _Perfect(_Idle):
    """Acts when the observers have told all that is to be seen of the true state, and only then."""

    def __init__(self, play: _Play) -> None:
        super().__init__(play)
        self._number = 0
        self._round = 0
        self._belief: Belief | None = None
        self._plan: list[Act] = []
        self._acting: Acted | None = None
        self._bad: tuple[str, ...] = ()

    @property
    def _id(self) -> str:
        return f"r-{self._number}"

    def step(self) -> None:
        if self._acting is not None and self._acting.code is None:
            return
        self._acting = None
        if self._plan:
            if not self.play.body.would_fail(self._plan[0]):
                self._do(self._plan.pop(0))
            return
        if not self._settled():
            return
        odd = abnormal(self.play.robot.anatomy, self.play.body.state)
        if odd:
            self._repair()
        elif self._belief is not None:
            self.play.record.diagnoses.append(Diagnosed(self.play.now_s, ((),)))
            self._end("repaired", "everything is as it should be")

    def _settled(self) -> bool:
        wanted = observed(self.play.robot.anatomy, self.play.body.state)
        return all(self.play.held.get(literal.atom) == literal for literal in wanted)

    def _repair(self) -> None:
        play, universe, policy = self.play, self.play.robot.universe, self.play.robot.policy
        state = play.body.state
        odd = abnormal(play.robot.anatomy, state)
        planted = dict.fromkeys(fault for _, fault in play.record.faults)
        known = dict(self._belief or ())
        if state not in known:  # the first look, or something else has broken
            found = universe.explanations(odd, len(planted))
            known = {each.state: each.weight for each in found}
            known.setdefault(state, min(known.values(), default=1.0))
            if self._belief is None:
                self._number += 1
            self._round += 1
            best = max(found, key=lambda each: each.weight, default=None)
            self._bad = tuple(sorted(best.components)) if best is not None else ()
            play.record.diagnoses.append(
                Diagnosed(play.now_s, tuple({tuple(sorted(each.components)): None for each in found}))
            )
        self._belief = frozenset(known.items())
        repair, _ = policy.choose(self._belief)
        if repair is None:
            parts = {fault.component for fault in planted}
            self._end("escalated", f"no repair is left for {', '.join(sorted(parts))}")
            self.step = lambda: None  # type: ignore[method-assign]  # it has called a person, and waits
            return
        self._tell("planning", str(repair))
        self._begin(repair)

    def _begin(self, repair: Repair) -> None:
        assert self._belief is not None
        _, acts, self._belief = self.play.robot.policy.carry_out(self.play.body.state, repair, self._belief)
        self._plan = list(acts)
        self._tell("running", str(repair))
        self.busy = True

    def _do(self, act: Act) -> None:
        acted = Acted(self.play.now_s, act, "stand-in")
        self.play.record.acts.append(acted)

        def answer(code: int, message: str) -> None:
            acted.code, acted.message, acted.done_s = code, message, self.play.body.now_s

        self.play.body.order(act, answer)
        self._acting = acted

    def _end(self, state: str, reason: str) -> None:
        self._tell(state, reason)
        self._belief = None
        self._round = 0
        self.busy = False

    def _tell(self, state: str, reason: str) -> None:
        plan = tuple(map(str, self._plan))
        seen = RepairSeen(self.play.now_s, self._id, state, self._bad, self._round, reason, plan)
        self.play.record.repairs.append(seen)


class _Sighted(_Perfect):
    """Knows how long each thing takes to the millisecond; that an act was in vain is seen after that."""

    def _settled(self) -> bool:
        if not super()._settled():
            return False
        return not abnormal(self.play.robot.anatomy, self.play.body.state) or self.play.now_s >= self._shows_s

    @property
    def _shows_s(self) -> float:
        """When the silence of what was acted on says that it will not come: silence was awaited before."""
        done = [(each.done_s, each.act) for each in self.play.record.acts if each.done_s is not None]
        shows_s = (done_s + self._takes_s(act) for done_s, act in done)
        return max(shows_s, default=0.0) + (self.play.terms.preset.silence_s if done else 0.0)

    def _takes_s(self, act: Act) -> float:
        """Return how long after its answer an act shows, if it helps."""
        anatomy = self.play.robot.anatomy
        if act.name == "start_node":
            return self.play.scenario.slowness * anatomy.nodes[act.parameters[0]].warm_s
        named = [
            device for device in anatomy.devices.values() if {device.name, device.bus} & set(act.parameters)
        ]
        return max((device.boot_s for device in named), default=0.0)


class _Knowing(_Perfect):
    """Knows the truth as soon as anything shows, so that its first repair is the right one.

    What is left is what nobody can go below: acts, side by side where they may be, the robot's starts, and
    observers that judge what was touched anew.
    """

    def __init__(self, play: _Play) -> None:
        super().__init__(play)
        self._under_way: list[Acted] = []
        self._settle = 0
        self._shows = False

    def step(self) -> None:
        play = self.play
        odd = abnormal(play.robot.anatomy, play.body.state)
        if self._belief is None and not self._shows:  # what shows now is acted on in the next step
            self._shows = not all(literal.positive for literal in play.held.values())
            return
        self._under_way = [each for each in self._under_way if not self._answered(each)]
        self._start_ready()
        if self._plan or self._under_way:
            return
        if odd:
            self._belief = None if self._belief is None else frozenset({(play.body.state, 1.0)})
            self._repair()
        elif self._settled():
            play.record.diagnoses.append(Diagnosed(play.now_s, ((),)))
            self._shows = False
            if self._belief is not None:
                self._end("repaired", "everything is as it should be")

    def _repair(self) -> None:
        play = self.play
        state = play.body.state
        if self._belief is None:
            self._number += 1
            self._belief = frozenset({(state, 1.0)})
        self._round += 1
        roots = {fault.component for _, fault in play.record.faults}
        self._bad = tuple(sorted(broken(play.robot.anatomy, state) & roots))
        play.record.diagnoses.append(Diagnosed(play.now_s, (self._bad,)))
        repair, _ = play.robot.policy.choose(self._belief)
        if repair is None:
            self._end("escalated", f"no repair is left for {', '.join(sorted(roots))}")
            self.step = lambda: None  # type: ignore[method-assign]  # it has called a person, and waits
            return
        self._tell("planning", str(repair))
        self._begin(repair)
        self._start_ready()

    def _start_ready(self) -> None:
        """Begin what need not wait for the answer of an act on something that it has to do with."""
        before = [each.act for each in self._under_way]
        for act in tuple(self._plan):
            if not self.play.body.would_fail(act) and not any(self._related(act, other) for other in before):
                self._plan.remove(act)
                self._do(act)
                assert self._acting is not None
                self._under_way.append(self._acting)
            before.append(act)

    def _related(self, act: Act, other: Act) -> bool:
        parts, others = set(act.parameters), set(other.parameters)
        anatomy = self.play.robot.anatomy
        return bool(_all_touched(anatomy, parts) & others or _all_touched(anatomy, others) & parts)

    def _answered(self, acted: Acted) -> bool:
        """Whether an act has answered; if so, what it influences is to be judged anew."""
        if acted.code is None:
            return False
        self._settle += 1
        anatomy, play = self.play.robot.anatomy, self.play
        parts = _all_touched(anatomy, set(acted.act.parameters))
        topics = [topic for topic, node in anatomy.publisher.items() if node in parts]
        for topic in topics:
            topics += (each for each in anatomy.consumers.get(topic, ()) if each not in topics)
        atoms = [Atom("ok", (topic,)) for topic in topics]
        for atom in atoms:
            play.held.pop(atom, None)
        for host in play.hosts:
            host.settle(self._settle, atoms)
        return True


class _Reflex(_Idle, ABC):
    """What people use today: a symptom has a remedy, which is tried so often, and then a person is called.

    It acts on what the observers say at that moment, awaits AWAIT_S for what it acted upon to be well, and
    takes the robot for well when no symptom is left.
    """

    def __init__(self, play: _Play) -> None:
        super().__init__(play)
        self._plan: list[Act] = []
        self._acting: Acted | None = None
        self._tried: dict[str, int] = {}
        self._until_s = 0.0
        self._number = self._round = 0
        self._bad: tuple[str, ...] = ()
        self._called: frozenset[Literal] | None = None  # of what a person was told

    @property
    def busy(self) -> bool:  # type: ignore[override]  # computed here, set there
        return bool(self._plan or self._acting or (self._bad and self._called is None))

    def step(self) -> None:
        play = self.play
        if self._acting is not None:
            if self._acting.code is None:
                return
            self._acting = None
            self._until_s = play.now_s + AWAIT_S
        if self._plan:
            act = self._plan.pop(0)
            self._acting = Acted(play.now_s, act, "stand-in")
            play.record.acts.append(self._acting)
            play.body.order(act, partial(self._answered, self._acting))
            return
        symptoms = frozenset(literal for literal in play.held.values() if not literal.positive)
        if not symptoms:
            if self._bad:
                play.record.diagnoses.append(Diagnosed(play.now_s, ((),)))
                if self._called is None:
                    self._tell("repaired", "no symptom is left")
                self._bad, self._called, self._tried = (), None, {}
        elif self._called is None or not symptoms <= self._called:
            self._remedy(symptoms)

    def _remedy(self, symptoms: frozenset[Literal]) -> None:
        play = self.play
        blamed = self.blamed(symptoms)
        if not blamed:
            return  # it does not look at such symptoms
        waits = play.now_s < self._until_s
        if waits and all(name in self._tried for name in blamed):
            return
        new = [name for name in blamed if not waits or name not in self._tried]
        plan = []
        for name in new:
            acts = self.remedy(name, self._tried.get(name, 0))
            self._tried[name] = self._tried.get(name, 0) + 1
            plan += acts or []
        if not self._bad:
            self._number += 1
            self._round = 0
            self._called = None
        if self._bad != tuple(blamed):
            self._bad = tuple(blamed)
            play.record.diagnoses.append(Diagnosed(play.now_s, (self._bad,)))
        if not plan:
            self._called = symptoms
            self._tell("escalated", f"nothing is left to be tried for {', '.join(blamed)}")
            return
        self._called = None
        self._round += 1
        self._plan = list(dict.fromkeys(plan))
        self._tell("planning", "")
        self._tell("running", "")

    @abstractmethod
    def blamed(self, symptoms: frozenset[Literal]) -> list[str]:
        """Return the components that it acts upon."""

    def remedy(self, name: str, tried: int) -> list[Act]:
        """Return what it does to a component that it has acted upon so often; nothing: it gives up."""
        return self._restart(name) if tried < MOST_TRIED else []

    def _restart(self, name: str) -> list[Act]:
        node = self.play.robot.anatomy.nodes[name]
        if not node.restartable or node.protected:
            return []
        runs = Literal(Atom("running", (name,)), False) not in self.play.held.values()
        return [*([Act("stop_node", (name,))] if runs else []), Act("start_node", (name,))]

    def _publishers(self, symptoms: frozenset[Literal]) -> dict[str, str]:
        """Return the topics that are not as they should be, each with its publisher."""
        publisher = self.play.robot.anatomy.publisher
        topics = [literal.atom.args[0] for literal in symptoms if literal.atom.predicate == "ok"]
        return {topic: publisher[topic] for topic in sorted(topics) if topic in publisher}

    def _stopped(self, symptoms: frozenset[Literal]) -> list[str]:
        return sorted(each.atom.args[0] for each in symptoms if each.atom.predicate == "running")

    def _answered(self, acted: Acted, code: int, message: str) -> None:
        acted.code, acted.message, acted.done_s = code, message, self.play.body.now_s

    def _tell(self, state: str, reason: str) -> None:
        plan = tuple(map(str, self._plan))
        seen = RepairSeen(self.play.now_s, f"r-{self._number}", state, self._bad, self._round, reason, plan)
        self.play.record.repairs.append(seen)


class _Respawn(_Reflex):
    """`respawn: true`: what has ended is started again, for ever; nobody is called."""

    def blamed(self, symptoms: frozenset[Literal]) -> list[str]:
        return self._stopped(symptoms)

    def remedy(self, name: str, tried: int) -> list[Act]:
        return [Act("start_node", (name,))]


class _Symptom(_Reflex):
    """Each symptom has its node, which is restarted."""

    def blamed(self, symptoms: frozenset[Literal]) -> list[str]:
        return list(dict.fromkeys((*self._stopped(symptoms), *self._publishers(symptoms).values())))


class _Upstream(_Reflex):
    """Of the most upstream component without output the node is restarted; then a level up is cycled."""

    def blamed(self, symptoms: frozenset[Literal]) -> list[str]:
        nodes, odd = self.play.robot.anatomy.nodes, self._publishers(symptoms)
        off = sorted(each.atom.args[0] for each in symptoms if each.atom.predicate == "on")
        first = [
            node for topic, node in odd.items() if not any(i in odd for i in nodes[node].publishes[topic])
        ]
        found = [*off, *self._stopped(symptoms), *(first or odd.values())]
        return list(dict.fromkeys(found))[:1]

    def remedy(self, name: str, tried: int) -> list[Act]:
        anatomy = self.play.robot.anatomy
        if name in anatomy.devices:
            return self._cycle(name) if tried < MOST_TRIED else []
        levels: list[list[Act]] = [self._restart(name)]
        for device in anatomy.nodes[name].drives:
            levels += (self._cycle(one) for one in (device, *anatomy.devices[device].fed_by))
        levels = [acts for acts in levels if acts]
        return levels[tried] if tried < len(levels) else []

    def _cycle(self, device: str) -> list[Act]:
        anatomy = self.play.robot.anatomy
        described = anatomy.devices[device]
        if described.switchable and not described.protected:
            off = Literal(Atom("on", (device,)), False) in self.play.held.values()
            acts = [*([] if off else [Act("shutdown", (device,))]), Act("power_up", (device,))]
        elif described.bus is not None:
            acts = [Act("reset_bus", (described.bus,))]
        else:
            return []
        drivers = sorted({driver for one in anatomy.fed[device] for driver in anatomy.drivers[one]})
        return [*acts, *(act for driver in drivers for act in self._restart(driver))]


class _Lifecycle(_Upstream):
    """A lifecycle manager: whatever is the matter, all nodes go down, and come up again."""

    def remedy(self, name: str, tried: int) -> list[Act]:
        if tried >= MOST_TRIED:
            return []
        restarts = [self._restart(node) for node in self.play.robot.anatomy.nodes]
        stops = [act for acts in reversed(restarts) for act in acts if act.name == "stop_node"]
        return [*stops, *(act for acts in restarts for act in acts if act.name == "start_node")]


def _all_touched(anatomy: Anatomy, names: set[str]) -> frozenset[str]:
    """Return what may have to be touched for these; a bus stands for what hangs on it."""
    on_bus = {device.name for device in anatomy.devices.values() if device.bus in names}
    known = (names | on_bus) & (anatomy.devices.keys() | anatomy.nodes.keys())
    return frozenset(names).union(*(touched(anatomy, name) for name in known))
