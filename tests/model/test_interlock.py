"""`act_when`: a sentence that OBS must show, judged in three values; what loading and checking say of it."""

from __future__ import annotations

from itertools import product

import pytest

from robomend.errors import ModelError
from robomend.model.checking import check
from robomend.model.formulas import truth
from robomend.model.loading import load_text
from robomend.model.sentences import parse
from robomend.model.system import System
from robomend_client.literals import Atom

ROBOT = """\
robomend: 1
hardware: {base: {channel: 1}}
nodes:
  driver: {drives: [base], publishes: {odom: []}}
  other: {publishes: {map: [odom]}}
properties: [parked, moving]
"""


def loaded(sentence: str) -> System:
    return load_text(f"{ROBOT}act_when: '{sentence}'\n", file="robot.yaml")


@pytest.mark.parametrize(
    "sentence",
    ["a and b", "a or b", "a -> b", "a <-> b", "not a", "not (a or not b)", "(a -> b) and (b -> a) or false"],
)
def test_a_sentence_is_known_only_if_every_completion_of_what_is_known_agrees(sentence: str) -> None:
    """Weaker than that in general (`a or not a`), never stronger."""
    formula = parse(sentence)
    atoms = (Atom("a"), Atom("b"))
    for values in product((True, False, None), repeat=2):
        seen = dict(zip(atoms, values, strict=True))
        completions = {
            truth(formula, dict(zip(atoms, whole, strict=True)).get)
            for whole in product((True, False), repeat=2)
            if all(known in (None, given) for known, given in zip(values, whole, strict=True))
        }
        found = truth(formula, seen.get)
        assert found is None or completions == {found}
        assert None not in values or len(completions) == 1 or found is None
        assert None in values or found is not None


@pytest.mark.parametrize(
    ("sentence", "said"),
    [
        ("not ab(base)", "robot.yaml:7: act_when: ab(base) is what a diagnosis decides"),
        ("true", "robot.yaml:7: act_when names nothing that could be observed"),
        ("ok(parked", "robot.yaml:7: act_when: 'ok(parked', position 9: expected `,` or `)`"),
        (
            "running(drivr)",
            "robot.yaml:7: act_when: 'running(drivr)', position 0: no node is named drivr",
        ),
    ],
)
def test_a_sentence_that_says_nothing_of_observations_is_refused_with_its_line(
    sentence: str, said: str
) -> None:
    with pytest.raises(ModelError) as refused:
        loaded(sentence)
    assert str(refused.value).startswith(said)


def test_the_check_names_a_sentence_that_a_repair_itself_takes_away() -> None:
    def said(sentence: str) -> list[str]:
        return [doubt for doubt in check(loaded(sentence)) if "act_when" in doubt]

    assert said("ok(parked) and not ok(moving)") == []
    assert said("ok(odom) and running(other)") == [
        f"act_when speaks of {atom}: while {by} is broken or being repaired it may not be observed, and then "
        "nothing is sent; observe it by other means"
        for atom, by in (("ok(odom)", "driver"), ("running(other)", "other"))
    ]
    assert said("ok(parkd)") == [
        "act_when speaks of ok(parkd), which is no topic or property: taken as declared by it"
    ]
