"""Load on a running service, from outside: `robomend-bench service`.

Nothing in here uses the service's code, but for finding the example model.

command.py   the command and its parts
process.py   `robomend serve` as a process: started, announced, measured, killed; percentiles
wire.py      HTTP/1.1 over keep-alive sockets and event streams, as cheap as Python can
load.py      robots that faults come to and leave: open loop, closed loops, NDJSON, overload, growth
attack.py    hostile clients of every role and without a key, and what an operator waits meanwhile
stops.py     cancellations and global stops in the middle of real repairs
"""
