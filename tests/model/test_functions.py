"""Functions and their variants: what a model may say of them, and what is refused with its line."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.cli.commands import run
from robomend.errors import ModelError, ObservationError
from robomend.model.checking import check
from robomend.model.components import Criticality, Variant
from robomend.model.five_key import five_key_of
from robomend.model.functions import Threshold, holds, in_order, left_without, need_of
from robomend.model.loading import load_text
from robomend.observations.language import parse
from robomend.planning.configurations import Keeper, KnownState
from robomend.web import graph
from robomend_client.literals import Atom

ROBOT = """\
robomend: 1
hardware:
  camera: {channel: 1, criticality: essential}
  sonar: {channel: 2}
nodes: {cam: {drives: [camera], publishes: {image: []}, criticality: optional}}
properties: [visibility]
functions:
  search:
    variants:
      wide: {needs: [altitude.high, sonar]}
      narrow: {needs: altitude, do: [follow]}
    criticality: essential
    notify: true
    changes_per_hour: 12
  altitude:
    prefer: [high, medium, low]
    variants:
      low: {do: ["set_mode(spiral, low)"]}
      medium: {when: "visibility ≥ 2.25 +- 0.1", needs: [camera], do: ["set_mode(spiral, medium)"]}
      high:
        needs: [camera, cam]
        when: "visibility >= 3.25 ± 0.1 and sees"
        do: ["set_mode(/spiral, \\"very high\\")", start_node(cam)]
    dwell_s: 0.5
    adapt: auto
"""


def test_reads_functions_as_they_are_written() -> None:
    model = load_text(ROBOT).parts
    assert model is not None
    altitude, search = model.functions["altitude"], model.functions["search"]
    assert list(altitude.variants) == ["high", "medium", "low"]  # by preference
    assert (altitude.dwell_s, altitude.adapt, altitude.changes_per_hour) == (0.5, "auto", 60)
    assert altitude.variants["high"].do == (
        ("set_mode", ("/spiral", "very high")),
        ("start_node", ("cam",)),
    )
    assert (list(search.variants), search.dwell_s, search.adapt) == (["wide", "narrow"], 5.0, None)
    assert (search.notify, search.changes_per_hour, search.criticality) == (True, 12, Criticality.ESSENTIAL)
    assert search.variants["narrow"] == Variant("narrow", None, ("altitude",), (("follow", ()),), 11, None)
    assert model.hardware["camera"].criticality is Criticality.ESSENTIAL
    assert model.hardware["sonar"].criticality is Criticality.NORMAL
    assert [function.name for function in in_order(model)] == ["altitude", "search"]
    assert need_of("altitude.high", model) == (None, "altitude", "high")


def test_what_is_active_is_observed_and_only_of_the_functions_own_variants() -> None:
    vocabulary = load_text(ROBOT).vocabulary
    (literal,) = parse("active(altitude, high)", vocabulary)
    assert literal.atom == Atom("active", ("altitude", "high"))
    with pytest.raises(ObservationError, match="did you mean high"):
        parse("active(altitude, hihg)", vocabulary)
    with pytest.raises(ObservationError, match="do not go together"):
        parse("active(altitude, wide)", vocabulary)
    assert parse("sees", vocabulary)  # what a condition speaks of is declared by it


def test_a_model_without_functions_has_no_such_word_and_the_same_clauses() -> None:
    without = ROBOT.partition("functions:")[0]
    plain, whole = load_text(without), load_text(ROBOT)
    with pytest.raises(ObservationError, match="no predicate is named active"):
        parse("active(altitude, high)", plain.vocabulary)
    assert plain.cnf.clauses == whole.cnf.clauses
    assert five_key_of(plain.cnf) == five_key_of(whole.cnf)
    own = load_text(f"{without}rules: ['active(camera) -> ok(image)']\n")  # a word of the user's, as before
    assert parse("active(camera)", own.vocabulary)


def test_a_condition_compares_the_reading_of_a_name_and_declares_it() -> None:
    system = load_text(ROBOT.replace("properties: [visibility]\n", ""))
    assert parse("ok(visibility)", system.vocabulary)
    assert any("declared by it" in warning for warning in system.warnings)
    assert not any(atom.predicate == "reading" for atom in system.vocabulary.atoms)


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("[high, medium, low]", "[high, low]", 16, "`prefer` does not name medium"),
        ("[high, medium, low]", "[high, medium, lo]", 16, "no variant `lo`; did you mean `low`"),
        ("[camera, cam]", "[camra, cam]", 20, "needs camra, which there is not; did you mean camera"),
        ("[camera, cam]", "[altitude.low]", 20, "cannot need its own function"),
        ("[camera, cam]", "[search]", 8, "in a circle: search needs altitude needs search"),
        ("adapt: auto", "adapt: often", 25, "one of observe, approve, auto, not `often`"),
        ("dwell_s: 0.5", "dwell_s: -1", 24, "seconds from 0 to 3600"),
        ("changes_per_hour: 12", "changes_per_hour: 0", 14, "whole number from 1"),
        ("criticality: optional", "criticality: low", 5, "one of essential, normal, optional"),
        ("dwell_s: 0.5", "dwel_s: 1", 24, "did you mean `dwell_s`"),
        ("{needs: altitude, do: [follow]}", "{need: altitude}", 11, "did you mean `needs`"),
        ("[follow]", "['follow it']", 11, "no act"),
        ("start_node(cam)", "start_node(camera)", 20, "wants one node of the model"),
        ("start_node(cam)", "stop_node(cam)", 20, "never admissible: its own acts take away cam"),
        ("≥ 2.25 +- 0.1", ">= 2 and visibility < 1", 19, "never admissible: nothing fulfils"),
        ("≥ 2.25 +- 0.1", ">= 2 ± 1 and visibility < 3 ± 1", 19, "with their ± the bounds cross"),
        ("visibility ≥", "visiblity ≥", 19, "is named visiblity; did you mean visibility"),
        ("sees", "not ab(camera)", 22, "name the component under `needs:`"),
        ("and sees", "and (sees", 22, "position"),
        ("  altitude:\n", "  x: {variants: {}}\n  altitude:\n", 15, "needs `variants:`, at least one"),
        ("  altitude:\n", "  sonar: {variants: [a]}\n  altitude:\n", 15, "sonar is a component already"),
    ],
)
def test_mistakes_are_named_with_their_line(old: str, new: str, line: int, message: str) -> None:
    assert ROBOT.count(old) == 1
    text = ROBOT.replace(old, new)
    with pytest.raises(ModelError, match=message) as caught:
        load_text(text)
    assert caught.value.line == line


def test_a_variant_beside_which_a_better_one_always_is_admissible_is_refused() -> None:
    text = ROBOT.replace("visibility ≥ 2.25 +- 0.1", "visibility >= 3.5").replace("[camera, cam]", "[camera]")
    assert load_text(text)  # high needs what `sees` says, too
    with pytest.raises(ModelError, match=r"altitude.medium is never reached") as caught:
        load_text(text.replace(" and sees", ""))
    assert caught.value.line == 19


def test_two_variants_that_take_away_what_the_other_needs_are_refused() -> None:
    text = ROBOT.replace("needs: altitude, do: [follow]", "needs: sonar, do: [shutdown(camera)]")
    assert load_text(text)
    with pytest.raises(ModelError, match=r"search.narrow and altitude.medium take away"):
        load_text(text.replace("set_mode(spiral, medium)", "shutdown(sonar)"))


TWO = """\
robomend: 1
hardware: {lidar: {channel: 1}}
nodes: {slam: {drives: [lidar], publishes: {scan: []}}, odom: {publishes: {odom: []}}}
properties: [visibility]
functions:
  place:
    variants:
      map: {when: "visibility >= 3", needs: [slam], do: [place(map)]}
      wheels: {needs: [odom], do: [place(wheels)]}
  drive:
    variants:
      fast: {needs: [place.map], do: [drive(fast)]}
      slow: {do: [drive(slow)]}
  follow:
    variants:
      near: {needs: [drive.slow], do: [follow(near)]}
      none: {do: [follow(none)]}
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("place(map)", "shutdown(lidar)", "place.map is never admissible: its own acts take away lidar"),
        ("drive(fast)", "shutdown(lidar)", "drive.fast takes away lidar, which place.map needs"),
        ("drive(slow)", "shutdown(lidar)", r"take away what the other needs \(lidar, pump\)"),
    ],
)
def test_to_take_away_what_feeds_or_is_driven_by_what_is_needed_takes_that_away(
    old: str, new: str, message: str
) -> None:
    text = TWO.replace("{lidar: {channel: 1}}", "{lidar: {channel: 1}, pump: {channel: 2}}")
    text = text.replace("odom: {pub", "wash: {drives: [pump]}, odom: {pub")
    text = text.replace("slow: {do", "slow: {needs: [wash], do")
    if "slow" in old:
        text = text.replace("place(map)", "shutdown(pump)")
    assert load_text(text)
    with pytest.raises(ModelError, match=message):
        load_text(text.replace(old, new))


def test_of_a_variant_without_acts_model_check_says_that_nothing_changes_to_it() -> None:
    said = [warning for warning in check(load_text(ROBOT)) if "acts" in warning]
    assert said == ["search.wide has no acts (`do:`), so that nothing changes to it"]


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("[drive.slow]", "[drive.fast, place.wheels]", 16, "it needs both place.(map|wheels) and place"),
        (
            "fast: {needs",
            "fast: {when: visibility < 2, needs",
            12,
            r"nothing fulfils its condition and those of what it needs \(place.map\) at once",
        ),
        (
            "drive(fast)",
            "stop_node(slam)",
            12,
            "drive.fast takes away slam, which place.map needs",
        ),
    ],
)
def test_a_variant_whose_needs_exclude_each_other_is_refused_by_model_check(
    old: str, new: str, line: int, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(TWO)
    assert run(["model", "check", str(file)]) == 0
    assert "visibility" not in capsys.readouterr().out  # a condition rests on it: it says something
    assert TWO.count(old) == 1
    file.write_text(TWO.replace(old, new))
    assert run(["model", "check", str(file)]) == 2
    said = capsys.readouterr().err
    assert f"{file}:{line}: " in said
    assert re.search(f"never admissible: .*{message}", said)


def test_isolability_says_how_functions_work_without_what_cannot_be_told_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(TWO.replace("channel: 1}", "channel: 1, blame_hardware: true}"))
    asked = ["model", "check", str(file), "--isolability"]
    assert run([*asked, "-o", "ok(scan)", "-o", "active(place, map)", "-o", "ok(visibility)"]) == 0
    said = capsys.readouterr().out
    assert "observing it adds nothing" not in said
    assert "active(place,map) and ok(visibility): decides how functions work" in said
    assert "lidar and slam cannot be told apart" in said
    alike = said.partition("lidar and slam cannot be told apart")[2]
    assert "whichever it is, place can work by wheels" in alike
    assert "whichever it is, drive can work by slow" in alike
    assert "follow" not in alike


def test_without_components_the_best_variant_that_is_left_is_the_one_decided() -> None:
    """Against the choice itself, for every set of components that may be broken."""
    system = load_text(TWO.replace('when: "visibility >= 3", ', ""))
    assert system.parts is not None
    whole = {"place": "map", "drive": "fast", "follow": "none"}
    for gone in [set[str](), {"lidar"}, {"slam"}, {"odom"}, {"lidar", "odom"}, {"slam", "lidar"}]:
        known = KnownState(lambda atom: atom.args[-1] in whole.values(), lambda atom: None, [gone])
        decided = Keeper().decide(system.parts, system.conditions, known, 0).states
        assert gone or {name: one.goal for name, one in decided.items()} == whole
        changed = {
            name: one.goal for name, one in decided.items() if one.goal != whole[name] and name != "follow"
        }  # `follow` can only become better
        assert left_without(gone, system.parts) == (changed if gone else whole)


def test_check_names_what_every_variant_needs() -> None:
    found = check(load_text(ROBOT))
    assert not any("every variant needs" in doubt for doubt in found)
    found = check(load_text(ROBOT.replace("low: {", "low: {needs: camera, ")))
    assert "function altitude: every variant needs camera; without it none is left" in found


def test_functions_are_drawn_with_what_they_need_and_how_they_work() -> None:
    model = load_text(ROBOT).parts
    assert model is not None
    drawn = graph.layout(model)
    altitude, search = graph.Thing("function", "altitude"), graph.Thing("function", "search")
    assert (graph.Thing("hardware", "camera"), altitude) in drawn.edges
    assert (altitude, search) in drawn.edges
    assert drawn.places[search][0] > drawn.places[altitude][0]
    shown = graph.svg(drawn, {}, {}, {}, {"altitude": "medium"})
    assert "altitude: medium" in shown
    assert "function search: unknown" in shown


NUMBERS = st.floats(-10, 10).map(lambda one: round(one, 2))


@given(NUMBERS, NUMBERS, NUMBERS.map(abs), st.sampled_from([">=", "<=", "<", ">"]), st.booleans())
def test_within_its_margin_a_comparison_counts_as_it_did(
    measured: float, bound: float, margin: float, sign: str, negated: bool
) -> None:
    """Entered by the whole margin, left beyond it, and a negation is the opposite comparison."""
    said = f"visibility {sign} {bound} ± {margin}"
    text = ROBOT.partition("functions:")[0] + (
        'functions: {f: {variants: {a: {when: "%s", do: [x]}, b: {do: [y]}}}}\n'
        % (f"not ({said})" if negated else said)
    )
    formula = load_text(text).conditions["f", "a"]
    enters, plain, stays = (
        holds(formula, lambda atom: None, lambda atom: measured, shift) for shift in (1, 0, -1)
    )
    assert enters in {False, plain}
    assert plain in {False, stays}
    whole = Threshold(Atom("ok", ("visibility",)), sign, bound, 0.0).holds(measured)
    assert plain == (whole != negated)
    if abs(measured - bound) > margin + 1e-9:
        assert enters == plain == stays
    assert holds(formula, lambda atom: None, lambda atom: None, 0) is None
