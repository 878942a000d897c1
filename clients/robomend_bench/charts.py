"""Cactus and scaling plots as SVG, written by hand: no plotting library, crisp in a browser and on paper.

cactus     how many questions (x) a contender solves within a time each (y, logarithmic): lower and
           longer is better
scaling    median time (y) over number of components (x), both logarithmic: the slope is the exponent
           of growth
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

from robomend_bench.results import Run, summarise
from robomend_bench.tables import seconds
from robomend_client.counts import counted

WIDTH, HEIGHT = 780, 470
LEFT, RIGHT, TOP, BOTTOM = 72, 158, 74, 58
FONT = "system-ui, Helvetica, Arial, sans-serif"
INK, FAINT, GRID = "#1f2933", "#66727f", "#e3e8ee"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#6b7280")
"""Okabe and Ito's, told apart by colour-blind eyes too."""

LABEL_GAP = 17.0
LOWEST_S = 1e-7
"""A time of 0 has no place on a logarithmic axis."""

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Curve:
    """One contender's points, in order of x."""

    name: str
    points: tuple[Point, ...]


def cactus(run: Run) -> str:
    """Return the cactus plot of a run."""
    curves = []
    for contender in run.contenders:
        times = sorted(max(LOWEST_S, time) for time in run.best(contender).values())
        curves.append(Curve(contender, tuple((index, time) for index, time in enumerate(times, 1))))
    asked = len({(sample.group, sample.question) for sample in run.samples})
    most = max(asked, 1)
    ticks = [(float(value), str(value)) for value in _round_steps(most)]
    of = f"{counted(asked, 'question')} in {counted(len(run.groups), 'group')}"
    return _chart(
        title=f"{run.suite}, {run.mode}: questions solved within a time",
        subtitle=f"{of}; fastest of the repeats of each",
        x_title="questions solved",
        curves=curves,
        x_ticks=ticks,
        x_of=lambda value: value / most,
        dots=most <= 60,
    )


def scaling(run: Run) -> str:
    """Return the scaling plot of a run whose groups differ in size."""
    curves = []
    for contender in run.contenders:
        points = sorted(
            (float(line.size), max(LOWEST_S, line.median_s))
            for line in summarise(run)
            if line.contender == contender and line.median_s is not None
        )
        curves.append(Curve(contender, tuple(points)))
    sizes = sorted({sample.size for sample in run.samples}) or [1]
    low, high = math.log10(max(1, sizes[0]) * 0.85), math.log10(max(2, sizes[-1]) * 1.15)
    ticks, nearest = [], -1.0
    for size in sizes:
        place = (math.log10(max(1, size)) - low) / (high - low)
        if place - nearest > 0.055:  # circuits crowd; a label needs its room
            ticks.append((float(size), f"{size:,}"))
            nearest = place
    return _chart(
        title=f"{run.suite}, {run.mode}: growth with the number of components",
        subtitle="median over the questions of a group; both axes logarithmic",
        x_title="components",
        curves=curves,
        x_ticks=ticks,
        x_of=lambda value: (math.log10(max(1.0, value)) - low) / (high - low),
        dots=True,
    )


def _round_steps(most: int) -> list[int]:
    """Return about six round numbers from 0 to `most`."""
    rough = most / 6
    power = 10 ** math.floor(math.log10(rough)) if rough >= 1 else 1
    step = next(int(power * factor) for factor in (1, 2, 5, 10) if power * factor >= rough)
    return list(range(0, most + 1, max(1, step)))


def _chart(
    title: str,
    subtitle: str,
    x_title: str,
    curves: Sequence[Curve],
    x_ticks: Sequence[tuple[float, str]],
    x_of: Callable[[float], float],
    dots: bool,
) -> str:
    values = [y for curve in curves for _, y in curve.points] or [1e-3, 1.0]
    low, high = math.log10(min(values)) - 0.12, math.log10(max(values)) + 0.12
    if high - low < 1:  # at least a decade, or noise looks like news
        middle = (low + high) / 2
        low, high = middle - 0.5, middle + 0.5
    inner_width, inner_height = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def x(value: float) -> float:
        return LEFT + inner_width * x_of(value)

    def y(value: float) -> float:
        return TOP + inner_height * (high - math.log10(value)) / (high - low)

    box = f'viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {box} font-family="{FONT}" '
        f'role="img" aria-label="{_safe(title)}">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
        _text(LEFT, 30, title, size=17, weight=600),
        _text(LEFT, 51, subtitle, size=12.5, colour=FAINT),
    ]
    parts += _y_axis(low, high, y)
    for value, label in x_ticks:
        place = x(value)
        parts.append(_line(place, HEIGHT - BOTTOM, place, HEIGHT - BOTTOM + 5, FAINT))
        parts.append(_text(place, HEIGHT - BOTTOM + 20, label, anchor="middle", colour=FAINT))
    parts.append(_line(LEFT, HEIGHT - BOTTOM, WIDTH - RIGHT, HEIGHT - BOTTOM, INK))
    parts.append(_text(LEFT + inner_width / 2, HEIGHT - 16, x_title, anchor="middle", colour=INK, size=13))
    ends: list[tuple[float, float, str, str]] = []
    for index, curve in enumerate(curves):
        colour = COLOURS[index % len(COLOURS)]
        places = [(x(px), y(py)) for px, py in curve.points]
        if not places:
            ends.append((WIDTH - RIGHT, TOP + LABEL_GAP * index, f"{curve.name} (none solved)", colour))
            continue
        path = " ".join(f"{'L' if at else 'M'}{px:.1f},{py:.1f}" for at, (px, py) in enumerate(places))
        parts.append(
            f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="2.25" '
            'stroke-linejoin="round" stroke-linecap="round"/>'
        )
        if dots:
            parts += [
                f'<circle cx="{px:.1f}" cy="{py:.1f}" r="3.2" fill="{colour}" stroke="#ffffff">'
                f"<title>{_safe(curve.name)}: {_safe(seconds(value))}</title></circle>"
                for (px, py), (_, value) in zip(places, curve.points, strict=True)
            ]
        ends.append((*places[-1], curve.name, colour))
    parts += _labels(ends)
    parts.append("</svg>")
    return "\n".join(parts) + "\n"


def _y_axis(low: float, high: float, y: Callable[[float], float]) -> list[str]:
    """Return grid lines and labels at the decades, and at 2 and 5 where there are few decades."""
    factors = (1, 2, 5) if high - low < 2.5 else (1,)
    parts = []
    for exponent in range(math.floor(low), math.ceil(high) + 1):
        for factor in factors:
            value = factor * 10.0**exponent
            if low <= math.log10(value) <= high:
                place = y(value)
                parts.append(_line(LEFT, place, WIDTH - RIGHT, place, GRID))
                parts.append(_text(LEFT - 9, place + 4, _tick(value), anchor="end", colour=FAINT))
    return parts


def _tick(value: float) -> str:
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if value * factor >= 0.999 or unit == "µs":
            return f"{value * factor:g} {unit}"
    raise AssertionError("unreachable")


def _labels(ends: Sequence[tuple[float, float, str, str]]) -> list[str]:
    """Return the curves' names at their ends, moved apart where they would overlap."""
    parts = []
    lowest = -math.inf
    for px, py, name, colour in sorted(ends, key=lambda end: end[1]):
        place = max(py, lowest + LABEL_GAP)
        lowest = place
        at = WIDTH - RIGHT + 12
        if px < at - 14 or abs(place - py) > 3:
            parts.append(_line(px + 5, py, at - 3, place, colour, width=0.75))
        parts.append(_text(at, place + 4, name, size=13, weight=600, colour=colour))
    return parts


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, width: float = 1.0) -> str:
    ends = f'x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
    return f'<line {ends} stroke="{colour}" stroke-width="{width}"/>'


def _text(
    x: float,
    y: float,
    text: str,
    *,
    size: float = 12,
    weight: int = 400,
    anchor: str = "start",
    colour: str = INK,
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" font-weight="{weight}" text-anchor="{anchor}" '
        f'fill="{colour}">{_safe(text)}</text>'
    )


def _safe(text: str) -> str:
    return escape(text, {'"': "&quot;"})
