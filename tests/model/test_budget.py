"""What a sentence or a model may ask for is counted before it is done."""

from __future__ import annotations

import pytest

from robomend.errors import ModelError, ObservationError
from robomend.model.budget import StepCount, scheme_steps
from robomend.model.components import ComponentModel, Hardware
from robomend.model.loading import load_text
from robomend.model.sentences import parse
from robomend.model.vocabulary import Vocabulary
from robomend.observations.language import read_assertion

NODES = tuple(f"n{index}" for index in range(100))
DEVICES = tuple(f"h{index}" for index in range(50))
VOCABULARY = Vocabulary(
    sorts={"nodes": NODES, "hardware": DEVICES},
    predicates={"running": (("nodes",),), "on": (("hardware",),)},
    relations={"drives": frozenset(zip(NODES, DEVICES, strict=False))},
)


def steps(sentence: str) -> int:
    return StepCount(VOCABULARY).of(parse(sentence, VOCABULARY.sorts, VOCABULARY.relations))


@pytest.mark.parametrize(
    ("sentence", "counted"),
    [
        ("on(h1)", 1),
        ("on(h1) and not on(h2)", 2),
        ("forall n in nodes: running(n)", 100 + 100),
        ("forall n in nodes, m in nodes: running(n) or running(m)", 100 + 10_000 + 2 * 10_000),
        # Each of the hundred drives one device at most, and there are fifty pairs.
        ("forall n in nodes, h in hardware where drives(n, h): on(h)", 100 + 50 + 50),
        ("forall h in hardware, n in nodes where drives(n, h): on(h)", 50 + 50 + 50),
        ("forall n, m in nodes where same(n, m): running(n)", 100 + 100 + 100),
        ("forall n, m in nodes where not same(n, m): running(n)", 100 + 10_000 + 10_000),
        ('forall n in nodes, h in hardware where drives("n", h): on(h)', 100 + 100 + 100),
    ],
)
def test_the_instances_of_quantifiers_are_a_product_that_guards_make_smaller(
    sentence: str, counted: int
) -> None:
    assert steps(sentence) == counted


def test_a_line_may_ask_for_more_than_there_is_memory_and_is_refused_at_once() -> None:
    sentence = " ".join(f"forall v{index} in nodes:" for index in range(20)) + " running(v0)"
    with pytest.raises(ObservationError) as refused:
        read_assertion("hint", sentence, VOCABULARY)
    assert "at most 20,000 are taken" in str(refused.value)
    assert "100 nodes × 100 nodes" in str(refused.value)
    assert "join them with `where`" in str(refused.value)
    assert refused.value.sentence == sentence


def model(rules: list[str], nodes: str) -> str:
    return f"robomend: 1\nname: big\nnodes:\n{nodes}" + "".join(
        f"{'rules:' if index == 0 else ''}\n  - {rule!r}" for index, rule in enumerate(rules)
    )


def test_the_rules_of_a_model_have_one_budget_together() -> None:
    nodes = "".join(f"  n{index}: {{publishes: {{t{index}: []}}}}\n" for index in range(30))
    rule = "forall a in nodes, b in nodes: running(a) or running(b)"
    text = model([rule] * 4, nodes)
    assert len(load_text(text, most=12_000).cnf.rules) == 60 + 4
    with pytest.raises(
        ModelError, match=r"^38: rule 4: with what is before it, the model takes 11,040 steps"
    ):
        load_text(text, most=10_500)


@pytest.mark.parametrize(
    "text",
    [
        "hardware: [{many}]\nnodes:\n  n: {{drives: [{many}], publishes: {{{topics}}}}}\n",
        "nodes:\n{publishers}\nvalues: {{a: {{topic: t, field: x}}, b: {{topic: t, field: y}}}}\n"
        "related: [[a, b]]\n",
        "nodes:\n  n: {{publishes: {{t: []}}, modes: {{{topics}}}}}\n",
    ],
    ids=["devices of a driver times its topics", "publishers of related values", "pairs of modes"],
)
def test_what_the_schemes_multiply_counts_as_well(text: str) -> None:
    filled = text.format(
        many=", ".join(f"h{index}" for index in range(300)),
        topics=", ".join(f"t{index}: []" for index in range(300)),
        publishers="\n".join(f"  n{index}: {{publishes: {{t: []}}}}" for index in range(300)),
    )
    with pytest.raises(ModelError, match=r"the clause schemes take [\d,]+ steps; at most 50,000"):
        load_text(f"robomend: 1\nname: wide\n{filled}", most=50_000)


def test_what_components_of_other_kinds_say_counts_as_well() -> None:
    lamps = {name: Hardware(name) for name in ("head", "back", "left")}
    assert scheme_steps(ComponentModel("r", {}, {}, {}, others={"lamps": lamps})) == 2 * len(lamps)
