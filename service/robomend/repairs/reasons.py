"""Whether there is a reason to begin a repair by itself, and what is not tried again for now.

A reason is: the policy is `approve` or `auto`, the diagnosis is not healthy and has held for `hold_s`, no
stop is active, the time is inside a maintenance window, and it is not what the last repair gave up on. Under
`approve` it must have held for as long as the observers of its symptoms may need to take them back: a person
takes longer anyway, and is asked nothing that would be withdrawn at once.

What was given up on is tried again when the diagnosis changes, a person releases a component, the robot is
configured anew, the back-off of a quarantine ends, OBS shows the model's `act_when` that it did not show
then, an agent says that it can do something else, or who was silent is heard. What was tried in vain may be
repairable later (a device has booted, somebody has plugged it in), and what a part of the service failed at
is none of the robot's doing: both are taken up again by themselves, after a back-off that doubles. That what
was bad lapsed, and is bad again, may be an agent that went away and came back: it is tried again, but the
next time only after LAPSED_S, and twice as much each time until all is seen to be well: those who report more
rarely than the lifetimes they give would be repaired for ever. So it is with symptoms of which less is heard
than before, whoever else may be blamed for these, and with what is blamed again as its repair ends.
"""

from __future__ import annotations

import time

from robomend.errors import RobomendError
from robomend.planning.policy import Policy
from robomend.repairs.choosing import Chooser
from robomend.repairs.conclusions import BadSets, blamed_now
from robomend.repairs.flapping import Flapping
from robomend.repairs.record import RepairRecord
from robomend.robots.clock import CLOCK
from robomend.robots.declared import Delays
from robomend.robots.robot import Robot
from robomend.robots.sight import SLACK_S
from robomend.store import View, audit, repairs
from robomend.store.records import Json, Paging, Stop, StoredRepair
from robomend_client.literals import Atom

IDLE_S = 30.0
"""An event wakes us; this is for one that was lost."""

AGAIN_S = 120.0
"""What was tried in vain is taken up again after this, then after twice as long, and so on …"""

MOST_AGAIN_S = 3600.0
"""… up to this. The first time it is no later than when all that has got its power has booted, and this:"""

BOOTED_S = 1.0

LAPSED_S = 60.0
"""The same of what was given up on, and was only not heard of in between."""

LAG_S = 0.05
"""What was given up on is not judged by a diagnosis that is behind OBS: the next one wakes us, or this."""

BROKE_S = 15.0
"""The same of a repair that failed for the service's own sake, as on a computer at its limit …"""

MOST_BROKE_S = 600.0
"""… up to this."""

RECONSIDERED = frozenset({"quarantine.release", "robot.put"})
"""Entries of the audit log after which what a repair gave up on is worth another try."""


class ReasonsToRepair:
    """Of one robot."""

    def __init__(self) -> None:
        self.given_up: BadSets | None = None  # the diagnoses that the last repair could not mend
        self._retry_s: float | None = None  # when they may be tried again, monotonic
        self.interlocked = False  # it ended while nothing might be sent: worth a try when something may
        self.again: Json | None = (
            None  # the repair that the next one takes up: its id, and how often that was
        )
        self._taken_up: Json | None = None  # the same, once its back-off is over
        self._unheard = False  # it ended as observers were silent: worth a try when they are not
        self._agents: int | None = None  # what the agents could do when it ended without having done anything
        self.held_by_stop = False  # by nothing else, when it was asked last
        self._flapping = Flapping()
        self._symptoms: frozenset[Atom] | None = None  # what did not hold then; None: nobody knows any more
        self._lapsed = False  # some of that was not heard of since
        self._again_s = 0.0  # when that may be a reason to try again, monotonic
        self._pause_s = LAPSED_S
        self._untouched: BadSets | None = None  # what the last repair gave up on without having done anything
        self._unhealthy: tuple[BadSets, float] | None = None  # and since when, monotonic
        self._unwell_s: float | None = None  # since when it was not healthy, whatever is blamed

    def recall(self, view: View, robot: str) -> None:
        """Learn from the store what the last repair gave up on, unless a person changed something since."""
        page = repairs.page(view, robot, Paging(limit=1))
        if not page.items or page.items[0].open or reconsidered(view, page.items[0]):
            return
        data = page.items[0].data
        if data.get("drill") is not None:  # the fault was planted, and is undone
            return
        if data.get("given_up") is not None:
            self.given_up = frozenset(tuple(bad) for bad in data["given_up"])
            self._retry_s = _from_now(data.get("retry_ns"))
            self.interlocked = bool(data.get("interlocked"))
            self._taken_up = data.get("takes_up")
            self._unheard = bool(data.get("unheard"))
            if data.get("unlasting"):
                self._does_not_last()

    def reconsider(self) -> None:
        """A person changed something: what was given up on may be worth another try."""
        self.given_up = None
        self._flapping.released()

    def gave_up(
        self,
        blamed: BadSets | None,
        retry_ns: int | None,
        symptoms: frozenset[Atom] | None = None,
        *,
        interlocked: bool,
        unheard: bool = False,
        untouched: bool = False,
        unlasting: bool = False,
        takes_up: Json | None = None,
        agents: int | None = None,
    ) -> None:
        """A repair has ended; `blamed` are the bad sets that it could not mend.

        Args:
            symptoms: what did not hold then.
            unheard: it ended as observers were silent, or as it was blamed again just then.
            untouched: nothing was done about them.
            unlasting: repairs of them helped, and did not last.
            takes_up: what the repair that begins after `retry_ns` is told of this one.
            agents: what the agents could do (`DeclaredAgents.changes`), if it may have been too little.
        """
        self.given_up, self._retry_s, self.interlocked = blamed, _from_now(retry_ns), interlocked
        self._symptoms, self._lapsed = symptoms, False
        self.again, self._taken_up, self._unheard, self._agents = None, takes_up, unheard, agents
        self._untouched = blamed if untouched and not unlasting else None
        if unlasting:
            self._does_not_last()

    def _does_not_last(self) -> None:
        if self.given_up is not None and self._retry_s is not None:
            self._flapping.came_back(self.given_up, self._retry_s)

    @property
    def suspects(self) -> BadSets | None:
        """What was blamed when it was looked last."""
        return None if self._unhealthy is None else self._unhealthy[0]

    def well_by_itself(self, record: RepairRecord, blamed: BadSets | None) -> str | None:
        """A repair ended well; if nothing was done for it, return what to tell a person, if it is time to."""
        if record.data.get("rounds") or record.data.get("asked") or record.drill:
            return None
        return self._flapping.well_by_itself(blamed, time.monotonic())

    def any(self, state: Robot | None, chooser: Chooser, stop: Stop) -> bool:
        """Return whether there is one, or soon is, by the diagnosis in memory; True where none is known.

        A turn of the robot's loop would cost several times as much.
        """
        if state is None or state.stale:
            return True
        try:
            chooser.keep_ready(state)
            policy = chooser.policy(state)
        except RobomendError:  # the loop tells of it
            return True
        return self.wait_s(state, policy, stop) < IDLE_S

    def wait_s(self, state: Robot, policy: Policy, stop: Stop) -> float:
        """Return 0 if there is a reason to begin a repair now, else after how long to look again."""
        self.held_by_stop = False
        blamed = blamed_now(state)
        bad = self._not_heard(state)
        late_s = state.sight.may_be_late_s(bad)
        lags = state.current is not None and state.current.revision < state.head
        if blamed is None:
            self._lapsed = self._lapsed or bool(bad)
            if late_s > 0:
                return late_s + 0.001
            self._unhealthy = self._unwell_s = None
            if state.current is not None and state.current.healthy and not bad and not lags:
                self.given_up = self.again = None
                self._lapsed, self._again_s, self._pause_s = False, 0.0, LAPSED_S
                if self._untouched is not None:  # a person was told already, as often as this has happened
                    self._flapping.well_by_itself(self._untouched, time.monotonic())
                    self._untouched = None
            return IDLE_S
        now = time.monotonic()
        if self._unhealthy is None or self._unhealthy[0] != blamed:
            self._unhealthy = (blamed, now)
        held_s = now - self._unhealthy[1]
        self._unwell_s = now if self._unwell_s is None else self._unwell_s
        if self._retry_s is not None and now >= self._retry_s:
            self.again = self._taken_up if blamed == self.given_up else None
            self.given_up = self._retry_s = None
        if self.interlocked and state.interlocked() is None:
            self.given_up, self.interlocked = None, False
        if self._agents is not None and state.sight.declared.changes != self._agents:
            self.given_up = self._agents = None
        acts = state.config.policy != "observe" and state.system.parts is not None
        same = blamed == self.given_up
        if not same and self.given_up is not None:
            if late_s > 0 or lags:  # whom else it blamed, as not all was heard
                return max(late_s, LAG_S) + 0.001
            if bad or blamed < self.given_up:  # of the same fault less is heard, or more again
                same = self._symptoms is not None and state.sight.symptoms() <= self._symptoms
                self._lapsed = self._lapsed or same
        back = self._lapsed or (self._unheard and all(map(state.sight.reported, state.sight.observed)))
        if self.given_up is not None and back and now >= self._again_s:
            self.given_up, self._lapsed, self._unheard = None, False, False
            self._again_s, self._pause_s = now + self._pause_s, min(2 * self._pause_s, MOST_AGAIN_S)
        if not acts or (same and self.given_up is not None):
            if acts and self._retry_s is not None:
                return min(IDLE_S, self._retry_s - now + 0.001)
            return IDLE_S
        if stop.active:
            self.held_by_stop = True
            return IDLE_S
        hold_s = policy.hold_s
        if state.config.policy == "approve":
            hold_s = max(hold_s, settles_s(state))
        steady_s = self._flapping.wait_s(blamed, now, now - self._unwell_s)
        if held_s < hold_s or steady_s > 0:
            return max(hold_s - held_s, steady_s) + 0.001
        return 0.0 if policy.may_begin(time.time_ns()) else IDLE_S

    def _not_heard(self, state: Robot) -> tuple[Atom, ...]:
        """Return what was last said not to hold, and is not heard now; after a repair has given up: of that
        which did not hold then.
        """
        bad = state.sight.lapsed_bad()
        if self.given_up is None or self._symptoms is None:
            return bad
        return tuple(atom for atom in bad if atom in self._symptoms)


def _from_now(at_ns: int | None) -> float | None:
    """Return a time of the computer's clock on one that does not jump."""
    return None if at_ns is None else time.monotonic() + (at_ns - time.time_ns()) / 1e9


def takes_up(record: RepairRecord, state: Robot, *, broke: bool) -> tuple[int, Json]:
    """Return when a repair that ended without success is taken up again, and what the next one is told.

    What may have been started too early for its device is tried again once that has booted.
    """
    times = (record.data.get("again") or {}).get("times", 0)
    first_s, most_s = (BROKE_S, MOST_BROKE_S) if broke else (AGAIN_S, MOST_AGAIN_S)
    wait_s = min(most_s, first_s * 2.0 ** min(times, 63))
    parts, sight = state.system.parts, state.sight
    booted_ns = 0 if parts is None or times else sight.start_ups.all_booted_ns(parts, sight)
    if booted_ns:
        wait_s = min(wait_s, (booted_ns - CLOCK.now_ns()) / 1e9 + BOOTED_S)
    why = "broke" if broke else "did not mend it"
    return time.time_ns() + round(wait_s * 1e9), {"of": record.id, "why": why, "times": times + 1}


def settles_s(state: Robot) -> float:
    """Return how long the observers of what does not hold may need to take it back, as far as they say."""
    nobody = Delays(0, 0)
    symptoms = (entry.atom for entry in state.sight.entries() if not entry.positive)
    settling_ns = (state.sight.declared.delays(atom, nobody).settling_ns for atom in symptoms)
    longest_ns = max(settling_ns, default=0)
    return longest_ns / 1e9 + SLACK_S if longest_ns else 0.0


def reconsidered(view: View, ended: StoredRepair) -> bool:
    """Return whether a person changed something since the repair ended; by the audit log, as its order is
    that of the writes and not of clocks.
    """
    for entry in audit.page(view, Paging(limit=1000), robot=ended.robot).items:  # the newest first
        if entry.subject == ended.id:
            return False
        if entry.action in RECONSIDERED:
            return True
    return False
