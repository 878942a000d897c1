"""A repeated action id gets the first result, and acts only once."""

from __future__ import annotations

import asyncio
from collections import OrderedDict

from robomend_client.actions import Action, ActionResult, Executor, Feedback


class Once:
    """Wraps an executor so that it sees each action id once.

    A second call while the first is under way waits for the same result. An action that was cancelled has
    no result and may be sent again: whether it acted is for OBS to say. The last `keep` results are
    remembered.
    """

    def __init__(self, executor: Executor, keep: int = 1024) -> None:
        self._executor = executor
        self._keep = keep
        self._results: OrderedDict[str, asyncio.Future[ActionResult]] = OrderedDict()

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        first = self._results.get(action.id)
        if first is not None and not first.cancelled():
            return await asyncio.shield(first)
        answer: asyncio.Future[ActionResult] = asyncio.get_running_loop().create_future()
        self._results[action.id] = answer
        while len(self._results) > self._keep:
            self._results.popitem(last=False)
        try:
            result = await self._executor.execute(action, feedback)
        except BaseException:  # a cancellation too; it is raised again, and the next one who asks begins anew
            self._results.pop(action.id, None)
            answer.cancel()
            raise
        answer.set_result(result)
        return result
