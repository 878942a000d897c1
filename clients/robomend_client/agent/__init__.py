"""The agent: robomend on the robot. `robomend-agent CONFIG.yaml`; config.py describes the file.

agent.py        how the parts hang together; read it first
watch.py        the observers, live          feeds.py        where their samples come from; usage.py
broker.py       messages of nodes            processes.py    one process: start, see, stop
reporter.py     what goes to the service     supervisor.py   all of them; spawn.py and guard.py below it
actions.py      what comes from it           memory.py       the first result of each action
executors/      who carries it out
"""
