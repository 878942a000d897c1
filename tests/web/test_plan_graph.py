"""A plan as a picture: what waits for what, and how far each step is."""

from __future__ import annotations

import re
from typing import Any

from robomend.web.plan_graph import MOST, svg


def step(index: int, text: str, *after: int, state: str = "waiting") -> dict[str, Any]:
    name, _, parameter = text.rstrip(")").partition("(")
    parameters = [parameter] if parameter else []
    return {
        "index": index,
        "text": text,
        "name": name,
        "parameters": parameters,
        "after": list(after),
        "state": state,
    }


PLAN = [
    step(0, "power_up(base)", state="done"),
    step(1, "power_up(lidar)", state="failed"),
    step(2, "stop_node(base_node)", 0, state="running"),
    step(3, "start_node(base_node)", 2),
]


def boxes(drawn: str) -> dict[str, tuple[int, int]]:
    """Return where each step stands."""
    found = re.findall(r'<rect x="(\d+)" y="(\d+)".*?isolate">(.*?)</tspan>', drawn)
    return {text: (int(x), int(y)) for x, y, text in found}


def test_what_waits_stands_right_of_what_it_waits_for_and_the_rest_side_by_side() -> None:
    at = boxes(svg(PLAN, False))
    assert at["Power up base"][0] == at["Power up lidar"][0]
    assert at["Power up base"][1] != at["Power up lidar"][1]
    chain = ["Power up base", "Stop base_node", "Start base_node"]
    assert [at[one][0] for one in chain] == sorted({at[one][0] for one in chain})
    assert len({at[one][1] for one in chain}) == 1, "beside what it waits for"
    assert svg(PLAN, False).count('class="edge"') == 2


def test_how_far_a_step_is_shows_by_a_sign_and_not_by_colour_alone() -> None:
    drawn = svg(PLAN, True)
    assert re.findall(r'class="thing (\w+)"', drawn) == ["good", "bad", "running", "waiting"]
    assert re.findall(r">([✓✕…] )?<tspan", drawn) == ["✓ ", "✕ ", "… ", ""]
    assert set(re.findall(r'class="thing (\w+)"', svg(PLAN, False))) == {"waiting"}


def test_names_are_text_whatever_is_in_them_and_cut_where_they_are_long() -> None:
    drawn = svg([step(0, "<script>"), step(1, "a" * 200, 0)], False)
    assert "<script>" not in drawn
    assert "&lt;script&gt;" in drawn
    assert "start_node(a)" in svg([step(0, "start_node(a)"), step(1, "b", 0)], False), "its PDDL name"
    assert re.search(r">Aa{9,30}…a{10,30}<", drawn)
    assert "a" * 200 in drawn, "in its title"


def test_one_step_and_very_many_are_a_list_alone() -> None:
    assert svg(PLAN[:1], False) == ""
    assert svg([step(n, "a") for n in range(MOST + 1)], False) == ""
