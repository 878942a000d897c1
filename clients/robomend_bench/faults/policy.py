"""The cheapest repair by a policy that sees only what can be observed: a search over beliefs.

    belief      the explanations of what is observed, each a state with a weight
    repair      restart a node; cycle or switch on a device; a spare; a reset: with all that it drags along
                (drivers of what was without power, tied nodes, are restarted as well)
    look        each repair's answers and the settled observation after it split the belief
    cost        the acts' costs in the repair domain, about seconds; the least expected cost is searched for

The policy gives up (a person is called) when no repair is left that would bring any explanation nearer to
health. It believes in no more faults than there are, knows how often each is planted, and sees settled
observations only: no service can know more, so its acts are a lower bound, in the mean over trials.

Where a belief has more than MOST_STATES states, or the search takes more than MOST_NODES beliefs, each repair
is chosen by weight that it may heal over cost, and the answer says so (`exact` is false).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from robomend_bench.faults.anatomy import Anatomy
from robomend_bench.faults.condition import (
    Act,
    DeviceCondition,
    Health,
    Mood,
    NodeCondition,
    State,
    abnormal,
    after,
    device_in,
    node_in,
)
from robomend_client.literals import Literal

COSTS: Mapping[str, float] = {
    "start_node": 3.0,
    "stop_node": 1.0,
    "power_up": 10.0,
    "shutdown": 15.0,
    "switch_to_spare": 30.0,
    "reset_bus": 5.0,
}
"""As in pddl/repair.pddl and in the robots' own actions."""

MOST_STATES = 40
MOST_NODES = 20_000

Belief = frozenset[tuple[State, float]]
Seen = tuple[tuple[int, ...], frozenset[Literal]]
_Now = Callable[[], State]
_Do = Callable[..., int]


@dataclass(frozen=True, slots=True, order=True)
class Repair:
    """What is done to one component, with all that it drags along."""

    how: str  # restart, power, spare, bus
    component: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the policy does to one state."""

    acts: tuple[Act, ...]
    repaired: bool  # False: it gave up
    exact: bool


class Policy:
    """The policy of one robot; what it finds for a belief is remembered."""

    def __init__(self, anatomy: Anatomy) -> None:
        self._anatomy = anatomy
        self._found: dict[Belief, tuple[float, Repair | None]] = {}
        self._left = MOST_NODES
        self._played: dict[tuple[State, Repair], tuple[State, tuple[Act, ...], Seen, float]] = {}

    def outcome(self, state: State, belief: Iterable[tuple[State, float]]) -> Outcome:
        """Return what the policy does when the robot is in `state` and that is all it could tell."""
        left = frozenset(belief)
        acts: list[Act] = []
        exact = True
        while abnormal(self._anatomy, state):
            repair, proved = self.choose(left)
            exact = exact and proved
            if repair is None:
                return Outcome(tuple(acts), False, exact)
            state, done, left = self.carry_out(state, repair, left)
            acts += done
        return Outcome(tuple(acts), True, exact)

    def choose(self, belief: Belief) -> tuple[Repair | None, bool]:
        """Return what to do next, None to give up, and whether that is proved to be cheapest."""
        if len(belief) > MOST_STATES:
            return self._greedy(belief), False
        self._left = MOST_NODES
        repair = self._search(belief)[1]
        return repair, self._left > 0

    def carry_out(
        self, state: State, repair: Repair, belief: Belief
    ) -> tuple[State, tuple[Act, ...], Belief]:
        """Return the state after a repair, its acts, and what is left of the belief when it was looked."""
        following, acts, seen, _ = self._play(state, repair)
        return following, acts, self._split(belief, repair)[seen]

    def repairable(self, state: State) -> bool:
        """Whether somebody who knew what is wrong could repair it."""
        return self.outcome(state, ((state, 1.0),)).repaired

    # --- search

    def _search(self, belief: Belief) -> tuple[float, Repair | None]:
        """Return the least expected cost of a belief, times its weight, and what to do first."""
        known = self._found.get(belief)
        if known is not None:
            return known
        self._left -= 1
        if self._left <= 0:
            return 0.0, self._greedy(belief)
        best: tuple[float, Repair | None] = (0.0, None)
        for repair in self._useful(belief):
            cost = sum(weight * self._play(state, repair)[3] for state, weight in belief)
            for (_, odd), rest in self._split(belief, repair).items():
                if odd:
                    cost += self._search(rest)[0]
            if best[1] is None or cost < best[0] - 1e-12:
                best = (cost, repair)
        self._found[belief] = best
        return best

    def _greedy(self, belief: Belief) -> Repair | None:
        def gain(repair: Repair) -> float:
            healed = cost = 0.0
            for state, weight in belief:
                following, _, _, costs = self._play(state, repair)
                healed += weight * (distance(following) < distance(state))
                cost += weight * costs
            return healed / cost if cost else 0.0

        return max(self._useful(belief), key=gain, default=None)

    def _useful(self, belief: Belief) -> list[Repair]:
        """Return the repairs that bring one state at least nearer to health."""
        found = {
            repair
            for state, _ in belief
            for repair in self._repairs(state)
            if distance(self._play(state, repair)[0]) < distance(state)
        }
        return sorted(found)

    def _split(self, belief: Belief, repair: Repair) -> dict[Seen, Belief]:
        parts: dict[Seen, dict[State, float]] = {}
        for state, weight in belief:
            following, _, seen, _ = self._play(state, repair)
            part = parts.setdefault(seen, {})
            part[following] = part.get(following, 0.0) + weight
        return {seen: frozenset(part.items()) for seen, part in parts.items()}

    # --- repairs

    def _repairs(self, state: State) -> Iterable[Repair]:
        anatomy = self._anatomy
        for name, condition in state:
            if isinstance(condition, NodeCondition):
                node = anatomy.nodes[name]
                if node.restartable and not node.protected:
                    yield Repair("restart", name)
                continue
            device = anatomy.devices[name]
            for other in (name, *device.fed_by):
                if anatomy.devices[other].switchable and not anatomy.devices[other].protected:
                    yield Repair("power", other)
            if device.spare is not None and not condition.replaced:
                yield Repair("spare", name)
            if device.bus is not None:
                yield Repair("bus", device.bus)

    def _play(self, state: State, repair: Repair) -> tuple[State, tuple[Act, ...], Seen, float]:
        """Carry out a repair; return the state, the acts, what is seen of it, and what it cost."""
        known = self._played.get((state, repair))
        if known is not None:
            return known
        acts: list[Act] = []
        answers: list[int] = []

        def do(name: str, *parameters: str) -> int:
            nonlocal state
            act = Act(name, parameters)
            state, code = after(self._anatomy, state, act)
            acts.append(act)
            answers.append(code)
            return code

        begun = state
        self._carry_out(repair, lambda: state, do)
        seen = (tuple(answers), abnormal(self._anatomy, state))
        found = (state, tuple(acts), seen, sum(COSTS[act.name] for act in acts))
        self._played[begun, repair] = found
        return found

    def _carry_out(self, repair: Repair, now: _Now, do: _Do) -> None:
        anatomy, name = self._anatomy, repair.component
        if repair.how == "restart":
            self._restart(name, now, do)
            return
        if repair.how == "power":
            if device_in(now(), name).on:
                do("shutdown", name)
            if do("power_up", name) != 0:
                return
            without = anatomy.fed[name]
        elif repair.how == "spare":
            spare = anatomy.devices[name].spare
            assert spare is not None
            do("switch_to_spare", name, spare)
            without = frozenset({name})
        else:
            do("reset_bus", name)
            without = frozenset(d.name for d in anatomy.devices.values() if d.bus == name)
        for driver in sorted({driver for device in without for driver in anatomy.drivers[device]}):
            node = anatomy.nodes[driver]
            if node.reconnects:
                continue
            if node_in(now(), driver).running and node.restartable and not node.protected:
                self._restart(driver, now, do)

    def _restart(self, name: str, now: _Now, do: _Do) -> None:
        if node_in(now(), name).running:
            do("stop_node", name)
        if do("start_node", name) == 0:
            for other in self._anatomy.tied[name]:
                node = self._anatomy.nodes[other]
                if node_in(now(), other).running and node.restartable and not node.protected:
                    self._restart(other, now, do)


def distance(state: State) -> int:
    """Return how far a state is from health: what a repair can take away, never what nothing takes away."""
    return sum(_distance(condition) for _, condition in state)


def _distance(condition: NodeCondition | DeviceCondition) -> int:
    if isinstance(condition, DeviceCondition):
        if condition.replaced:
            return 0
        return (not condition.on) + (condition.health is not Health.WELL)
    if not condition.starts or condition.ever is not Mood.WELL:
        # Starting it may still have to be tried, to learn so; a successor less is no step nearer.
        return 1
    odd = not condition.running or condition.mood is not Mood.WELL or condition.stale
    return odd + len(condition.successors)
