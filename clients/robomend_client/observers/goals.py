"""Goals of an action server: ok(navigate_to_pose) while none of them was aborted, or rejected.

    /navigate_to_pose/_action/status    ROS 2, action_msgs/GoalStatusArray
    /move_base/status, …/result         ROS 1, actionlib_msgs/GoalStatusArray (`preset: ros1`)

A goal that was cancelled, preempted or recalled is no fault, and no recovery. The next goal that succeeds is
a recovery, and so is `hold_s` without another that was aborted. ROS 2 tells nobody but the client of a goal
that was rejected; ROS 1 does.

What is in the first list that is heard may have been over for long: it counts where its goal was given no
more than `hold_s` ago. Of a list only its newest MOST_GOALS goals are looked at.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from robomend_client.literals import Atom
from robomend_client.observers.base import SECOND, Evidence, WrongKind
from robomend_client.observers.incidents import Incidents, check_incidents
from robomend_client.readings import Reading, Symptom

MOST_GOALS = 64
"""Goals of one list that are looked at: the newest."""

REMEMBERED = 1024
"""Goals whose end is not to count twice."""

TYPES = {"action_msgs/GoalStatusArray": "/_action/status", "actionlib_msgs/GoalStatusArray": "/status"}
"""What an action server tells of its goals: type of the topic, and how its name ends."""

SUCCEEDED, ABORTED, REJECTED, LOST = "succeeded", "aborted", "rejected", "lost"
ROS1_ENDS = {3: SUCCEEDED, 4: ABORTED, 5: REJECTED, 2: "", 8: "", 9: LOST}
ROS2_ENDS = {4: SUCCEEDED, 5: "", 6: ABORTED}


@dataclass(frozen=True)
class GoalRules:
    """What of the goals is bad, and for how long.

    Attributes:
        in_a_row: so many goals in a row must have been aborted or rejected.
        hold_s: without another one it is good again after so many seconds.
        status: how the topic with the goals' states is called, below the action's name.
    """

    in_a_row: int = 1
    hold_s: float = 60.0
    status: str = "_action/status"

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"ros1": {"status": "status"}, "ros2": {}}

    def __post_init__(self) -> None:
        check_incidents(self.hold_s, self.in_a_row, "in_a_row")


class GoalsObserver(Incidents):
    """Watches the goals of one action server."""

    latched = True
    """How a goal has ended is said once, also of one that ended just before a reset."""

    def __init__(
        self, atom: str, action: str | None = None, source: str | None = None, rules: GoalRules | None = None
    ) -> None:
        """
        Args:
            atom: what it speaks of, e.g. `ok(goals,navigator)`; `navigate_to_pose` is short for
                ok(navigate_to_pose); by default the entry's name.
            action: the action's name; by default the last one in the atom.
            source: where the states come from, instead of the action's own topic: a list, or one of them.
            rules: what is bad.
        """
        rules = rules or GoalRules()
        super().__init__(atom, rules.in_a_row, rules.hold_s)
        self.action = (action or self.atoms[0].args[-1]).strip("/")
        self.sources = frozenset((source or f"{self.action}/{rules.status}:status_list[-{MOST_GOALS}:]",))
        self._in_a_row = rules.in_a_row
        self._ended: OrderedDict[str, None] = OrderedDict()  # goals whose end was seen
        self._heard = False
        self._last = self._text = ""

    def reset(self, time_ns: int) -> None:
        """What had ended before is not news after it."""
        if time_ns < self._began_ns:
            self._ended.clear()
            self._heard = False
        super().reset(time_ns)

    def feed(self, source: str, time_ns: int, value: object) -> None:
        goals = [value] if isinstance(value, Mapping) else value
        if not isinstance(goals, Sequence) or isinstance(goals, str | bytes):
            raise WrongKind("a goal's state or a list of them is", value)
        for goal in goals[-MOST_GOALS:]:
            try:
                self._look(goal, time_ns)
            except (KeyError, TypeError, AttributeError, ValueError) as error:
                raise WrongKind("a goal's state (goal_id or goal_info, status) is", goal) from error
        self._heard = True

    def _look(self, goal: Mapping[str, Any], time_ns: int) -> None:
        new = "goal_info" in goal
        about = goal["goal_info"] if new else goal["goal_id"]
        end = (ROS2_ENDS if new else ROS1_ENDS).get(int(goal["status"]))
        if end is None:
            return
        name = str(about["goal_id"] if new else about["id"])[:200]
        if name in self._ended:
            return
        self._ended[name] = None
        if len(self._ended) > REMEMBERED:
            self._ended.popitem(last=False)
        given_ns = stamp_ns(about.get("stamp"))
        late = given_ns is None or not -SECOND <= time_ns - given_ns < self._hold_ns
        if not end or (not self._heard and late):
            return  # cancelled; or from before anybody looked
        self._last, self._text = end, str(goal.get("text") or "")
        if end == SUCCEEDED:
            self.well(time_ns)
        else:
            self.incident(time_ns)

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        if self._bad:
            told = f"goal {self._last}" if self.count == 1 else f"{self.count} goals {self._last} in a row"
            told += f": {self._text}" if self._text else ""
            limit = f"{self._in_a_row} in a row are too many" if self._in_a_row > 1 else ""
            return self.evidence_of(now_ns, Reading(told, "", limit, Symptom.SELF_REPORT))
        if self._good_ns is not None and now_ns - self._good_ns < self._hold_ns:
            return self.evidence_of(now_ns, Reading("goal succeeded"))
        return self.evidence_of(now_ns, Reading(f"no goal aborted for {self.hold_s:g} s"))


def stamp_ns(stamp: object) -> int | None:
    """Return a ROS time in nanoseconds; None where there is none."""
    if isinstance(stamp, Mapping):
        sec = stamp.get("sec", stamp.get("secs"))
        rest = stamp.get("nanosec", stamp.get("nsecs", stamp.get("nsec", 0)))
        if isinstance(sec, int) and isinstance(rest, int):
            return sec * SECOND + rest
    return None


def suggested(topic: str, kind: str) -> dict[str, dict[str, Any]]:
    """Return the entry of `observers:` that a topic of this type suggests; nothing for others.

    Args:
        topic: with its slash, as ROS has it.
        kind: package/Name.
    """
    end = TYPES.get(kind)
    if end is None or not topic.endswith(end):
        return {}
    action = topic.removesuffix(end).strip("/")
    preset = {"preset": "ros1"} if end == "/status" else {}
    return {f"ok(goals,{action})": {"kind": "goals", "action": action, **preset}}
