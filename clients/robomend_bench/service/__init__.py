"""Load on a running service, from outside: `robomend-bench service`.

Nothing in here uses the service's code, but for finding the example model.

wire.py      HTTP/1.1 over keep-alive sockets and event streams, as cheap as Python can
process.py   `robomend serve` as a process: started, announced, measured, killed
robots.py    robots that a fault comes to and leaves
fleet.py     open loop: so many robots, so many changes a second, whatever the service does
durable.py   closed loop: as many durable writes as it takes; NDJSON
hostile.py   clients that read a byte a second, half-open connections, idle streams
pages.py     open pages: what they cost at rest, and what a fleet suffers from them
overload.py  twice as many changes as it can take
attack.py    hostile clients of every role (attackers.py), and what an operator waits meanwhile
prober.py    an operator: health, readiness, the stop
companion.py  attackers and prober as processes of their own
stops.py     cancellations and global stops in the middle of real repairs
repairing.py  robots with much to repair, on emulated boards
measure.py   percentiles, memory
command.py   the command
"""
