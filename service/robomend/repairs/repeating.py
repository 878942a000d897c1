"""Whether an act is worth doing once more in the same repair: three times, unless something else was seen.

What acts on a device, once: see robomend.planning.cures.once.

    sent ──► seen then ──► asked again: the same is seen now? ── no ──► new evidence: counted anew
                                              │ yes
                                              ▼
                       three times, or two plain answers ──► not again; another way, or a person

New evidence is an observation with another sign than when the act was last sent, what the act itself switches
left out: a process that is started, runs for a moment and is gone again proves nothing. A plain answer is one
that the same again does not change: refused, a faulty channel, no such program.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from robomend.planning.prediction import OBSERVED_FACTS
from robomend_client.actions import NO_PROGRAM, NOT_EXECUTABLE, REFUSED, Action, ActionResult
from robomend_client.literals import Literal

MOST = 3
"""Times that an act is done in a repair without new evidence."""

MOST_PLAIN = 2
"""Plain answers after which it is not done again in this repair."""

PLAIN: Mapping[int, str] = {
    REFUSED: "it was refused",
    NO_PROGRAM: "there is no such program",
    NOT_EXECUTABLE: "the program cannot be executed",
}
"""Answers that the same again does not change."""


@dataclass(slots=True)
class _Act:
    """What became of one act so far."""

    sent: int = 0  # times without new evidence
    seen: frozenset[Literal] = frozenset()  # what was known when it was last sent
    plain: int = 0
    in_vain: bool = False  # carried out wholly and awaited, and the same again cures no better
    said: str = ""  # what the last plain one said; its own words are told with the round that it ended


class Repeats:
    """The acts of one repair."""

    def __init__(self, steps: Iterable[Mapping[str, Any]] = ()) -> None:
        """`steps`: what is on disk of the repair's steps, after a crash."""
        self._acts: dict[str, _Act] = {}
        for step in steps:
            if step.get("sent_ns") is None:
                continue
            act = self._acts.setdefault(step["text"], _Act())
            # The id of a step's second sending ends with `.1`.
            times = 1 + int(str(step.get("id") or "").partition(":")[2].partition(".")[2] or 0)
            act.sent += times
            if step.get("result") in PLAIN:
                act.plain += times
                act.said = PLAIN[step["result"]]

    def sent(self, action: Action, known: Iterable[Literal]) -> None:
        """An action is sent; `known` is OBS."""
        act = self._acts.setdefault(str(action), _Act())
        seen = _relevant(known, action.parameters)
        if _new(act, seen):
            act.sent, act.in_vain = 0, False
        act.sent += 1
        act.seen = seen

    def not_sent(self, action: Action) -> None:
        """It was not sent after all."""
        self._acts[str(action)].sent -= 1

    def answered(self, action: Action, result: ActionResult) -> None:
        """Its answer has come."""
        act = self._acts[str(action)]
        if result.code in PLAIN:
            act.plain += 1
            act.said = PLAIN[result.code]

    def in_vain(self, texts: Iterable[str]) -> None:
        """These were carried out, their effects were awaited in vain, and the same again cures no better."""
        for text in texts:
            if text in self._acts:
                self._acts[text].in_vain = True

    def why_not(self, text: str, parameters: Iterable[str], known: Iterable[Literal]) -> str | None:
        """Return why an act is not done once more, or None."""
        act = self._acts.get(text)
        if act is None:
            return None
        if act.plain >= MOST_PLAIN:
            return f"it was sent {act.plain} times in this repair, and each answer was plain: {act.said}"
        if not (act.in_vain or act.sent >= MOST) or _new(act, _relevant(known, parameters)):
            return None
        if act.in_vain:
            return "it was done in this repair without help, and nothing else was observed since"
        return f"it was done {act.sent} times in this repair, and nothing else was observed since"

    def exhausted(self, known: Iterable[Literal]) -> tuple[tuple[str, str], ...]:
        """Return the acts that are not to be planned, each with the reason."""
        literals = tuple(known)
        found = ((text, self.why_not(text, parameters_of(text), literals)) for text in sorted(self._acts))
        return tuple((text, why) for text, why in found if why is not None)


def parameters_of(text: str) -> tuple[str, ...]:
    """Return the parameters of an act as text, `power_up(lidar)`."""
    inside = text.partition("(")[2].removesuffix(")")
    return tuple(inside.split(", ")) if inside else ()


def _relevant(known: Iterable[Literal], parameters: Iterable[str]) -> frozenset[Literal]:
    """Return what may be evidence: not what the act switches itself."""
    own = frozenset(parameters)
    return frozenset(
        literal
        for literal in known
        if not (literal.atom.predicate in OBSERVED_FACTS and own.intersection(literal.atom.args))
    )


def _new(act: _Act, seen: frozenset[Literal]) -> bool:
    return any(-literal in seen for literal in act.seen)
