"""The repair loops of the robots that this instance owns. The loop itself is robomend/cycle.py.

custody.py      all loops: whose they are, and what people may ask of them
keeper.py       one robot's: when a repair begins, and that it ends
case.py         one repair: what the loop asks for, answered by fleet, store, planners and executors
choosing.py     the situation that a choice is made in
hearing.py      whether the observers have spoken
reentry.py      what a crash left: settled, asked, taken up again; the questions to people
signals.py      what reaches a running repair: a yes, a cancellation, the stop
conclusions.py  what a repair came to, in words
"""
