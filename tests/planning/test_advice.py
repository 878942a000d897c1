"""From a diagnosis result to a choice: what is planned for, and probes as choosing sees them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pysat.solvers import Solver
from tests.planning.robots import TEDUSAR

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.probes import Probe, ProbeResult
from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.model.loading import load_text
from robomend.model.system import System
from robomend.planning.advice import SELDOM_HELPS, Situation, explains_all, looks, other_suspects, parts_of
from robomend.planning.choice import Candidate, Choice
from robomend.planning.cures import power_cuts
from robomend.planning.planning import PlanOptions, plan_for, plans_for
from robomend.planning.prediction import Prediction, theory_of
from robomend.planning.tried import Attempt, attempt, interruptions
from robomend_client.literals import Atom, Literal, fails, holds
from robomend_client.readings import Symptom

MUTE: tuple[Literal, ...] = (holds("on", "jaguar"), holds("running", "jaguar_node"), fails("ok", "odom"))


def result(*diagnoses: Diagnosis) -> DiagnosisResult:
    return DiagnosisResult(TEDUSAR.components, diagnoses, True, None, (), 0.0)


def test_probes_become_looks_in_the_order_of_the_candidates() -> None:
    plan = plan_for(TEDUSAR, MUTE, ["jaguar"])
    candidates = [Candidate(Diagnosis((name,)), plan) for name in ("jaguar_node", "jaguar", "rviz")]
    probe = Probe(Atom("ok", ("current(jaguar)",)), 1.0, 2.0, if_true=(1,), if_false=(0,))
    found = ProbeResult((("jaguar",), ("jaguar_node",)), (probe,), 1.0, True)
    (look,) = looks(found, candidates)
    assert look.predicted == (True, False, None)
    assert look.cost == 2.0


FEEDS = load_text(
    "robomend: 1\n"
    "hardware: {rail: {channel: 1}, cam: {channel: 3, fed_by: rail}, lamp: {channel: 4, fed_by: rail}}\n"
    "nodes: {cam_d: {drives: cam, publishes: [img]}, lamp_d: {drives: lamp, publishes: [lux]}}"
)


def diagnosed(system: System, observed: tuple[Literal, ...]) -> DiagnosisResult:
    engine = make_engine("sat", system.cnf)
    try:
        return engine.diagnose(observed)
    finally:
        engine.close()


def chosen(
    system: System,
    *observed: Literal,
    tried: tuple[Attempt, ...] = (),
    options: PlanOptions | None = None,
    **known: Any,
) -> Choice:
    """What is done about these observations, from the engine to the plan."""
    result = diagnosed(system, observed)
    situation = Situation(parts_of(system), observed, result, tried, cnf=system.cnf, **known)
    wanted = [diagnosis.bad for diagnosis in situation.wanted]
    options = options or PlanOptions(quarantined=tuple(situation.second_published))
    return situation.decide(plans_for(situation.model, situation.observed, wanted, options))


def steps(choice: Choice) -> list[str]:
    assert choice.plan is not None
    return [str(step) for step in choice.plan.steps]


def test_a_supply_that_is_off_takes_five_acts_and_comes_first() -> None:
    relays = (fails("on", "rail"), holds("on", "cam"), holds("on", "lamp"))
    choice = chosen(FEEDS, *relays, fails("ok", "img"), fails("ok", "lux"))
    assert steps(choice)[0] == "power_up(rail)"
    assert sorted(steps(choice)[1:]) == [
        "start_node(cam_d)",
        "start_node(lamp_d)",
        "stop_node(cam_d)",
        "stop_node(lamp_d)",
    ]


PROBE = load_text(
    """
robomend: 1
hardware: {probe: {channel: 1}}
nodes:
  probe_d: {drives: [probe], publishes: [a, b, c]}
  agg: {publishes: {x: [a], y: [a]}}
"""
)


def test_a_device_that_is_seen_to_work_keeps_its_power_when_what_rests_on_it_stays_broken() -> None:
    """Nobody watches a; whatever is restarted, x and y stay silent."""
    running = (holds("on", "probe"), holds("running", "probe_d"), holds("running", "agg"))
    silent = (fails("ok", "x"), fails("ok", "y"))

    def repaired(*others: Literal) -> list[tuple[str, ...]]:
        """Return what is repaired in vain, round by round, until power is cut or a person is called."""
        tried: list[Attempt] = []
        for _ in range(5):
            choice = chosen(PROBE, *running, *silent, *others, tried=tuple(tried))
            if choice.plan is None or choice.diagnosis is None:
                break
            bad = frozenset(choice.diagnosis.bad)
            tried.append(Attempt(bad, bad, 0, effect_seen=True, helped=False, actions=tuple(steps(choice))))
            if power_cuts(choice.plan):
                break
        return [tuple(one.bad) for one in tried]

    well = (holds("ok", "b"), holds("ok", "c"))
    found = repaired(*well)
    assert found[0] == ("agg",)
    assert ("probe",) not in found
    # Of a probe of which nothing is seen to work, or all is silent, power is cut in the end.
    assert repaired()[-1] == ("probe",)
    assert repaired(*(-literal for literal in well))[-1] == ("probe",)


def test_a_node_that_had_ended_is_restarted_once_more_before_something_else_is_blamed() -> None:
    """Its successor is silent: the driver of its input, or the probe, would have to have failed besides."""
    seen = (holds("ok", "b"), holds("ok", "c"), fails("ok", "x"), fails("ok", "y"))
    start = Attempt(
        frozenset({"agg"}),
        frozenset({"agg"}),
        0,
        effect_seen=True,
        helped=False,
        actions=("start_node(agg)",),
    )
    restart = replace(start, actions=("stop_node(agg)", "start_node(agg)"))
    known = frozenset({"agg"})
    agg = ["stop_node(agg)", "start_node(agg)"]
    assert steps(chosen(PROBE, *seen, tried=(start, restart), surely_broken=known)) == agg
    assert steps(chosen(PROBE, *seen, tried=(start, restart))) != agg
    # Not for ever: a repair does the same three times at most (robomend.repairs.acts).
    vain = chosen(PROBE, *seen, tried=(start, *[restart] * 9), surely_broken=known)
    assert steps(vain) != agg


def test_a_device_that_was_off_and_is_on_again_is_not_cycled_before_its_driver_is_restarted() -> None:
    seen = (holds("on", "probe"), fails("ok", "a"), fails("ok", "b"), fails("ok", "c"))
    power = Attempt(frozenset({"probe"}), frozenset({"probe"}), 0, effect_seen=True, helped=False)
    known = frozenset({"probe"})
    with_it = chosen(PROBE, *seen, tried=(power,), surely_broken=known)
    assert steps(with_it) == ["stop_node(probe_d)", "start_node(probe_d)"]
    without = chosen(PROBE, *seen, tried=(power,))
    assert [one.weight for one in with_it.alternatives] == [one.weight for one in without.alternatives]


def test_no_power_is_cut_on_a_tie_that_restarts_would_break() -> None:
    """Three silent sensors: one power cycle of all would mend every diagnosis, and yet it comes last."""
    names = ("a", "b", "c")
    hardware = ", ".join(f"{name}: {{channel: {index}}}" for index, name in enumerate(names))
    nodes = ", ".join(f"{name}_d: {{drives: {name}, publishes: [{name}_out]}}" for name in names)
    system = load_text(f"robomend: 1\nhardware: {{{hardware}}}\nnodes: {{{nodes}}}")
    choice = chosen(system, *(fails("ok", f"{name}_out") for name in names))
    assert choice.plan is not None
    assert power_cuts(choice.plan) == frozenset()


LOOP = load_text(
    "robomend: 1\ntopics: {cmd: {rate_hz: 5}, state: {rate_hz: 20}}\n"
    "nodes: {est: {publishes: {state: [cmd]}}, ctl: {publishes: {cmd: [state]}}}"
)


def blamed_by_onset(cmd_s: float, state_s: float) -> tuple[str, ...]:
    system = LOOP.extended(loop.clause for loop in LOOP.loops)
    observed = (fails("ok", "cmd"), fails("ok", "state"))
    found = diagnosed(system, observed)
    onsets = {Atom("ok", ("cmd",)): round(cmd_s * 1e9), Atom("ok", ("state",)): round(state_s * 1e9)}
    situation = Situation(
        parts_of(system), observed, found, cnf=system.cnf, loops=system.loops, onsets=onsets
    )
    return situation.leading[0].bad


def test_in_a_circle_who_fell_first_leads() -> None:
    assert blamed_by_onset(cmd_s=1.0, state_s=1.3) == ("ctl",)
    assert blamed_by_onset(cmd_s=1.3, state_s=1.0) == ("est",)


BUS = load_text(
    """
robomend: 1
hardware:
  bus: {channel: 1}
  imu: {fed_by: bus}
  cam: {fed_by: bus}
  gps: {channel: 2, fed_by: bus}
nodes:
  imu_d: {drives: imu, publishes: [acc], inputs_matter: true}
  cam_d: {drives: cam, publishes: [img]}
  gps_d: {drives: gps, publishes: [fix]}
blame_hardware: true
"""
)
WELL = (holds("ok", "img"), holds("ok", "fix"))


def tried_in(choice: Choice, at_ns: int = 0) -> Attempt:
    """Return the attempt that a choice comes to, each effect seen, in vain."""
    assert choice.plan is not None
    assert choice.diagnosis is not None
    return attempt(
        choice.diagnosis,
        choice.plan,
        done=None,
        time_ns=at_ns,
        effect_seen=True,
        helped=False,
        model=parts_of(BUS),
    )


def test_a_cut_that_darkens_what_works_comes_after_every_cheaper_act_that_is_worth_doing() -> None:
    first = chosen(BUS, *WELL, fails("ok", "acc"))
    assert steps(first) == ["stop_node(imu_d)", "start_node(imu_d)"]
    second = chosen(BUS, *WELL, fails("ok", "acc"), tried=(tried_in(first),))
    assert steps(second) == ["stop_node(imu_d)", "start_node(imu_d)"]
    bus = next(one for one in second.alternatives if "shutdown(bus)" in map(str, one.plan.steps))
    again = next(one for one in second.alternatives if one.plan is second.plan)
    assert bus.darkens == {"cam", "gps"}
    assert "it cuts the power of what works: cam, gps" in bus.reason
    # By probability over the costs of the acts alone the bus would come first.
    assert bus.helps / bus.plan.cost > again.helps / again.plan.cost
    assert bus.score > 0
    third = chosen(BUS, *WELL, fails("ok", "acc"), tried=(tried_in(first), tried_in(second)))
    assert "shutdown(bus)" in steps(third)


def test_the_cycle_of_a_supply_counts_as_one_of_what_hangs_on_it_by_a_channel_of_its_own_too() -> None:
    """A tie of bus and gps: the bus is cycled in vain; then the gps is not cycled once more."""
    silent = (fails("ok", "fix"), fails("ok", "img"), fails("ok", "acc"))
    cycle = plan_for(parts_of(BUS), silent, ["bus"])
    vain = attempt(
        Diagnosis(("bus",)), cycle, done=None, time_ns=0, effect_seen=True, helped=False, model=parts_of(BUS)
    )
    assert vain.cycled == {"bus", "imu", "cam", "gps"}
    gps = (fails("ok", "fix"), holds("ok", "img"), holds("ok", "acc"))
    driver = replace(vain, bad=frozenset({"gps_d"}), repaired=frozenset({"gps_d"}), cycled=frozenset())
    before = chosen(BUS, *gps, tried=(driver, driver))
    assert "shutdown(gps)" in steps(before)
    after = chosen(BUS, *gps, tried=(vain, driver, driver))
    own = [one for choice in (before, after) for one in choice.alternatives if one.diagnosis.bad == ("gps",)]
    assert own[1].helps < 0.2 * own[0].helps
    assert after.plan is None or "shutdown(gps)" not in steps(after)


def test_power_that_was_seen_to_go_and_come_back_was_cycled_and_the_drivers_are_restarted() -> None:
    silent = tuple(fails("ok", topic) for topic in ("fix", "img", "acc"))
    onsets = {literal.atom: 10 for literal in silent}
    without = chosen(BUS, holds("on", "bus"), *silent, onsets=onsets)
    assert "shutdown(bus)" in steps(without)
    seen = chosen(BUS, holds("on", "bus"), *silent, onsets=onsets, power_back={"bus": 20})
    restarted = [f"{verb}_node({name})" for name in ("imu_d", "cam_d", "gps_d") for verb in ("stop", "start")]
    assert sorted(steps(seen)) == sorted(restarted)
    # What was well after its power had come back was not cycled in vain.
    later = dict.fromkeys(onsets, 30)
    assert "shutdown(bus)" in steps(chosen(BUS, *silent, onsets=later, power_back={"bus": 20}))
    # A cycle of ours is an attempt already; one of what was restarted since has a new connection.
    ours = Attempt(frozenset({"bus"}), frozenset({"bus"}), 20, effect_seen=True, helped=False)
    assert interruptions(parts_of(BUS), {"bus": 20}, onsets, [ours]) == ([], frozenset())
    since = Attempt(frozenset({"gps_d"}), frozenset({"gps_d"}), 25, effect_seen=True, helped=False)
    (cycle,), dropped = interruptions(parts_of(BUS), {"bus": 20}, onsets, [since])
    assert cycle.cycled == {"bus", "imu", "cam", "gps"}
    assert dropped == {"imu_d", "cam_d"}


BASE = load_text(
    """
robomend: 1
hardware: {base: {channel: 1}}
nodes: {base_d: {drives: base, publishes: [odom, temp]}, loc: {publishes: {pose: [odom]}}}
properties: [diagnostics]
values: {stamp: {topic: odom, field: stamp}}
rules: ["not ab(base_d) -> ok(diagnostics)"]
"""
)
FAST = {Atom("ok", ("odom",)): Symptom.FAST}


LOOK = "probably a second publisher: look who publishes odom; a person is needed; "


def test_where_two_publish_nothing_is_restarted_and_who_publishes_is_looked_for() -> None:
    seen = (fails("ok", "odom"), holds("ok", "temp"))
    choice = chosen(BASE, *seen, symptoms={Atom("ok", ("odom",)): Symptom.PUBLISHERS})
    assert choice.plan is None
    assert choice.reason == (
        f"{LOOK}no known repair: to act on base_d is no remedy for that; to act on base is no remedy for that"
    )
    for other in (Symptom.SILENT, Symptom.SLOW, Symptom.OLD, None):
        symptoms = {} if other is None else {Atom("ok", ("odom",)): other}
        choice = chosen(BASE, *seen, symptoms=symptoms)
        assert steps(choice) == ["stop_node(base_d)", "start_node(base_d)"]
        assert "second publisher" not in choice.reason


def test_what_comes_too_fast_is_worth_one_restart_and_a_second_publisher_is_suspected_first() -> None:
    seen = (fails("ok", "odom"), holds("ok", "temp"))
    first = chosen(BASE, *seen, symptoms=FAST)
    assert steps(first) == ["stop_node(base_d)", "start_node(base_d)"]
    assert first.reason.startswith(LOOK)
    for vain in (1, 2):
        nothing = chosen(BASE, *seen, symptoms=FAST, tried=driven_in_vain(vain))
        assert nothing.plan is None
        assert nothing.reason.startswith(LOOK)
    asked = chosen(BASE, *seen, symptoms=FAST, asking=frozenset({"stop_node", "start_node"}))
    assert asked.plan is None
    assert asked.reason.startswith(LOOK)


def test_a_restart_in_vain_of_one_suspect_of_what_comes_too_fast_speaks_for_a_second_publisher() -> None:
    fast = {Atom("ok", ("pose",)): Symptom.FAST}
    first = chosen(BASE, fails("ok", "pose"), holds("ok", "temp"), symptoms=fast)
    assert steps(first) == ["stop_node(loc)", "start_node(loc)"]
    then = chosen(
        BASE, fails("ok", "pose"), holds("ok", "temp"), symptoms=fast, tried=driven_in_vain(1, "loc")
    )
    assert then.plan is None
    assert "look who publishes pose; a person is needed" in then.reason
    silent = chosen(BASE, fails("ok", "pose"), holds("ok", "temp"), tried=driven_in_vain(1, "loc"))
    assert steps(silent) == ["stop_node(base_d)", "start_node(base_d)"]


def driven_in_vain(times: int, node: str = "base_d") -> tuple[Attempt, ...]:
    one = Attempt(
        frozenset({node}),
        frozenset({node}),
        0,
        effect_seen=True,
        helped=False,
        actions=(f"stop_node({node})", f"start_node({node})"),
    )
    return (one,) * times


@pytest.mark.parametrize("symptom", [None, Symptom.SILENT, Symptom.STILL])
def test_power_is_cut_for_what_is_silent_and_not_without_a_person_for_what_stands_still(
    symptom: Symptom | None,
) -> None:
    symptoms = {Atom("ok", ("odom",)): symptom} if symptom else {}
    seen = (fails("ok", "odom"), fails("ok", "temp"))
    if symptom:
        symptoms[Atom("ok", ("temp",))] = symptom
    assert steps(chosen(BASE, *seen, symptoms=symptoms)) == ["stop_node(base_d)", "start_node(base_d)"]
    cut = chosen(BASE, *seen, tried=driven_in_vain(2), symptoms=symptoms)
    assert "shutdown(base)" in steps(cut)
    still = symptom is Symptom.STILL
    assert bool(cut.yes) is still
    if still:
        assert "power is not cut for ok(odom) (still), ok(temp) (still) without a person's yes" in cut.reason


def test_a_bad_self_report_over_good_data_is_worth_one_restart_and_no_power_cycle() -> None:
    warned = {Atom("ok", ("diagnostics",)): Symptom.SELF_REPORT}
    trend = (holds("inc", "stamp"), fails("dec", "stamp"), fails("const", "stamp"))
    good = (fails("ok", "diagnostics"), holds("ok", "odom"), holds("ok", "temp"), *trend)
    once = chosen(BASE, *good, symptoms=warned)
    assert steps(once) == ["stop_node(base_d)", "start_node(base_d)"]
    assert once.alternatives[0].helps == pytest.approx(SELDOM_HELPS)
    assert chosen(BASE, *good, symptoms=warned, tried=driven_in_vain(1)).plan is None
    # Over bad data, or none, it is one symptom as any.
    assert chosen(BASE, fails("ok", "diagnostics"), symptoms=warned).alternatives[0].helps == 1.0


LOADED = load_text(
    """
robomend: 1
hardware: {pc: {computer: true}}
nodes:
  camera: {host: pc, publishes: {image: []}}
  lidar: {host: pc, publishes: {scan: []}}
  imu: {host: pc, publishes: {accel: []}}
  slam: {host: pc, publishes: {map: [image, scan]}}
  planner: {host: pc, publishes: {path: [map]}}
"""
)


@pytest.mark.parametrize(
    "told", [(fails("ok", "load", "pc"),), ()], ids=["load is seen", "nobody watches it"]
)
def test_of_many_that_are_late_at_once_on_a_loaded_computer_none_is_restarted(
    told: tuple[Literal, ...],
) -> None:
    nodes = ("camera", "lidar", "imu", "slam", "planner")
    late = [fails("ok", topic) for topic in ("image", "scan", "accel", "map", "path")]
    slow = {literal.atom: Symptom.SLOW for literal in late}
    choice = chosen(LOADED, *told, *(holds("running", node) for node in nodes), *late, symptoms=slow)
    assert choice.plan is None
    assert "pc" in choice.reason


# --- what is awaited where only what all diagnoses share is repaired: nothing that another one can prevent

SYSTEM = load_text(
    "robomend: 1\nhardware: {cam: {channel: 1}}\nnodes:\n"
    "  cam_d: {drives: cam, publishes: [img]}\n  task: {publishes: {state: [img]}}\n"
)
RESULT = DiagnosisResult(
    SYSTEM.cnf.components, (Diagnosis(("cam", "task")), Diagnosis(("cam_d", "task"))), True, None, (), 0.0
)


def test_only_what_other_suspects_cannot_prevent_is_awaited_while_the_shared_part_is_repaired() -> None:
    assert other_suspects(("task",), RESULT) == {"cam", "cam_d"}
    good = [Atom("good", (name,)) for name in SYSTEM.cnf.components]
    theory, left = theory_of(SYSTEM.cnf), other_suspects(("task",), RESULT)
    sure = Prediction(theory, [c for c in SYSTEM.cnf.components if c not in left], good).expected()
    assert sure == {holds("running", "task")}
    assert holds("ok", "state") in Prediction(theory, SYSTEM.cnf.components, good).expected()


def test_a_whole_diagnosis_leaves_no_other_suspects() -> None:
    assert other_suspects(("cam", "task"), RESULT) == frozenset()


# --- a plan for only a part of what is bad: refused where what it leaves explains all that is observed

RESET_USB = (
    (Path(__file__).parents[2] / "examples" / "actions" / "reset_usb.pddl")
    .read_text()
    .replace("(:init (on_bus imu usb1))", "(:init (on_bus imu usb1) (on_bus camera usb1))")
)

USB = load_text("""
robomend: 1
blame_hardware: true
hardware: {imu: {}, camera: {}}
nodes:
  imu_node: {drives: [imu], publishes: {imu_data: []}}
  camera_node: {drives: [camera], publishes: {image: []}}
""")

TIRED = ("start_node(imu_node)", "it was done 3 times in this repair")


SILENT = (fails("ok", "imu_data"), holds("ok", "image"), holds("running", "imu_node"))
WITH_RESET = PlanOptions(domain=RESET_USB)


def test_a_bus_is_not_reset_for_a_device_whose_driver_cannot_be_restarted_any_more() -> None:
    restart = ["stop_node(imu_node)", "start_node(imu_node)"]
    assert steps(chosen(USB, *SILENT, options=WITH_RESET)) == restart
    choice = chosen(USB, *SILENT, options=replace(WITH_RESET, avoided=(TIRED,)))
    assert choice.plan is None
    assert (
        "imu: its plan would leave imu_node broken, which explains all that is observed, and so help nothing"
    ) in choice.reason


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
