"""How well diagnoses fit what works: L against its formula, and what it makes of ties."""

from __future__ import annotations

import pytest

from robomend.diagnosis.ranking import likelihoods, works_in_part
from robomend.model.loading import load_text
from robomend.model.system import System
from robomend.observations.language import parse
from robomend.oneshots.warm_model import WarmModel
from robomend.planning.advice import Situation, parts_of
from robomend.planning.planning import plans_for
from robomend_client.literals import Literal

PROBE = """
robomend: 1
hardware: {probe: {channel: 1%s}}
nodes:
  probe_d: {drives: [probe], publishes: [a, b, c]%s}
  agg: {publishes: {x: [a], y: [a]}%s}
"""
PLAIN = load_text(PROBE % ("", "", ""))
WITH_PRIORS = load_text(PROBE % ((", prior: 0.01",) * 3))
SEEN = "ok(b), ok(c), not ok(x), not ok(y)"


def read(system: System, sentences: str) -> list[Literal]:
    return [literal for part in sentences.split(", ") for literal in parse(part, system.vocabulary)]


def fit(system: System, sentences: str, *bad: str) -> float:
    return likelihoods(system.cnf, read(system, sentences), [bad])[0]


def test_what_works_speaks_against_whoever_would_have_silenced_it() -> None:
    # a is not observed: of the probe's outputs two are, and both are good.
    assert fit(PLAIN, SEEN, "probe_d") == fit(PLAIN, SEEN, "probe") == pytest.approx(0.2 / 4)
    assert fit(PLAIN, SEEN, "agg") == pytest.approx(0.8 + 0.2 / 4)


def test_of_what_is_blamed_that_works_in_part_of_which_an_output_is_good() -> None:
    def works(sentences: str, *bad: str) -> set[str]:
        return set(works_in_part(PLAIN.cnf, read(PLAIN, sentences), bad))

    assert works(SEEN, "probe") == {"probe"}
    assert works(SEEN, "probe", "probe_d") == {"probe", "probe_d"}
    assert works(SEEN, "agg") == set()
    assert works("ok(x), not ok(y)", "agg", "probe") == {"agg"}
    assert works("not ok(b), not ok(c), not ok(x), not ok(y)", "probe") == set()
    assert works("running(agg)", "probe", "agg") == set()


def test_a_supply_is_weighed_by_all_that_it_feeds() -> None:
    fed = load_text(
        "robomend: 1\nhardware: {rail: {channel: 1}, cam: {channel: 2, fed_by: rail}, lamp: {fed_by: rail}}\n"
        "nodes: {cam_d: {drives: cam, publishes: [img]}, lamp_d: {drives: lamp, publishes: [lux]}}"
    )
    assert fit(fed, "not ok(img), ok(lux)", "rail") == pytest.approx(0.2 / 4)
    assert fit(fed, "not ok(img), ok(lux)", "cam") == pytest.approx(0.8 + 0.2 / 2)


def test_a_model_says_how_often_a_fault_is_one_in_part() -> None:
    system = load_text("partial_failure: 0.5\n" + PROBE.lstrip() % ("", "", ""))
    assert fit(system, SEEN, "probe") == pytest.approx(0.5 / 4)


@pytest.mark.parametrize("engine", ["sat", "hs_dag", "maxsat", "asp"])
def test_with_priors_the_probability_has_it_and_conflicts_and_diagnoses_stay(engine: str) -> None:
    with WarmModel(WITH_PRIORS, engine) as model:
        weighed = model.ask(model.question(SEEN.split(", "))).result
    with WarmModel(PLAIN, engine) as model:
        plain = model.ask(model.question(SEEN.split(", "))).result
    assert {d.bad for d in weighed.diagnoses} == {d.bad for d in plain.diagnoses}
    assert {c.components for c in weighed.conflicts} == {c.components for c in plain.conflicts}
    shares = {d.bad: d.probability for d in weighed.diagnoses}
    assert shares[("agg",)] == pytest.approx(0.85 / 0.95)
    assert shares[("probe",)] == pytest.approx(0.05 / 0.95)
    assert {d.probability for d in plain.diagnoses} == {None}


RAIL = """
robomend: 1
hardware:
  battery: {channel: 1}
  rail: {channel: 2, fed_by: [battery]}
  lidar: {fed_by: [rail]}
  camera: {fed_by: [rail]}
  base: {fed_by: [battery]}
nodes:
  lidar_node: {drives: [lidar], publishes: {scan: []}}
  camera_node: {drives: [camera], publishes: {img: []}}
  base_node: {drives: [base], publishes: {odom: []}}
"""


@pytest.mark.parametrize("seen", ["ok(odom)", "not ok(odom)", "not on(rail)"])
@pytest.mark.parametrize("prior", ["", "prior: 0.02, "])
def test_suspects_of_one_size_are_listed_as_choosing_weighs_them(prior: str, seen: str) -> None:
    system = load_text(
        RAIL.replace("{publishes", f"{{{prior}publishes").replace("rail: {", f"rail: {{{prior}")
    )
    with WarmModel(system) as warm:
        asked = warm.question(("not ok(scan)", "not ok(img)", seen))
        result = warm.ask(asked).result
    situation = Situation(parts_of(system), tuple(sorted(asked.literals)), result, cnf=system.cnf)
    plans = plans_for(situation.model, situation.observed, [one.bad for one in situation.wanted])
    chosen = {one.diagnosis.bad: one.weight for one in situation.decide(plans).alternatives}
    for size in {len(bad) for bad in chosen}:
        listed = [chosen[one.bad] for one in result.diagnoses if len(one.bad) == size and one.bad in chosen]
        assert listed == sorted(listed, reverse=True)
