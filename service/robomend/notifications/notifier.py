"""What people are to be told is written down, and sent until it has arrived.

    event ──► wake ──► one transaction: a row for each recipient that wants it, and how far the log was looked
                       through, so that a crash tells nothing twice and forgets nothing
    row due ──► claimed ──► delivered │ put off: 5 s, 10 s, … 15 min │ given up after a day

Every instance does this; whoever looks first writes the rows, and whoever claims a row sends it. An instance
that dies while it sends leaves the row claimed for two minutes. So a message may come twice, after a crash:
its id says so. What is due for one recipient goes out together, so that a hundred robots that fall silent are
one mail.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from functools import partial

import structlog

from robomend.errors import NotFound, RobomendError
from robomend.metrics import Metrics
from robomend.notifications.delivery import Delivery, Messages, deliver
from robomend.notifications.notices import KINDS, Notice, message, notice_of, trial_notice
from robomend.notifications.recipients import Recipient, recipients
from robomend.poller import Seeker
from robomend.settings import Settings
from robomend.store import Store, Transaction, events, notifications
from robomend.store.records import AuditEntry, StoredNotification
from robomend_client.events import Event

log = structlog.get_logger("robomend.notifications.notifier")

TOGETHER = 100
"""Notifications in one message."""
LOOK_S = 30.0
"""How often it looks what is due, when nothing wakes it."""
NOTE_S = 60.0
"""How often it notes how far the log was looked through, when there is nothing to tell."""
FIRST_PAUSE_S = 5.0
LONGEST_PAUSE_S = 900.0
GIVE_UP_S = 86_400.0
CLOSE_S = 3.0

Deliver = Callable[[Recipient, Messages, Settings], Awaitable[Delivery]]


class Notifier:
    """See the module. Belongs to one event loop."""

    def __init__(
        self, store: Store, settings: Settings, metrics: Metrics, deliver: Deliver = deliver
    ) -> None:
        self._store = store
        self._settings = settings
        self._metrics = metrics
        self._deliver = deliver
        self.recipients = recipients(settings)
        self._heard: deque[Event] = deque()
        self._heard_to = 0
        self._noted_s = 0.0
        self._sending: dict[str, asyncio.Task[None]] = {}
        self._catch_up_to: int | None = None  # the newest event when this began
        self._seeker = Seeker(self._look, "notifications", LOOK_S)
        self._end: Callable[[], None] = lambda: None

    async def start(self) -> None:
        """Begin; without recipients there is nothing to do, and nobody is told later of what is now."""
        if not self.recipients:
            if await self._store.read(notifications.looked_to) is not None:
                await self._store.write(notifications.forget)
            return
        self._end = self._store.subscribe(self._hear)
        newest = (await self._store.read(events.kept)).newest
        if await self._store.read(notifications.looked_to) is None:
            await self._store.write(partial(notifications.look_to, event=newest))
        self._catch_up_to = newest
        self._seeker.start()

    async def close(self) -> None:
        """Let go; what is on its way is told again, by whoever comes next."""
        self._end()
        await self._seeker.close(self._sending.values(), CLOSE_S)

    async def test(self, recipient: str, by: str) -> int:
        """Tell one recipient that this is a test, and return the notification's number.

        Raises:
            NotFound: the settings name nobody so.
        """
        if recipient not in self.recipients:
            raise NotFound(f"the setting notify names no recipient {recipient!r}")
        notice = trial_notice(recipient, by, time.time_ns())

        def write(tx: Transaction) -> int | None:
            tx.note(AuditEntry(by, "notification.test", recipient))
            return notifications.tell(tx, recipient, notice.key, notice.data)

        number = await self._store.write(write)
        if number is None:
            raise NotFound(f"too much waits for {recipient!r} already")
        self._seeker.wake()
        return number

    # --- what is to be told

    def _hear(self, heard: Sequence[Event]) -> None:
        self._heard_to = heard[-1].id
        told = [event for event in heard if event.kind in KINDS]
        if told:
            self._heard.extend(told)
            self._seeker.wake()

    async def _look(self) -> float:
        """Write down what is to be told, and send what is due; return how long nothing else is."""
        if self._catch_up_to is not None:
            await self._store.write(partial(notifications.disown, known=self.recipients, answer=GONE))
            await self._catch_up(self._catch_up_to)
            self._catch_up_to = None
        await self._note_heard()
        return await self._send()

    async def _catch_up(self, newest: int) -> None:
        """Look at what came while no instance ran."""
        last = await self._store.read(notifications.looked_to)
        while last is not None and last < newest:
            found = await self._store.read(events.after, last)
            if not found:
                return
            last = found[-1].id
            await self._write([event for event in found if event.kind in KINDS], last)

    async def _note_heard(self) -> None:
        """Write down what is to be told of the events that were heard."""
        heard, heard_to = tuple(self._heard), self._heard_to
        now_s = time.monotonic()
        if heard or (heard_to and now_s - self._noted_s >= NOTE_S):
            if heard_to > (await self._store.read(notifications.looked_to) or 0):
                await self._write(heard, heard_to)
            self._noted_s = now_s
        for _ in heard:
            self._heard.popleft()

    async def _write(self, found: Sequence[Event], to: int) -> None:
        notices = [(event.id, notice) for event in found if (notice := notice_of(event)) is not None]
        await self._store.write(partial(self._tell, notices, to))

    def _tell(self, notices: Sequence[tuple[int, Notice]], to: int, tx: Transaction) -> None:
        before = notifications.look_to(tx, to) or 0
        for event, notice in notices:
            if event > before:
                for recipient in self.recipients.values():
                    if recipient.wants(notice):
                        notifications.tell(tx, recipient.name, notice.key, notice.data)

    # --- what is due

    async def _send(self) -> float:
        """Begin to send what is due, and return when to look again."""
        due = await self._store.read(notifications.next_due)
        now_ns = time.time_ns()
        pause_s = LOOK_S
        for name, due_ns in due.items():
            recipient = self.recipients.get(name)
            if recipient is None or name in self._sending:
                continue
            if due_ns > now_ns:
                pause_s = min(pause_s, (due_ns - now_ns) / 1e9)
                continue
            found = await self._store.write(partial(notifications.due, recipient=name, limit=TOGETHER))
            if found:
                task = asyncio.create_task(self._send_to(recipient, found), name=f"telling {name}")
                self._sending[name] = task
                task.add_done_callback(partial(self._sent, name))
        return pause_s

    def _sent(self, name: str, _: asyncio.Task[None]) -> None:
        del self._sending[name]
        self._seeker.wake()

    async def _send_to(self, recipient: Recipient, found: Sequence[StoredNotification]) -> None:
        url = self._settings.public_url
        messages = [message(one.number, one.data, url) for one in found]
        try:
            outcome = await self._deliver(recipient, messages, self._settings)
            await self._store.write(partial(_note, found, outcome, time.time_ns()))
        except RobomendError as error:
            log.warning("not noted whether it arrived", recipient=recipient.name, code=error.code)
            return
        except Exception:  # of one recipient's address or server: the others are told all the same
            log.exception("telling", recipient=recipient.name)
            return
        self._metrics.notifications.labels("delivered" if outcome.delivered else "failed").inc(len(found))
        if not outcome.delivered:
            log.warning(
                "not delivered", recipient=recipient.name, answer=outcome.answer, notifications=len(found)
            )


GONE = "the settings do not name this recipient any more"


def _note(found: Sequence[StoredNotification], outcome: Delivery, now_ns: int, tx: Transaction) -> None:
    """Write what came of a delivery."""
    if outcome.delivered:
        notifications.delivered(tx, [one.number for one in found], outcome.answer)
        return
    for one in found:
        if now_ns - one.created_ns > GIVE_UP_S * 1e9:
            notifications.give_up(tx, [one.number], outcome.answer)
        else:
            pause_s = min(FIRST_PAUSE_S * 2**one.tries, LONGEST_PAUSE_S)
            notifications.put_off(tx, [one.number], outcome.answer, by_ns=int(pause_s * 1e9))
