"""Which variants a robot works by: the choice against brute force, dwell and bounds on a clock, plans."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from itertools import product

import pytest
from tests.planning.test_planning_oracles import cheapest

from robomend.errors import ModelError
from robomend.model.functions import needs_of
from robomend.model.loading import load_text
from robomend.model.system import System
from robomend.planning.configurations import (
    Decision,
    Keeper,
    KnownState,
    Made,
    VariantChange,
    change_plan,
    does_without,
)
from robomend.planning.domain.loading import load_domain
from robomend.planning.domain.values import Domain
from robomend.planning.plan import Outcome, Plan
from robomend.planning.planning import PlanOptions, plan_problem
from robomend.planning.problem import RepairProblem
from robomend.planning.static_facts import Work
from robomend_client.literals import Atom, Literal, fails, holds

S = 10**9

SUAVE = """\
robomend: 1
name: suave
nodes: {camera: {}, sonar: {}}
properties: [visibility]
functions:
  altitude:
    prefer: [high, medium, low]
    variants:
      high: {when: "visibility >= 3.25 ± 0.02", needs: camera, do: ["change_mode(spiral, high)"]}
      medium: {when: "visibility >= 2.25 ± 0.02", needs: camera, do: ["change_mode(spiral, medium)"]}
      low: {do: ["change_mode(spiral, low)"]}
    dwell_s: 0.3
"""


class Water:
    """A robot of which everything is observed, on a virtual clock; its changes take effect at once."""

    def __init__(self, text: str = SUAVE, active: str = "medium") -> None:
        self.system = load_text(text)
        assert self.system.parts is not None
        self.model = self.system.parts
        self.active = active
        self.visibility: float | None = 2.5
        self.diagnoses: list[set[str]] = []
        self.left_off: set[str] = set()
        self.keeper = Keeper()

    def decide(self, now_s: float, *, act: bool = True) -> Decision:
        known = KnownState(
            lambda atom: atom.args[1] == self.active if atom.predicate == "active" else None,
            lambda atom: self.visibility,
            self.diagnoses,
            self.left_off,
        )
        found = self.keeper.decide(self.model, self.system.conditions, known, round(now_s * S))
        for change in found.changes if act else ():
            made = Made(round(now_s * S), change.function, change.source, change.target, change.fault)
            self.keeper.changed(made)
            self.active = change.target
        return found


def test_suave_flies_at_the_right_altitude_but_for_moments() -> None:
    """The published uncertainty: 2.5 ± 1.25 m, period 80 s, for 110 s; seen ten times a second."""
    water, wrong_s = Water(), 0.0
    changes: list[VariantChange] = []
    for tick in range(1100):
        now_s = tick / 10
        water.visibility = 2.5 + 1.25 * math.sin(2 * math.pi * now_s / 80)
        changes += water.decide(now_s).changes
        best = "high" if water.visibility >= 3.25 else "medium" if water.visibility >= 2.25 else "low"
        wrong_s += 0.1 * (water.active != best)
    assert [change.target for change in changes] == ["high", "medium", "low", "medium", "high"]
    assert wrong_s < 4
    assert changes[1].reason == "visibility fell to 3.227, at least 3.25"


@pytest.mark.parametrize("dwell_s", [0, 0.5, 1, 5])
@pytest.mark.parametrize("period_s", [0.4, 1, 2, 3, 8])
def test_a_condition_that_flaps_ends_with_the_safer_variant(dwell_s: float, period_s: float) -> None:
    """It crosses its threshold after each period, for ten minutes."""
    water = Water(SUAVE.replace("dwell_s: 0.3", f"dwell_s: {dwell_s}"), "high")
    changes: list[VariantChange] = []
    for tick in range(6000):
        now_s = tick / 10
        water.visibility = 3.0 if int(now_s / period_s) % 2 else 3.5
        changes += water.decide(now_s).changes
    assert 1 <= len(changes) <= 6
    assert water.active == "medium"
    if len(changes) > 2:
        water.visibility = 3.5
        water.decide(601)
        state = water.decide(610).states["altitude"]
        why = "a change for the better had to be undone soon, 2 times within the hour"
        assert state.held == f"high is admissible again, and not changed to: {why}"
        assert [change.target for change in water.decide(2 * 3600).changes] == ["high"]


@pytest.mark.parametrize("deep", [2.0, 2.9])
def test_what_flaps_bars_only_the_variants_that_did_not_last(deep: float) -> None:
    """Falls to `deep` soon after it was well, twice: what held at that depth is not barred with the rest."""
    water = Water(SUAVE.replace("dwell_s: 0.3", "dwell_s: 0.1"), "low")
    made: list[str] = []
    for tick in range(600):
        now_s = tick / 10
        water.visibility = 5.0 if tick % 40 < 20 else deep
        made += [change.target for change in water.decide(now_s).changes]
    assert len(made) <= 6
    water.visibility = 2.9  # good enough for medium
    water.decide(100)
    water.decide(101)
    assert water.active == ("low" if deep < 2.25 else "medium")
    water.visibility = 5.0
    water.decide(102)
    assert water.decide(103).changes == ()  # high did not last


def test_a_better_variant_is_not_barred_as_one_between_flapped() -> None:
    water = Water(SUAVE.replace("dwell_s: 0.3", "dwell_s: 0.1"), "low")
    for tick in range(600):
        water.visibility = 2.9 if tick % 40 < 20 else 2.0
        water.decide(tick / 10)
    assert water.active == "low"
    water.visibility = 5.0
    water.decide(100)
    (change,) = water.decide(101).changes
    assert change.target == "high"


def test_what_flaps_slowly_ends_with_the_safer_variant_by_the_bound_of_an_hour() -> None:
    water = Water(SUAVE.replace("dwell_s: 0.3", "dwell_s: 1\n    changes_per_hour: 6"), "high")
    changes: list[VariantChange] = []
    for now_s in range(3500):
        water.visibility = 3.0 if now_s // 60 % 2 else 3.5
        changes += water.decide(now_s).changes
    assert [change.target for change in changes] == ["medium", "high", "medium", "high", "medium"]
    water.visibility = 3.5
    water.decide(3500)
    state = water.decide(3505).states["altitude"]
    assert (
        state.held
        == "high is admissible again, and not changed to: 5 changes within the hour, and at most 6 are made"
    )
    assert [change.target for change in water.decide(2 * 3600).changes] == ["high"]


def test_to_what_is_worse_is_changed_at_once_and_back_after_the_dwell() -> None:
    water = Water(SUAVE.replace("dwell_s: 0.3", "dwell_s: 5"), "high")
    water.visibility = 3.3
    assert water.decide(0).changes == ()
    water.visibility = 2.9
    (change,) = water.decide(10).changes
    assert change == VariantChange(
        "altitude", "high", "medium", "visibility fell to 2.9, at least 3.25", False
    )
    water.visibility = 3.6
    found = water.decide(20)
    assert (found.changes, found.again_ns) == ((), 25 * S)
    assert water.decide(24.9).changes == ()
    (change,) = water.decide(25).changes
    assert change == VariantChange(
        "altitude", "medium", "high", "visibility rose to 3.6, at least 3.25", True
    )


def test_a_fault_is_bridged_by_the_variant_that_does_without() -> None:
    water = Water(active="high")
    water.visibility = 3.5
    water.diagnoses = [{"camera"}]
    (change,) = water.decide(0).changes
    assert (change.target, change.reason) == ("low", "camera is blamed")
    water.diagnoses = [set()]
    water.decide(10)
    (change,) = water.decide(10.3).changes
    assert (change.target, change.better) == ("high", True)
    water.left_off = {"camera"}
    (change,) = water.decide(20).changes
    assert (change.target, change.reason) == ("low", "camera is left off")


MULE = """\
robomend: 1
name: mule
nodes: {camera: {}}
functions:
  localisation: {variants: {markers: {needs: camera, do: [localise(markers)]}}}
  speed:
    variants: {high: {needs: localisation, do: [drive(fast)]}, low: {do: [drive(slow)]}}
    dwell_s: 0.3
"""
"""What is needed has no variant left while the camera is broken."""


@pytest.mark.parametrize("text", [SUAVE, MULE], ids=["needed itself", "by what is needed"])
def test_a_fault_soon_after_the_way_back_is_no_flapping_of_the_condition_and_makes_the_dwell_longer(
    text: str,
) -> None:
    """Broken and mended again and again; the way back is always found, each time a bit later."""
    water = Water(text, active="high")
    water.visibility = 3.5
    back_s: list[float] = []
    now_s = 0.0
    for _ in range(4):
        water.diagnoses = [{"camera"}]
        water.decide(now_s)
        assert water.active == "low"
        mended_s = now_s = now_s + 3
        water.diagnoses = [set()]
        while water.active != "high":
            water.decide(now_s)
            now_s += 0.1
        back_s.append(round(now_s - mended_s, 1))
        now_s += 4
    assert back_s == [0.4, 5.1, 10.1, 20.1]


def test_who_changed_by_hand_is_told_that_the_better_variant_is_admissible_not_that_it_is_so_again() -> None:
    water = Water(active="high")
    water.visibility = 3.6
    assert not water.decide(0).changes
    water.active = "low"
    (back,) = water.decide(1).changes
    assert (back.target, back.reason) == ("high", "high is admissible")


def test_a_fault_that_comes_and_goes_ends_with_the_safer_variant_until_it_is_gone() -> None:
    water = Water(active="high")
    water.visibility = 3.5
    changes: list[VariantChange] = []
    for now_s in range(600):
        water.diagnoses = [{"camera"}] if now_s // 3 % 2 else [set()]
        changes += water.decide(now_s).changes
    assert (water.active, len(changes)) == ("low", 3)
    assert changes[1].reason == "nothing that high needs is blamed any more"  # the water was clear all along
    water.diagnoses = [set()]
    water.decide(600)
    held = water.decide(601).states["altitude"].held
    why = "what it needs was broken again soon, 1 time within the hour"
    assert held == f"high is admissible again, and not changed to for 4 s: {why}"
    water.decide(606)
    assert water.active == "high"


def test_what_is_not_known_makes_no_degraded_robot_unhealthy() -> None:
    """With `bad` in need of nothing that works, and a function of which something is not known."""
    text = SUAVE.replace("sonar: {}", "sonar: {}, lamp: {criticality: optional}, mast: {}").replace(
        "    dwell_s: 0.3", "    dwell_s: 0.3\n  talk:\n    variants: {radio: {needs: [mast]}, light: {}}"
    )
    system = load_text(text)
    assert system.parts is not None

    def degraded(
        bad: str,
        active: tuple[str, ...],
        visibility: float | None,
        talks: str = "light",
        model: System = system,
    ) -> bool:
        assert model.parts is not None
        seen = {Atom("active", ("altitude", one)): True for one in active}
        seen[Atom("active", ("talk", talks))] = True
        known = KnownState(seen.get, lambda atom: visibility, [{bad}])
        states = Keeper().decide(model.parts, model.conditions, known, 0).states
        return does_without(model.parts, states, [{bad}])

    assert degraded("mast", ("high",), 4.0)
    assert not degraded("mast", ("high",), 1.0)  # it is known not to work
    for bad in ("mast", "lamp"):
        assert degraded(bad, ("high",), None)
        assert degraded(bad, (), None)
        assert degraded(bad, ("high", "low"), None)
    assert not degraded("camera", ("high",), None)
    assert not degraded("camera", (), 4.0)  # it may work by what needs it
    assert not degraded("camera", ("high", "low"), 4.0)
    assert degraded("camera", ("low",), None)
    assert not degraded("sonar", ("low",), 4.0)  # nothing is known to do without it
    assert not degraded("mast", ("low",), 4.0, "radio")
    left = load_text(text.replace("  talk:\n", "  talk:\n    criticality: optional\n"))
    assert degraded("mast", ("low",), 4.0, "radio", left)


def test_a_variant_that_failed_is_left_aside_and_the_next_one_taken() -> None:
    water = Water(active="high")
    water.visibility = 2.9
    (change,) = water.decide(0, act=False).changes
    assert change.target == "medium"
    water.keeper.failed("altitude", "medium", "change_mode(spiral, medium) failed", 0)
    found = water.decide(1)
    assert [one.target for one in found.changes] == ["low"]
    assert found.states["altitude"].standings["medium"].why == "change_mode(spiral, medium) failed"
    assert found.again_ns == 60 * S
    assert [one.target for one in water.decide(60).changes] == ["medium"]
    water.keeper.failed("altitude", "high", "no", 100 * S)
    water.keeper.failed("altitude", "high", "no", 200 * S)
    water.visibility = 3.5
    water.active = "medium"
    water.decide(318)
    assert water.decide(319).again_ns == 320 * S


# --- against brute force


def random_robot(chance: random.Random) -> str:
    components = [f"c{number}" for number in range(chance.randint(1, 3))]
    lines = ["robomend: 1", f"nodes: [{', '.join(components)}]", "properties: [x, y]", "functions:"]
    known: list[str] = []
    for number in range(chance.randint(1, 4)):
        lines += [f"  f{number}:", "    dwell_s: 0", "    variants:"]
        names = []
        for variant in range(chance.randint(1, 3)):
            needs = chance.sample([*components, *known], chance.randint(0, min(2, len(components))))
            when = chance.choice(
                [None, "x >= 1", "x < 1", "y > 2 and x <= 3", "not (y > 2)", "ok(x) or y >= 1"]
            )
            said = [f"needs: [{', '.join(needs)}]", f"do: [act{number}({variant})]"]
            said += [] if when is None else [f'when: "{when}"']
            lines.append(f"      v{variant}: {{{', '.join(said)}}}")
            names.append(f"f{number}.v{variant}")
        known += [f"f{number}", *names]
    return "\n".join(lines) + "\n"


def robots(count: int) -> Iterator[tuple[System, random.Random]]:
    """Random models, those left out that are refused as a variant of theirs is never reached."""
    seed = found = 0
    while found < count:
        chance = random.Random(seed)
        seed += 1
        try:
            system = load_text(random_robot(chance))
        except ModelError:
            continue
        found += 1
        yield system, chance


def brute_force(
    system: System, bad: set[str], value: Callable[[str], bool], numbers: dict[str, float]
) -> dict[str, str | None]:
    """All assignments of variants (None: none is left) that hold together; the best of them: no function
    could have a variant that it prefers while those that it rests on have theirs.
    """
    model = system.parts
    assert model is not None
    names = sorted(model.functions)  # fN needs none after it

    def condition(text: str | None) -> bool:
        if text is None:
            return True
        python = text.replace("ok(x)", str(value("x")))
        return bool(eval(python, {}, numbers))  # of the six conditions above

    def together(chosen: dict[str, str | None]) -> bool:
        for name, picked in chosen.items():
            if picked is None:
                continue
            variant = model.functions[name].variants[picked]
            if not condition(variant.when) or bad & {need.component for need in needs_of(variant, model)}:
                return False
            for need in needs_of(variant, model):
                if need.function is not None:
                    got = chosen[need.function]
                    if got is None or (need.variant is not None and need.variant != got):
                        return False
        return True

    choices = [[*model.functions[name].variants, None] for name in names]
    whole = (dict(zip(names, each, strict=True)) for each in product(*choices))
    rank = {name: {v: i for i, v in enumerate([*model.functions[name].variants, None])} for name in names}
    return min(filter(together, whole), key=lambda chosen: [rank[name][chosen[name]] for name in names])


def test_the_chosen_configuration_is_optimal_on_small_models() -> None:
    for system, chance in robots(500):
        model = system.parts
        assert model is not None
        bad = {name for name in model.components if chance.random() < 0.25}
        numbers = {name: chance.choice([0.0, 1.0, 2.5, 3.5]) for name in "xy"}
        active = {name: chance.choice(list(f.variants)) for name, f in model.functions.items()}

        def value(atom: Atom, active: dict[str, str] = active) -> bool:
            return active[atom.args[0]] == atom.args[1] if atom.predicate == "active" else True

        def measured(atom: Atom, numbers: dict[str, float] = numbers) -> float:
            return numbers[atom.args[0]]

        known = KnownState(value, measured, [bad])
        found = Keeper().decide(model, system.conditions, known, 0)
        best = brute_force(system, bad, lambda name: True, numbers)
        assert {name: state.goal for name, state in found.states.items()} == best, system.source
        for name, state in found.states.items():
            assert state.target == (best[name] or active[name])
        assert {change.function for change in found.changes} == {
            name for name, variant in best.items() if variant not in {None, active[name]}
        }


PLANT = """\
robomend: 1
hardware: {lidar: {channel: 3}, lidar_b: {channel: 4}, base: {channel: 5}}
nodes:
  lidar_node: {drives: [lidar], publishes: {scan: []}}
  lidar_b_node: {drives: [lidar_b], publishes: {scan_b: []}}
functions:
  view:
    variants:
      main: {needs: [lidar, lidar_node], do: [remap(scan)]}
      spare: {needs: [lidar_b, lidar_b_node], do: [remap(scan_b), slow_down]}
  drive:
    variants:
      fast: {needs: [view.main], do: [speed(fast)]}
      slow: {needs: [view], do: [speed(slow)]}
"""
COLD = ("lidar_b", "lidar_b_node")


@pytest.mark.parametrize("needs", ["lidar_b, lidar_b_node", "lidar_b_node"])
def test_a_cold_spare_is_switched_on_for_the_variant_that_needs_it(planner: str, needs: str) -> None:
    system = load_text(PLANT.replace("lidar_b, lidar_b_node", needs))
    assert system.parts is not None
    obs = [fails("on", "lidar_b"), fails("running", "lidar_b_node")]
    obs += [holds("active", "view", "main"), holds("active", "drive", "fast")]
    seen = {literal.atom: literal.positive for literal in obs}
    known = KnownState(seen.get, lambda atom: None, [{"lidar"}])
    found = Keeper().decide(system.parts, system.conditions, known, 0)
    assert [(change.function, change.target) for change in found.changes] == [
        ("view", "spare"), ("drive", "slow"),
    ]  # fmt: skip
    assert all(change.fault for change in found.changes)  # also of what follows the view
    options = PlanOptions(planner=planner, expected_stopped=COLD)
    plan = change_plan(system.parts, obs, ["lidar"], found.states, found.changes, options)
    assert plan.outcome is Outcome.SOLVED
    order = [str(step) for step in plan.steps]
    assert order == [
        "power_up(lidar_b)", "start_node(lidar_b_node)", "remap(scan_b)", "slow_down()", "speed(slow)",
    ]  # fmt: skip
    assert [step.after for step in plan.steps] == [(), (0,), (1,), (2,), (3,)]
    assert holds("active", "view", "spare") in plan.steps[3].effects
    assert fails("active", "view", "main") in plan.steps[3].effects
    assert not any("lidar_node" in step.parameters for step in plan.steps)  # no repair
    refused = PlanOptions(
        planner=planner, expected_stopped=COLD, forbidden=(("power_up", "the policy says no"),)
    )
    plan = change_plan(system.parts, obs, ["lidar"], found.states, found.changes, refused)
    assert plan.outcome is Outcome.UNSOLVABLE
    assert any(sentence.startswith("view by spare") for sentence in plan.unreachable)


def test_plans_of_changes_cost_the_least_there_is(planner: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the states of the domain as written, seen one by one."""
    compared: set[int] = set()
    problems: list[RepairProblem] = []
    domains: list[Domain] = []

    def kept(domain: Domain, problem: RepairProblem, options: PlanOptions, work: Work | None) -> Plan:
        problems.append(problem)
        domains.append(domain)
        return plan_problem(domain, problem, options, work)

    monkeypatch.setattr("robomend.planning.configurations.plan_problem", kept)
    for seed in range(40):
        chance = random.Random(seed)
        system = load_text(PLANT)
        assert system.parts is not None
        off = [name for name in system.parts.components if chance.random() < 0.4]
        obs: list[Literal] = [
            Literal(Atom("on" if name in system.parts.hardware else "running", (name,)), name not in off)
            for name in system.parts.components
        ]
        active = {"view": chance.choice(["main", "spare"]), "drive": "slow"}
        obs += [holds("active", *pair) for pair in active.items()]
        seen = {literal.atom: literal.positive for literal in obs}
        bad = chance.choice([[], ["lidar"], ["lidar_node"]])
        keeper, known = Keeper(), KnownState(seen.get, lambda atom: None, [set(bad)])
        keeper.decide(system.parts, system.conditions, known, 0)
        found = keeper.decide(system.parts, system.conditions, known, 10 * S)
        if not found.changes:
            continue
        options = PlanOptions(planner=planner)
        plan = change_plan(system.parts, obs, bad, found.states, found.changes, options)
        least = cheapest(domains[-1], problems[-1], frozenset(problems[-1].goal))
        assert plan.outcome is Outcome.SOLVED
        assert least is not None
        assert plan.cost == pytest.approx(least), seed
        compared.add(seed)
    assert len(compared) > 10
    assert load_domain().predicates.keys().isdisjoint({"active-0"})  # the domain itself is as it was
