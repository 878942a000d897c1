"""The score of diagnosis and repair: faults planted into simulated robots, `robomend-bench faults`.

The service, its HTTP interface, the agents' protocol, the observers and the power board are the real ones.
Only the robots' innards are simulated, and what is true of them is known. docs/score.md defines the score.

The robots
    anatomy.py     what a robot is made of
    condition.py   the state that it is in, what acts change, what is seen: no times
    kinds.py       what can be wrong with one component
    classes.py     the classes of faults with their shares, and scenarios drawn from them
    robot.py       robots by name: files in robots/, and generated ones
    body.py        the same in time: messages, starts, boots
What could be known and done
    universe.py    explanations, suspects, what is told apart
    policy.py      the cheapest repair of one who sees only what can be observed
A trial
    observing.py   the observers of a host: the one place where literals are made
    agents.py      the robot's agents, towards the service
    live.py        a robot in real time, and its board
    record.py      what happened
    trial.py, stretches.py, bench.py   one trial; robots without faults; many side by side
    standins.py    scripted agents in place of the service
Exemplars of others
    sunset.py, suave.py, exemplars.py   their systems, the rival's rules, and both with the service
The score
    scoring.py, intervals.py, report.py, command.py
"""
