"""A plan as a small graph: what has to be done before what, from left to right; what is above each other runs
side by side.

    power_up(base) ──► stop_node(base_node) ──► start_node(base_node)
    power_up(lidar) ─► …

Colour and a sign say how far a step is. It is text, so that it can be searched and read aloud.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import ceil
from typing import Any

from robomend.planning.plan import action_title
from robomend.repairs.states import StepState
from robomend.web.letters import cut, width
from robomend.web.words import layers

GAP, ROW = 42, 40  # between two columns, and from one row to the next, pixels
BOX, HEIGHT = (140, 340), 28
"""A box is as wide as the longest step wants it, between these; of a longer step the rest is in its title."""

MARGIN = 4
PADDING = 10
LETTERS = 13  # pixels, as in page.css

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

SIGN = max(width(sign, LETTERS) for _, sign in SHOWN.values())


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
    widest = max(width(action_title(step["name"], step["parameters"]), LETTERS) for step in plan)
    box = min(max(BOX[0], ceil(widest + SIGN + 2 * PADDING)), BOX[1])
    wide = 2 * MARGIN + box + (box + GAP) * (len(columns) - 1)
    height = 2 * MARGIN + HEIGHT + ROW * (max(map(len, columns)) - 1)
    out = [
        f'<svg class="plan-graph" viewBox="0 0 {wide} {height}" width="{wide}" height="{height}" '
        f'role="group" aria-label="The plan: {len(plan)} actions">'
    ]
    for step in plan:
        for before in step["after"]:
            out.append(_edge(places[before], places[step["index"]], box))
    out += [_box(step, places[step["index"]], box, states) for step in plan]
    out.append("</svg>")
    return "\n".join(out)


def _edge(source: tuple[int, int], target: tuple[int, int], box: int) -> str:
    (left, above), (right, below) = _corner(source, box), _corner(target, box)
    left, y1, y2 = left + box, above + HEIGHT // 2, below + HEIGHT // 2
    bend = max(18, (right - left) // 2)
    tip = right - 1
    curve = f"M{left} {y1} C{left + bend} {y1} {tip - bend} {y2} {tip} {y2}"
    arrow = f"M{tip - 7} {y2 - 4} L{tip} {y2} L{tip - 7} {y2 + 4}"
    return f'<path class="edge" d="{curve} {arrow}"/>'


def _box(step: Mapping[str, Any], place: tuple[int, int], box: int, states: bool) -> str:
    x, y = _corner(place, box)
    kind, sign = SHOWN.get(step.get("state", ""), ("waiting", "")) if states else ("waiting", "")
    text, title = step["text"], action_title(step["name"], step["parameters"])
    shown = cut(title, box - 2 * PADDING - SIGN, LETTERS)
    told = f"{text}: {step['state']}" if states and step.get("state") else text
    return (
        f'<g class="thing {kind}"><title>{escape(told)}</title>'
        f'<rect x="{x}" y="{y}" width="{box}" height="{HEIGHT}" rx="6"/>'
        f'<text x="{x + box / 2:g}" y="{y + HEIGHT / 2 + 4.5:g}" text-anchor="middle">'
        f'{sign}<tspan unicode-bidi="isolate">{escape(shown)}</tspan></text></g>'
    )


def _corner(place: tuple[int, int], box: int) -> tuple[int, int]:
    return MARGIN + (box + GAP) * place[0], MARGIN + ROW * place[1]
