"""Repair planning: the paper's robot and seeded robots of 100 and 1000 components, against the stock chain.

    dijkstra, asp, …      robomend, diagnosis to validated plan; answers are forgotten before each question
    NAME:warm             the same, with the answers to equal parts remembered, as in service
    up-chain              Unified Planning alone: PDDL text, up_quantifiers_remover, up_grounder, pyperplan
    fast-downward-whole   Fast Downward, optimal, over the whole problem: none of our grounding

Mode `time` asks for two bad components and for all bad at once. Mode `cost` compares the cost of plans, with
Fast Downward where it is installed, on two groups: small robots, each of whose parts is searched whole, and
robots with a power supply, whose part is planned in stages where enough of it is broken
(robomend.planning.decomposition). `dijkstra`, `asp` and Fast Downward are held to the cheapest plan that
anybody found, `pyperplan` to 1.1 times its cost.
"""

from __future__ import annotations

import random
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from robomend.errors import InputError, OptionRefused
from robomend.model.components import ComponentModel, Hardware, Node
from robomend.model.loading import load_model
from robomend.planning.domain.loading import load_domain
from robomend.planning.plan import Outcome
from robomend.planning.planners import PLANNERS, make_planner
from robomend.planning.planning import PlanOptions, forget, plan_for
from robomend.planning.problem import needs_of, problem_text, repair_problem
from robomend.resources import resource
from robomend_bench.exporting import Exported, PlanningProblem
from robomend_bench.suite import Answer, Ask, Group, Question, Wish
from robomend_client.literals import Literal, fails

# --- seeded random robots and states for the planning benchmark and its tests.
#
# `random_robot` is any robot, `supplied_robot` one whose power supply makes most of it a single question.
#
# A robot of n components has about a quarter devices, half of them fed by another, most on a channel of a
# power board large enough; half of the devices have a driver; the other nodes rest on the topics of up to
# three earlier nodes, near ones preferred, so that the longest chain grows with n. Now and then a node is
# tied to another, is not restartable, or closes a cycle of topics. Same seed, same robot, on every machine.


def random_robot(seed: int, components: int, *, awkward: bool = True) -> ComponentModel:
    """Return a robot of `components` components; not awkward: everything can be switched and restarted."""
    chance = random.Random(f"robot {seed} {components}")
    devices = max(1, components // 4)
    hardware: dict[str, Hardware] = {}
    for index in range(devices):
        name = f"device{index}"
        feeders = (f"device{chance.randrange(index)}",) if index and chance.random() < 0.5 else ()
        channel = None if awkward and chance.random() < 0.15 else index
        hardware[name] = Hardware(name, channel, fed_by=feeders)
    nodes: dict[str, Node] = {}
    names = [f"node{index}" for index in range(components - devices)]
    for index, name in enumerate(names):
        topic = f"topic{index}"
        if index < devices and chance.random() < 0.7:
            nodes[name] = Node(name, drives=(f"device{index}",), publishes={topic: ()})
            continue
        near = names[max(0, index - 12) : index]
        inputs = chance.sample(near, min(len(near), chance.randint(1, 3)))
        rests_on = tuple(f"topic{names.index(other)}" for other in inputs)
        tied = (chance.choice(near),) if near and chance.random() < 0.05 else ()
        node = Node(name, publishes={topic: rests_on}, tied_to=tied)
        if awkward and chance.random() < 0.03:
            node = replace(node, restartable=False)
        nodes[name] = node
    if awkward and len(names) > 4 and chance.random() < 0.3:
        # Close a cycle of topics between the last node and one before it.
        first = nodes[names[-3]]
        nodes[first.name] = replace(
            first, publishes={topic: (*on, f"topic{len(names) - 1}") for topic, on in first.publishes.items()}
        )
    return ComponentModel(f"random-{seed}", hardware, nodes, {}, channels=devices)


def supplied_robot(seed: int) -> ComponentModel:
    """Return a robot of 9 to 14 components: one supply feeds 4 to 6 devices, each with its driver.

    Three devices or more hang on the supply itself, others now and then on a device before them; a driver may
    be tied to the one before it, and most robots have a node that rests on two drivers. Whatever cycles the
    supply takes all of that along: one part of 18 to 26 actions.
    """
    chance = random.Random(f"supplied {seed}")
    count = chance.choice((4, 5, 6))
    hardware = {"supply": Hardware("supply", 0)}
    nodes: dict[str, Node] = {}
    for index in range(count):
        device, driver = f"device{index}", f"driver{index}"
        chained = index >= 3 and chance.random() < 0.4
        feeder = f"device{chance.randrange(index)}" if chained else "supply"
        hardware[device] = Hardware(device, index + 1, fed_by=(feeder,))
        tied = (f"driver{index - 1}",) if index and chance.random() < 0.25 else ()
        nodes[driver] = Node(driver, drives=(device,), publishes={f"topic{index}": ()}, tied_to=tied)
    if chance.random() < 0.6:
        nodes["merger"] = Node("merger", publishes={"merged": ("topic0", "topic1")})
    return ComponentModel(f"supplied-{seed}", hardware, nodes, {}, channels=count + 1)


def broken(model: ComponentModel, bad: Collection[str], seed: int | None = None) -> list[Literal]:
    """Return OBS in which bad components are off or stopped; with a seed only half of them are."""
    chance = random.Random(f"state {seed}")
    seen: list[Literal] = []
    for name in model.components:
        if name not in bad or (seed is not None and chance.random() < 0.5):
            continue
        if name in model.nodes:
            seen.append(fails("running", name))
        elif model.switchable(name):
            seen.append(fails("on", name))
    return seen


def some_bad(model: ComponentModel, count: int, seed: int) -> tuple[str, ...]:
    """Return `count` components, one a driver or a device where there is one."""
    return tuple(random.Random(f"bad {seed}").sample(model.components, min(count, len(model.components))))


def longest_chain(model: ComponentModel) -> int:
    """Return how many nodes the longest chain of `needs` has."""
    follows: dict[str, list[str]] = {name: [] for name in model.nodes}
    for node, other in needs_of(model):
        follows[node].append(other)
    depth: dict[str, int] = {}
    for name in model.nodes:
        work = [name]
        while work:
            top = work[-1]
            missing = [other for other in follows[top] if other not in depth]
            if missing:
                work.extend(missing)
                continue
            depth[work.pop()] = 1 + max((depth[other] for other in follows[top]), default=0)
    return max(depth.values(), default=0)


UP_CHAIN = "up-chain"
FD_WHOLE = "fast-downward-whole"

SIZES = {"tedusar": 14, "robot-100": 100, "robot-1000": 1000}
SMALL, SUPPLIED = "small-robots", "supplied-robots"
COST_ROBOTS = {SMALL: 25, SUPPLIED: 30}

CHEAPEST, NEARLY = 1.0, 1.1
"""How many times the cost of the cheapest plan that is known a plan may cost."""

Payload = tuple[ComponentModel, list[Literal], tuple[str, ...]]
"""Robot, OBS and diagnosis."""


class Plans:
    """See the module."""

    name = "plans"
    version = "1"
    summary = "repair planning: power-up and seeded robots of 100 and 1000 components"
    modes: Mapping[str, str] = {
        "time": "from diagnosis to validated plan, two components bad and all bad",
        "cost": "cost of the plan, on tedusar, 25 small robots and 30 with a supply",
    }

    def contenders(self, mode: str) -> tuple[str, ...]:
        """Return our planners, and what they are compared with."""
        if mode == "time":
            return (UP_CHAIN, "dijkstra", "pyperplan", "asp", "pyperplan:warm")
        return ("dijkstra", "asp", "pyperplan", *((FD_WHOLE,) if find_spec("up_fast_downward") else ()))

    def groups(self, wish: Wish) -> Iterator[Group]:
        """Yield a robot a group; in mode `cost`, a group of small ones and one of those with a supply."""
        known = tuple(COST_ROBOTS if wish.mode == "cost" else SIZES)
        for name in wish.only or known:
            if name not in known:
                raise InputError(f"no group {name}: choose from {', '.join(known)}")
            if name == SMALL:
                yield Group(name, 9, None, tuple(_small_questions(wish)))
                continue
            if name == SUPPLIED:
                yield Group(name, 14, None, tuple(_supplied_questions(wish)))
                continue
            if name == "tedusar":
                robot = _tedusar()
                off = tuple(c for c in robot.components if robot.switchable(c) or c in robot.nodes)
                yield Group(
                    name,
                    14,
                    None,
                    (_question("power-up", robot, off), _question("shut-down", robot, ("jaguar",))),
                )
                continue
            robot = random_robot(wish.seed, SIZES[name], awkward=False)
            title = f"{name} (longest chain {longest_chain(robot)})"
            two = _question("2 bad", robot, some_bad(robot, 2, wish.seed))
            yield Group(title, SIZES[name], None, (two, _question("all bad", robot, robot.components)))

    def prepare(self, contender: str, group: Group, wish: Wish) -> Ask:
        """Return what plans one diagnosis."""
        if contender in (UP_CHAIN, FD_WHOLE):
            return _stock(contender, wish)
        name, _, how = contender.partition(":")
        if name not in PLANNERS.names() or how not in ("", "warm"):
            known = ", ".join((UP_CHAIN, FD_WHOLE, *PLANNERS.names()))
            raise OptionRefused(f"no contender {contender!r}: choose from {known}, or a planner with :warm")
        make_planner(name)
        options = PlanOptions(planner=name, timeout_s=wish.timeout_s)
        bound = NEARLY if name == "pyperplan" else CHEAPEST

        def ask(question: Question) -> Answer:
            if not how:
                forget()
            robot, seen, bad = question.payload
            plan = plan_for(robot, seen, bad, options)
            done = plan.outcome is not Outcome.GAVE_UP
            return _answer(wish, plan.cost, len(plan.steps), bound, complete=done)

        return ask

    def exported(self, question: Question, group: Group) -> Exported:
        """Return the repair problem."""
        robot, seen, bad = question.payload
        domain = load_domain()
        return PlanningProblem(domain, repair_problem(robot, domain, seen, bad))


def _answer(wish: Wish, cost: float, steps: int, bound: float, *, complete: bool = True) -> Answer:
    """Costs are compared in mode `cost` only: elsewhere planners may differ."""
    if wish.mode != "cost":
        return Answer((), complete, shown=steps)
    return Answer((), complete, shown=steps, cost=cost, bound=bound)


def _tedusar() -> ComponentModel:
    parts = load_model(resource("examples", "tedusar.yaml")).parts
    assert parts is not None
    return parts


def _question(name: str, robot: ComponentModel, bad: tuple[str, ...], seed: int | None = None) -> Question:
    payload: Payload = (robot, broken(robot, bad, seed), bad)
    return Question(name, payload)


def _small_questions(wish: Wish) -> Iterator[Question]:
    tedusar = _tedusar()
    yield _question("tedusar shut-down", tedusar, ("jaguar",))
    for number in range(wish.instances or COST_ROBOTS[SMALL]):
        seed = wish.seed * 1000 + number
        robot = random_robot(seed, 7 + seed % 3, awkward=False)
        bad = some_bad(robot, 2 + seed % 4, seed) if seed % 3 else robot.components
        yield _question(f"robot {seed}, {len(bad)} bad", robot, bad, seed)


def _supplied_questions(wish: Wish) -> Iterator[Question]:
    """The supply alone, the supply with one to three others, everything."""
    for number in range(wish.instances or COST_ROBOTS[SUPPLIED]):
        seed = wish.seed * 1000 + number
        robot = supplied_robot(seed)
        others = robot.components[1:]
        few = random.Random(f"bad supplied {seed}").sample(others, 1 + number // 3 % 3)
        bad = (("supply",), ("supply", *few), robot.components)[number % 3]
        yield _question(f"robot {seed}, {len(bad)} bad", robot, bad, seed)


# --- the stock chain ------------------------------------------------------------------------------


def _stock(contender: str, wish: Wish) -> Ask:
    try:
        from unified_planning.shortcuts import get_environment
    except ImportError as error:
        raise OptionRefused(f"{contender} needs Unified Planning: {error}") from error
    get_environment().credits_stream = None
    if contender == FD_WHOLE and not find_spec("up_fast_downward"):
        raise OptionRefused("Fast Downward is not installed: pip install 'robomend[fast-downward]'")
    solve = _up_chain if contender == UP_CHAIN else _fast_downward
    domain = load_domain()
    costs = {name: schema.cost for name, schema in domain.schemas.items()}

    def ask(question: Question) -> Answer:
        robot, seen, bad = question.payload
        problem = repair_problem(robot, domain, seen, bad)
        with TemporaryDirectory() as folder:
            files = Path(folder, "domain.pddl"), Path(folder, "problem.pddl")
            files[0].write_text(domain.pddl)
            files[1].write_text(problem_text(domain, problem, problem.goal))
            names = solve(files, wish.timeout_s)
        if names is None:
            return Answer((), complete=False)
        cost = sum(next(cost for key, cost in costs.items() if name.startswith(key)) for name in names)
        return _answer(wish, cost, len(names), CHEAPEST)

    return ask


def _up_problem(files: tuple[Path, Path]) -> Any:
    from unified_planning.io import PDDLReader
    from unified_planning.shortcuts import CompilationKind, Compiler

    problem = PDDLReader().parse_problem(str(files[0]), str(files[1]))
    with Compiler(name="up_quantifiers_remover") as compiler:
        return compiler.compile(problem, CompilationKind.QUANTIFIERS_REMOVING).problem


def _up_chain(files: tuple[Path, Path], timeout_s: float) -> list[str] | None:
    from unified_planning.shortcuts import CompilationKind, Compiler, OneshotPlanner

    with Compiler(name="up_grounder") as compiler:
        problem = compiler.compile(_up_problem(files), CompilationKind.GROUNDING).problem
    with Compiler(name="up_disjunctive_conditions_remover") as compiler:
        problem = compiler.compile(problem, CompilationKind.DISJUNCTIVE_CONDITIONS_REMOVING).problem
    with Compiler(name="up_negative_conditions_remover") as compiler:
        problem = compiler.compile(problem, CompilationKind.NEGATIVE_CONDITIONS_REMOVING).problem
    problem.clear_quality_metrics()
    with OneshotPlanner(name="pyperplan", params={"search": "gbf", "heuristic": "hff"}) as planner:
        result = planner.solve(problem)
    return [action.action.name for action in result.plan.actions] if result.plan else None


def _fast_downward(files: tuple[Path, Path], timeout_s: float) -> list[str] | None:
    from unified_planning.shortcuts import OneshotPlanner

    with Path("/dev/null").open("w") as silence, OneshotPlanner(name="fast-downward-opt") as planner:
        result = planner.solve(_up_problem(files), timeout=timeout_s, output_stream=silence)
    return [action.action.name for action in result.plan.actions] if result.plan else None


SUITE = Plans()
