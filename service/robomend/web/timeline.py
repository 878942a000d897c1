"""The timeline of a repair as SVG, in the manner of the paper's figures 5 and 6.

    actions      ▭ power_up(hokuyo)   ▭ start_node(hokuyo_node)      lanes: side by side shows as such
    components   ████████▬▬▬▬▬▬▬▬▬▬▬▬▬▬▬▬                            tall is bad, thin good, a gap unknown;
                                                                     between: blamed by some diagnosis only
                         0 s      1 s      2 s

State is told by height as well as by colour, so that the figure reads in grey and by people who do not tell
red from green. One renderer serves the demo's report, the dashboard and the docs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from math import ceil

from robomend.web.letters import cut

BAD, SUSPECT, GOOD = "#c8553d", "#e3a690", "#2a7f77"
INK, MUTED, GRID, ACTION, FAILED = "#1f2933", "#616e7c", "#e4e7eb", "#3d5a80", "#b23a48"
FONT = "font-family='system-ui, Segoe UI, Roboto, Helvetica, Arial, sans-serif'"

RIGHT = 24  # pixels
ROW, LANE = 20, 22
TOP = 64  # title and subtitle


STATES = {"bad": (13, BAD), "suspect": (8, SUSPECT), "good": (4, GOOD)}
"""What a component may be -> height in pixels and colour."""


@dataclass(frozen=True, slots=True)
class Width:
    """How wide a figure is, in pixels, and how much of that names its rows."""

    name: str  # the class of the SVG element
    all: int
    labels: int
    ticks: int  # at most
    signs: int  # of the legend, side by side


WIDE = Width("wide", 1080, 190, 15, 5)
NARROW = Width("narrow", 360, 118, 4, 3)
"""For a phone, where a wide figure could only be scrolled, without the names of its rows."""


@dataclass(frozen=True, slots=True)
class Span:
    """A component that is good or bad from `start_s` to `end_s`, seconds from the figure's zero.

    `only_suspect`: it is bad in some of the minimal diagnoses and good in others.
    """

    start_s: float
    end_s: float
    bad: bool
    only_suspect: bool = False

    @property
    def state(self) -> str:
        """One of STATES."""
        return ("suspect" if self.only_suspect else "bad") if self.bad else "good"


@dataclass(frozen=True, slots=True)
class ActionBar:
    """One action, from being sent until its effect was seen (or not: `ok` false)."""

    start_s: float
    end_s: float
    label: str
    ok: bool = True


@dataclass(frozen=True, slots=True)
class Mark:
    """A moment worth a dashed line: a fault, a diagnosis."""

    at_s: float
    label: str


@dataclass(frozen=True, slots=True)
class Timeline:
    """Everything the figure shows."""

    title: str
    subtitle: str
    rows: Sequence[tuple[str, Sequence[Span]]]  # component -> spans, top to bottom
    actions: Sequence[ActionBar]
    marks: Sequence[Mark]
    end_s: float
    begins_ns: int | None = None
    """When it begins: then the axis shows the time of day (UTC), else seconds from its beginning."""
    good: str = "good"
    """What is said of a component that is not blamed."""


@dataclass(frozen=True, slots=True)
class Placed:
    """A bar in its lane, and where its label is: inside it, or on one side of it."""

    lane: int
    action: ActionBar
    label: str  # inside, right, left


def lanes(actions: Iterable[ActionBar], per_second: float, end_s: float) -> list[Placed]:
    """Return each action with the topmost lane in which neither its bar nor its label meets another's.

    Args:
        end_s: where the figure ends; a label that would go beyond stands left of its bar.
    """
    taken: list[float] = []  # of each lane: until when
    placed = []
    for action in sorted(actions, key=lambda a: (a.start_s, a.end_s, a.label)):
        wide_s = _wide(action.label) / per_second
        if action.end_s - action.start_s >= wide_s:
            label, begins, ends = "inside", action.start_s, action.end_s
        elif action.end_s + wide_s <= end_s:
            label, begins, ends = "right", action.start_s, action.end_s + wide_s
        else:
            label, begins, ends = "left", action.start_s - wide_s, action.end_s
        lane = next((i for i, until in enumerate(taken) if until <= begins), len(taken))
        taken[lane : lane + 1] = [ends]
        placed.append(Placed(lane, action, label))
    return placed


def _wide(label: str) -> float:
    """Return how many pixels a label takes: inside its bar if that is as long, else beside it."""
    return 6.4 * len(label) + 14


def svg(timeline: Timeline, width: Width = WIDE) -> str:
    """Return the figure as a standalone SVG document; its height follows from what it shows."""
    end_s = max(timeline.end_s, 0.001)
    per_second = (width.all - width.labels - RIGHT) / end_s

    def x(at_s: float) -> float:
        return round(width.labels + min(max(at_s, 0.0), end_s) * per_second, 2)

    placed = lanes(timeline.actions, per_second, end_s + RIGHT / per_second)
    lane_count = max((one.lane for one in placed), default=-1) + 1
    marks_height = 18 * len(timeline.marks)
    actions_top = TOP + marks_height
    if width is NARROW and lane_count:
        actions_top += LANE  # labels left of their bars need the whole width: the heading stands above them
    rows_top = actions_top + LANE * lane_count + (14 if lane_count else 4)
    bottom = rows_top + ROW * len(timeline.rows)
    legend = _legend(timeline)
    height = bottom + 58 + ROW * ((len(legend) - 1) // width.signs)

    out = [
        f"<svg xmlns='http://www.w3.org/2000/svg' class='{width.name}' viewBox='0 0 {width.all} {height}' "
        f"width='{width.all}' height='{height}' role='img' aria-label='{_attribute(timeline.title)}' {FONT}>",
        f"<rect width='{width.all}' height='{height}' fill='#ffffff'/>",
        _text(16, 28, timeline.title, size=17, weight=600),
        _text(16, 48, timeline.subtitle, size=12, fill=MUTED),
    ]
    for at_s, told in _ticks(timeline, end_s, width.ticks):
        at = x(at_s)
        out.append(f"<line x1='{at}' x2='{at}' y1='{actions_top - 4}' y2='{bottom + 4}' stroke='{GRID}'/>")
        out.append(_text(at, bottom + 20, told, size=11, fill=MUTED, anchor="middle"))
    marks = [
        (x(mark.at_s), TOP + 18 * index + 8, mark.label)
        for index, mark in enumerate(sorted(timeline.marks, key=lambda m: m.at_s))
    ]
    for at, y, _ in marks:
        out.append(
            f"<line x1='{at}' x2='{at}' y1='{y}' y2='{bottom + 4}' stroke='{MUTED}' stroke-dasharray='3 3'/>"
        )
    for at, y, told in marks:
        flip = at > width.all * 0.7
        out.append(
            _text(
                at + (-5 if flip else 5),
                y + 3,
                told,
                size=11,
                fill=MUTED,
                anchor="end" if flip else "start",
                over=True,
            )
        )
    if lane_count:
        heading = actions_top + (-7 if width is NARROW else 15)
        out.append(_text(16, heading, "repair actions", size=12, fill=MUTED))
    for one in placed:
        action, y = one.action, actions_top + LANE * one.lane
        left, right = x(action.start_s), x(action.end_s)
        colour = ACTION if action.ok else FAILED
        out.append(
            f"<rect class='action' x='{left}' y='{y + 2}' width='{round(max(right - left, 3), 2)}' "
            f"height='{LANE - 6}' rx='3' fill='{colour}' fill-opacity='0.22'/>"
        )
        out.append(f"<rect x='{left}' y='{y + 2}' width='3' height='{LANE - 6}' fill='{colour}'/>")
        if one.label == "inside":
            out.append(_text(left + 7, y + 14, action.label, size=11))
        elif one.label == "right":
            out.append(_text(max(right, left + 3) + 5, y + 14, action.label, size=11, over=True))
        else:
            label = cut(action.label, left - 10, 11)
            out.append(_text(left - 5, y + 14, label, size=11, anchor="end", over=True, title=action.label))
    for index, (component, spans) in enumerate(timeline.rows):
        middle = rows_top + ROW * index + ROW / 2
        out.append(_text(16, middle + 4, _cut(component, width), size=12, title=component))
        for span in spans:
            left, right = x(span.start_s), x(span.end_s)
            thick, colour = STATES[span.state]
            out.append(
                f"<rect class='{span.state}' x='{left}' y='{middle - thick / 2}' "
                f"width='{round(right - left, 2)}' height='{thick}' fill='{colour}'>"
                f"<title>{escape(component)}: {timeline.good if span.state == 'good' else span.state}, "
                f"{span.start_s:.2f} s to {span.end_s:.2f} s</title></rect>"
            )
    for index, (words, thick, colour, faint) in enumerate(legend):
        left = (width.labels if width is WIDE else 16) + 114 * (index % width.signs)
        y = bottom + 44 + ROW * (index // width.signs)
        light = " fill-opacity='0.22'" if faint else ""
        top, box = y - thick / 2, f"height='{thick}' fill='{colour}'"
        out.append(f"<rect x='{left}' y='{top}' width='28' {box}{light}/>")
        if faint:
            out.append(f"<rect x='{left}' y='{top}' width='3' {box}/>")
        out.append(_text(left + 36, y + 4, words, size=11, fill=MUTED))
    out.append("</svg>\n")
    return "\n".join(out)


def _legend(timeline: Timeline) -> list[tuple[str, int, str, bool]]:
    """Return what the bars of a figure mean: words, height, colour, and whether it is a bar of an action."""
    shown = {span.state for _, spans in timeline.rows for span in spans} | {"bad", "good"}
    states = [
        (timeline.good if state == "good" else state, *sign, False)
        for state, sign in STATES.items()
        if state in shown
    ]
    done = [action.ok for action in timeline.actions]
    actions = [("action", ACTION)] * any(done) + [("failed action", FAILED)] * (not all(done))
    return states + [(words, LANE - 6, colour, True) for words, colour in actions]


def _ticks(timeline: Timeline, end_s: float, most: int) -> list[tuple[float, str]]:
    """Return where grid lines are, seconds from the beginning, and what is written at them."""
    step = _grid_step(end_s, most)
    if timeline.begins_ns is None:
        return [(tick * step, f"{tick * step:g} s") for tick in range(int(end_s / step + 1e-9) + 1)]
    begins_s = timeline.begins_ns / 1e9
    first = step * ceil(begins_s / step)  # at round times of the day
    count = int((begins_s + end_s - first) / step + 1e-9) + 1
    form = "%H:%M" if step % 60 == 0 else "%H:%M:%S"
    at = [first + tick * step for tick in range(count)]
    return [(one - begins_s, datetime.fromtimestamp(one, UTC).strftime(form)) for one in at]


def _grid_step(end_s: float, most: int) -> float:
    """Return a round distance between grid lines that gives at most so many of them."""
    for step in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600):
        if end_s / step <= most:
            return step
    return float(ceil(end_s / most / 86400) * 86400)


def _cut(name: str, width: Width) -> str:
    """Return as much of a name as stands before the bars."""
    return cut(name, width.labels - 24, 12)


def _text(
    x: float,
    y: float,
    text: str,
    *,
    size: int,
    fill: str = INK,
    weight: int = 400,
    anchor: str = "start",
    title: str = "",
    over: bool = False,
) -> str:
    """Return a text; `over`: with a rim, so that it is read where it stands on lines."""
    rim = " class='over' paint-order='stroke' stroke='#ffffff' stroke-width='3'" if over else ""
    whole = f"<title>{escape(title)}</title>" if title not in ("", text) else ""
    return (
        f"<text x='{x}' y='{y}' font-size='{size}' fill='{fill}' font-weight='{weight}' "
        f"text-anchor='{anchor}'{rim}>{whole}{escape(text)}</text>"
    )


def _attribute(text: str) -> str:
    return escape(text).replace("'", "&#39;")
