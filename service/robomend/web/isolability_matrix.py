"""The isolability matrix as SVG: row i, column j says whether fault i can be told from fault j.

              a  b  c
    a         ▪  ·  ·        always: nothing in the way
    b         █  ▪  ◦        never: a full square; sometimes: a ring
    c         ·  ·  ▪

What is told by colour is told by shape as well, so that the figure reads in grey.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from robomend.web.letters import cut, width

NEVER, SOMETIMES, UNKNOWN, SELF = "#c8553d", "#e3a690", "#9aa5b1", "#d9dee3"
INK, MUTED, GRID = "#1f2933", "#616e7c", "#eef1f4"
FONT = "font-family='system-ui, Segoe UI, Roboto, Helvetica, Arial, sans-serif'"

CELL, LETTERS = 20, 13  # pixels
TOP, MARGIN = 64, 16
TOLD = {"-": "never told apart", "~": "told apart by some symptoms of the first only", "?": "not known"}
"""What is marked, in the titles of the marks."""
LEGEND = 300  # pixels: the words below and above the figure, which a phone shows whole
MOST_ROWS = 200
"""Faults in one figure; what is left out is said in it."""
MOST_NAME = 260
"""Pixels; of a longer name the rest is in its title."""


def isolability_matrix(
    title: str, faults: Sequence[Sequence[str]], matrix: Sequence[str], detectable: Sequence[bool | None]
) -> str:
    """Return the figure."""
    count = min(len(faults), MOST_ROWS)
    names = [" + ".join(fault) for fault in faults[:count]]
    wide = min(max((width(name, LETTERS) for name in names), default=0.0), MOST_NAME) + 12
    left, top = MARGIN + wide, TOP + wide
    all_wide = max(left + count * CELL, MARGIN + LEGEND, MARGIN + len(title) * 8) + MARGIN
    height = top + count * CELL + 152
    out = [
        f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {all_wide:.0f} {height:.0f}' "
        f"width='{all_wide:.0f}' height='{height:.0f}' role='img' {FONT} font-size='13' fill='{INK}'>",
        f"<title>{escape(title)}</title>",
        f"<rect width='{all_wide:.0f}' height='{height:.0f}' fill='white'/>",
        f"<text x='{MARGIN}' y='24' font-size='16' font-weight='600'>{escape(title)}</text>",
        f"<text x='{MARGIN}' y='42' fill='{MUTED}'>Is the row's fault told from the column's?"
        f"{f' The first {count} of {len(faults)}.' if count < len(faults) else ''}</text>",
    ]
    for index, name in enumerate(names):
        x, y = left + index * CELL, top + index * CELL
        faint = f" fill='{MUTED}' font-style='italic'" if detectable[index] is False else ""
        lines = f"M{left:.1f} {y:.1f}h{count * CELL}M{x:.1f} {top:.1f}v{count * CELL}"
        turned = f"translate({x + 14:.1f} {top - 6:.1f}) rotate(-90)"
        shown = cut(name, MOST_NAME, LETTERS)
        whole = f"<title>{escape(name)}</title>" if shown != name else ""
        told = f"{faint}>{whole}{escape(shown)}</text>"
        out += [
            f"<text x='{left - 6:.1f}' y='{y + 14:.1f}' text-anchor='end'{told}",
            f"<text transform='{turned}'{told}",
            f"<path d='{lines}' stroke='{GRID}'/>",
        ]
    end = f"M{left:.1f} {top + count * CELL:.1f}h{count * CELL}v{-count * CELL}"
    out.append(f"<path d='{end}' fill='none' stroke='{GRID}'/>")
    for index in range(count):
        for other in range(count):
            found = matrix[index][other]
            mark = _cell(found, left + other * CELL, top + index * CELL)
            said = escape(f"{names[index]}, {names[other]}: {TOLD.get(found)}")
            out.append(f"<g>{mark}<title>{said}</title></g>" if found in TOLD else mark)
    for place, (kind, words) in enumerate(
        (("-", "never"), ("~", "by some symptoms only"), ("+", "always"), ("?", "not known"))
    ):
        x, y = MARGIN, top + count * CELL + 22 + place * 26
        frame = f"<path d='M{x:.1f} {y:.1f}h{CELL}v{CELL}h{-CELL}z' fill='none' stroke='{GRID}'/>"
        out += [frame, _cell(kind, x, y), f"<text x='{x + CELL + 6:.1f}' y='{y + 14:.1f}'>{words}</text>"]
    out.append(
        f"<text x='{MARGIN}' y='{y + 40:.1f}' fill='{MUTED}'>in italics: cannot be detected at all</text>"
    )
    return "".join(filter(None, [*out, "</svg>"])) + "\n"


def _cell(place: str, x: float, y: float) -> str:
    half = CELL / 2
    if place == "-":
        wide = CELL - 2
        return f"<rect x='{x + 1:.1f}' y='{y + 1:.1f}' width='{wide}' height='{wide}' fill='{NEVER}'/>"
    if place == "~":
        return (
            f"<circle cx='{x + half:.1f}' cy='{y + half:.1f}' r='5.5' fill='none' stroke='{SOMETIMES}' "
            "stroke-width='2.5'/>"
        )
    if place == "?":
        return f"<text x='{x + 6:.1f}' y='{y + 15:.1f}' fill='{UNKNOWN}'>?</text>"
    if place == "=":
        return f"<rect x='{x + half - 3:.1f}' y='{y + half - 3:.1f}' width='6' height='6' fill='{SELF}'/>"
    return ""
