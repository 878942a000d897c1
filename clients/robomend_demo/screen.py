"""What people see while the demo runs: a live picture on a terminal, lines anywhere else.

A View is the robot as a client of the service sees it: events in, state out.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from robomend.planning.plan import action_title, action_titles
from robomend_client.events import Event, Kind
from robomend_demo.record import FINAL
from robomend_demo.scenarios import SCENARIOS


@dataclass(frozen=True, slots=True)
class Act:
    """A step of a plan that was begun."""

    text: str
    state: str
    sent_ns: int | None
    ended_ns: int | None
    message: str = ""


@dataclass
class RobotView:
    """Everything that the events so far say of one robot."""

    robot: str
    observed: Collection[str]  # atoms that the observers report
    obs: dict[str, bool] = field(default_factory=dict)
    diagnoses: tuple[tuple[str, ...], ...] | None = None  # the bad sets; None: not diagnosed yet
    repair: Mapping[str, Any] | None = None  # the latest one
    acts: dict[tuple[str, int], Act] = field(default_factory=dict)
    board: str = "connecting"

    def take(self, event: Event) -> None:
        """Take in what an event says."""
        if event.robot != self.robot:
            return
        data = event.data
        match event.kind:
            case Kind.OBSERVATIONS:
                for literal in data["changed"]:
                    self.obs[literal.removeprefix("not ")] = not literal.startswith("not ")
                for atom in data["forgotten"]:
                    self.obs.pop(atom, None)
            case Kind.DIAGNOSIS:
                result = data["result"]
                found = None if result is None else result["diagnoses"]
                self.diagnoses = None if found is None else tuple(tuple(one["bad"]) for one in found)
            case Kind.REPAIR:
                self.repair = data
            case Kind.BOARD if "link" in data:
                self.board = data["link"]
            case Kind.ACTION if "repair" in data:
                self.acts[data["repair"], data["index"]] = Act(
                    data["text"], data["state"], data["sent_ns"], data["ended_ns"], data["message"]
                )

    @property
    def suspects(self) -> frozenset[str] | None:
        """The components that some minimal diagnosis blames; None before the first diagnosis."""
        if self.diagnoses is None:
            return None
        return frozenset(name for bad in self.diagnoses for name in bad)

    @property
    def blamed(self) -> frozenset[str]:
        """The components that every minimal diagnosis blames."""
        return frozenset.intersection(*map(frozenset, self.diagnoses)) if self.diagnoses else frozenset()

    @property
    def healthy(self) -> bool:
        """Every observer says that all is well, and so does the diagnosis."""
        return self.suspects == frozenset() and all(self.obs.get(atom) for atom in self.observed)

    @property
    def unheard(self) -> list[str]:
        """What no observer has said anything about yet."""
        return [atom for atom in self.observed if atom not in self.obs]

    @property
    def repairing(self) -> bool:
        """A repair is open."""
        return self.repair is not None and self.repair["state"] not in FINAL


FRAME_S = 0.1

HOLD = "hold"
WHAT_HAPPENS = {
    **{name: scenario.happens for name, scenario in SCENARIOS.items()},
    HOLD: "the robot runs on, and is looked after",
}

SIGNS = {
    "running": ("▶", "yellow"),
    "done": ("✓", "green"),
    "already-there": ("✓", "green"),
    "failed": ("✗", "red"),
    "waiting": ("·", "dim"),
}


class Screen(Protocol):
    """Where the demo shows itself."""

    def __enter__(self) -> Screen: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def say(self, text: str) -> None:
        """Say something that no event tells."""
        ...

    def scene(self, name: str, zero_ns: int, view: RobotView) -> None:
        """A scenario begins."""
        ...

    def heard(self, event: Event, view: RobotView) -> None:
        """An event came; `view` has taken it in."""
        ...

    def refresh(self, view: RobotView) -> None:
        """Some time has passed."""
        ...

    def account(self, lines: Sequence[str]) -> None:
        """The scene is over; this is what the service wrote down of its repairs."""
        ...

    def rest(self) -> None:
        """Leave what was shown as it is: somebody else prints now, and another scene may follow."""
        ...


class Lines:
    """One line for each thing worth knowing; on standard error, as standard output is for results."""

    def __init__(self) -> None:
        self._zero_ns = time.time_ns()
        self._told = ""

    def __enter__(self) -> Lines:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing to put away."""

    def say(self, text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    def scene(self, name: str, zero_ns: int, view: RobotView) -> None:
        self._zero_ns = zero_ns
        self._told = ""
        self.say(f"{name}: {WHAT_HAPPENS[name]}")

    def heard(self, event: Event, view: RobotView) -> None:
        line = tell(event)
        if line is not None and line != self._told:
            self._told = line
            self.say(f"  {(event.time_ns - self._zero_ns) / 1e9:7.2f} s  {line}")

    def refresh(self, view: RobotView) -> None:
        """Lines stay as they are."""

    def account(self, lines: Sequence[str]) -> None:
        self.say("\n".join(["  the record:", *(f"    {line}" for line in lines)]))

    def rest(self) -> None:
        """Lines stay as they are."""


def tell(event: Event) -> str | None:
    """Return an event as a line, if people care."""
    data = event.data
    match event.kind:
        case Kind.DIAGNOSIS if data["result"] is not None:
            found = [one["bad"] for one in data["result"]["diagnoses"]]
            if found == [[]]:
                return "diagnosis: healthy"
            shown = " or ".join(braces(bad) for bad in found[:2])
            return f"diagnosis: {shown}" + (f" or {len(found) - 2} more" if len(found) > 2 else "")
        case Kind.REPAIR if data["state"] == "planning" and data["plan"]:
            parted = ((step, *_parted(step["text"])) for step in data["plan"])
            steps = [{**step, "name": name, "parameters": given} for step, name, given in parted]
            return "plan: " + ", ".join(action_titles(steps))
        case Kind.REPAIR if data["state"] in FINAL:
            return f"repair {data['state']}: {data['reason']}"
        case Kind.ACTION if "repair" in data and data["state"] in {"done", "already-there", "failed"}:
            why = f": {data['message']}" if data["state"] == "failed" else ""
            return f"{action_title(*_parted(data['text']))}: {data['state']}{why}"
    return None


def _parted(text: str) -> tuple[str, list[str]]:
    """Return the name and the parameters of a step, `start_node(imu_node)`."""
    name, _, rest = text.removesuffix(")").partition("(")
    return name, [one.strip() for one in rest.split(",") if one.strip()]


def braces(names: Sequence[str]) -> str:
    """Return a set of components, shortened if it is long."""
    shown = ", ".join(names[:4])
    return "{" + shown + (f", and {len(names) - 4} more" if len(names) > 4 else "") + "}"


class Picture:
    """A table of components and one of actions, redrawn as things happen."""

    def __init__(self, console: Console, components: Sequence[str]) -> None:
        self._console = console
        self._components = components
        self._live = self._new()
        self._zero_ns = 0
        self._name = ""
        self._drawn = 0.0
        self._ended_ns: int | None = None
        self._changed = True

    def _new(self) -> Live:
        return Live(console=self._console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)

    def __enter__(self) -> Picture:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.rest()

    def rest(self) -> None:
        if self._name:
            self._live.stop()
            self._console.print()
        self._name = ""

    def account(self, lines: Sequence[str]) -> None:
        self.rest()
        self.say("\n".join(["the record:", *(f"  {line}" for line in lines), ""]))

    def say(self, text: str) -> None:
        self._console.print(text, style="dim", highlight=False, markup=False)

    def scene(self, name: str, zero_ns: int, view: RobotView) -> None:
        self.rest()
        self._live = self._new()
        self._name, self._zero_ns, self._ended_ns = name, zero_ns, None
        view.acts.clear()
        self._live.start()
        self._draw(view)

    def heard(self, event: Event, view: RobotView) -> None:
        if event.kind is Kind.REPAIR and event.time_ns >= self._zero_ns:
            self._ended_ns = event.time_ns if event.data["state"] in FINAL else None
        self._changed = True

    def refresh(self, view: RobotView) -> None:
        running = self._ended_ns is None
        if self._name and (self._changed or running) and time.monotonic() - self._drawn >= FRAME_S:
            self._draw(view)

    def _draw(self, view: RobotView) -> None:
        self._drawn, self._changed = time.monotonic(), False
        now_ns = self._ended_ns or time.time_ns()
        self._live.update(picture(self._name, self._components, view, self._zero_ns, now_ns), refresh=True)


def picture(
    name: str, components: Sequence[str], view: RobotView, zero_ns: int, now_ns: int
) -> RenderableType:
    """Return the live picture: what is good and bad, and what is being done about it."""
    head = Text.assemble(
        (f" {name} ", "bold reverse"),
        f"  {(now_ns - zero_ns) / 1e9:6.2f} s   ",
        (_headline(view), "bold"),
        overflow="ellipsis",
        no_wrap=True,
    )
    both = _SideBySide(components, view, zero_ns, now_ns)
    return Group(head, Text(""), both, Text(""))


GAP = 2
NARROW = "███ bad   ▄▄▄ suspect   ─── good"


@dataclass(frozen=True)
class _SideBySide:
    """Components beside actions; in a narrow terminal without words for each state, and when it began."""

    components: Sequence[str]
    view: RobotView
    zero_ns: int
    now_ns: int

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        wide = self._tables(words=True)
        room = options.update(max_width=1000)
        if sum(Measurement.get(console, room, one).maximum for one in wide) + GAP <= options.max_width:
            yield _beside(wide)
            return
        yield _beside(self._tables(words=False))
        yield Text(NARROW, "dim")

    def _tables(self, *, words: bool) -> tuple[Table, Table]:
        return (
            _components(self.components, self.view, words=words),
            _actions(self.view, self.zero_ns, self.now_ns, began=words),
        )


def _beside(tables: tuple[Table, Table]) -> Table:
    both = Table.grid(padding=(0, GAP))
    both.add_row(*tables)
    return both


def _headline(view: RobotView) -> str:
    repair = view.repair
    if repair is not None and view.repairing:
        match repair["state"]:
            case "waiting":
                return f"waiting for observers: {len(repair['waiting_for'])} still to be heard"
            case "planning":
                return "planning"
            case "running":
                return "repairing"
            case "verifying":
                return "looking whether it helped"
        return str(repair["state"])
    if view.suspects is None:
        return "not diagnosed yet"
    if view.suspects:
        return "something is wrong"
    return "all good, and verified" if view.healthy else "nothing known to be wrong"


def _components(components: Sequence[str], view: RobotView, *, words: bool) -> Table:
    table = Table(box=None, padding=(0, 1), pad_edge=False, header_style="dim")
    table.add_column("component")
    table.add_column("")
    suspects = view.suspects
    for name in components:
        if suspects is None:
            table.add_row(name, Text("?", "dim"))
        elif name in view.blamed:
            table.add_row(Text(name, "red"), Text("███ bad" if words else "███", "red"))
        elif name in suspects:
            table.add_row(Text(name, "yellow"), Text("▄▄▄ suspect" if words else "▄▄▄", "yellow"))
        else:
            table.add_row(name, Text("─── good" if words else "───", "green"))
    return table


def _actions(view: RobotView, zero_ns: int, now_ns: int, *, began: bool) -> Table:
    table = Table(box=None, padding=(0, 1), pad_edge=False, header_style="dim")
    table.add_column("")
    table.add_column("action", no_wrap=True)
    if began:
        table.add_column("at", justify="right")
    table.add_column("took", justify="right")
    for act in _planned(view, zero_ns):
        sign, style = SIGNS.get(act.state, ("·", "dim"))
        at = "" if act.sent_ns is None else f"{(act.sent_ns - zero_ns) / 1e9:.2f} s"
        ended = act.ended_ns or now_ns
        took = "" if act.sent_ns is None else f"{(ended - act.sent_ns) / 1e9:.2f} s"
        text = Text(action_title(*_parted(act.text)), style if act.state != "done" else "")
        table.add_row(Text(sign, style), text, *([at] if began else []), took)
    return table


def _planned(view: RobotView, zero_ns: int) -> list[Act]:
    """Return every step of the latest repair, begun or not."""
    repair = view.repair
    if repair is None or repair["created_ns"] < zero_ns:
        return []
    steps = [step for done in repair["rounds"] for step in done["plan"]]
    return [
        view.acts.get((repair["id"], step["index"]), Act(step["text"], "waiting", None, None))
        for step in steps
    ]
