"""The timeline of a robot's past: whom its diagnoses blamed, and what its repairs did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robomend.planning.plan import action_title
from robomend.repairs.states import StepState
from robomend.store.records import StoredDiagnosis
from robomend.web.timeline import ActionBar, Span, Timeline
from robomend_client.counts import counted

NS = 1_000_000_000
ROWS = 30
"""Components that are drawn."""
ACTIONS = 60
NOT_BLAMED = "not blamed"


def timeline(
    robot: str,
    start_ns: int,
    end_ns: int,
    diagnoses: Sequence[StoredDiagnosis],
    repairs: Sequence[Mapping[str, Any]],
    *,
    unknown: bool = False,
) -> Timeline:
    """Return what happened from `start_ns` to `end_ns`.

    A component that no diagnosis blamed is not said to be good: what it was seen by may have been silent.

    Args:
        diagnoses: oldest first, beginning with the one that held at the start.
        repairs: with the steps of every round.
        unknown: nothing of the robot is known at the end; the last diagnosis then says nothing.
    """

    def at(time_ns: int) -> float:
        return (min(max(time_ns, start_ns), end_ns) - start_ns) / NS

    spans: dict[str, list[Span]] = {}
    blamed: set[str] = set()
    for index, one in enumerate(diagnoses):
        until_ns = diagnoses[index + 1].time_ns if index + 1 < len(diagnoses) else end_ns
        found = (one.result.get("result") or {}).get("diagnoses") or []
        says_nothing = not one.revision or (unknown and index + 1 == len(diagnoses))  # nobody had observed it
        if not found or until_ns <= start_ns or says_nothing:
            continue
        named = set().union(*(each["bad"] for each in found))
        in_all = set(found[0]["bad"]).intersection(*(each["bad"] for each in found))
        blamed |= named
        for component in (*found[0]["bad"], *found[0]["good"]):
            bad = component in named
            span = Span(at(one.time_ns), at(until_ns), bad, bad and component not in in_all)
            spans.setdefault(component, []).append(span)
    rows = [(name, _joined(spans[name])) for name in spans if name in blamed][:ROWS]
    actions = [bar for repair in repairs for bar in _bars(repair, start_ns, end_ns)][:ACTIONS]
    left_out = len(blamed) - len(rows)
    subtitle = "what its diagnoses said of each component" + (
        f"; {counted(left_out, 'more component was', 'more components were')} blamed" if left_out > 0 else ""
    )
    return Timeline(robot, subtitle, rows, actions, (), (end_ns - start_ns) / NS, start_ns, NOT_BLAMED)


def _joined(spans: Sequence[Span]) -> list[Span]:
    """Return spans with neighbours of one state as one."""
    joined: list[Span] = []
    for span in spans:
        if joined and joined[-1].state == span.state and joined[-1].end_s == span.start_s:
            joined[-1] = Span(joined[-1].start_s, span.end_s, span.bad, span.only_suspect)
        else:
            joined.append(span)
    return joined


def _bars(repair: Mapping[str, Any], start_ns: int, end_ns: int) -> list[ActionBar]:
    bars = []
    for one in repair["rounds"]:
        for step in one["plan"]:
            sent, ended = step.get("sent_ns"), step.get("ended_ns") or end_ns
            if sent is not None and sent < end_ns and ended > start_ns:
                begins = (max(sent, start_ns) - start_ns) / NS
                ends = (min(ended, end_ns) - start_ns) / NS
                label = action_title(step["name"], step["parameters"])
                bars.append(ActionBar(begins, ends, label, step.get("state") != StepState.FAILED))
    return bars
