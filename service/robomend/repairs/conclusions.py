"""What a repair comes to, in words: pure, from its last turn and what is written of it.

Who reads them is a person who was not there: what was tried, how it ended, what stands in the way.
"""

from __future__ import annotations

from collections.abc import Sequence

from robomend.cycle import Turn, TurnOutcome
from robomend.errors import InputError, RobomendError
from robomend.repairs.execution_values import Ending
from robomend.repairs.record import Json
from robomend.repairs.signals import NO_REASON, Halted, Signals
from robomend.repairs.states import RepairTrigger
from robomend.robots.health import HealthState, health_of
from robomend.robots.robot import Robot
from robomend_client.counts import first_few
from robomend_client.literals import Atom

BadSets = frozenset[tuple[str, ...]]
"""The diagnoses' bad sets: what a repair gave up on is not tried again until they change."""

ALL_WELL = "every observation is what a healthy robot would show"

BY_ITSELF = f"{ALL_WELL}; nothing was done, it became so by itself"

UNSEEN = "nothing of the robot is observed"

NAMED = 5
"""Literals that a reason lists; the rest is counted."""


class Silent(InputError):
    """Observers of the robot's `observed` list are silent: an automatic repair would be blind."""

    code = "not-observed"


class Overtaken(InputError):
    """While a plan waited for a person, the diagnosis changed, or nothing is known any more."""

    code = "overtaken"


class NotPermitted(RobomendError):
    """A step of the plan that the policy refuses: a person must change the policy, or do it."""

    code = "not-permitted"


def blamed_now(state: Robot) -> BadSets | None:
    """Return the bad sets of the present diagnoses; None when healthy, or not diagnosed."""
    if state.current is None or state.current.healthy:
        return None
    return frozenset(state.current.bad_sets or ()) or None


def unseen(state: Robot, written: Json) -> str | None:
    """Return why a repair that sent nothing ends without a verdict, though nobody is blamed any more.

    Its symptoms went as those did who told of them (a board that is not heard, lifetimes that are over): that
    is no health. What was sent is confirmed by what is seen after it, or a person is told.
    """
    steps = (step for one in written.get("rounds", ()) for step in one["plan"])
    sent = any(step.get("sent_ns") for step in steps)
    return UNSEEN if not sent and health_of(state)[0] is HealthState.UNKNOWN else None


def nobody_blamed(state: Robot, written: Json) -> tuple[RepairTrigger, str]:
    """Return what ends a repair of which the last diagnosis blames nobody: it is well only by what is known
    now, of all that should be (robomend.robots.health).
    """
    if (nothing := unseen(state, written)) is not None:
        return RepairTrigger.OVERTAKEN, nothing
    how, unknown = health_of(state)
    if how.faulty:
        return RepairTrigger.OVERTAKEN, "something is blamed again"
    if how is not HealthState.HEALTHY:
        return RepairTrigger.UNSEEN, unconfirmed(unknown, state)
    rounds = written.get("rounds", ())
    own = next((one["by_itself"] for one in reversed(rounds) if one.get("by_itself")), None)
    reason = ALL_WELL if rounds else BY_ITSELF
    if own is not None and not any(one.get("helped") for one in rounds):
        reason = f"{ALL_WELL}; nothing that was done is credited with it: {own}"
    return RepairTrigger.HEALTHY, well(reason, state)


def well(reason: str, state: Robot) -> str:
    """Return the reason of a repair that ends well, with what is silent although nothing is wrong.

    Topics that wait for an input from outside are nobody's fault; a person should hear of it all the same,
    and not that every observation is as it should be.
    """
    literals = (literal for literal in state.literals() if literal.atom.predicate == "ok")
    seen = sorted(str(literal) for literal in literals if not literal.positive)
    if not seen:
        return reason
    words = reason.replace(ALL_WELL, "no component is blamed any more", 1)
    return f"{words}; {named(seen)}: still seen, and the model blames nobody for it"


def named(what: Sequence[object]) -> str:
    """Return a list as a reason shows it: the first few, and how many more."""
    return first_few(what, NAMED)


def unconfirmed(unknown: Sequence[Atom], state: Robot) -> str:
    """Return the reason of a repair after which nothing is known to be wrong, and this is not known."""
    if unknown and tuple(unknown) == state.wait_for_themselves():
        silent = named([f"not {atom}" for atom in unknown])
        return (
            f"not confirmed: {silent}: still seen, and blamed on nobody only as topics wait for each other, "
            "in a circle that was never seen up"
        )
    held = {atom: state.obs.get(atom) for atom in unknown}
    bad = [str(entry.literal) for entry in held.values() if entry is not None and not entry.positive]
    stood = [a for a in state.sight.confirmed_by_silence() if (e := held.get(a)) is not None and e.positive]
    rest = [atom for atom in unknown if atom not in stood and f"not {atom}" not in bad]
    told = []
    if bad:
        told.append(f"{named(bad)} was the last that was said of it, and nobody has said anything since")
    if stood:
        told.append(
            f"{named(stood)} stood before the last act, and nobody has said otherwise since; who observes "
            "it speaks on change only"
        )
    if rest:
        told.append(f"nobody reports {named(rest)} any more")
    return f"not confirmed: {'; '.join(told) or 'nothing is heard of the robot any more'}"


def in_doubt(last: Turn) -> str | None:
    """Return why a person must look: what must not be repeated was sent, and nobody knows if it acted."""
    done = last.execution
    if last.outcome is not TurnOutcome.ASK or done is None or done.ending is not Ending.UNKNOWN_OUTCOME:
        return None
    return done.reason


def conclusion(last: Turn, signals: Signals, written: Json, state: Robot) -> tuple[RepairTrigger, str]:
    """Return what ends a repair and the reason, from its last turn and what is written of it."""
    rounds = _vain_rounds(written)
    why = last.execution.reason if last.execution is not None else ""
    match last.outcome:
        case TurnOutcome.HEALTHY:
            return nobody_blamed(state, written)
        case TurnOutcome.HALTED | TurnOutcome.NOT_APPROVED:
            return RepairTrigger.HALTED, signals.reason or why or NO_REASON
        case TurnOutcome.NOTHING_TO_TRY:
            assert last.choice is not None
            beyond, why = last.choice.beyond, last.choice.reason
            first = f"{beyond}; " if beyond else ""  # what no act mends is said before what was tried
            return RepairTrigger.NEEDS_PERSON, f"{first}{_tried(rounds)}{why.removeprefix(first)}"
        case TurnOutcome.ASK:
            return RepairTrigger.NEEDS_PERSON, why
        case _ if last.choice is None:
            return RepairTrigger.NEEDS_PERSON, (
                f"{_tried(rounds)}what is blamed changed again and again before anything was done, and the "
                "robot is not healthy"
            )
        case _:
            return RepairTrigger.NEEDS_PERSON, (
                f"{_tried(rounds)}that is as many plans as one repair may try (limits.rounds), and the robot "
                f"is not healthy{': ' + why if not rounds else ''}"
            )


def end_of(error: Exception, signals: Signals, written: Json) -> tuple[RepairTrigger, str]:
    """Return what ends a repair, and the reason, where an exception ended it."""
    match error:
        case Halted():
            return RepairTrigger.HALTED, signals.reason
        case Overtaken():
            return RepairTrigger.OVERTAKEN, str(error)
        case Silent() | NotPermitted():
            return RepairTrigger.NEEDS_PERSON, _without_repeating(_tried(_vain_rounds(written)), str(error))
        case RobomendError():
            return RepairTrigger.BROKE, f"{error.code}: {error}"
        case _:
            return RepairTrigger.BROKE, f"an error in robomend: {type(error).__name__}: {error}"


def _vain_rounds(written: Json) -> list[Json]:
    rounds = (one for one in written.get("rounds", ()) if one.get("ending"))
    return [one for one in rounds if not (one.get("helped") or one.get("by_itself") or one.get("undid"))]


def _without_repeating(tried: str, why: str) -> str:
    """Return what was tried and why it ended; where the last round says why it ended, that once."""
    return tried.removesuffix("; ") if why in tried else f"{tried}{why}"


def _tried(rounds: Sequence[Json]) -> str:
    """Return what the rounds that did not help came to: each end once, with how often, the last one first.

    Ends that differ only in how long was waited are one.
    """
    ends: dict[str, list[str]] = {}
    for one in map(_in_vain, reversed(rounds)):
        what, _, waited = one.partition(WITHIN)
        ends.setdefault(what, []).append(waited)
    told = [_times(what, waited) for what, waited in ends.items()]
    first = "tried, the last first: " if len(told) > 1 else ""
    return first + "".join(f"{one}; " for one in told)


WITHIN = " seen within "
"""Before how long a missing effect was waited for, in the reason of its round."""


def _times(what: str, waited: Sequence[str]) -> str:
    """Return an end as it is told, with how often; `waited`: how long each time, the last first."""
    last = f"{WITHIN}{waited[0]}" if waited[0] else ""
    if len(waited) == 1:
        return f"{what}{last}"
    if len(set(waited)) == 1:
        return f"{what}{last} ({len(waited)} times)"
    return f"{what} seen ({len(waited)} times, the last within {waited[0]})"


def _in_vain(one: Json) -> str:
    """Return how a round ended that did not help."""
    if one["ending"] != str(Ending.DONE):
        return str(one["reason"])
    return (
        f"{', '.join(step['text'] for step in one['plan'])}: done, every effect was seen, and it did not help"
    )
