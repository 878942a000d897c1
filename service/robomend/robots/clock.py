"""The clock of the process, by which OBS is ordered and grows stale.

After a restart it begins no earlier than what a robot's OBS holds.
"""

from __future__ import annotations

from robomend_client.clock import Clock

CLOCK = Clock()

AHEAD_NS = 60 * 10**9
"""How far in the future a client's clock may be: an entry from the future outlives everything older."""
