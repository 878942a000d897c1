"""YAML with lines: what is read, what is refused and where, by the parser in C and the one in Python."""

from __future__ import annotations

import pytest
import yaml

from robomend_client.yaml_tree import (
    MAX_NESTING,
    Mapping,
    RepeatedKey,
    Scalar,
    Sequence,
    YamlError,
    read_tree,
)


@pytest.fixture(params=["in C", "in Python"], autouse=True)
def parser(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "in Python":
        monkeypatch.delattr(yaml, "CSafeLoader", raising=False)


def mapping(text: str, *, aliases: bool = False) -> Mapping:
    tree = read_tree(text, aliases=aliases)
    assert isinstance(tree, Mapping)
    return tree


def test_everything_knows_its_line() -> None:
    tree = mapping("a: 1\nb:\n  - x\n  - {c: d}\n")
    assert tree.items["a"] == Scalar("1", 1, plain=True)
    assert tree.lines == {"a": 1, "b": 2}
    items = tree.items["b"]
    assert isinstance(items, Sequence)
    assert items.items == [Scalar("x", 3, plain=True), Mapping({"c": Scalar("d", 4, True)}, 4, {"c": 4})]


@pytest.mark.parametrize(
    ("text", "empty"), [("", True), ("~", True), ("null", True), ('""', False), ("0", False)]
)
def test_no_value_is_told_from_an_empty_text(text: str, empty: bool) -> None:
    value = mapping(f"a: {text}").items["a"]
    assert isinstance(value, Scalar)
    assert value.empty is empty


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", None, "the file is empty"),
        ("a: ]", 1, "not YAML: "),
        ("a: 1\n---\nb: 2", 3, "a second document begins"),
        ("a: 1\n[b]: 2", 2, "a key must be a name"),
        ("a: &x 1\nb: *x", 2, r"`\*x`: aliases are not read"),
        ("a:\n\tb: 1", 2, "not YAML: a tab; lines are indented with spaces"),
        ("a: 1\nb: \x07", 2, "not YAML: character #x07 is not allowed"),
        ("\n" + "[" * (MAX_NESTING + 1), 2, "nested deeper than"),
    ],
)
def test_what_is_not_read_is_named_with_its_line(text: str, line: int | None, message: str) -> None:
    with pytest.raises(YamlError, match=message) as refused:
        read_tree(text)
    assert refused.value.line == line


def test_a_key_that_is_there_twice_is_named_with_the_way_to_it() -> None:
    with pytest.raises(RepeatedKey, match=r"`c` is written twice \(first in line 3\)") as refused:
        read_tree("a:\n  b:\n    c: 1\n    c: 2\n")
    assert (refused.value.place, refused.value.line) == (("a", "b", "c"), 4)


def test_an_alias_is_the_node_that_it_names() -> None:
    tree = mapping("a: &x {b: &y 1}\nc: *x\nd: *y", aliases=True)
    assert tree.items["c"] is tree.items["a"]
    assert tree.items["d"] == Scalar("1", 1, plain=True)


@pytest.mark.parametrize("text", ["a: *x", "a: &x [*x]", "a: &x {b: *x}"])
def test_an_alias_of_what_is_not_whole_is_refused(text: str) -> None:
    with pytest.raises(YamlError, match="names nothing that is whole before it"):
        read_tree(text, aliases=True)
