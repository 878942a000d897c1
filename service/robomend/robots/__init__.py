"""The robots of the service: OBS in, diagnoses out. Begin with robots.py.

robots.py         all robots: a batch into OBS and onto the disk;  memory.py  which are in memory, how fresh
robot.py          what is held of one robot in memory, and its states, as tables
configuration.py  what is configured of it;  configuring.py  what that must hold
health.py         what its state is called
batches.py        sentences → literals;  boards.py  a board's channels → literals
diagnosing.py     when a robot is diagnosed;  diagnoser.py  by which engine, within which time; as published
systems.py        models, compiled once for all robots that have them
clock.py          a clock that never goes back;  dating.py    sources and their clocks
"""
