"""The component graph as SVG: what feeds, drives and publishes what, from left to right.

    hardware ──► node ──► topic ──► node ──► topic        one column further than the furthest it rests on

Edges that close a circle count for nothing when columns are found. Within a column, things stand near what
they rest on (the barycentre heuristic, a few sweeps): K. Sugiyama, S. Tagawa, M. Toda. Methods for visual
understanding of hierarchical system structures. IEEE SMC 11(2), 1981.

Shape says what it is, colour and a sign how it is; a suspect's colour is as strong as the suspicion. It is
text and links, so that it can be searched, read aloud and followed with the keyboard.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from html import escape
from itertools import pairwise
from math import ceil

from robomend.model.components import ComponentModel
from robomend.model.functions import needs_of
from robomend.web.letters import cut, width
from robomend.web.suspicion import Suspicion

GAP, ROW = 48, 40  # between two columns, and from one row to the next, pixels
BOX, HEIGHT = (120, 280), 28
"""A box is as wide as the longest name wants it, between these; of a longer name the rest is in its title."""

MARGIN = 12
PADDING = 10
LETTERS = 13  # pixels, as in page.css

SWEEPS = 6

SIGNS = {"bad": "✕ ", "suspect": "! ", "good": "", "unknown": "? ", "silent": "✕ "}

SIGN = max(width(sign, LETTERS) for sign in SIGNS.values())
"""Whatever a thing's state: a box is as wide as before when that changes."""

ODD = frozenset({"bad", "suspect", "silent"})
"""What leads on from these is drawn broken."""


@dataclass(frozen=True, slots=True)
class Thing:
    """A box of the graph; hardware and nodes are components, topics and functions are not."""

    kind: str  # hardware, node, topic, function
    name: str


@dataclass(frozen=True, slots=True)
class Layout:
    """Where things stand, and what leads from which to which."""

    places: Mapping[Thing, tuple[int, int]]  # column, row
    edges: Sequence[tuple[Thing, Thing]]
    box: int = BOX[0]  # how wide each is, pixels

    def corner(self, thing: Thing) -> tuple[int, int]:
        """Return where the box of a thing begins, pixels."""
        column, row = self.places[thing]
        return MARGIN + (self.box + GAP) * column, MARGIN + ROW * row


_kept: dict[int, tuple[ComponentModel, Layout]] = {}
"""The newest layouts: of a model that does not change, everything stands where it stood."""

KEPT = 64


def layout(model: ComponentModel) -> Layout:
    """Return where each thing of a model stands."""
    known, laid_out = _kept.get(id(model), (None, None))
    if known is not model or laid_out is None:
        laid_out = _laid_out(model)
        _kept[id(model)] = (model, laid_out)
        while len(_kept) > KEPT:
            del _kept[next(iter(_kept))]
    return laid_out


def _laid_out(model: ComponentModel) -> Layout:
    edges = _edges(model)
    things = list(
        dict.fromkeys(
            [
                *(Thing("hardware", name) for name in model.hardware),
                *(Thing("node", name) for name in model.nodes),
                *(thing for edge in edges for thing in edge),
                *(Thing("topic", name) for name in model.topics),
                *(Thing("function", name) for name in model.functions),
            ]
        )
    )
    before: dict[Thing, set[Thing]] = {thing: set() for thing in things}
    for source, target in edges:
        before[target].add(source)
    column: dict[Thing, int] = {}
    for thing in _in_order(before):
        column[thing] = 1 + max((column[one] for one in before[thing] if one in column), default=-1)
        if thing.kind == "node":
            column[thing] = max(column[thing], 1)
        elif thing.kind == "topic":
            column[thing] = max(column[thing], 2)
        elif thing.kind == "function":
            column[thing] = max(column[thing], 3)
    names = [thing.name for thing in things]
    names += [f"{one.name}: {variant}" for one in model.functions.values() for variant in one.variants]
    widest = max((width(name, LETTERS) for name in names), default=0.0)
    box = min(max(BOX[0], ceil(widest + SIGN + 2 * PADDING)), BOX[1])
    return Layout(_rows(things, column, edges), edges, box)


def _edges(model: ComponentModel) -> list[tuple[Thing, Thing]]:
    edges: dict[tuple[Thing, Thing], None] = {}
    for hardware in model.hardware.values():
        for feeder in hardware.fed_by:
            edges[Thing("hardware", feeder), Thing("hardware", hardware.name)] = None
    for node in model.nodes.values():
        for device in node.drives:
            edges[Thing("hardware", device), Thing("node", node.name)] = None
        for topic, inputs in node.publishes.items():
            for needed in inputs:
                edges[Thing("topic", needed), Thing("node", node.name)] = None
            edges[Thing("node", node.name), Thing("topic", topic)] = None
    for function in model.functions.values():
        for variant in function.variants.values():
            for need in needs_of(variant, model):
                if need.component is not None:
                    kind = "hardware" if need.component in model.hardware else "node"
                    edges[Thing(kind, need.component), Thing("function", function.name)] = None
                elif need.function is not None:
                    edges[Thing("function", need.function), Thing("function", function.name)] = None
    return list(edges)


def _in_order(before: Mapping[Thing, set[Thing]]) -> list[Thing]:
    """Return the things, each after what it rests on; an edge of each circle is taken out of `before`."""
    while True:
        try:
            return list(TopologicalSorter(before).static_order())
        except CycleError as error:
            circle = error.args[1]  # each before the next
            source, target = next(
                (pair for pair in pairwise(circle) if pair[0].kind == "topic"),
                (circle[0], circle[1]),
            )
            before[target].discard(source)


def _rows(
    things: Sequence[Thing], column: Mapping[Thing, int], edges: Sequence[tuple[Thing, Thing]]
) -> dict[Thing, tuple[int, int]]:
    columns: list[list[Thing]] = [[] for _ in range(max(column.values(), default=-1) + 1)]
    for thing in things:
        columns[column[thing]].append(thing)
    beside: dict[Thing, list[Thing]] = {thing: [] for thing in things}
    for source, target in edges:
        beside[source].append(target)
        beside[target].append(source)
    row = {thing: index for each in columns for index, thing in enumerate(each)}
    for sweep in range(SWEEPS):
        for index in range(len(columns)) if sweep % 2 == 0 else reversed(range(len(columns))):
            side = -1 if sweep % 2 == 0 else 1

            def middle(thing: Thing, side: int = side) -> float:
                near = [row[one] for one in beside[thing] if (column[one] - column[thing]) * side > 0] or [
                    row[one] for one in beside[thing]
                ]
                return sum(near) / len(near) if near else row[thing]

            columns[index].sort(key=middle)
            row.update({thing: place for place, thing in enumerate(columns[index])})
    return {thing: (column[thing], row[thing]) for thing in things}


def svg(
    drawn: Layout,
    found: Mapping[str, Suspicion],
    topics: Mapping[str, bool],
    links: Mapping[str, str],
    active: Mapping[str, str] = {},
) -> str:
    """Return the graph as an SVG element.

    Args:
        found: what the diagnosis makes of each component.
        topics: whether a topic was seen to be ok; one that is not in it is unknown.
        links: a component -> where its explanation is.
        active: a function -> the variant by which it works; one that is not in it is unknown.
    """
    number = {thing: index for index, thing in enumerate(drawn.places)}
    on_path = path(drawn, found, topics)
    last = max((x for x, _ in drawn.places.values()), default=0)
    wide = 2 * MARGIN + drawn.box + (drawn.box + GAP) * last
    height = 2 * MARGIN + HEIGHT + ROW * max((y for _, y in drawn.places.values()), default=0)
    out = [
        f'<svg class="graph" viewBox="0 0 {wide} {height}" width="{wide}" height="{height}" role="group" '
        f'aria-label="Component graph">'
    ]
    for source, target in drawn.edges:
        (left, above), (right, below) = drawn.corner(source), drawn.corner(target)
        left, y1, y2 = left + drawn.box, above + HEIGHT / 2, below + HEIGHT / 2
        bend = max(24.0, abs(right - left) / 2)
        odd = " odd" if _state(source, found, topics, active) in ODD else ""
        odd += " path" if source in on_path and target in on_path else ""
        wide, down = right - left, y2 - y1  # relative, as like edges then read alike: a page is sent packed
        curve = f"M{left} {y1:g}c{bend:g} 0 {wide - bend:g} {down:g} {wide} {down:g}"
        ends = f'data-from="{number[source]}" data-to="{number[target]}"'
        out.append(f'<path class="edge{odd}" {ends} d="{curve}"/>')
    for thing, index in number.items():
        out.append(_box(thing, index, drawn, found, topics, links, active))
    out.append("</svg>")
    return "\n".join(out)


def path(drawn: Layout, found: Mapping[str, Suspicion], topics: Mapping[str, bool]) -> frozenset[Thing]:
    """Return what stands on a way from a suspect to a topic that is not as it should be, both included."""
    after: dict[Thing, list[Thing]] = {thing: [] for thing in drawn.places}
    before: dict[Thing, list[Thing]] = {thing: [] for thing in drawn.places}
    for source, target in drawn.edges:
        after[source].append(target)
        before[target].append(source)
    state = {thing: _state(thing, found, topics, {}) for thing in drawn.places}
    suspects = [thing for thing in drawn.places if state[thing] in {"bad", "suspect"}]
    symptoms = [thing for thing in drawn.places if state[thing] == "silent"]
    return frozenset(_reached(suspects, after) & _reached(symptoms, before))


def _reached(begin: Sequence[Thing], leads: Mapping[Thing, Sequence[Thing]]) -> set[Thing]:
    """Return where one comes to, the beginnings included."""
    found, waiting = set(begin), list(begin)
    while waiting:
        for one in leads[waiting.pop()]:
            if one not in found:
                found.add(one)
                waiting.append(one)
    return found


def _box(
    thing: Thing,
    index: int,
    drawn: Layout,
    found: Mapping[str, Suspicion],
    topics: Mapping[str, bool],
    links: Mapping[str, str],
    active: Mapping[str, str],
) -> str:
    (x, y), box = drawn.corner(thing), drawn.box
    state = _state(thing, found, topics, active)
    share = found[thing.name].share if state == "suspect" else 1.0
    told = f"{thing.kind} {thing.name}: {state}" + (f", {share:.0%} of the suspicion" if share < 1 else "")
    name = thing.name
    if thing.kind == "function" and name in active:
        name = f"{name}: {active[name]}"
        told += f", by {active[thing.name]}"
    text = cut(name, box - 2 * PADDING - SIGN, LETTERS)
    radius = {"hardware": 2, "node": 8, "topic": HEIGHT / 2, "function": 2}[thing.kind]
    fill = f' fill-opacity="{0.15 + 0.85 * share:.2f}"' if state == "suspect" else ""
    drawing = (
        f'<g class="thing {thing.kind} {state}" data-n="{index}" transform="translate({x} {y})">'
        f'<title>{escape(told)}</title><rect width="{box}" height="{HEIGHT}" rx="{radius:g}"{fill}/>'
        f'<text x="{box / 2:g}" y="{HEIGHT / 2 + 4.5:g}" text-anchor="middle">'
        f'{SIGNS[state]}<tspan unicode-bidi="isolate">{escape(text)}</tspan></text></g>'
    )
    link = links.get(thing.name) if thing.kind in {"hardware", "node"} else None
    return drawing if link is None else f'<a href="{escape(link)}" aria-label="{escape(told)}">{drawing}</a>'


def _state(
    thing: Thing, found: Mapping[str, Suspicion], topics: Mapping[str, bool], active: Mapping[str, str]
) -> str:
    if thing.kind == "function":
        return "good" if thing.name in active else "unknown"
    if thing.kind == "topic":
        seen = topics.get(thing.name)
        return "unknown" if seen is None else "good" if seen else "silent"
    return found.get(thing.name, Suspicion("unknown")).state
