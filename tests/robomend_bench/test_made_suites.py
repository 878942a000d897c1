"""Suites whose models are made: what they ask is what their text says, by brute force."""

from __future__ import annotations

import random
from itertools import combinations, product
from pathlib import Path

import pytest

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.errors import InputError
from robomend_bench.suite import Wish, find_suite
from robomend_bench.suites.feature_models import feature_model
from robomend_bench.suites.sequential import made_sequential, unrolled
from robomend_client.literals import Atom, Literal

COUNTER = """
INPUT(en)
OUTPUT(carry)
low = DFF(next_low)
high = DFF(next_high)
next_low = XOR(low, en)
both = AND(low, en)
next_high = XOR(high, both)
carry = AND(high, both)
"""


def steps_that(bad: tuple[str, ...], wrong: tuple[bool, ...], enabled: tuple[bool, ...]) -> list[bool]:
    """Return what the counter's `carry` is in each step; `wrong`: what each bad gate gives, step by step."""
    given = iter(wrong)
    low = high = False
    carries = []
    for en in enabled:
        values: dict[str, bool] = {}
        for net in ("next_low", "both", "next_high", "carry"):
            right = {
                "next_low": low != en,
                "both": low and en,
                "next_high": high != values.get("both", False),
                "carry": high and values.get("both", False),
            }[net]
            values[net] = next(given) if net in bad else right
        carries.append(values["carry"])
        low, high = values["next_low"], values["next_high"]
    return carries


@pytest.mark.parametrize("seed", range(12))
def test_a_gate_of_an_unrolled_circuit_is_one_component_in_all_steps(seed: int) -> None:
    chance = random.Random(seed)
    steps = 5
    cnf = unrolled(COUNTER, "counter", steps)
    assert cnf.components == ("next_low", "both", "next_high", "carry")
    enabled = tuple(chance.random() < 0.8 for _ in range(steps))
    seen = [chance.random() < 0.4 for _ in range(steps)]
    possible = [
        set(bad)
        for size in range(3)
        for bad in combinations(cnf.components, size)
        if any(
            steps_that(bad, wrong, enabled) == seen
            for wrong in product((False, True), repeat=len(bad) * steps)
        )
    ]
    minimal = [bad for bad in possible if not any(other < bad for other in possible)]
    said = [Literal(Atom("v", (f"{net}@0",)), False) for net in ("low", "high")]
    said += [Literal(Atom("v", (f"en@{step}",)), value) for step, value in enumerate(enabled)]
    said += [Literal(Atom("v", (f"carry@{step}",)), value) for step, value in enumerate(seen)]
    for engine in ("sat", "hs_dag"):
        result = make_engine(engine, cnf).diagnose(said, Options(max_size=2))
        assert sorted(map(sorted, minimal)) == sorted(sorted(one.bad) for one in result.diagnoses), engine


def test_a_made_sequential_circuit_has_flip_flops_in_a_tenth_of_it_and_each_fault_shows() -> None:
    text = made_sequential(300, random.Random(1))
    assert text.count("DFF(") >= 9
    (group,) = find_suite("sequential").groups(Wish(mode="first", only=("made-300",), instances=4))
    assert group.size == 300
    engine = make_engine("sat", group.model)
    assert not any(engine.diagnose(question.payload, Options()).healthy for question in group.questions)


@pytest.mark.parametrize("seed", range(8))
def test_what_is_given_up_is_the_least_that_some_product_leaves_unmet(seed: int) -> None:
    """Brute force over all products of ten features, by the clauses that name no requirement."""
    cnf = feature_model(10, random.Random(seed))
    n = len(cnf.components)
    names = {cnf.atom_variable[atom]: atom.args[0] for atom in cnf.atoms if atom.predicate == "chosen"}
    tree = [clause for clause in cnf.clauses if all(abs(lit) > n for lit in clause)]
    products = []
    for has in product((False, True), repeat=len(names)):
        value = dict(zip(names, has, strict=True))
        if all(any((lit > 0) == value[abs(lit)] for lit in clause) for clause in tree):
            products.append({names[variable] for variable in names if value[variable]})
    assert products
    chance = random.Random(seed)
    for _ in range(20):
        wished = {name: chance.random() < 0.5 for name in chance.sample(sorted(names.values()), 6)}
        least = min(sum((name in has) != wants for name, wants in wished.items()) for has in products)
        stated = {f"{'with' if wants else 'without'}({name})" for name, wants in wished.items()}
        said = [Literal(Atom("stated", (one,)), one in stated) for one in cnf.components]
        result = make_engine("sat", cnf).diagnose(said, Options(minimal="cardinality", limit=1))
        assert len(result.diagnoses[0].bad) == least


@pytest.mark.parametrize(
    ("suite", "only", "says"),
    [
        ("sequential", "s27", "give --data DIR"),
        ("sequential", "made-9", "made-N has 60 to 30000 gates"),
        ("feature-models", "9", "numbers of features, 10 to 100000"),
    ],
)
def test_what_is_not_there_is_named_with_what_is(tmp_path: Path, suite: str, only: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        list(find_suite(suite).groups(Wish(mode="first", only=(only,), data=tmp_path)))
