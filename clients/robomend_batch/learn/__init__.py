"""From logs of a healthy robot to what was heard of it, and by that to a first model and its observers.

    logs ──► what was published, by whom, when, which values ──► numbers, each with its evidence ──► DRAFT/
     gathering.py                                        rates, delays, matches, ranges         draft.py
        │                                                                                          │
        └── stretches.py: three of four are learned from, the fourth is held back ──► a trial ◄────┘

tails.py        what is rare, beyond what was seen
rates.py        the rate of a topic, how far it strays, how long it is silent
delays.py       which topic answers which, and how fast
matches.py      values whose trends are alike
ranges.py       the numbers in /diagnostics
draft.py        what was learned, as part of what was heard: of that `model/from_graph.py` makes the model
update.py       changes of a file that exists, as a diff
learning.py     all of it, in order; the drafted observers over what was held back: the false alarms
"""
