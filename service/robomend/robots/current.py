"""The diagnosis that a robot has now, and whether a new one says anything new."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, NamedTuple

from robomend.diagnosis.result import healthy
from robomend.robots.diagnoser import Diagnosed
from robomend.store import Transaction, diagnoses
from robomend.store.encoding import Common, Encoded, to_json
from robomend.store.records import StoredDiagnosis


class Current(NamedTuple):
    """A diagnosis of one revision of OBS, as it is published."""

    revision: int
    model_version: str
    time_ns: int
    result: dict[str, Any] | None  # JSON
    fault: dict[str, Any] | None  # why there is none
    answer: Diagnosed | None  # None: made by another instance, or before a restart
    expected_stopped: tuple[str, ...] = ()  # what the diagnosis does not expect to run

    @classmethod
    def of(
        cls, revision: int, model_version: str, answer: Diagnosed, expected_stopped: tuple[str, ...]
    ) -> Current:
        """Return the diagnosis that was just made."""
        fault = None if answer.fault is None else {"code": answer.fault.code, "detail": str(answer.fault)}
        return cls(revision, model_version, time.time_ns(), answer.json, fault, answer, expected_stopped)

    @classmethod
    def published(cls, revision: int, time_ns: int, data: Mapping[str, Any]) -> Current:
        """Return a diagnosis that was made by another instance, or before a restart."""
        version = data.get("model_version") or ""
        stopped = tuple(data.get("expected_stopped", ()))
        return cls(revision, version, time_ns, data.get("result"), data.get("fault"), None, stopped)

    @classmethod
    def stored(cls, stored: StoredDiagnosis) -> Current:
        """Return a diagnosis that the store has."""
        return cls.published(stored.revision, stored.time_ns, stored.result)

    @property
    def bad_sets(self) -> tuple[tuple[str, ...], ...] | None:
        """What each diagnosis blames; None without a result."""
        if self.answer is not None:
            return self.answer.bad_sets
        if self.result is None:
            return None
        return tuple(tuple(diagnosis["bad"]) for diagnosis in self.result["diagnoses"])

    @property
    def healthy(self) -> bool:
        """OBS is what a healthy system would show; False without a result as well."""
        return healthy(self.bad_sets or ()) if self.answer is None else self.answer.healthy

    def says_the_same_as(self, before: Current | None) -> bool:
        """Return whether this is no news, whatever time it took."""
        if before is None or before.fault != self.fault or before.model_version != self.model_version:
            return False
        if before.expected_stopped != self.expected_stopped:
            return False
        if before.answer is not None and self.answer is not None:
            return before.answer.key == self.answer.key
        if before.result is None or self.result is None:
            return before.result is self.result
        return {**before.result, "elapsed_s": 0} == {**self.result, "elapsed_s": 0}

    def announce(self, robot: str, tx: Transaction) -> None:
        """Write it, with its event."""
        diagnoses.record(tx, robot, self.revision, self.event_data())

    def event_data(self) -> Encoded:
        """Return what table and event hold of it; equal answers have all but revision and time in common."""
        data = {
            "revision": self.revision,
            "model_version": self.model_version,
            "result": self.result,
            "fault": self.fault,
            "expected_stopped": list(self.expected_stopped),
        }
        if self.answer is None:
            return Encoded(data)
        return Encoded.around(
            data, f'{{"revision":{self.revision},', self._common(self.answer), f"{self.answer.took or ''}}}"
        )

    def _common(self, answer: Diagnosed) -> Common:
        of = (self.model_version, self.expected_stopped)
        common = answer.kept_as.get(of)
        if common is None:
            rest = to_json(
                {
                    "model_version": self.model_version,
                    "fault": self.fault,
                    "expected_stopped": list(self.expected_stopped),
                }
            )
            result = "null" if answer.took is None else answer.key
            common = answer.kept_as[of] = Common(f'{rest[1:-1]},"result":{result}')
        return common
