"""Logs to diagnoses: which of these logs shows which fault, when, and is it the same one?

    logs ──► literals ──► OBS ──► codes ──► distinct codes ──► diagnoses ──► intervals ──► OUT/
     logs/                └── track.py       └── answers.py                   └── parts.py

main.py, commands.py   the command robomend-batch
logs/                  the kinds of logs: literals in NDJSON, CSV, Parquet; messages in .bag, .mcap, .db3
observing.py           the observers of messages, from an agent's file
words.py               from sentences to sensors: which bits of a code a literal is
track.py               OBS ⊕ over a log, without a step of Python for each row
answers.py             what the distinct codes come to
parts.py               equal neighbours are one interval, or one explanation for a window; files beside
one_log.py             all of it for one log
manifest.py            what a folder of results was made of, and which logs are done
starting.py, pool.py   worker processes, which may die
run.py                 all logs, in order
learn/                 from logs of a healthy robot to a first model and its observers
priors.py              from confirmed faults to a model's priors
results.py             a folder of results, read again; report.py, query_command.py
"""
