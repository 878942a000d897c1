"""PDDL from users: merged when right, refused with file, line and remedy when wrong."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.planning.robots import TEDUSAR

from robomend.errors import DomainError
from robomend.planning.domain.loading import load_domain, shipped
from robomend.planning.domain.sexpr import read, render
from robomend.planning.planning import PlanOptions, plan_for


def extension(body: str, name: str = "robot-repair") -> str:
    return f"(define (domain {name})\n{body}\n)"


ACTION = "(:action a :parameters (?h - hardware) :precondition {} :effect (and (on ?h) (not (off ?h))))"


def test_without_a_text_of_the_user_the_shipped_domain_is_meant() -> None:
    domain = load_domain()
    assert domain.schemas.keys() >= {"power_up", "shutdown", "start_node", "stop_node"}
    assert domain is load_domain("") is load_domain(None)
    assert {"drives", "fed_by", "switchable"} <= domain.static
    assert not {"on", "good", "running"} & domain.static


def test_a_users_part_is_added_to_it() -> None:
    text = extension(
        "(:types lidar - hardware) (:predicates (spare ?a ?b - lidar))"
        "(:action swap :parameters (?a ?b - lidar) :precondition (spare ?a ?b)"
        " :effect (and (good ?b) (not (bad ?b))))"
    )
    domain = load_domain(text)
    assert set(domain.schemas) == {*load_domain().schemas, "swap"}
    assert domain.schemas["swap"].parameters == (("?a", "lidar"), ("?b", "lidar"))
    assert domain.is_a("lidar", "component")
    assert domain.predicates["spare"].types == ("lidar", "lidar")


def test_a_whole_domain_of_the_user_takes_the_place_of_ours() -> None:
    assert load_domain(shipped("paper-repair.pddl")).name == "paper-repair"


REFUSED = {
    "one bracket too few": ("(define (domain robot-repair) (:action", 1, "never closed"),
    "one bracket too many": (extension("") + ")", 3, "more text after the last bracket"),
    "a closing bracket first": (")", 1, "without its"),
    "words outside": ("domain robot-repair", 1, "outside of any bracket"),
    "nothing at all": ("; only a comment", 1, "no (define"),
    "no domain": ("(define (problem p) (:domain robot-repair))", 1, "expected (domain NAME)"),
    "another domain's name": (extension("", "robot"), 1, "actions are added to 'robot-repair'"),
    "an unknown section": (extension("(:axiom (on ?h))"), 2, "unknown section ':axiom'"),
    "an unknown requirement": (extension("(:requirements :durative-actions)"), 2, "not supported"),
    "an undeclared variable": (
        extension(ACTION.format("(off ?x)")),
        2,
        "?x is not declared; declared are ?h",
    ),
    "an unknown predicate": (extension(ACTION.format("(offf ?h)")), 2, "did you mean 'off'"),
    "an unknown type": (
        extension("(:action a :parameters (?h - hardwear) :effect (on ?h))"),
        2,
        "unknown type 'hardwear'; did you mean 'hardware'",
    ),
    "too many arguments": (extension(ACTION.format("(off ?h ?h)")), 2, "off takes 1 argument, found 2"),
    "an argument of another type": (
        extension("(:action a :parameters (?n - node)\n :precondition (off ?n) :effect (bad ?n))"),
        3,
        "off wants a hardware here, and ?n is a node",
    ),
    "an action that is there already": (
        extension("\n(:action power_up :parameters (?h - hardware) :effect (and (on ?h) (not (off ?h))))"),
        3,
        "'power_up' is declared twice",
    ),
    "a type that is its own kind": (extension("(:types a - b b - a)"), 2, "is a kind of itself"),
    "a variable declared twice": (
        extension("(:action a :parameters (?h ?h - hardware) :effect (bad ?h))"),
        2,
        "?h is declared twice",
    ),
    "a variable without its mark": (
        extension("(:action a :parameters (h - hardware) :effect (bad h))"),
        2,
        "variables start with '?'",
    ),
    "a name that is no variable and no constant": (
        extension("(:action a :parameters () :effect (and (on jaguar) (not (off jaguar))))"),
        2,
        "neither a variable (?jaguar) nor in (:constants",
    ),
    "a number in init": (extension("(:init (= (battery) 3))"), 2, "only function is (total-cost)"),
    "a fact without brackets": (extension("(:init jaguar)"), 2, "expected a fact such as"),
    "no name": (extension("(:action)"), 2, "expected (:action NAME"),
    "no effect": (extension("(:action a :parameters (?h - hardware))"), 2, "has no :effect"),
    "an effect of nothing": (
        extension("(:action a :parameters () :effect (increase (total-cost) 5))"),
        2,
        "changes nothing",
    ),
    "a fact added and its opposite left": (
        extension("(:action a :parameters (?c - component) :effect (good ?c))"),
        2,
        "adds (good ?c) and leaves (bad ?c); add (not (bad ?c))",
    ),
    "a cost that is a word": (
        extension("(:action a :parameters (?h - hardware) :effect (increase (total-cost) cheap))"),
        2,
        "from 0 up",
    ),
    "an effect that depends on what changes": (
        extension(
            "\n(:action a :parameters (?h - hardware) :effect (when (on ?h) (and (bad ?h) (not (good ?h)))))"
        ),
        3,
        "only static predicates may guard an effect",
    ),
    "a negative cost": (
        extension(
            "(:action a :parameters (?c - component) :effect (and (bad ?c) (not (good ?c))"
            " (increase (total-cost) -3)))"
        ),
        2,
        "from 0 up",
    ),
    "either": (
        extension("(:action a :parameters (?h - (either node hardware)) :effect (bad ?h))"),
        2,
        "(either …) is not supported",
    ),
    "a fact with a variable": (extension("(:init (drives ?n jaguar))"), 2, "has no variables"),
    "a quote left open": (extension('(:objects "usb 1)'), 2, "quote that is not closed"),
    "an action field twice": (
        extension("(:action a :effect (bad ?c) :effect (bad ?c))"),
        2,
        ":effect is given twice",
    ),
    "an unknown action field": (
        extension("(:action a :condition () :effect (bad ?c))"),
        2,
        "expected one of :parameters, :precondition, :effect",
    ),
    "imply with one part": (extension(ACTION.format("(imply (off ?h))")), 2, "imply takes 2 parts, found 1"),
    "a quantifier over a name that is taken": (
        extension(ACTION.format("(forall (?h - hardware) (off ?h))")),
        2,
        "?h is declared already",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_refused_with_its_line(case: str) -> None:
    text, line, message = REFUSED[case]
    with pytest.raises(DomainError) as caught:
        load_domain(text, "mine.pddl")
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"mine.pddl:{line}: ")


def test_objects_and_facts_must_fit_the_model() -> None:
    def plan(body: str) -> None:
        plan_for(TEDUSAR, [], ["imu"], PlanOptions(domain=extension(body), domain_file="mine.pddl"))

    with pytest.raises(DomainError, match=r"mine.pddl:2: 'lidar' is neither a component"):
        plan("(:init (drives imu_node lidar))")
    with pytest.raises(DomainError, match="drives wants a hardware here, and rviz is a node"):
        plan("(:init (drives imu_node rviz))")
    with pytest.raises(DomainError, match="'lidar' is declared a hardware, but the model has no such"):
        plan("(:objects lidar - hardware)")
    with pytest.raises(DomainError, match="'rviz' is a node, not a hardware"):
        plan("(:objects rviz - hardware)")
    plan('(:objects "IMU" rviz) (:init (drives rviz Imu))')


def test_deep_nesting_is_refused() -> None:
    with pytest.raises(DomainError, match="brackets inside each other"):
        load_domain("(" * 5000)
    with pytest.raises(DomainError, match="at most"):
        load_domain(" " * 10 + ";" * 300_000 + "x")


def refusal(text: str) -> int | None:
    """The line that is refused, 0 when the text is taken."""
    try:
        load_domain(text)
    except DomainError as error:
        return error.line
    return 0


@given(st.text(alphabet="()?:-; \nabc\"'", max_size=80))
def test_garbage_raises_nothing_but_domain_errors(text: str) -> None:
    assert refusal(extension(text)) is not None


@given(st.integers(0, 10_000), st.integers(0, 10_000))
def test_a_damaged_domain_raises_nothing_but_domain_errors(at: int, length: int) -> None:
    text = shipped("repair.pddl")
    start = at % len(text)
    damaged = text[:start] + text[start + length % 200 :]
    assert refusal(damaged) is not None


def test_a_domain_can_be_written_and_read_again() -> None:
    text = shipped("repair.pddl")
    assert render(read(render(read(text)))) == render(read(text))
