"""From logs of a healthy robot to a first model and its observers.

    logs ──► what was published, by whom, when, which values ──► numbers, each with its evidence ──► DRAFT/
     gathering.py                                        rates, delays, matches, ranges         draft.py
        │                                                                                          │
        └── stretches.py: three of four are learned from, the fourth is held back ──► a trial ◄────┘

tails.py        what is rare, beyond what was seen
rates.py        the rate of a topic, how far it strays, how long it is silent
delays.py       which topic answers which, and how fast
matches.py      values whose trends are alike
ranges.py       the numbers in /diagnostics
words.py        names and numbers as YAML has them
model.py        the graph, and what else the model must declare
draft.py        the observers' file
update.py       changes of a file that exists, as a diff
learning.py     all of it, in order; the drafted observers over what was held back: the false alarms
"""
