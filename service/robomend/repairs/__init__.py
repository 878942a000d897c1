"""Repairs: each plan carried out, written down, looked at; the loop itself is robomend/cycle.py.

states.py            the states of a repair and of its steps, as tables
repairs.py           what people, pages and agents may ask of the repairs of all robots
robot_repairs.py     which robots are ours; of each, when a repair begins, and that it ends
live_repair.py       one repair: what the loop asks for, answered by robots, store, planners and executors
reasons.py           whether there is a reason to begin one by itself
choosing.py          the situation that a choice is made in
execution.py         a plan, step by step;  execution_values.py  what that needs and reports
acts.py              its journal, and how often an act may be repeated
looking.py           OBS meanwhile: preconditions, effects, contradictions
executors/           who carries out an action;  agent_queue.py  the actions that wait for agents
record.py            what is written down, before an action is sent and after;  repair_json.py  as JSON
remembering.py       what was tried, whether it helped, and what is left alone
hearing.py           whether the observers have spoken
reentry.py           what a crash left: settled, asked, taken up again; the questions to people
signals.py           what reaches a running repair: a yes, a cancellation, the stop
conclusions.py       what a repair came to, in words
"""
