"""The robots of the service: OBS in, diagnoses out. Begin with fleet.py.

robots.py        what is configured of one robot;  robot_state.py  what is held of it in memory
batches.py       sentences → literals;  boards.py  a board's channels → literals
fleet.py         all robots: accept, keep, tell;  memory.py  which are in memory, and how fresh
configuring.py   what a configuration must hold;  following.py  what other instances did
diagnosing.py    when a robot is diagnosed;  diagnoser.py  by which engine, within which time
    solvers.py       engines in worker processes, each kept warm where it was last used
systems.py       models, compiled once for all robots that have them
oneshots.py      questions without a robot
clock.py         a clock that never goes back
turnstile.py     waiting for a revision
"""
