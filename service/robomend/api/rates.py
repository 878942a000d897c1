"""Not too often: a token bucket."""

from __future__ import annotations

import math
import time


class Bucket:
    """A token bucket."""

    __slots__ = ("_policy", "burst", "filled_at", "rate", "tokens")

    def __init__(self, rate: float, burst: int) -> None:
        """`rate` tokens come a second, up to `burst`."""
        self.rate, self.burst = rate, burst
        self.tokens = float(burst)
        self.filled_at = time.monotonic()
        full_s = math.ceil(burst / rate)
        self._policy = (b"ratelimit-policy", b'"key";q=%d;w=%d' % (burst, full_s))

    def headers(self) -> tuple[tuple[bytes, bytes], ...]:
        """Return what a client is told of it (draft-ietf-httpapi-ratelimit-headers)."""
        back_s = math.ceil((self.burst - self.tokens) / self.rate)
        return self._policy, (b"ratelimit", b'"key";r=%d;t=%d' % (self.tokens, back_s))

    def take(self) -> float:
        """Take one token; return 0, or the seconds until there is one."""
        now = time.monotonic()
        self.tokens = min(self.burst, self.tokens + (now - self.filled_at) * self.rate)
        self.filled_at = now
        if self.tokens >= 1:
            self.tokens -= 1
            return 0.0
        return (1 - self.tokens) / self.rate
