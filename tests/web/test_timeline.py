"""The figure of a repair: lanes, spans, marks, and SVG that every viewer takes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from robomend.store.records import StoredDiagnosis
from robomend.web.letters import cut, width
from robomend.web.past import NS, timeline
from robomend.web.timeline import NARROW, WIDE, ActionBar, Mark, Span, Timeline, lanes, svg

SVG = "{http://www.w3.org/2000/svg}"
TIMES = st.floats(0, 30, allow_nan=False)
NAMES = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), max_size=20)
BARS = st.builds(
    lambda start, length, label, ok: ActionBar(start, start + length, label, ok),
    TIMES,
    st.floats(0, 5),
    NAMES,
    st.booleans(),
)


def drawn(timeline: Timeline) -> ET.Element:
    return ET.fromstring(svg(timeline))


def classes(root: ET.Element) -> list[str]:
    return [element.get("class", "") for element in root.iter(f"{SVG}rect") if element.get("class")]


@given(st.lists(BARS, max_size=12), st.floats(1, 500))
def test_no_bar_meets_another_in_its_lane(bars: list[ActionBar], per_second: float) -> None:
    placed = lanes(bars, per_second, 30)
    assert sorted(id(one.action) for one in placed) == sorted(map(id, bars))
    for lane in {one.lane for one in placed}:
        inside = [one.action for one in placed if one.lane == lane]
        for before, after in pairwise(inside):
            assert before.end_s <= after.start_s


def test_a_label_left_of_its_bar_meets_none_before_it() -> None:
    bars = [ActionBar(0, 9, "long enough"), ActionBar(9.2, 9.4, "at the end")]
    assert [(one.lane, one.label) for one in lanes(bars, 200, 10)] == [(0, "inside"), (0, "right")]
    assert [(one.lane, one.label) for one in lanes(bars, 50, 10)] == [(0, "inside"), (1, "left")]
    bars = [ActionBar(0, 1, "a"), ActionBar(9.2, 9.4, "at the end")]
    assert [(one.lane, one.label) for one in lanes(bars, 50, 10)] == [(0, "inside"), (0, "left")]


def test_state_is_told_by_height_as_well_as_by_colour() -> None:
    spans = (Span(0, 1, True), Span(1, 2, True, only_suspect=True), Span(2, 3, False))
    root = drawn(Timeline("t", "s", [("jaguar", spans)], [], [], 3))
    rows = [element for element in root.iter(f"{SVG}rect") if element.get("class")]
    assert [element.get("class") for element in rows] == ["bad", "suspect", "good"]
    assert [float(element.get("height", "0")) for element in rows] == [13, 8, 4]
    assert "suspect" in [element.text for element in root.iter(f"{SVG}text")]


def test_the_legend_says_what_bars_of_actions_are_and_stays_inside() -> None:
    rows = [("jaguar", (Span(0, 1, True), Span(1, 2, True, only_suspect=True)))]
    bars = [ActionBar(0, 1, "power_up(jaguar)"), ActionBar(1, 2, "start(a)", ok=False)]
    for shape in (WIDE, NARROW):
        root = ET.fromstring(svg(Timeline("t", "s", rows, bars, [], 3, good="not blamed"), shape))
        texts = {element.text: element for element in root.iter(f"{SVG}text")}
        legend = [texts[word] for word in ("bad", "suspect", "not blamed", "action", "failed action")]
        for text in legend:
            assert float(text.get("x", "")) + width(text.text or "", 11) <= float(root.get("width", ""))
            assert float(text.get("y", "")) < float(root.get("height", ""))
        assert len({(text.get("x"), text.get("y")) for text in legend}) == 5
    assert "failed action" not in written(drawn(Timeline("t", "s", rows, bars[:1], [], 3)))
    assert "action" not in written(drawn(Timeline("t", "s", rows, [], [], 3)))


def test_no_label_of_an_action_lies_on_the_heading_of_a_narrow_figure() -> None:
    bars = [ActionBar(2.9, 3, "start_node(laser_alignment_control)")]
    root = ET.fromstring(svg(Timeline("t", "s", [], bars, [], 3), NARROW))
    texts = {"".join(one.itertext()): one for one in root.iter(f"{SVG}text")}
    label = next(one for words, one in texts.items() if "laser" in words)
    assert float(label.get("y", "")) - float(texts["repair actions"].get("y", "")) >= 12


def test_of_a_robot_of_which_nothing_is_known_nothing_is_drawn_as_good() -> None:
    blamed, nobody = ({"bad": ["h"], "good": ["n"]}, {"bad": [], "good": ["h", "n"]})
    found = [
        StoredDiagnosis("r", number, "", number * NS, {"result": {"diagnoses": [one]}})
        for number, one in enumerate((nobody, blamed, nobody))
    ]
    assert [
        (name, [span.state for span in spans]) for name, spans in timeline("r", 0, 3 * NS, found, []).rows
    ] == [("h", ["bad", "good"])]
    drawn_unknown = timeline("r", 0, 3 * NS, found, [], unknown=True)
    assert [(name, [span.state for span in spans]) for name, spans in drawn_unknown.rows] == [("h", ["bad"])]
    assert "not blamed" in written(drawn(drawn_unknown))


@given(NAMES, st.lists(BARS, max_size=5), st.lists(st.builds(Mark, TIMES, NAMES), max_size=3))
def test_any_name_makes_well_formed_svg_that_stays_inside(
    name: str, bars: list[ActionBar], marks: list[Mark]
) -> None:
    root = drawn(Timeline(name, name, [(name, (Span(0, 40, True),))], bars, marks, 20))
    width, height = float(root.get("width", "0")), float(root.get("height", "0"))
    for rect in root.iter(f"{SVG}rect"):
        assert 0 <= float(rect.get("x", "0")) <= width
        assert 0 <= float(rect.get("y", "0")) <= height
    assert len([kind for kind in classes(root) if kind == "action"]) == len(bars)


def test_a_label_that_does_not_fit_its_bar_stands_beside_it() -> None:
    bars = (
        ActionBar(0, 0.2, "start_node(mapper)"),
        ActionBar(1, 4, "power_up(base)"),
        ActionBar(4.9, 5, "stop(a)"),
    )
    root = drawn(Timeline("t", "", (), bars, (), 5.0))
    texts = {text.text: text for text in root.iter(f"{SVG}text")}
    rects = [one for one in root.iter(f"{SVG}rect") if one.get("class") == "action"]

    def edges(rect: ET.Element) -> tuple[float, float]:
        left = float(rect.get("x", ""))
        return left, left + float(rect.get("width", ""))

    (_, right), (left, _), (last, _) = map(edges, rects)
    short, long, late = (texts[bar.label] for bar in bars)
    assert float(short.get("x", "")) > right
    assert left < float(long.get("x", "")) < left + 10
    assert (float(late.get("x", "")) < last, late.get("text-anchor")) == (True, "end")


def written(root: ET.Element) -> list[str]:
    return ["".join(element.itertext()) for element in root.iter(f"{SVG}text")]


def test_the_axis_counts_seconds_or_tells_round_times_of_the_day() -> None:
    assert {"0 s", "20 s", "60 s"} <= set(written(drawn(Timeline("t", "s", [], [], [], 60))))
    noon_ns = 12 * 3600 * 10**9 + 7 * 10**9  # 12:00:07 on the first of January 1970
    told = written(drawn(Timeline("t", "s", [], [], [], 60, noon_ns)))
    assert [one for one in told if ":" in one][:2] == ["12:00:10", "12:00:15"]
    assert "13:00" in written(drawn(Timeline("t", "s", [], [], [], 7200, noon_ns)))


def test_a_narrow_figure_names_its_rows_before_the_bars_and_says_the_whole_name() -> None:
    names = ["laser_alignment_control", "laser_alignment_node", "front_alignment_node"]
    timeline = Timeline("t", "s", [(name, (Span(0, 1, True),)) for name in names], [], [], 60)
    root = ET.fromstring(svg(timeline, NARROW))
    rows = [text for text in root.iter(f"{SVG}text") if text.find(f"{SVG}title") is not None]
    assert [row.findtext(f"{SVG}title") for row in rows] == names
    shown = ["".join(row.itertext()).removeprefix(name) for row, name in zip(rows, names, strict=True)]
    assert all("…" in one for one in shown)
    assert len(set(shown)) == 3, "told apart by what they begin or end with"
    bars = [rect for rect in root.iter(f"{SVG}rect") if rect.get("class") == "bad"]
    assert all(float(bar.get("x", "0")) >= NARROW.labels for bar in bars)


@given(st.text(min_size=1), st.floats(20, 300))
def test_what_is_cut_fits_and_is_the_beginning_and_the_end_of_the_name(name: str, most: float) -> None:
    shown = cut(name, most, 12)
    assert width(shown, 12) <= most + 1e-6
    if shown != name:
        signs = [at for at, letter in enumerate(shown) if letter == "…"]
        assert any(name.startswith(shown[:at]) and name.endswith(shown[at + 1 :]) for at in signs)
