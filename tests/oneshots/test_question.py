"""From sentences to a question, and what is supposed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robomend.diagnosis.result import Options
from robomend.errors import InputError, ObservationError, UnknownComponent
from robomend.model.loading import load_text
from robomend.oneshots.warm_model import question, sentences_of, supposing
from robomend_client.literals import fails, holds

ROBOT = load_text(
    "robomend: 1\nnodes: {gyro: {publishes: {imu: []}}, base: {publishes: {odom: []}}}\n"
    "values: {yaw: {topic: imu, field: z}}\nrules: ['not ab(gyro) -> inc(yaw)']\n"
)
WORDS = ROBOT.vocabulary


def test_what_is_said_later_replaces_what_it_contradicts_and_a_trend_the_other_trends() -> None:
    assert question(["ok(imu)", "not ok(imu)"], WORDS).literals == {fails("ok", "imu")}
    rising = {holds("inc", "yaw"), fails("dec", "yaw"), fails("const", "yaw")}
    assert question(["dec(yaw)", "inc(yaw)"], WORDS).literals == rising
    assert question(["inc(yaw)", "not inc(yaw)"], WORDS).literals == {
        fails("inc", "yaw"), fails("dec", "yaw"), fails("const", "yaw")
    }  # fmt: skip


@pytest.mark.parametrize(
    ("sentences", "both"),
    [
        (["ok(imu)", "ok(odom)", "not ok(imu)"], r"both ok\(imu\) and not ok\(imu\)"),
        (["inc(yaw)", "dec(yaw)"], r"both inc\(yaw\) and dec\(yaw\)"),
    ],
)
def test_sentences_of_one_moment_may_not_contradict_one_another(sentences: list[str], both: str) -> None:
    with pytest.raises(InputError, match=f"the observations hold {both}"):
        question(sentences, WORDS, opposites="refuse")
    assert question(["inc(yaw)", "not dec(yaw)", "inc(yaw)"], WORDS, opposites="refuse").literals == {
        holds("inc", "yaw"), fails("dec", "yaw"), fails("const", "yaw")
    }  # fmt: skip


@pytest.mark.parametrize(
    ("line", "sentences"),
    [
        ('["a", "b"]', ["a", "b"]),
        ("v(1) not v(2), ~v(3)", ["v(1)", "not v(2)", "~v(3)"]),
        ("v(1), v(2),", ["v(1)", "v(2)"]),
        ("not not v(1) p q(a,b)", ["not not v(1)", "p", "q(a,b)"]),
        ("v(1) and not v(2)", ["v(1) and not v(2)"]),
        ('ok("a b") ok(c)', ['ok("a b")', "ok(c)"]),
        ("", []),
    ],
)
def test_lines_are_cut_into_sentences(line: str, sentences: list[str]) -> None:
    assert sentences_of(line) == sentences


def test_a_line_that_is_no_array_and_no_sentence_is_refused() -> None:
    for line in ("[ok(scan)]", "[" * 100_000, "v(1) " * 10_000):
        with pytest.raises(ObservationError):
            sentences_of(line)


def test_suppositions_are_of_components_of_the_model_and_one_way() -> None:
    options = supposing(Options(healthy=frozenset({"/gyro"}), abnormal=frozenset({"base"})), ROBOT)
    assert [*options.healthy, *options.abnormal] == ["gyro", "base"]
    with pytest.raises(UnknownComponent, match="did you mean 'gyro'"):
        supposing(replace(options, abnormal=frozenset({"gyr"})), ROBOT)
    with pytest.raises(InputError, match="gyro cannot be assumed healthy and abnormal"):
        supposing(replace(options, abnormal=frozenset({"gyro"})), ROBOT)
