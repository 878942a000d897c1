"""The first result of each action: an action id that comes again gets it again, and nothing acts twice.

The newest `limit` results are kept, in memory and, one JSON line each, in a file that survives the agent. A
torn last line (the power went) is skipped: that action's result never left this machine.
"""

from __future__ import annotations

import json
import logging
import os
from collections import OrderedDict
from pathlib import Path

from robomend_client.actions import ActionResult

log = logging.getLogger(__name__)


class FirstResults:
    """What each action id led to."""

    def __init__(self, file: Path, limit: int = 1000) -> None:
        self._file = file
        self._limit = limit
        self._results: OrderedDict[str, ActionResult] = OrderedDict()
        self._lines = 0
        self._load()

    def get(self, action_id: str) -> ActionResult | None:
        return self._results.get(action_id)

    def remember(self, action_id: str, result: ActionResult) -> ActionResult:
        """Keep `result` unless there is one already; return the one that counts."""
        first = self._results.get(action_id)
        if first is not None:
            return first
        self._results[action_id] = result
        while len(self._results) > self._limit:
            self._results.popitem(last=False)
        try:
            if self._lines >= 2 * self._limit:
                self._rewrite()
            else:
                self._append(action_id, result)
        except OSError as error:  # a full disk: memory still serves until the agent ends
            log.error("cannot write %s: %s", self._file, error)
        return result

    def _append(self, action_id: str, result: ActionResult) -> None:
        with self._file.open("a") as file:
            file.write(_line(action_id, result))
            file.flush()
            os.fsync(file.fileno())  # before the result is reported: a few a minute, so it may take its time
        self._lines += 1

    def _rewrite(self) -> None:
        temporary = self._file.with_suffix(".new")
        with temporary.open("w") as file:
            file.writelines(_line(*item) for item in self._results.items())
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(self._file)
        self._lines = len(self._results)

    def _load(self) -> None:
        try:
            lines = self._file.read_text().splitlines()
        except FileNotFoundError:
            return
        for line in lines:
            try:
                action_id, code, message = json.loads(line)
                self._results.setdefault(str(action_id), ActionResult(int(code), str(message)))
            except (ValueError, TypeError):
                log.warning("%s: a line that cannot be read was skipped", self._file)
        while len(self._results) > self._limit:
            self._results.popitem(last=False)
        self._rewrite()  # also ends a torn line, which the next append would otherwise be glued to


def _line(action_id: str, result: ActionResult) -> str:
    return json.dumps([action_id, result.code, result.message]) + "\n"
