"""From a diagnosis result to a choice: what is planned for, and probes as choosing sees them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tests.planning.robots import TEDUSAR

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.probes import Probe, ProbeResult
from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.model.loading import load_model, load_text
from robomend.model.system import System
from robomend.planning.advice import Situation, looks, parts_of
from robomend.planning.choice import Candidate, Choice, power_cuts
from robomend.planning.domain.loading import shipped
from robomend.planning.planning import PlanOptions, plan_for, plans_for
from robomend.planning.tried import Attempt
from robomend_client.literals import Atom, Literal, fails, holds

MUTE: tuple[Literal, ...] = (holds("on", "jaguar"), holds("running", "jaguar_node"), fails("ok", "odom"))
TIED = (Diagnosis(("jaguar",)), Diagnosis(("jaguar_node",)))


def result(*diagnoses: Diagnosis) -> DiagnosisResult:
    return DiagnosisResult(TEDUSAR.components, diagnoses, True, None, (), 0.0)


def decided(situation: Situation, options: PlanOptions = PlanOptions()) -> tuple[str, ...]:  # noqa: B008  # frozen
    wanted = [diagnosis.bad for diagnosis in situation.wanted]
    choice = situation.decide(plans_for(situation.model, situation.observed, wanted, options))
    return choice.diagnosis.bad if choice.diagnosis else ()


def test_the_tie_is_broken_by_cost_and_by_what_was_tried() -> None:
    situation = Situation(TEDUSAR, MUTE, result(*TIED))
    assert decided(situation) == ("jaguar_node",)
    power = Attempt(frozenset({"jaguar"}), frozenset({"jaguar"}), 0, effect_seen=True, helped=False)
    assert decided(replace(situation, tried=(power,))) == ("jaguar_node",)


def test_with_the_papers_actions_too_the_driver_is_restarted_after_the_power_came_back() -> None:
    """Two rounds: power_up(jaguar), then stop and start of the driver."""
    options = PlanOptions(domain=shipped("paper-repair.pddl"))
    power = Attempt(frozenset({"jaguar"}), frozenset({"jaguar"}), 0, effect_seen=True, helped=False)
    assert decided(Situation(TEDUSAR, MUTE, result(*TIED), (power,)), options) == ("jaguar_node",)


def test_when_the_driver_was_restarted_in_vain_the_device_is_next() -> None:
    driver = Attempt(
        frozenset({"jaguar_node"}), frozenset({"jaguar_node"}), 0, effect_seen=True, helped=False
    )
    situation = Situation(TEDUSAR, MUTE, result(*TIED), (driver, driver))
    assert decided(situation) == ("jaguar",)


def test_the_shared_part_is_planned_for_as_well() -> None:
    found = (Diagnosis(("jaguar", "rviz")), Diagnosis(("jaguar", "imu_node")))
    assert Situation(TEDUSAR, (), result(*found)).wanted == (*found, Diagnosis(("jaguar",)))
    assert Situation(TEDUSAR, (), result(Diagnosis(()))).wanted == ()


def test_probes_become_looks_in_the_order_of_the_candidates() -> None:
    plan = plan_for(TEDUSAR, MUTE, ["jaguar"])
    candidates = [Candidate(Diagnosis((name,)), plan) for name in ("jaguar_node", "jaguar", "rviz")]
    probe = Probe(Atom("ok", ("current(jaguar)",)), 1.0, 2.0, if_true=(1,), if_false=(0,))
    found = ProbeResult((("jaguar",), ("jaguar_node",)), (probe,), (), 0.0, 1.0, True)
    (look,) = looks(found, candidates)
    assert look.predicted == (True, False, None)
    assert look.cost == 2.0


FEEDS = load_text(
    "robomend: 1\n"
    "hardware: {rail: {channel: 1}, cam: {channel: 3, fed_by: rail}, lamp: {channel: 4, fed_by: rail}}\n"
    "nodes: {cam_d: {drives: cam, publishes: [img]}, lamp_d: {drives: lamp, publishes: [lux]}}"
)


def chosen(
    system: System,
    *observed: Literal,
    tried: tuple[Attempt, ...] = (),
    surely_broken: frozenset[str] = frozenset(),
) -> Choice:
    """What is done about these observations, from the engine to the plan."""
    engine = make_engine("sat", system.cnf)
    try:
        result = engine.diagnose(observed)
    finally:
        engine.close()
    situation = Situation(
        parts_of(system), observed, result, tried, cnf=system.cnf, surely_broken=surely_broken
    )
    wanted = [diagnosis.bad for diagnosis in situation.wanted]
    return situation.decide(plans_for(situation.model, situation.observed, wanted, PlanOptions()))


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


def test_on_the_shipped_manipulator_the_first_plan_powers_the_supply() -> None:
    """The 12 V supply is off; all relays behind it are where they were, and what it feeds is silent."""
    system = load_model(Path(__file__).parents[2] / "examples" / "mobile_manipulator.yaml")
    parts = parts_of(system)
    relays = [holds("on", name) for name in parts.hardware if parts.switchable(name) and name != "psu_12v"]
    silent = [
        fails("ok", topic)
        for node in parts.nodes.values()
        for topic in node.publishes
        if any("psu_12v" in parts.feeders(name) for name in node.drives)
    ]
    assert steps(chosen(system, fails("on", "psu_12v"), *relays, *silent))[0] == "power_up(psu_12v)"


PROBE = load_text(
    "robomend: 1\nhardware: {probe: {channel: 1}}\n"
    "nodes: {probe_d: {drives: probe, publishes: [a, b, c]}, agg: {publishes: {x: [a], y: [a]}}}"
)


def test_a_probe_two_of_whose_topics_work_keeps_its_power() -> None:
    seen = (holds("ok", "b"), holds("ok", "c"), fails("ok", "x"), fails("ok", "y"))
    assert steps(chosen(PROBE, *seen)) == ["stop_node(agg)", "start_node(agg)"]
    agg = Attempt(
        frozenset({"agg"}),
        frozenset({"agg"}),
        0,
        effect_seen=True,
        helped=False,
        actions=("stop_node(agg)", "start_node(agg)"),
    )
    assert steps(chosen(PROBE, *seen, tried=(agg,))) == ["stop_node(probe_d)", "start_node(probe_d)"]


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
    # Not for ever: a repair does the same three times at most (robomend.repairs.repeating).
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
    engine = make_engine("sat", system.cnf)
    try:
        found = engine.diagnose(observed)
    finally:
        engine.close()
    onsets = {Atom("ok", ("cmd",)): round(cmd_s * 1e9), Atom("ok", ("state",)): round(state_s * 1e9)}
    situation = Situation(
        parts_of(system), observed, found, cnf=system.cnf, loops=system.loops, onsets=onsets
    )
    return situation.leading[0].bad


def test_in_a_circle_who_fell_first_leads() -> None:
    assert blamed_by_onset(cmd_s=1.0, state_s=1.3) == ("ctl",)
    assert blamed_by_onset(cmd_s=1.3, state_s=1.0) == ("est",)


def test_differences_of_less_than_a_period_say_nothing() -> None:
    assert blamed_by_onset(cmd_s=1.0, state_s=1.19) == blamed_by_onset(cmd_s=1.19, state_s=1.0)
