"""The agent's side of executors: pull an action, carry it out once, tell how it went.

    POST …/actions/next ─► known id? ── finished ──► its first result, again
         (long poll)           │    └── under way ─► nothing: its result will come
                               └─ new ─► executor ──► remembered ──► POST …/result, until it arrives

Several actions may be under way at once; those on one process take turns (processes.py). An executor has
`action.timeout_s` and not a moment more. While it works, what it says goes out as feedback, and the latest of
it again twice a second; when the service answers 409 the action has been withdrawn, and is given up if it can
be: before it has begun to act, and later if its executor leaves things as they were. What can be done is in
executors/.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Collection
from typing import Protocol

from robomend_client.actions import (
    CANCELLED,
    FAILED,
    TIMED_OUT,
    Action,
    ActionResult,
    Feedback,
    Orders,
    Settle,
)
from robomend_client.agent.executors.base import Executors
from robomend_client.agent.memory import FirstResults
from robomend_client.literals import Atom
from robomend_client.observers import Driver
from robomend_client.outbox import LATER
from robomend_client.python310 import end, timeout
from robomend_client.rest import calls
from robomend_client.rest.asynchronous import AsyncClient
from robomend_client.rest.errors import ClientError, NotFound, StateConflict
from robomend_client.rest.retry import NEVER, Retry

log = logging.getLogger(__name__)

WAIT_S = 20.0
"""How long the service may hold back its answer when there is nothing to do."""

MOST_AT_ONCE = 64
PATIENCE = Retry(longest_s=2.0)

TELL_S = 600.0
"""How long a result is offered to a service that is away."""

BEAT_S = 0.5
"""How often the service hears that an action is under way, and may answer that it is withdrawn: twice in the
second after which what was stopped must be cut off."""


class Observing(Protocol):
    """The observers that the service may ask to judge anew; agent/watch.py is the agent's."""

    @property
    def driver(self) -> Driver:
        """What they speak of, and how fast."""
        ...

    def settle(self, n: int, atoms: Collection[Atom]) -> None:
        """Judge these atoms anew from now on."""
        ...

    @property
    def starved_ns(self) -> int | None:
        """Since when this computer is starved; None: it is not."""
        ...

    @property
    def starved_changed(self) -> asyncio.Event:
        """Set when that changes."""
        ...


class Actions:
    """Carries out the actions meant for this agent."""

    def __init__(
        self,
        client: AsyncClient,
        robot: str,
        agent: str,
        executors: Executors,
        memory: FirstResults,
        host: str | None = None,
        watch: Observing | None = None,
    ) -> None:
        """`watch` has the observers that the service may ask to judge anew."""
        self._client = client
        self._robot = robot
        self._agent = agent
        self._host = host
        self._executors = executors
        self._memory = memory
        self._watch = watch
        self._atoms = {} if watch is None else {str(atom): atom for atom in watch.driver.atoms}
        self._settled: int | None = None  # the newest `n` that was asked for
        self._under_way: dict[str, asyncio.Task[None]] = {}
        self._tellings: dict[str, _Telling] = {}
        self._taken = (0, f"taken by agent {agent}")
        self._room = asyncio.Semaphore(MOST_AT_ONCE)

    async def pull(self) -> None:
        """Ask for actions and start them, for ever."""
        failures = 0
        while True:
            async with self._room:  # with as many as this under way, the rest stays with the service
                pass
            try:
                orders = await self._ask()
            except ClientError as error:
                failures += 1
                level = logging.WARNING if failures in (1, 10) else logging.DEBUG
                log.log(level, "no actions from the service: %s", error)
                await asyncio.sleep(PATIENCE.wait_s(failures, 0.5))
                continue
            failures = 0
            action = orders.action
            if orders.settle is not None and not self._settle(orders.settle) and action is None:
                await asyncio.sleep(0.2)  # it would come back at once, and round and round
            if action is not None:
                again = action.id in self._under_way
                self.take(action)
                await self._accept(action, again)

    def take(self, action: Action) -> None:
        """Start `action`, unless its id is known already."""
        if action.id in self._under_way:
            return
        task = asyncio.create_task(self._carry_out(action), name=f"action {action.id}")
        self._under_way[action.id] = task
        task.add_done_callback(lambda _: self._under_way.pop(action.id, None))

    async def close(self) -> None:
        """Give up what is under way; its results will be asked for again."""
        await end(list(self._under_way.values()))

    async def run(self, action: Action, feedback: Feedback) -> ActionResult:
        """Carry out `action` if this agent may; never later than its time-out."""
        executor = self._executors.find(action)
        if isinstance(executor, ActionResult):
            return executor
        try:
            async with timeout(action.timeout_s):
                return await executor.execute(action, feedback)
        except TimeoutError:
            return ActionResult(TIMED_OUT, f"{action} was not done within {action.timeout_s:g} s")
        except Exception as error:  # anybody's executor may raise anything
            log.warning("%s failed", action, exc_info=not isinstance(error, OSError))
            return ActionResult(FAILED, f"{action}: {type(error).__name__}: {error}")

    async def _accept(self, action: Action, again: bool) -> None:
        """Say that the action has arrived: until then the service gives it to every poll."""
        telling = self._tellings.get(action.id)
        number, message = self._taken if telling is None else telling.latest
        try:
            await self._client.send(calls.feedback(action.id, number, message), NEVER)
        except StateConflict:
            pass  # its result was faster
        except ClientError as error:
            log.debug("%s: not acknowledged: %s", action.id, error)
            again = True
        if again:
            await asyncio.sleep(0.2)  # it would come back at once, and round and round

    # --- inside ----------------------------------------------------------------------------------------

    async def _ask(self) -> Orders:
        """Ask what there is to do; of what the poll says of this computer, the service hears at once."""
        if self._watch is None:
            return await self._client.send(self._poll(), NEVER)
        self._watch.starved_changed.clear()
        asking = asyncio.create_task(self._client.send(self._poll(), NEVER))
        changed = asyncio.create_task(self._watch.starved_changed.wait())
        try:
            await asyncio.wait({asking, changed}, return_when=asyncio.FIRST_COMPLETED)
            return await asking if asking.done() else Orders()
        finally:
            await end([asking, changed])

    def _poll(self) -> calls.Call[Orders]:
        observes = []
        for name, atom in self._atoms.items():
            assert self._watch is not None
            detection_s, settling_s = self._watch.driver.delays_s(atom)
            observes.append(
                {"atom": name, "detection_s": round(detection_s, 3), "settling_s": round(settling_s, 3)}
            )
        return calls.poll(
            self._robot,
            self._agent,
            self._host,
            self._executors.can,
            observes,
            WAIT_S,
            self._settled,
            self._executors.takes_s,
            None if self._watch is None else self._watch.starved_ns,
        )

    def _settle(self, settle: Settle) -> bool:
        """Have observers judge anew; False for an `n` that came before: the service may repeat it."""
        if settle.n == self._settled or self._watch is None:
            return False
        self._settled = settle.n
        log.debug("settle %d: %s", settle.n, ", ".join(settle.atoms))
        self._watch.settle(settle.n, [self._atoms[name] for name in settle.atoms if name in self._atoms])
        return True

    async def _carry_out(self, action: Action) -> None:
        result = self._memory.get(action.id)
        if result is None:
            async with self._room:
                log.info("%s: %s", action.id, action)
                telling = self._tellings[action.id] = _Telling(self._client, action.id, self._taken)
                try:
                    result = self._memory.remember(action.id, await self._unless_withdrawn(action, telling))
                finally:
                    del self._tellings[action.id]
                    await telling.close()
                log.info("%s: %s → %d %s", action.id, action, result.code, result.message)
        await self._tell(action.id, result)

    async def _unless_withdrawn(self, action: Action, telling: _Telling) -> ActionResult:
        """Carry out `action`; give it up when the service does not want it any more."""
        work = asyncio.create_task(self.run(action, telling.tell))
        withdrawn = asyncio.create_task(telling.withdrawn.wait())
        try:
            await asyncio.wait({work, withdrawn}, return_when=asyncio.FIRST_COMPLETED)
            executor = self._executors.find(action)
            gives_up = not isinstance(executor, ActionResult) and executor.gives_up
            if work.done() or (telling.acts and not gives_up):
                return await work
            work.cancel()
            await asyncio.wait({work})
            if not work.cancelled():
                return work.result()
            return ActionResult(CANCELLED, f"{action} was withdrawn by the service and given up")
        finally:
            work.cancel()
            withdrawn.cancel()
            await asyncio.gather(work, withdrawn, return_exceptions=True)

    async def _tell(self, action_id: str, result: ActionResult) -> None:
        """Report a result until it has arrived; the first report counts, so telling twice does no harm."""
        began = time.monotonic()
        failures = 0
        while True:
            try:
                await self._client.send(calls.result(action_id, result), NEVER)
                return
            except (NotFound, StateConflict) as error:
                log.warning("the service knows nothing of %s any more: %s", action_id, error)
                return
            except LATER as error:
                failures += 1
                why: ClientError = error
            except ClientError as error:
                log.warning("the result of %s was refused: %s", action_id, error)
                return
            log.log(logging.WARNING if failures == 1 else logging.DEBUG, "%s: %s", action_id, why)
            if time.monotonic() - began > TELL_S:
                log.error("the result of %s was not taken within %g s", action_id, TELL_S)
                return  # it is remembered: if the service still wants it, it asks with the same id
            await asyncio.sleep(PATIENCE.wait_s(failures, 0.5))


class _Telling:
    """Feedback of one action, sent in order beside it; what does not get through is not worth waiting for.

    The latest is sent again with each beat, so that it gets through in the end and withdrawals are heard of.
    """

    acts = False  # the handler has said something: it is past waiting for its turn

    def __init__(self, client: AsyncClient, action_id: str, first: tuple[int, str]) -> None:
        self.latest = first
        self._client = client
        self._action_id = action_id
        self._queue: asyncio.Queue[tuple[int, str]] = asyncio.Queue(maxsize=16)
        self.withdrawn = asyncio.Event()
        self._closed = False
        self._task = asyncio.create_task(self._send())

    def tell(self, number: int, message: str) -> None:
        self.acts = True
        self.latest = (number, message)
        if not self._queue.full():
            self._queue.put_nowait((number, message))

    async def close(self) -> None:
        self._closed = True  # should the cancellation be lost, it ends with the call that is under way
        await end([self._task])

    async def _send(self) -> None:
        while not self._closed:
            number, message = self.latest
            with contextlib.suppress(TimeoutError):
                async with timeout(BEAT_S):
                    number, message = await self._queue.get()
            try:
                await self._client.send(calls.feedback(self._action_id, number, message), NEVER)
            except StateConflict:
                self.withdrawn.set()
                return
            except ClientError as error:
                log.debug("feedback of %s was not taken: %s", self._action_id, error)
