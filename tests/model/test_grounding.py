"""encodings/grounding.lp and its Python side, against plain substitution."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.model.budget import StepCount
from robomend.model.clauses import describe
from robomend.model.formulas import And, Formula, Implies, Leaf, Not, Or, Quantified, Truth, Variable, leaves
from robomend.model.rules import ground
from robomend.model.sentences import parse
from robomend.model.vocabulary import Vocabulary
from robomend_client.literals import Atom, Literal, holds

HOSTILE = 'x). :- bound(_,_). #show foo("'
"""A name that would do harm if it ever became program text."""

VOCABULARY = Vocabulary(
    sorts={"nodes": ("a", "b", HOSTILE), "topics": ("t", "u"), "empty": ()},
    predicates={"p": (("nodes", "topics"),), "q": (("nodes",),)},
    relations={
        "publishes": frozenset({("a", "t"), ("b", "u"), (HOSTILE, "u")}),
        "reads": frozenset({("b", "t")}),
    },
)


def read(sentence: str) -> Formula:
    return parse(sentence, VOCABULARY.sorts, VOCABULARY.relations)


def value(formula: Formula, true: frozenset[Atom], scope: dict[str, str]) -> bool:
    """The meaning of a sentence, quantifiers and guards included, by definition."""
    match formula:
        case Leaf(literal):
            atom = Atom(literal.atom.predicate, tuple(scope.get(arg, arg) for arg in literal.atom.args))
            return (atom in true) == literal.positive
        case Truth(known):
            return known
        case Not(body):
            return not value(body, true, scope)
        case And(parts):
            return all(value(part, true, scope) for part in parts)
        case Or(parts):
            return any(value(part, true, scope) for part in parts)
        case Implies(left, right):
            return not value(left, true, scope) or value(right, true, scope)
        case Quantified(universal, variable, sort, guard, body):
            scopes = [{**scope, variable: member} for member in VOCABULARY.sorts[sort]]
            found = [value(body, true, s) for s in scopes if all(related(g, s) for g in guard)]
            return all(found) if universal else any(found)
        case _:
            raise AssertionError(formula)


def related(guard: Literal, scope: dict[str, str]) -> bool:
    one, other = (scope.get(arg, arg) for arg in guard.atom.args)
    if guard.atom.predicate == "same":
        return (one == other) == guard.positive
    return ((one, other) in VOCABULARY.relations[guard.atom.predicate]) == guard.positive


def test_guards_join_over_what_the_model_fixes() -> None:
    found = ground(read("forall n in nodes, t in topics where publishes(n, t): p(n, t)"), VOCABULARY)
    pairs = [("a", "t"), ("b", "u"), (HOSTILE, "u")]
    assert [str(leaf.literal) for leaf in leaves(found)] == [str(holds("p", *pair)) for pair in pairs]


ATOMS = [Atom("q", (n,)) for n in VOCABULARY.sorts["nodes"]] + [
    Atom("p", (n, t)) for n in VOCABULARY.sorts["nodes"] for t in VOCABULARY.sorts["topics"]
]


@st.composite
def sentences(
    draw: st.DrawFn, depth: int = 3, nodes: tuple[str, ...] = ("a",), topics: tuple[str, ...] = ("t",)
) -> Formula:
    """Sentences with quantifiers inside one another; `nodes` and `topics` are what may be named."""

    def below(n: tuple[str, ...] = nodes, t: tuple[str, ...] = topics) -> Formula:
        return draw(sentences(depth - 1, n, t))

    kind = draw(st.sampled_from(["leaf", "not", "and", "or", "implies", "quantifier", "quantifier"]))
    if depth == 0 or kind == "leaf":
        args = (draw(st.sampled_from(nodes)), draw(st.sampled_from(topics)))
        atom = Atom("p", args) if draw(st.booleans()) else Atom("q", args[:1])
        return Leaf(Literal(atom, draw(st.booleans())))
    if kind == "not":
        return Not(below())
    if kind in ("and", "or"):
        return (And if kind == "and" else Or)((below(), below()))
    if kind == "implies":
        return Implies(below(), below())
    sort = draw(st.sampled_from(["nodes", "topics", "empty"]))
    variable = Variable(f"V{depth}")
    names = (*nodes, variable) if sort != "topics" else nodes
    others = (*topics, variable) if sort == "topics" else topics
    guard = []
    if draw(st.booleans()):
        relation = draw(st.sampled_from(["publishes", "reads", "same"]))
        pair = (draw(st.sampled_from(names)), draw(st.sampled_from(names if relation == "same" else others)))
        guard.append(Literal(Atom(relation, pair), draw(st.booleans())))
    return Quantified(draw(st.booleans()), variable, sort, tuple(guard), below(names, others))


@given(sentences())
def test_no_sentence_takes_more_steps_than_it_was_counted(sentence: Formula) -> None:
    assert sum(1 for _ in leaves(ground(sentence, VOCABULARY))) <= StepCount(VOCABULARY).of(sentence)


@given(sentences(), st.data())
def test_the_ground_sentence_means_the_same(sentence: Formula, data: st.DataObject) -> None:
    found = ground(sentence, VOCABULARY)
    for _ in range(5):
        true = frozenset(data.draw(st.lists(st.sampled_from(ATOMS), unique=True)))
        assert value(found, true, {}) == value(sentence, true, {})


@pytest.mark.parametrize(
    "sentence",
    [
        "forall n in nodes: q(n)",
        "exists n in nodes: q(n)",
        "forall n in nodes where not same(n,a): exists t in topics where publishes(n,t): p(n,t)",
    ],
)
def test_a_quantified_sentence_is_told_as_it_was_said(sentence: str) -> None:
    told = describe(read(sentence))
    assert told.replace(", ", ",") == sentence
    assert ground(read(told), VOCABULARY) == ground(read(sentence), VOCABULARY)
