"""What a repair's acts made uncertain, and the wait until somebody has seen how it is now.

    act answered ──► atoms that it influences ──► unconfirmed, `settle` to the agents
                                                        │
    healthy? ──► only if each of them was seen since ◄──┘ else wait: start-up, settling, what is on its way

The wait ends: then a person is told what nobody could confirm, or, where those who should have are known to
speak on change only, the repair says so of itself.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from datetime import UTC, datetime

from robomend.diagnosis.result import DiagnosisResult
from robomend.planning.influence import influenced
from robomend.planning.prediction import OBSERVED_FACTS, theory_of
from robomend.repairs.conclusions import Silent, named
from robomend.repairs.execution_values import StepReport
from robomend.repairs.record import RepairRecord
from robomend.repairs.signals import Signals
from robomend.repairs.states import RepairTrigger
from robomend.robots.clock import CLOCK
from robomend.robots.robot import Robot
from robomend.robots.sight import SLACK_S
from robomend.store.records import Json
from robomend_client.actions import REFUSED, UNREACHABLE, Action, ActionResult
from robomend_client.literals import Atom

LOOK_S = 0.25

DID_NOT_ACT = frozenset({REFUSED, UNREACHABLE})


class Confirming:
    """Of one repair."""

    def __init__(
        self,
        state: Robot,
        record: RepairRecord,
        signals: Signals,
        observed: frozenset[Atom],
        newest: Callable[[], Awaitable[DiagnosisResult]],
        shows_s: Callable[..., float],
        start_up_s: Callable[[str], float],
    ) -> None:
        """
        Args:
            observed: what somebody should report.
            newest: returns the diagnosis of what is confirmed now.
            shows_s: actions, by name -> how long the effect of one of them may take to show.
            start_up_s: component -> how long it may need, once started, until it shows.
        """
        self._state = state
        self._record = record
        self._signals = signals
        self._observed = observed
        self._newest = newest
        self._shows_s = shows_s
        self._takes_s = start_up_s
        self._start_up_s = shows_s("power_up", "start_node")  # what acts of before this repair may still need
        self._began_ns = CLOCK.now_ns()

    def acted(self, action: Action, result: ActionResult, report: StepReport) -> Json | None:
        """Note what an act that has answered made uncertain; return what agents are to judge anew."""
        parts = self._state.system.parts
        if result.code in DID_NOT_ACT or parts is None:
            return None
        components = frozenset(parts.components)
        acted_on = components.intersection(
            [*action.parameters, *(arg for effect in report.step.effects for arg in effect.atom.args)]
        )
        known = {entry.atom for entry in self._state.obs.entries()} | self._observed
        _, system, _ = self._state.question(())
        atoms = influenced(parts, theory_of(system.cnf), acted_on, known)
        facts = {atom for atom in atoms if atom.predicate in OBSERVED_FACTS}
        now_ns = CLOCK.now_ns()
        sent_ns, sight = report.sent_ns or now_ns, self._state.sight
        n = sight.acted(facts, sent_ns, atoms - facts, now_ns)
        shows_s = self._shows_s(action.name)
        self._start_up_s = max([self._start_up_s, shows_s, *map(self._takes_s, acted_on)])
        sight.start_ups.acted(action, sent_ns, now_ns + round(shows_s * 1e9))
        return {"n": n, "atoms": [str(atom) for atom in sorted(atoms)]}

    async def seen(self) -> None:
        """Wait until all is confirmed that acts made uncertain, or nobody can be expected to any more."""
        while self._left_s() > 0:
            await self._news()

    async def healthy(self, result: DiagnosisResult) -> DiagnosisResult:
        """Return a diagnosis that is not healthy, or one that is, and that rests on what was seen.

        Silent: nobody could confirm it.
        """
        told = False
        while result.healthy and (left := self._state.sight.not_confirmed()):
            names = named(left)
            if self._left_s() <= 0:
                since_ns = max(self._state.sight.unconfirmed.acts[atom].from_ns for atom in left)
                since = datetime.fromtimestamp(since_ns / 1e9, UTC).strftime("%H:%M:%S")
                raise Silent(
                    f"nobody could confirm {names} since {since} UTC, when the last act had answered: "
                    "nothing else is wrong; look at the robot, and whether its observers still work"
                )
            if not told and self._left_s() > 1.0:
                told = True
                await self._record.update(
                    RepairTrigger.UNHEARD,
                    reason=f"until {names} is seen after the last act",
                    waiting_for=[str(atom) for atom in left],
                )
            await self._news()
            result = await self._newest()
        return result

    def _left_s(self) -> float:
        """Return how long what is not confirmed may still take."""
        acts, now_ns = self._state.sight.unconfirmed.acts, CLOCK.now_ns()
        left = self._state.sight.not_confirmed()
        # What an earlier repair left unconfirmed gets its time in this one, too.
        began = {atom: max(acts[atom].from_ns, self._began_ns) for atom in left}
        ends = [began[a] + self._state.sight.delays(a).settling_ns - now_ns for a in left]
        return max(ends) / 1e9 + self._start_up_s + SLACK_S if ends else 0.0

    async def _news(self) -> None:
        left_s = max(0.01, min(LOOK_S, self._left_s()))
        await self._signals.unless_halted(self._state.changed(self._state.revision, left_s))
