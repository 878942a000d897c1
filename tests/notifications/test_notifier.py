"""What people are told arrives: once, in spite of crashes, absent receivers and several instances."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from tests.waiting import LOOK_S

from robomend.metrics import Metrics
from robomend.notifications.delivery import Delivery, Messages
from robomend.notifications.notifier import Notifier
from robomend.notifications.recipients import Recipient
from robomend.settings import Settings
from robomend.store import Store, Transaction, notifications
from robomend.store.records import StoredNotification
from robomend_client.events import Kind

pytestmark = pytest.mark.anyio

DUTY = {"name": "duty", "url": "https://hooks.example/x", "secret": "s3cret"}
LAB = {"name": "lab", "url": "https://lab.example/x", "secret": "s3cret", "about": ["stop"]}


class Post:
    """Takes what is sent, or refuses."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, list[str]]] = []
        self.answers: list[Delivery] = []
        self.news = asyncio.Event()

    async def __call__(self, recipient: Recipient, messages: Messages, _: Settings) -> Delivery:
        self.sent.append((recipient.name, [one["title"] for one in messages]))
        self.news.set()
        return self.answers.pop(0) if self.answers else Delivery(True, "answered 200")

    def titles(self, recipient: str) -> list[str]:
        return [title for name, titles in self.sent if name == recipient for title in titles]


@pytest.fixture
async def store(tmp_path: Path) -> AsyncIterator[Store]:
    store = Store(f"sqlite:///{tmp_path}/robomend.db")
    await store.start()
    yield store
    await store.close()


@pytest.fixture
async def post() -> Post:
    return Post()


def notifier(store: Store, post: Post, *recipients: dict[str, Any]) -> Notifier:
    return Notifier(store, Settings.model_validate({"notify": recipients}), Metrics(), post)


async def emit(store: Store, kind: Kind, data: dict[str, Any], robot: str | None = None) -> None:
    await store.write(lambda tx: tx.emit(kind, robot, data))


async def stop(store: Store, active: bool = True) -> None:
    await emit(store, Kind.STOP, {"active": active, "by": "ann", "reason": "smoke"})


async def unknown(store: Store, robot: str) -> None:
    await emit(store, Kind.ROBOT, {"what": "health", "state": "unknown", "unknown": []}, robot)


async def every(store: Store) -> tuple[StoredNotification, ...]:
    return (await store.read(notifications.page)).items


async def until(
    store: Store, met: Callable[[Sequence[StoredNotification]], bool]
) -> Sequence[StoredNotification]:
    async with asyncio.timeout(60):
        while not met(found := await every(store)):
            await asyncio.sleep(LOOK_S)
    return found


def states(found: Sequence[StoredNotification]) -> list[str]:
    return [one.state for one in found]


async def test_each_recipient_is_told_of_what_it_wants(store: Store, post: Post) -> None:
    telling = notifier(store, post, DUTY, LAB)
    await telling.start()
    await unknown(store, "r1")
    await stop(store)
    await until(store, lambda found: states(found) == ["delivered"] * 3)
    assert sorted(post.titles("duty")) == ["r1: Nothing is heard of it", "the global stop was set"]
    assert post.titles("lab") == ["the global stop was set"]
    await telling.close()


async def test_what_happened_while_nobody_ran_is_told_later_and_only_once(store: Store, post: Post) -> None:
    first = notifier(store, post, DUTY)
    await first.start()
    await stop(store)
    await until(store, lambda found: states(found) == ["delivered"])
    await first.close()
    await stop(store, False)
    for _ in range(2):  # twice, as a service that is restarted
        again = notifier(store, post, DUTY)
        await again.start()
        await until(store, lambda found: states(found) == ["delivered"] * 2)
        await again.close()
    assert post.titles("duty") == ["the global stop was set", "the global stop was lifted"]


async def test_whoever_is_named_later_is_not_told_of_what_was(store: Store, post: Post) -> None:
    nobody = notifier(store, post)
    await nobody.start()
    await stop(store)
    telling = notifier(store, post, DUTY)
    await telling.start()
    await stop(store, False)
    await until(store, lambda found: states(found) == ["delivered"])
    assert post.titles("duty") == ["the global stop was lifted"]
    await telling.close()


async def test_two_instances_tell_it_once(
    store: Store, post: Post, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notifications, "SAME_NS", 0)  # the log's place alone keeps them apart
    other = Store(f"sqlite:///{tmp_path}/robomend.db")
    await other.start()
    both = [notifier(store, post, DUTY), notifier(other, post, DUTY)]
    for each in both:
        await each.start()
    for n in range(20):
        await unknown(store if n % 2 else other, f"r{n}")
    await until(store, lambda found: states(found) == ["delivered"] * 20)
    assert sorted(post.titles("duty")) == sorted(f"r{n}: Nothing is heard of it" for n in range(20))
    for each in both:
        await each.close()
    await other.close()


async def test_the_same_is_not_told_again_within_an_hour(store: Store, post: Post) -> None:
    telling = notifier(store, post, DUTY)
    await telling.start()
    await unknown(store, "r1")
    await unknown(store, "r1")
    await stop(store)  # comes after both
    await until(store, lambda found: len(found) == 2 and states(found) == ["delivered"] * 2)
    assert post.titles("duty").count("r1: Nothing is heard of it") == 1
    await telling.close()


async def test_what_does_not_arrive_is_tried_again_later(
    store: Store, post: Post, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robomend.notifications.notifier.FIRST_PAUSE_S", 600.0)
    post.answers = [Delivery(False, "answered 500")]
    telling = notifier(store, post, DUTY)
    await telling.start()
    await stop(store)
    [one] = await until(store, lambda found: bool(found and found[0].tries))
    assert (one.state, one.answer) == ("waiting", "answered 500")
    assert one.due_ns is not None
    assert one.due_ns >= one.created_ns + 600 * 10**9
    await store.write(lambda tx: notifications.put_off(tx, [one.number], "answered 500", by_ns=0))
    telling._seeker.wake()
    [one] = await until(store, lambda found: states(found) == ["delivered"])
    assert one.tries == 3
    await telling.close()


async def test_after_a_day_it_is_given_up(store: Store, post: Post, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robomend.notifications.notifier.GIVE_UP_S", 0.0)
    post.answers = [Delivery(False, "not reached: ConnectError")]
    telling = notifier(store, post, DUTY)
    await telling.start()
    await stop(store)
    [one] = await until(store, lambda found: states(found) == ["given-up"])
    assert (one.due_ns, one.answer) == (None, "not reached: ConnectError")
    await telling.close()


async def test_a_receiver_that_is_away_holds_up_nobody_else(store: Store, post: Post) -> None:
    hanging = asyncio.Event()

    async def deliver(recipient: Recipient, messages: Messages, settings: Settings) -> Delivery:
        if recipient.name == "duty":
            await hanging.wait()
        return await post(recipient, messages, settings)

    settings = Settings.model_validate({"notify": [DUTY, LAB]})
    telling = Notifier(store, settings, Metrics(), deliver)
    await telling.start()
    for active in (True, False, True):
        await stop(store, active)
    await until(store, lambda found: states(found).count("delivered") == 3)
    assert len(post.titles("lab")) == 3
    hanging.set()
    await until(store, lambda found: states(found).count("delivered") == 6)
    await telling.close()


async def test_what_falls_silent_together_is_told_together(store: Store, post: Post) -> None:
    def all_at_once(tx: Transaction) -> None:
        for n in range(30):
            tx.emit(Kind.ROBOT, f"r{n}", {"what": "health", "state": "unknown", "unknown": []})

    telling = notifier(store, post, DUTY)
    await telling.start()
    await store.write(all_at_once)
    await until(store, lambda found: states(found) == ["delivered"] * 30)
    assert [len(titles) for _, titles in post.sent] == [30]
    await telling.close()


async def test_no_more_waits_for_one_recipient_than_may(
    store: Store, post: Post, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notifications, "MOST_WAITING", 3)

    def keep(tx: Transaction) -> list[bool]:
        return [notifications.tell(tx, "duty", f"k{n}", {}) is not None for n in range(5)]

    assert await store.write(keep) == [True, True, True, False, False]


async def test_what_waits_for_somebody_who_is_named_no_more_is_given_up(store: Store, post: Post) -> None:
    await store.write(lambda tx: notifications.tell(tx, "gone", "k", {}))
    telling = notifier(store, post, DUTY)
    await telling.start()
    [one] = await until(store, lambda found: states(found) == ["given-up"])
    assert "do not name" in one.answer
    await telling.close()
