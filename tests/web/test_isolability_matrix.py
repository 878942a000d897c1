"""The isolability matrix as a figure."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from robomend.web import isolability_matrix as figure

SVG = "{http://www.w3.org/2000/svg}"


def drawn(matrix: tuple[str, ...], names: list[str]) -> ElementTree.Element:
    text = figure.isolability_matrix("r1 <1>", [(name,) for name in names], matrix, [True] * len(names))
    return ElementTree.fromstring(text)


def test_each_kind_of_place_has_its_own_mark() -> None:
    root = drawn(("=-~", "+=?", "++="), ["a", "b", "c & d"])
    legend = 1  # of each mark, one explains it
    assert len([r for r in root.iter(f"{SVG}rect") if r.get("fill") == figure.NEVER]) == 1 + legend
    assert len(list(root.iter(f"{SVG}circle"))) == 1 + legend
    assert [t.text for t in root.iter(f"{SVG}text")].count("?") == 1 + legend
    assert [t.text for t in root.iter(f"{SVG}text")].count("c & d") == 2


def test_a_figure_of_many_faults_shows_some_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figure, "MOST_ROWS", 2)
    root = drawn(("=--", "-=-", "--="), ["a", "b", "c"])
    said = [text.text or "" for text in root.iter(f"{SVG}text")]
    assert "c" not in said
    assert any("The first 2 of 3" in text for text in said)


def test_a_long_name_is_cut_and_told_whole_in_its_title() -> None:
    long = "n" * 200
    root = drawn(("=-", "-="), ["a", long])
    assert float(root.get("width", "")) < 700
    assert float(root.get("height", "")) < 560
    assert [title.text for title in root.iter(f"{SVG}title")].count(long) == 2
