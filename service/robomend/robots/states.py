"""The states of a robot in memory, and how each comes from the one before.

Two things go on side by side: what is held may grow stale and is read again, and a diagnosis may be under
way. Only robomend.robots.robot.Robot changes either.
"""

from __future__ import annotations

from enum import StrEnum


class Held(StrEnum):
    """How what is held stands to the store."""

    UNREAD = "unread"
    FRESH = "fresh"  # as the store has it, or ahead of it by the writes under way
    STALE = "stale"  # read again before its next use
    GONE = "gone"  # deleted; whoever still holds it lets go


class HeldTrigger(StrEnum):
    """What happens to what is held."""

    READ = "read from the store"
    ACCEPTED = "a batch is taken in, its write begins"
    KEPT = "a write is on disk"
    NOT_KEPT = "a write failed, or was of a batch that is there already"
    CHANGED = "changed by another instance, configured, or given a new model"
    DELETED = "deleted"


HELD: dict[tuple[Held, HeldTrigger], Held] = {
    (Held.UNREAD, HeldTrigger.READ): Held.FRESH,
    (Held.FRESH, HeldTrigger.READ): Held.FRESH,
    (Held.FRESH, HeldTrigger.ACCEPTED): Held.FRESH,
    (Held.FRESH, HeldTrigger.KEPT): Held.FRESH,
    (Held.FRESH, HeldTrigger.NOT_KEPT): Held.STALE,
    (Held.FRESH, HeldTrigger.CHANGED): Held.STALE,
    (Held.FRESH, HeldTrigger.DELETED): Held.GONE,
    (Held.STALE, HeldTrigger.READ): Held.FRESH,
    (Held.STALE, HeldTrigger.ACCEPTED): Held.STALE,  # the store will refuse it, and it is tried again
    (Held.STALE, HeldTrigger.KEPT): Held.STALE,
    (Held.STALE, HeldTrigger.NOT_KEPT): Held.STALE,
    (Held.STALE, HeldTrigger.CHANGED): Held.STALE,
    (Held.STALE, HeldTrigger.DELETED): Held.GONE,
    (Held.GONE, HeldTrigger.ACCEPTED): Held.GONE,  # by who still holds it; the store refuses it
    (Held.GONE, HeldTrigger.KEPT): Held.GONE,
    (Held.GONE, HeldTrigger.NOT_KEPT): Held.GONE,
    (Held.GONE, HeldTrigger.CHANGED): Held.GONE,
}


class Search(StrEnum):
    """Whether a diagnosis is under way: one at a time, and one pending."""

    IDLE = "idle"
    UNDER_WAY = "under-way"
    PENDING = "pending"  # one is under way, and one more comes after it


class SearchTrigger(StrEnum):
    """What happens to a diagnosis under way."""

    WOKEN = "something changed"
    BEGAN = "OBS is read"
    CAME = "the diagnosis came"
    GAVE_UP = "it failed, or was cancelled"


SEARCH: dict[tuple[Search, SearchTrigger], Search] = {
    (Search.IDLE, SearchTrigger.WOKEN): Search.UNDER_WAY,
    (Search.UNDER_WAY, SearchTrigger.WOKEN): Search.PENDING,
    (Search.PENDING, SearchTrigger.WOKEN): Search.PENDING,
    (Search.UNDER_WAY, SearchTrigger.BEGAN): Search.UNDER_WAY,
    (Search.PENDING, SearchTrigger.BEGAN): Search.UNDER_WAY,
    (Search.UNDER_WAY, SearchTrigger.CAME): Search.IDLE,
    (Search.PENDING, SearchTrigger.CAME): Search.UNDER_WAY,
    (Search.UNDER_WAY, SearchTrigger.GAVE_UP): Search.IDLE,
    (Search.PENDING, SearchTrigger.GAVE_UP): Search.IDLE,
}
