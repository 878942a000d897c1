"""A plan for only a part of what is bad: refused where what it leaves explains all that is observed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
from pysat.solvers import Solver

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import DiagnosisResult
from robomend.model.loading import load_text
from robomend.model.system import System
from robomend.planning.advice import Situation, explains_all, parts_of
from robomend.planning.choice import Choice
from robomend.planning.planning import PlanOptions, plans_for
from robomend_client.literals import Literal, fails, holds

RESET_USB = (
    (Path(__file__).parents[2] / "examples" / "actions" / "reset_usb.pddl")
    .read_text()
    .replace("(:init (on_bus imu usb1))", "(:init (on_bus imu usb1) (on_bus camera usb1))")
)

BUS = load_text("""
robomend: 1
blame_hardware: true
hardware: {imu: {}, camera: {}}
nodes:
  imu_node: {drives: [imu], publishes: {imu_data: []}}
  camera_node: {drives: [camera], publishes: {image: []}}
""")

TIRED = ("start_node(imu_node)", "it was done 3 times in this repair")


def diagnosed(system: System, observed: tuple[Literal, ...]) -> DiagnosisResult:
    engine = make_engine("sat", system.cnf)
    try:
        return engine.diagnose(observed)
    finally:
        engine.close()


def chosen(system: System, *observed: Literal, options: PlanOptions) -> Choice:
    """What is done about these observations, from the engine to the plan."""
    situation = Situation(parts_of(system), observed, diagnosed(system, observed), cnf=system.cnf)
    wanted = [diagnosis.bad for diagnosis in situation.wanted]
    return situation.decide(plans_for(situation.model, situation.observed, wanted, options))


def steps(choice: Choice) -> list[str]:
    return [] if choice.plan is None else [str(step) for step in choice.plan.steps]


SILENT = (fails("ok", "imu_data"), holds("ok", "image"), holds("running", "imu_node"))
WITH_RESET = PlanOptions(domain=RESET_USB)


def test_a_bus_is_not_reset_for_a_device_whose_driver_cannot_be_restarted_any_more() -> None:
    assert steps(chosen(BUS, *SILENT, options=WITH_RESET)) == ["stop_node(imu_node)", "start_node(imu_node)"]
    choice = chosen(BUS, *SILENT, options=replace(WITH_RESET, avoided=(TIRED,)))
    assert steps(choice) == []
    assert (
        "imu: its plan would leave imu_node broken, which explains all that is observed, and so help nothing"
    ) in choice.reason


CYCLE = ["shutdown(lidar)", "power_up(lidar)"]


FED = load_text("""
robomend: 1
hardware: {supply: {channel: 1}, lidar: {channel: 2, fed_by: supply}}
nodes:
  base: {drives: [supply], publishes: {odom: []}}
  lidar_node: {drives: [lidar], publishes: {scan: []}}
""")


# --- random robots ----------------------------------------------------------------------------------


@st.composite
def situations(draw: st.DrawFn) -> tuple[System, tuple[Literal, ...], PlanOptions]:
    """Draw a robot of devices with drivers and a chain of nodes, what is observed of it, and what may not be
    done any more.
    """
    devices = draw(st.integers(1, 3))
    fed = [index > 0 and draw(st.booleans()) for index in range(devices)]
    hardware = ", ".join(
        f"d{i}: {{channel: {i + 1}{', fed_by: d0' if fed[i] else ''}}}" for i in range(devices)
    )
    drivers = [f"  n{i}: {{drives: [d{i}], publishes: {{t{i}: []}}}}" for i in range(devices)]
    rests = draw(st.sets(st.integers(0, devices - 1), min_size=1))
    task = f"  task: {{publishes: {{out: [{', '.join(f't{i}' for i in sorted(rests))}]}}}}"
    system = load_text("\n".join(["robomend: 1", f"hardware: {{{hardware}}}", "nodes:", *drivers, task]))
    nodes = [*(f"n{i}" for i in range(devices)), "task"]
    atoms = [
        *(("on", f"d{i}") for i in range(devices)),
        *(("running", name) for name in nodes),
        *(("ok", f"t{i}") for i in range(devices)),
        ("ok", "out"),
    ]
    signs = draw(
        st.lists(st.sampled_from((True, True, False, None)), min_size=len(atoms), max_size=len(atoms))
    )
    seen = tuple(
        (holds if sign else fails)(*atom) for atom, sign in zip(atoms, signs, strict=True) if sign is not None
    )
    parts = (*(f"d{i}" for i in range(devices)), *nodes)
    acts = [*(f"power_up(d{i})" for i in range(devices)), *(f"start_node({name})" for name in nodes)]
    avoided = draw(st.sets(st.sampled_from(acts), max_size=2))
    aside = draw(st.sets(st.sampled_from(parts), max_size=1))
    options = PlanOptions(
        planner="asp",
        quarantined=tuple(sorted(aside)),
        avoided=tuple((act, "it was done 3 times in this repair") for act in sorted(avoided)),
    )
    return system, seen, options


@settings(max_examples=60, deadline=None)
@given(situations())
def test_a_plan_is_refused_just_where_obs_is_possible_with_only_broken_what_it_leaves_broken(
    drawn: tuple[System, tuple[Literal, ...], PlanOptions],
) -> None:
    system, seen, options = drawn
    result = diagnosed(system, seen)
    situation = Situation(parts_of(system), seen, result, cnf=system.cnf)
    plans = plans_for(situation.model, seen, [one.bad for one in situation.wanted], options)
    for diagnosis, plan in zip(situation.wanted, plans, strict=True):
        # What is bad in the world that the plan predicts, by its own initial state and effects.
        bad = {fact.args[0] for fact in plan.initial if fact.predicate == "bad"}
        off = {fact.args[0] for fact in plan.initial if fact.predicate in {"off", "stopped"}} - set(
            plan.excluded
        )
        for step in plan.steps:
            for effect in step.effects:
                if effect.atom.predicate == "bad":
                    (bad.add if effect.positive else bad.discard)(effect.atom.args[0])
        cnf = system.cnf
        world = [cnf.health[name] for name in cnf.components if name not in bad]
        world += [number for number in map(cnf.literal, seen) if number is not None]
        with Solver(bootstrap_with=cnf.clauses) as solver:
            explained = solver.solve(assumptions=world)
        refused = bool(explains_all(plan, diagnosis, result.diagnoses, situation.model))
        assert refused == (bool(plan.steps) and explained and off <= bad)
        assert bool(situation.helpful(plan, diagnosis).steps) == (bool(plan.steps) and not refused)
