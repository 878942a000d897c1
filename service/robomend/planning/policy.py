"""What may be done to a robot, by whose leave, how often and when. Pure: times are passed in.

`observe` never acts, `approve` (the default) waits for a person's yes, `auto` acts by itself. Symptoms
can mean broken hardware, so acting is opt-in. Protected components and channels are refused here and again
in the executors, so that neither a plan nor a request nor a user's own action can shut them down.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

from robomend.model.components import KINDS
from robomend.planning.plan import Step
from robomend.planning.prediction import OBSERVED_FACTS
from robomend.planning.protection import Protection

HOUR_NS = 3600 * 10**9

POWER_ACTIONS = frozenset({"power_up", "shutdown"})
"""The domain's own actions on power channels."""

NODE_ACTIONS = frozenset({"start_node", "stop_node"})
"""The domain's own actions on processes."""

TAKES_AWAY = frozenset({"shutdown", "stop_node"})
"""The domain's own actions that switch something off."""

DARK = frozenset(lost for kind in KINDS for lost in kind.lost)
"""Predicates of what is switched off, in our domain and in the paper's."""


class Mode(StrEnum):
    """How far robomend may go by itself; ordered from least to most."""

    OBSERVE = "observe"
    APPROVE = "approve"
    AUTO = "auto"


@dataclass(frozen=True, slots=True)
class Window:
    """A maintenance window: automatic repair is allowed only inside one, if any is given. UTC."""

    weekdays: frozenset[int]  # 0 Monday … 6 Sunday
    start_minute: int  # of the day, 0 … 1439
    end_minute: int  # exclusive; before start_minute: past midnight

    def holds(self, now_ns: int) -> bool:
        """Return whether the moment lies in the window; past midnight it belongs to the day it began."""
        now = datetime.fromtimestamp(now_ns / 1e9, UTC)
        minute = 60 * now.hour + now.minute
        if self.start_minute <= self.end_minute:
            return now.weekday() in self.weekdays and self.start_minute <= minute < self.end_minute
        yesterday = (now.weekday() - 1) % 7
        return (now.weekday() in self.weekdays and minute >= self.start_minute) or (
            yesterday in self.weekdays and minute < self.end_minute
        )

    @classmethod
    def of(cls, value: Mapping[str, Any]) -> Window:
        """Return the window that a robot's configuration describes: weekdays, start and end as HH:MM."""
        start, end = (60 * int(value[key][:2]) + int(value[key][3:]) for key in ("start", "end"))
        return cls(frozenset(value.get("weekdays", range(7))), start, end)


@dataclass(frozen=True, slots=True)
class Limits:
    """How much an automatic repair may try."""

    attempts_per_hour: int = 12  # actions on one component
    rounds: int = 5  # plans within one repair, before a person is asked


@dataclass(frozen=True)
class Policy:
    """A robot's policy."""

    mode: Mode = Mode.APPROVE
    actions: Mapping[str, Mode] = field(default_factory=dict)  # stricter or laxer for single actions
    allowed: frozenset[str] | None = None  # allow-list of action names; None: every action of the domain
    protected: Protection = field(default_factory=dict)  # what nothing shuts down or stops
    limits: Limits = Limits()
    hold_s: float = 0.0  # a diagnosis must last this long before automatic repair
    windows: tuple[Window, ...] = ()

    def mode_of(self, step: Step) -> Mode:
        """Return the mode for this step's action."""
        return self.actions.get(step.name, self.mode)

    def forbids(self, action: str) -> str | None:
        """Return why an action may never be taken, on whatever, or None."""
        if self.actions.get(action, self.mode) is Mode.OBSERVE:
            return f"the policy for {action!r} is 'observe'"
        if self.allowed is not None and action not in self.allowed:
            return f"{action!r} is not on the robot's allow-list ({', '.join(sorted(self.allowed))})"
        return None

    def mode_for(self, steps: Iterable[Step]) -> Mode:
        """Return the strictest mode among the steps: a plan runs as a whole or not at all."""
        modes = [self.mode_of(step) for step in steps] or [self.mode]
        return min(modes, key=list(Mode).index)

    def plan_refusal(
        self, steps: Iterable[Step], attempts: Mapping[str, int], components: Collection[str]
    ) -> str | None:
        """Return why a plan may not be begun, or None.

        The limit is counted over the whole plan: one that it would cut short half-way, perhaps between a
        device's shutdown and its power-up, is not begun.
        """
        counted = Counter(attempts)
        for step in steps:
            refusal = self.refusal(step, counted, components)
            if refusal is not None:
                return f"{step}: {refusal}"
            counted.update(step.acts_on(components))
        return None

    def refusal(self, step: Step, attempts: Mapping[str, int], components: Collection[str]) -> str | None:
        """Return why a step may not be taken, or None.

        Args:
            attempts: component -> actions on it in the last hour, those of this repair included.
            components: the model's; a user's action has other parameters as well, which have no limit.
        """
        if (why := self.forbids(step.name)) is not None:
            return why
        for component in sorted(self.harmed(step)):
            if component in self.protected:
                return f"{component} stays as it is: {self.protected[component]}"
        most = self.limits.attempts_per_hour
        for component in sorted(step.acts_on(components)):
            if attempts.get(component, 0) >= most:
                return f"that would be more than {most} actions on {component} within an hour, the limit"
        return None

    def harmed(self, step: Step) -> frozenset[str]:
        """Return the components that the step switches off, by its name or by its effects."""
        by_effect = {
            effect.atom.args[0]
            for effect in step.effects
            if effect.atom.args
            and (effect.positive, effect.atom.predicate)
            in {*((False, name) for name in OBSERVED_FACTS), *((True, name) for name in DARK)}
        }
        by_name = set(step.parameters) if step.name in TAKES_AWAY else set()
        return frozenset(by_effect | by_name)

    def may_begin(self, now_ns: int) -> bool:
        """Return whether an automatic repair may begin now."""
        return not self.windows or any(window.holds(now_ns) for window in self.windows)
