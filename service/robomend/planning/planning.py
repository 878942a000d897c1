"""Plan the repair of one diagnosis: the whole chain in one function.

    model, OBS, diagnosis ──► problem ──► ground ──► parts ──► a plan for each ──► replay ──► order ──► Plan

`plan_for` is pure but for the clock, and made for a worker process: its arguments and its answer pickle.
Limits are processor time of the process, or work, so that a busy computer turns no answer into "gave up".
robomend.planning.planner_pool calls it from the service.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from robomend.errors import SolverError
from robomend.model.components import ComponentModel
from robomend.model.loops import strong_components
from robomend.planning.cures import Avoided, SuccessRate, best_way
from robomend.planning.decomposition import NamedPart, Part, PartAction, split
from robomend.planning.domain.loading import load_domain
from robomend.planning.domain.values import Domain
from robomend.planning.grounding import GroundAction, Grounder
from robomend.planning.ordering import late, layered, partial_order
from robomend.planning.plan import Outcome, Plan, Step
from robomend.planning.planners import (
    DEFAULT,
    FALLBACK,
    PartAnswer,
    Planner,
    make_planner,
    processor_s,
)
from robomend.planning.planners.dijkstra import Dijkstra
from robomend.planning.planners.relaxed import achieves
from robomend.planning.problem import RepairProblem, Restrictions, problem_text, repair_problem
from robomend.planning.relevance import ground
from robomend.planning.static_facts import UNBOUNDED, OutOfWork, Work
from robomend.planning.validation import replay
from robomend_client.literals import Atom, Literal


@dataclass(frozen=True, slots=True)
class PlanOptions(Restrictions):
    """How to plan. The defaults are those of HTTP and the command line."""

    planner: str = DEFAULT
    timeout_s: float | None = 5.0  # processor time
    domain: str | None = None  # the user's PDDL: actions for repair.pddl, or a whole domain
    domain_file: str | None = None  # what messages call it
    pddl: bool = False  # add the PDDL to the plan
    rates: tuple[SuccessRate, ...] = ()  # how probably acts cure, where that is given or learned


def plan_for(
    model: ComponentModel,
    observed: Iterable[Literal],
    bad: Collection[str],
    options: PlanOptions = PlanOptions(),
    work: Work | None = None,
) -> Plan:
    """Return a validated plan that makes every component good, as far as known actions can.

    Args:
        work: the bound on a plan that is made at once, by robomend.planning.planners.dijkstra; None: the
            planner that the options name is asked.

    Raises:
        OutOfWork: it takes more than `work`.
        DomainError: the user's PDDL is at fault.
        UnknownComponent: the diagnosis or an option names no component of the model.
        OptionRefused: no such planner.
        SolverError: the planner and the fallback failed.
    """
    started = time.perf_counter()
    domain = load_domain(options.domain, options.domain_file)
    problem = repair_problem(model, domain, observed, bad, options)
    plan = plan_problem(domain, problem, options, work)
    return replace(plan, elapsed_s=time.perf_counter() - started)


def plans_for(
    model: ComponentModel,
    observed: Iterable[Literal],
    diagnoses: Sequence[Collection[str]],
    options: PlanOptions = PlanOptions(),
) -> list[Plan]:
    """Return a plan for each diagnosis; those for which the time is up are GAVE_UP."""
    literals = tuple(observed)
    make_planner(options.planner)  # loading it is not planning
    deadline = None if options.timeout_s is None else processor_s() + options.timeout_s
    found: list[Plan] = []
    for bad in diagnoses:
        left = None if deadline is None else deadline - processor_s()
        if left is not None and left <= 0 and found:
            found.append(gave_up(options.planner, 0.0))
        else:
            found.append(_way_for(model, literals, bad, replace(options, timeout_s=left)))
    return found


EVERYDAY = (DEFAULT, FALLBACK)
"""Planners that a service is asked for, and that are stood in for where there is little work."""

AT_ONCE = 50_000
"""Steps of work: less than a tenth of a second of processor time; a robot of 50 components takes a tenth."""

AT_ONCE_COMPONENTS = 300
AT_ONCE_CHARACTERS = 20_000
"""Of a model, and of a user's domain, that are looked at at all: a few milliseconds."""


def may_be_little(model: ComponentModel, options: PlanOptions) -> bool:
    """Return whether `plans_at_once` looks at it at all. A planner that is not an everyday one is meant."""
    return (
        options.planner in EVERYDAY
        and len(model.components) <= AT_ONCE_COMPONENTS
        and len(options.domain or "") <= AT_ONCE_CHARACTERS
    )


def plans_at_once(
    model: ComponentModel,
    observed: Iterable[Literal],
    diagnoses: Sequence[Collection[str]],
    options: PlanOptions = PlanOptions(),
) -> list[Plan] | None:
    """Return what `plans_for` does, without a planner to be loaded; None if that is more than little work.

    The plans cost what those of the other planners cost: parts are searched as they are there. For any
    thread.

    Raises:
        As `plan_for` does.
    """
    if not may_be_little(model, options):
        return None
    literals = tuple(observed)
    work = Work(AT_ONCE)
    try:
        found = [_way_for(model, literals, bad, replace(options, timeout_s=None), work) for bad in diagnoses]
    except OutOfWork:
        return None
    return None if any(plan.outcome is Outcome.GAVE_UP for plan in found) else found


def _way_for(
    model: ComponentModel,
    observed: Iterable[Literal],
    bad: Collection[str],
    options: PlanOptions,
    work: Work | None = None,
) -> Plan:
    """Return the cheapest plan, or, where the user's actions have it, a way that is likelier to help."""
    began = processor_s()
    plan = plan_for(model, observed, bad, options, work)
    if options.domain is None and not options.rates:
        return plan
    left_s = None if options.timeout_s is None else max(0.0, options.timeout_s - (processor_s() - began))

    def other(avoided: Avoided) -> Plan:
        again = replace(options, timeout_s=left_s, avoided=(*options.avoided, *avoided))
        return plan_for(model, observed, bad, again, work)

    return best_way(plan, bad, other, {(rate.act, rate.component): rate for rate in options.rates})


def gave_up(planner: str, elapsed_s: float) -> Plan:
    """Return the answer for a planner that ran out of time."""
    return Plan(Outcome.GAVE_UP, (), 0.0, planner, frozenset(), (), (), (), elapsed_s)


def plan_problem(
    domain: Domain, problem: RepairProblem, options: PlanOptions, work: Work | None = None
) -> Plan:
    """Return a validated plan for a problem that is built already; see `plan_for`."""
    search = _PartSearch(options, work)
    grounder = Grounder(domain, problem, work or UNBOUNDED)
    goal = [grounder.number(fact) for fact in problem.goal]
    unreachable: dict[int, str] = {}
    serial: list[GroundAction] | None = None

    def sentences() -> tuple[str, ...]:
        return tuple(unreachable[number] for number in goal if number in unreachable)

    while serial is None:
        ground_problem = ground(grounder, [number for number in goal if number not in unreachable])
        unreachable.update(ground_problem.unreachable)
        lost: dict[int, str] = {}
        serial = []
        for part in split(ground_problem):
            answer = search.solve(part.part)
            given_up = _lost_goals(grounder, part, search) if answer.outcome is Outcome.UNSOLVABLE else {}
            if answer.outcome is Outcome.GAVE_UP or given_up is None:
                unreachable.update(lost)
                return replace(
                    gave_up(search.used, 0.0),
                    unreachable=sentences(),
                    excluded=problem.excluded,
                    assumed=problem.assumed,
                )
            lost.update(given_up)
            serial.extend(part.actions[index] for index in answer.actions)
        if lost:
            # What waits for a lost goal must be planned anew, without it.
            unreachable.update(lost)
            serial = None
    kept = [number for number in goal if number not in unreachable]
    names = [(action.name, action.parameters) for action in serial]
    if work is not None:
        work.spend(len(names) * len(names))  # the order may compare each with each
    complete, flaw = replay(grounder, names, kept)
    if flaw is not None:
        raise SolverError(f"{search.used} gave an invalid plan: {flaw}")
    return Plan(
        outcome=Outcome.UNSOLVABLE if unreachable else Outcome.SOLVED,
        steps=_steps(grounder, complete),
        cost=sum(action.cost for action in complete),
        planner=search.used,
        initial=frozenset(
            Atom(fact[0], fact[1:]) for fact in problem.initial if fact[0] not in domain.static
        ),
        assumed=problem.assumed,
        unreachable=sentences(),
        excluded=problem.excluded,
        elapsed_s=0.0,
        pddl=(domain.pddl, problem_text(domain, problem, problem.goal)) if options.pddl else None,
    )


EXACT_UP_TO = 14
"""Actions of a part that is searched as a whole: a device with some drivers. Larger ones: in stages first."""


class _PartSearch:
    """Asks the planner part by part, the fallback where the planner fails or a part is too large for it."""

    def __init__(self, options: PlanOptions, work: Work | None) -> None:
        self._planner = make_planner(options.planner) if work is None else Dijkstra(work)
        self._deadline = None if options.timeout_s is None else processor_s() + options.timeout_s
        self.used = self._planner.name

    def solve(self, part: Part) -> PartAnswer:
        """Return the answer for a part: exact for small ones, in stages for large ones where that works."""
        if len(part.actions) > EXACT_UP_TO:
            plan = in_series(part, self.solve)
            if plan is not None and achieves(part, plan):
                return PartAnswer(Outcome.SOLVED, plan)
        return self._whole(part)

    def _whole(self, part: Part) -> PartAnswer:
        planner = self._planner
        if planner.max_actions is not None and len(part.actions) > planner.max_actions:
            planner = make_planner(FALLBACK)
        try:
            answer = self._ask(planner, part)
        except SolverError:
            if planner.name == FALLBACK:
                raise
            planner = make_planner(FALLBACK)
            answer = self._ask(planner, part)
        if planner.name != self._planner.name:
            self.used = f"{self._planner.name}+{planner.name}"
        return answer

    def _ask(self, planner: Planner, part: Part) -> PartAnswer:
        known = _ANSWERS.get((planner.name, part))
        if known is not None:
            return known
        left = None if self._deadline is None else max(0.0, self._deadline - processor_s())
        answer = planner.solve(part, left)
        if answer.outcome is Outcome.SOLVED and not achieves(part, answer.actions):
            raise SolverError(
                f"{planner.name} gave an invalid plan for a part of {len(part.actions)} actions"
            )
        late = self._deadline is not None and processor_s() >= self._deadline
        if answer.outcome is not Outcome.GAVE_UP and not (late and answer.outcome is Outcome.SOLVED):
            _ANSWERS.put((planner.name, part), answer)  # not the best that was found until the time was up
        return answer


class _Memory:
    """The answers of late: a robot's devices mostly pose the same small problems, a fleet's robots too.

    For all threads.
    """

    def __init__(self, max_actions: int) -> None:
        self._lock = threading.Lock()
        self._answers: OrderedDict[tuple[str, Part], PartAnswer] = OrderedDict()
        self._room = max_actions  # in actions, so that large parts do not fill the memory

    def get(self, key: tuple[str, Part]) -> PartAnswer | None:
        with self._lock:
            found = self._answers.get(key)
            if found is not None:
                self._answers.move_to_end(key)
            return found

    def put(self, key: tuple[str, Part], answer: PartAnswer) -> None:
        with self._lock:
            if key not in self._answers:
                self._room -= len(key[1].actions)
            self._answers[key] = answer
            while self._room < 0:
                (_, part), _ = self._answers.popitem(last=False)
                self._room += len(part.actions)

    def clear(self) -> None:
        with self._lock:
            self._room += sum(len(part.actions) for _, part in self._answers)
            self._answers.clear()


_ANSWERS = _Memory(max_actions=50_000)


def forget() -> None:
    """Forget the answers of late: for measurements."""
    _ANSWERS.clear()


def _lost_goals(grounder: Grounder, part: NamedPart, search: _PartSearch) -> dict[int, str] | None:
    """Return the goals of an unsolvable part that must be given up, each with a sentence; None where the time
    ran out before all of that was proved.

    Each goal by itself looked reachable, so goals exclude one another, or need an order of events that does
    not exist. Goals are kept one by one while a plan remains: once beginning with what is broken, once with
    what works; the larger set is kept, and of equal ones that with the repair.
    """
    facts = dict(zip(part.goals, sorted(part.part.goal), strict=True))
    broken = [number for number in facts if not grounder.holds_at_first(number)]
    working = [number for number in facts if grounder.holds_at_first(number)]

    def solvable(numbers: Collection[int]) -> bool:
        goal = frozenset(facts[one] for one in numbers)
        answer = search.solve(replace(part.part, goal=goal))
        if answer.outcome is Outcome.GAVE_UP:
            raise _GaveUp
        return answer.outcome is Outcome.SOLVED

    try:
        best: list[int] = []
        for order in (broken + working, working + broken):
            kept: list[int] = []
            for number in order:
                if solvable((*kept, number)):
                    kept.append(number)
            if len(kept) > len(best):
                best = kept
        alone = {number: solvable((number,)) for number in facts if number not in best}
    except _GaveUp:
        return None
    others = ", ".join(sorted({", ".join(grounder.fact(one)[1:]) for one in best}))
    sentences: dict[int, str] = {}
    for number, possible in alone.items():
        word, *names = grounder.fact(number)
        if possible and best:
            why = f"cannot be made {word} together with {others}"
        else:
            why = f"no sequence of known actions makes it {word}"
        sentences[number] = f"{', '.join(names)}: {why}"
    return sentences


class _GaveUp(Exception):
    """A planner ran out of time: what it was asked is neither possible nor impossible."""


def _steps(grounder: Grounder, plan: Sequence[GroundAction]) -> tuple[Step, ...]:
    """Return the actions as steps of a partial order, devices before processes where the order is free."""
    objects = {name: index for index, name in enumerate(grounder.problem.objects)}
    after = late(plan, partial_order(plan))

    def rank(position: int) -> tuple[int, ...]:
        parameters = plan[position].parameters
        first = parameters[0] if parameters else ""
        kind = grounder.problem.objects.get(first, "")
        is_node = bool(kind) and "node" in grounder.domain.supertype and grounder.domain.is_a(kind, "node")
        return (int(is_node), objects.get(first, -1))

    order = layered(after, rank)
    new = {position: index for index, position in enumerate(order)}
    return tuple(
        Step(
            index=index,
            name=plan[position].name,
            parameters=plan[position].parameters,
            cost=plan[position].cost,
            after=tuple(sorted(new[other] for other in after[position])),
            preconditions=tuple(map(grounder.literal, sorted(plan[position].needs, key=abs))),
            effects=tuple(map(grounder.literal, sorted(plan[position].effects, key=abs))),
        )
        for index, position in enumerate(order)
    )


# --- plan a large part stage by stage: what feeds others first, then what is fed.
#
#     power supply ──► devices that it feeds ──► their drivers
#
# A power supply that is cycled takes everything behind it down, so all of that is one part, too large for a
# planner that searches for the cheapest plan. Its actions still depend on each other in one direction. A
# stage is a strongly connected component of "writes what the other needs"; stages are planned in order,
# each from the state that those before it leave behind, for the goals that no later stage brings about.
#
# Every step is planned in the state that it will find, so the result is a plan or there is none (None: the
# caller searches the whole part). It need not be a cheapest one: a dearer supply-side plan that spares the
# devices is not seen.
#
# Source: as decomposition.py; serialisable subgoals, R. Korf. Planning as search. AIJ 33, 1987.


def in_series(part: Part, solve: Callable[[Part], PartAnswer]) -> tuple[int, ...] | None:
    """Return a plan as indices of the part's actions, None when planning in stages does not get there."""
    order = stages(part)
    if len(order) < 2:
        return None
    last: dict[int, int] = {}  # fact -> the last stage that can achieve it
    for number, stage in enumerate(order):
        for index in stage:
            last.update(dict.fromkeys(part.actions[index].adds, number))
    state = set(part.initial)
    plan: list[int] = []
    for number, stage in enumerate(order):
        written: dict[int, int] = {}
        for index in stage:
            action = part.actions[index]
            for fact in (*sorted(action.needs), *sorted(action.adds), *sorted(action.deletes)):
                written.setdefault(fact, len(written))
        changed = {fact for index in stage for fact in part.actions[index].adds | part.actions[index].deletes}
        goal = {fact for fact in part.goal & changed if last.get(fact, -1) <= number}
        if goal <= state:
            continue
        usable = [index for index in stage if part.actions[index].needs - changed <= state]
        answer = solve(
            Part(
                len(written),
                tuple(_renumbered(part.actions[index], written) for index in usable),
                frozenset(written[fact] for fact in written if fact in state),
                frozenset(written[fact] for fact in goal),
            )
        )
        if answer.outcome is not Outcome.SOLVED:
            return None
        for chosen in answer.actions:
            action = part.actions[usable[chosen]]
            state -= action.deletes
            state |= action.adds
            plan.append(usable[chosen])
    return tuple(plan) if part.goal <= state else None


def stages(part: Part) -> list[list[int]]:
    """Return the actions in groups such that no group writes what an earlier one needs."""
    writers: dict[int, list[str]] = defaultdict(list)
    for index, action in enumerate(part.actions):
        for fact in action.adds | action.deletes:
            writers[fact].append(str(index))
    waits_for = {
        str(index): sorted({writer for fact in action.needs for writer in writers[fact]}, key=int)
        for index, action in enumerate(part.actions)
    }
    numbers = strong_components(waits_for)
    groups: dict[int, list[int]] = defaultdict(list)
    for index in range(len(part.actions)):
        groups[numbers[str(index)]].append(index)
    return [groups[number] for number in sorted(groups)]


def _renumbered(action: PartAction, numbers: dict[int, int]) -> PartAction:
    return PartAction(
        action.cost,
        frozenset(numbers[fact] for fact in action.needs),
        frozenset(numbers[fact] for fact in action.adds),
        frozenset(numbers[fact] for fact in action.deletes),
    )
