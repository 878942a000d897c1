"""Small plots of what was measured: around a moment, which is a dashed line, and of the last minutes.

        2.31 ┤   ╭──╮ ┊
             │───╯  ╰─┊──────
        0.00 ┤        ┊
            -30 s     0     10 s

Gaps in which nothing came are gaps of the line, and in a rate they are its zeros. A plot is text, so that it
can be searched and read aloud. A sparkline is the same in the room of two words, without figures beside it:
what did not hold is drawn in the colour of what is bad.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import pairwise
from math import isfinite

from robomend.web.words import duration

WIDE, HIGH = 360, 84
LEFT, TOP, BOTTOM = 64, 8, 20
"""Room for the figures beside and below the line, pixels."""

GAP_S = 1.0
"""Values that are further apart are not joined."""

SPARK_WIDE, SPARK_HIGH = 96, 22
"""Of a sparkline, pixels."""


def svg(source: str, kind: str, at_s: Sequence[float], values: Sequence[float]) -> str:
    """Return the plot as an SVG element; nothing where there are no values.

    Args:
        source: what an observer calls it.
        kind: `rate` or `value`.
        at_s: seconds from the moment on, parallel to the values.
    """
    points = [(s, value) for s, value in zip(at_s, values, strict=False) if isfinite(s) and isfinite(value)]
    if not points:
        return ""
    points.sort()
    begin_s, end_s = min(points[0][0], 0.0), max(points[-1][0], 0.0)
    low, high = min(value for _, value in points), max(value for _, value in points)
    if kind == "rate":
        low = min(low, 0.0)
    unit = " Hz" if kind == "rate" else ""
    across, up = WIDE - LEFT - 8, HIGH - TOP - BOTTOM

    def x(s: float) -> float:
        return LEFT + across * (s - begin_s) / ((end_s - begin_s) or 1.0)

    def y(value: float) -> float:
        return TOP + up * (high - value) / ((high - low) or 1.0)

    path = [f"M{x(points[0][0]):.1f} {y(points[0][1]):.1f}h.1"]
    for before, (s, value) in pairwise(points):
        joined = kind == "rate" or s - before[0] <= GAP_S
        path.append(f"{'L' if joined else 'M'}{x(s):.1f} {y(value):.1f}" + ("" if joined else "h.1"))
    said = (
        f"{source}: {low:.6g} to {high:.6g}{unit}, from {begin_s:.1f} s to {end_s:.1f} s after it turned bad"
    )
    zero = x(0.0)
    return (
        f'<svg class="moment-plot" viewBox="0 0 {WIDE} {HIGH}" role="img" aria-label="{escape(said)}">'
        f"<title>{escape(said)}</title>"
        f'<path class="moment" d="M{zero:.1f} {TOP - 4}V{HIGH - BOTTOM + 4}"/>'
        f'<path class="line" d="{"".join(path)}"/>'
        f'<text x="{LEFT - 6}" y="{TOP + 8}" text-anchor="end">{high:.3g}{unit}</text>'
        f'<text x="{LEFT - 6}" y="{HIGH - BOTTOM}" text-anchor="end">{low:.3g}{unit}</text>'
        f'<text x="{LEFT}" y="{HIGH - 5}">{begin_s:.0f} s</text>'
        f'<text x="{WIDE - 8}" y="{HIGH - 5}" text-anchor="end">{end_s:.0f} s</text>'
        "</svg>"
    )


def sparkline(what: str, points: Sequence[tuple[float, float, bool]], unit: str) -> str:
    """Return what was measured as a small SVG element; nothing where one point is no course.

    Args:
        what: the atom that the observer judges by it.
        points: when each was reported (nanoseconds), its value, and whether it held; the oldest first.
    """
    if len(points) < 2 or points[0][0] >= points[-1][0]:
        return ""
    (first_ns, _, _), (last_ns, newest, _) = points[0], points[-1]
    low, high = min(value for _, value, _ in points), max(value for _, value, _ in points)

    def place(time_ns: float, value: float) -> str:
        x = 2 + (SPARK_WIDE - 4) * (time_ns - first_ns) / (last_ns - first_ns)
        up = (value - low) / (high - low) if high > low else 0.5
        return f"{x:.1f} {SPARK_HIGH - 3 - (SPARK_HIGH - 6) * up:.1f}"

    lines = {True: "", False: ""}
    for (from_ns, value, _), (to_ns, after, good) in pairwise(points):
        lines[good] += f"M{place(from_ns, value)}L{place(to_ns, after)}"
    named = f" {unit}" if unit else ""
    said = (
        f"{what}: {low:.4g} to {high:.4g}{named} in the last {duration((last_ns - first_ns) / 1e9)}, "
        f"now {newest:.4g}"
    )
    drawn = "".join(
        f'<path class="{"line" if good else "amiss"}" d="{path}"/>' for good, path in lines.items() if path
    )
    return (
        f'<svg class="spark" viewBox="0 0 {SPARK_WIDE} {SPARK_HIGH}" width="{SPARK_WIDE}" '
        f'height="{SPARK_HIGH}" role="img" aria-label="{escape(said)}"><title>{escape(said)}</title>'
        f"{drawn}</svg>"
    )
