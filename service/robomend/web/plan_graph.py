"""A plan as a small graph: what has to be done before what, from left to right; what is above each other runs
side by side.

    power_up(base) ──► stop_node(base_node) ──► start_node(base_node)
    power_up(lidar) ─► …

Colour and a sign say how far a step is. It is text, so that it can be searched and read aloud.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from robomend.repairs.states import StepState
from robomend.web.words import layers

COLUMN, ROW = 246, 40  # from one box to the next, pixels
BOX, HEIGHT = 204, 28
MARGIN = 4
LETTERS = 24
"""Of a step that is shown; the rest is in its title."""

LEAST = 2
"""Steps from which there is something to draw."""

MOST = 60
"""Steps that are drawn; of more there is the list alone."""

SHOWN = {
    StepState.DONE: ("good", "✓ "),
    StepState.ALREADY: ("good", "✓ "),
    StepState.FAILED: ("bad", "✕ "),
    StepState.RUNNING: ("running", "… "),
}


def svg(plan: Sequence[Mapping[str, Any]], states: bool) -> str:
    """Return the graph as an SVG element, nothing where there is nothing to draw.

    Args:
        states: whether to show how far each step is; of a plan that waits for a yes all are waiting.
    """
    if not LEAST <= len(plan) <= MOST:
        return ""
    columns = layers(plan)
    places: dict[int, tuple[int, int]] = {}
    for x, steps in enumerate(columns):  # each beside what it waits for
        steps.sort(key=lambda step: min((places[one][1] for one in step["after"]), default=0))
        places |= {step["index"]: (x, y) for y, step in enumerate(steps)}
    width = 2 * MARGIN + BOX + COLUMN * (len(columns) - 1)
    height = 2 * MARGIN + HEIGHT + ROW * (max(map(len, columns)) - 1)
    out = [
        f'<svg class="plan-graph" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'role="group" aria-label="The plan: {len(plan)} actions">'
    ]
    for step in plan:
        for before in step["after"]:
            out.append(_edge(places[before], places[step["index"]]))
    out += [_box(step, places[step["index"]], states) for step in plan]
    out.append("</svg>")
    return "\n".join(out)


def _edge(source: tuple[int, int], target: tuple[int, int]) -> str:
    (left, above), (right, below) = _corner(source), _corner(target)
    left, y1, y2 = left + BOX, above + HEIGHT // 2, below + HEIGHT // 2
    bend = max(18, (right - left) // 2)
    tip = right - 1
    curve = f"M{left} {y1} C{left + bend} {y1} {tip - bend} {y2} {tip} {y2}"
    arrow = f"M{tip - 7} {y2 - 4} L{tip} {y2} L{tip - 7} {y2 + 4}"
    return f'<path class="edge" d="{curve} {arrow}"/>'


def _box(step: Mapping[str, Any], place: tuple[int, int], states: bool) -> str:
    x, y = _corner(place)
    kind, sign = SHOWN.get(step.get("state", ""), ("waiting", "")) if states else ("waiting", "")
    text = step["text"]
    shown = text if len(text) <= LETTERS else f"{text[: LETTERS - 1]}…"
    told = f"{text}: {step['state']}" if states and step.get("state") else text
    return (
        f'<g class="thing {kind}"><title>{escape(told)}</title>'
        f'<rect x="{x}" y="{y}" width="{BOX}" height="{HEIGHT}" rx="6"/>'
        f'<text x="{x + BOX / 2:g}" y="{y + HEIGHT / 2 + 4.5:g}" text-anchor="middle">'
        f'{sign}<tspan unicode-bidi="isolate">{escape(shown)}</tspan></text></g>'
    )


def _corner(place: tuple[int, int]) -> tuple[int, int]:
    return MARGIN + COLUMN * place[0], MARGIN + ROW * place[1]
