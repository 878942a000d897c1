"""When a call may be sent again, and after how long. No sockets, no clocks.

A call that never reached the service may always be repeated. One whose answer got lost may be repeated only
if doing it twice is the same as doing it once: GET, PUT and DELETE are, and a POST is when it carries an
Idempotency-Key, which all POSTs of this client do: one key for all tries of one call.

The waits grow exponentially with "equal jitter" (half fixed, half random), so that a fleet whose service
comes back does not knock at the same moment: M. Brooker, Exponential backoff and jitter, AWS Architecture
Blog, 2015.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field

from robomend_client.rest.errors import (
    ApiError,
    ClientError,
    NotTheService,
    TooManyRequests,
    Unavailable,
    Unreachable,
)


@dataclass(frozen=True, slots=True)
class Retry:
    """How often and how patiently a call is repeated; `times=0` never repeats."""

    times: int = 4
    first_s: float = 0.1
    factor: float = 2.0
    longest_s: float = 5.0

    def wait_s(self, failures: int, draw: float) -> float:
        """Return the wait after the `failures`-th failure (from 1); `draw` is uniform in [0, 1)."""
        # Bounded before the power: a client that fails for days must not overflow.
        exponent = min(failures - 1, 64)
        full = min(self.longest_s, self.first_s * self.factor**exponent)
        return full * (0.5 + 0.5 * draw)


NEVER = Retry(times=0)


@dataclass(slots=True)
class Attempts:
    """The tries of one call."""

    policy: Retry
    repeatable: bool
    failures: int = 0
    random: random.Random = field(default_factory=random.Random)

    def after(self, failure: ClientError) -> float:
        """Return the seconds to wait before the next try; raise `failure` if there is to be none."""
        self.failures += 1
        if self.failures > self.policy.times or not self._worth_it(failure):
            raise failure
        wait_s = self.policy.wait_s(self.failures, self.random.random())
        asked_s = failure.retry_after_s if isinstance(failure, ApiError) else None
        if asked_s is not None and asked_s > 12 * self.policy.longest_s:
            raise failure  # the caller decides about minutes of silence
        return max(wait_s, asked_s or 0.0)

    def _worth_it(self, failure: ClientError) -> bool:
        if isinstance(failure, NotTheService):
            return False
        if isinstance(failure, TooManyRequests):
            return True  # refused before anything was done
        return self.repeatable and isinstance(failure, Unreachable | Unavailable)
