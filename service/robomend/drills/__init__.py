"""Drills: faults that are planted on purpose, watched, and undone; repairs' siblings.

permission.py  whether a fault may be planted now
hands.py       who plants and undoes it: the node's agent, the power board or its emulator, a person
watching.py    what becomes of it: what showed, what was diagnosed, what repaired it
record.py      the states of a drill, and what is written of it, with its event and audit entry
one_drill.py   one drill, from its beginning or from where a crash left it
drills.py      those of all robots that this instance owns; what the HTTP interface asks of them
"""
