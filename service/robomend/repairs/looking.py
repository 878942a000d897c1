"""Looking at OBS while a plan runs: what is there before a step, what its effect is, what breaks meanwhile.

Awaited are the literals that a step makes expected (robomend.planning.prediction) and that somebody observes:
on/off, running/stopped, and ok(t) once all that t rests on is predicted good.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from math import inf
from typing import TypeVar

from robomend.planning.plan import Step
from robomend.planning.policy import NODE_ACTIONS, POWER_ACTIONS
from robomend.planning.prediction import OBSERVED_FACTS, observable
from robomend.repairs.execution_values import Setting, Timing
from robomend.robots.clock import CLOCK
from robomend_client.counts import first_few, listed
from robomend_client.literals import Atom, Literal

T = TypeVar("T")

LOOK_S = 0.25
"""How often OBS is looked at unasked: observations also grow stale, which is no change."""

SOON_S = 0.05
"""How often where what counts is repeated news, which wakes nobody either."""

LONGER = "which is longer than earlier starts took"

AS_LONG = "as long as what boots or starts there may take"

MOST_LONGER_S = 600.0
"""So much longer than its time-out an effect is waited for at most, whatever goes on booting and starting."""

DENIED = "and its observer, which has judged anew since, says otherwise"

NAMED = 4
"""How many missing effects a reason names; the step has them all."""


class Looking:
    """OBS, as the execution of one plan sees it."""

    def __init__(self, setting: Setting, steps: Iterable[Step] = ()) -> None:
        """`steps`: those of the plan, whose own effects are theirs to bring about."""
        self._sight = setting.sight
        self._observed = setting.observed
        self._prediction = setting.prediction
        self._hold_s = setting.default_timing.hold_s
        # Expected literals that OBS has shown. What the plan was made on and leaves as it is, it showed then.
        steps = tuple(steps)
        theirs = {observable(effect).atom for step in steps for effect in step.effects}
        self._before = _before(steps, self._prediction.expected())
        self._agreed = {
            literal
            for literal in self._prediction.expected()
            if literal.atom.predicate in OBSERVED_FACTS and literal.atom not in theirs
        }

    def visible(self, step: Step) -> bool:
        """Return whether OBS shows each on/off and running/stopped that the step brings about.

        What was so before the step says nothing of it: a process that lingers was not seen to run either, and
        one that hangs runs before a remedy restarts it.
        """
        before = {*step.preconditions, *self._before.get(step.index, ())}
        facts = {
            observable(effect)
            for effect in step.effects
            if effect.positive
            and effect not in before
            and observable(effect).atom.predicate in OBSERVED_FACTS
        }
        return bool(facts) and all(self._sight.value(f.atom) == f.positive for f in facts)

    def known(self, atom: Atom) -> bool:
        """Return whether OBS holds the atom, with either sign."""
        return self._sight.value(atom) is not None

    async def becomes_visible(self, step: Step, timeout_s: float) -> bool:
        """Return whether OBS shows the step's effect within the time."""
        return await self._until_none(lambda: None if self.visible(step) else step, timeout_s) is None

    async def came_since(self, wanted: Iterable[Literal], time_ns: int, timeout_s: float) -> bool:
        """Return whether OBS shows, within the time, all of these that somebody observes, and that one of
        them at least came after then.
        """
        awaited = {w for w in wanted if w.atom in self._observed or self._sight.reported(w.atom)}

        def missing() -> bool | None:
            shown = all(self._sight.value(w.atom) == w.positive for w in awaited)
            came = any(w.positive and (self._sight.rose_ns(w.atom) or 0) > time_ns for w in awaited)
            return None if shown and came else True

        return bool(awaited) and await self._until_none(missing, timeout_s) is None

    async def wrong_before(self, step: Step, timing: Timing) -> Literal | None:
        """Return a precondition that OBS contradicts, or that its observer no longer reports.

        It gets a moment to clear up.
        """
        conditions = [observable(p) for p in step.preconditions]
        conditions = [p for p in conditions if p.atom.predicate not in {"good", "bad"}]

        def wrong() -> Literal | None:
            for literal in conditions:
                value = self._sight.value(literal.atom)
                if value is None and literal.atom in self._observed:
                    return literal
                if value is not None and value != literal.positive:
                    return literal
            return None

        unknown = any(p.atom in self._observed and not self.known(p.atom) for p in conditions)
        return await self._until_none(wrong, timing.effect_timeout_s if unknown else timing.hold_s)

    async def effect(
        self, action: str, wanted: Iterable[Literal], timeout_s: float, sent_ns: int
    ) -> tuple[Sequence[Literal], Sequence[Literal], str]:
        """Await what a step makes expected; return what of it OBS showed, what it did not, and within what.

        Awaited is what somebody observes: the robot's `observed` list names it, or OBS knows it already. It
        is given up before the time-out where earlier starts say that it would be there by now, and after an
        action of the user's own, which starts nothing, once a settled observer says otherwise.

        Args:
            sent_ns: when the step was sent: what it starts begins after that, be it before it has answered.
        """
        # What nobody says of a device since comes by its driver, which may have to be restarted first.
        by_driver = action in POWER_ACTIONS
        awaited = frozenset(
            literal
            for literal in wanted
            if self._sight.reported(literal.atom) or literal.atom in self._observed
        )

        def missing() -> frozenset[Literal] | None:
            # Another step may have taken away what this one gave, or have failed to give what it rests on.
            left = awaited & self._prediction.expected()
            values = {w: self._sight.value(w.atom) for w in left}
            unsaid = {w for w in left if by_driver and w.atom.predicate == "ok" and values[w] is None}
            return frozenset(w for w in left - unsaid if values[w] != w.positive) or None

        began, answered_ns = time.monotonic(), CLOCK.now_ns()
        longest_s = timeout_s

        def longer_s() -> float:
            """Observers may need longer than the time-out, and what boots or starts for longer than that."""
            nonlocal longest_s
            passed_s = time.monotonic() - began
            due_s = self._sight.due_s(awaited & self._prediction.expected(), timeout_s)
            longest_s = max(timeout_s, min(passed_s + due_s, timeout_s + MOST_LONGER_S))
            settle_s = {w: self._sight.settling_s(w.atom) for w in awaited}
            for literal in missing() or ():
                if self._sight.value(literal.atom) is None:
                    continue
                turns_s = self._sight.turns_s(literal.atom, answered_ns)
                if turns_s <= 0 and not settle_s[literal]:
                    settle_s.clear()  # it is known to be missing, whatever the others will say
                    break
                settle_s[literal] = max(settle_s[literal], passed_s + turns_s - timeout_s)
            return max(longest_s - timeout_s, max(settle_s.values(), default=0.0))

        own = action not in POWER_ACTIONS | NODE_ACTIONS
        within = ""

        def known_s(left: frozenset[Literal]) -> float:
            nonlocal within
            ends = {LONGER: self._sight.may_take_s(left, sent_ns, answered_ns)}
            if own:
                ends[DENIED] = self._sight.denied_s(left, sent_ns, answered_ns)
            within, left_s = min(ends.items(), key=lambda end: end[1])
            return left_s

        left = await self._until_none(missing, timeout_s, longer_s, known_s) or frozenset()
        took_s = time.monotonic() - began
        if longest_s > timeout_s and took_s >= longest_s:
            within = f"{took_s:.0f} s, {AS_LONG}"
        else:
            within = f"{timeout_s:g} s" if took_s >= timeout_s else f"{took_s:.1f} s, {within}"
        seen = sorted(w for w in awaited if self._sight.value(w.atom) == w.positive)
        for literal in left:
            self._prediction.fail(literal)
        self._agreed.update(seen)
        return tuple(seen), tuple(sorted(left)), within

    async def contradiction(self) -> Literal:
        """Return a literal that the plan predicts and that OBS contradicts for longer than a flutter.

        Only what OBS once agreed with can break: what a step still has to bring about is that step's
        business. So may what the plan was made on, and what has changed since.
        """
        agreed = self._agreed
        since: dict[Literal, float] = {}
        while True:
            revision = self._sight.revision
            expected = self._prediction.expected()
            agreed.intersection_update(expected)
            agreed.update(e for e in expected if self._sight.value(e.atom) == e.positive)
            broken = {e for e in agreed if self._sight.value(e.atom) == (not e.positive)}
            now = time.monotonic()
            since = {e: since.get(e, now) for e in broken}
            lasting = sorted(e for e, begun in since.items() if now - begun >= self._hold_s)
            if lasting:
                for literal in lasting:
                    self._prediction.fail(literal)
                return lasting[0]
            await self._sight.changed(revision, self._hold_s / 2 if broken else 1.0)

    async def _until_none(
        self,
        wrong: Callable[[], T | None],
        timeout_s: float,
        longer_s: Callable[[], float] = lambda: 0.0,
        at_most_s: Callable[[T], float] = lambda answer: inf,
    ) -> T | None:
        """Wait until `wrong()` is None, looking at each change of OBS; return its last answer.

        `longer_s`: how much longer than the time-out observers may need; `at_most_s`: after what time more
        that answer is the last.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            revision = self._sight.revision
            answer = wrong()
            left = deadline + longer_s() - time.monotonic()
            at_most = inf if answer is None else at_most_s(answer)
            left = min(left, at_most)
            if answer is None or left <= 0:
                return answer
            await self._sight.changed(revision, min(left, LOOK_S if at_most == inf else SOON_S))


def _before(steps: Iterable[Step], expected: Iterable[Literal]) -> dict[int, frozenset[Literal]]:
    """Return, for each step of a plan, what is on or running before it."""
    facts = {literal for literal in expected if literal.positive and literal.atom.predicate in OBSERVED_FACTS}
    found: dict[int, frozenset[Literal]] = {}
    for step in steps:
        found[step.index] = frozenset(facts)
        for effect in map(observable, step.effects):
            if effect.atom.predicate in OBSERVED_FACTS:
                (facts.add if effect.positive else facts.discard)(Literal(effect.atom))
    return found


def first_of(missing: Sequence[Literal]) -> str:
    """Return what was not seen as a reason names it: all of a few, or the first, what is no topic before."""
    told = [str(literal) for literal in sorted(missing, key=lambda one: one.atom.predicate == "ok")]
    if len(told) <= NAMED:
        return listed(told)
    return first_few(told, NAMED - 1)
