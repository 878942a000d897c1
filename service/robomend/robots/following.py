"""What other instances did, as their events tell: what is held of a robot here is old then, and read again.

A state that is newer already, because this instance wrote the change, stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from robomend.robots.diagnosing import Diagnosing
from robomend.robots.robot import Robot
from robomend_client.events import Event, Kind


class Following:
    """See the module. Belongs to one event loop."""

    def __init__(
        self,
        robots: Mapping[str, Robot],
        diagnosing: Diagnosing,
        deleted: Callable[[str], None],
    ) -> None:
        """`deleted` is called with the id of a robot that is gone."""
        self._robots = robots
        self._diagnosing = diagnosing
        self._deleted = deleted

    def follow(self, events: Sequence[Event]) -> None:
        """Take note of events in the order of the log; most are our own."""
        robot, state = None, None
        for event in events:
            if event.kind is Kind.MODEL:
                self._model(event)
            if event.robot is None:
                continue
            if event.robot != robot:  # a batch and its diagnosis come together
                robot, state = event.robot, self._robots.get(event.robot)
            if state is not None:
                self._robot(state, event)

    def _model(self, event: Event) -> None:
        for state in self._robots.values():
            if (
                state.stored.config.get("model") == event.data.get("name")
                and event.data.get("version") not in (None, state.model.version)
                and not state.stale
            ):
                state.changed_elsewhere()
                self._diagnosing.wake(state)

    def _robot(self, state: Robot, event: Event) -> None:
        kind, data = event.kind, event.data
        if kind is Kind.OBSERVATIONS:
            if data["revision"] > state.head:
                state.changed_elsewhere()
                if state.diagnosed.awaited:  # there is no event if the other's diagnosis says nothing new
                    self._diagnosing.wake(state)
        elif kind is Kind.DIAGNOSIS:
            state.diagnosed_elsewhere(data["revision"], event.time_ns, data)
        elif kind is Kind.ROBOT and data.get("etag") not in (None, state.stored.etag):
            state.changed_elsewhere()
            self._diagnosing.wake(state)
        elif kind is Kind.ROBOT and data.get("what") == "deleted":
            self._deleted(state.id)
