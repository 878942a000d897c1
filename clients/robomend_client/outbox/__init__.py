"""Observations on their way to a service that may be away:
at once when it is there, from the disk when it is back.

Everything arrives in the order in which it was seen: while something waits in the buffer, new observations
wait behind it. Each batch carries its time and an Idempotency-Key, kept in the buffer too, so that a lost
answer or a crash never makes it count twice. What the service refuses for good (4xx) is dropped, counted and
told to `on_refused`: a bad sentence must not hold up all later ones.

    buffer = DiskBuffer("/var/lib/robot/observations")
    outbox = Outbox(client, "tedusar", buffer)
    outbox.observe(["not ok(scan)"])          # never raises for a service that is away
    outbox.flush()                            # now and then

backlog.py  what waits, and what was refused;  asynchronous.py  AsyncOutbox;  sync.py  Outbox, made from it
"""

from robomend_client.outbox.asynchronous import AsyncOutbox
from robomend_client.outbox.backlog import LATER, Refused
from robomend_client.outbox.sync import Outbox

__all__ = ["LATER", "AsyncOutbox", "Outbox", "Refused"]
