"""Observers, pure: samples and times in, verdicts out. base.py says how to add one.

driver.py              feeds and asks them, live and over logs; read it after base.py
combining.py           what several observers of one atom say together
observer_state.py      what the driver keeps of each, and whose turn it is
recording.py           what a driver took in, and its replay
problems.py            what is left out, and observers that fail
kinds.py               all kinds by name, and the section `observers:` of a file

general.py             GObs: ok(topic) by the rate of its messages
node.py                NObs: running(node); restarts
diagnostic.py          DObs: ok(device) by what its driver publishes
multiple.py            MObs: ok(out_triggered), one topic answers another
qualitative.py         QObs: inc, dec, const of a value
binary_qualitative.py  BiQObs: matched(value, value)
hardware.py            HObs: on(device), ok(current,device)
property.py            PObs: ok(CPU,node), a number in its band; filters.py

goals.py, rosout.py    what a robot says itself: aborted goals, lines of ERROR; incidents.py
lifecycle.py           the state of a node with a lifecycle
freshness.py           a value that stands still, stamps that are old
meeting.py             who publishes a topic, and who does not meet whom
reading.py             the base of observers that judge one reading at a time, of your own too
"""

from robomend_client.observers.base import (
    SECOND,
    Contact,
    Evidence,
    NoNumber,
    Observer,
    Publishers,
    Verdict,
    ns,
    number,
)
from robomend_client.observers.binary_qualitative import BinaryQualitativeObserver, Match
from robomend_client.observers.combining import Change
from robomend_client.observers.diagnostic import DIAGNOSTICS, DiagnosticObserver, Levels
from robomend_client.observers.driver import Driver
from robomend_client.observers.filters import Filter
from robomend_client.observers.general import GeneralObserver
from robomend_client.observers.hardware import BOARD, BoardReadings, HardwareObserver, Wiring
from robomend_client.observers.multiple import Answers, MultipleObserver
from robomend_client.observers.node import PROCESSES, NodeObserver, Table
from robomend_client.observers.problems import ObserverProblem
from robomend_client.observers.property import Band, PropertyObserver
from robomend_client.observers.qualitative import QualitativeObserver, Trend
from robomend_client.observers.rate import Rate
from robomend_client.observers.reading import FunctionObserver, ReadingObserver, Readings

__all__ = [
    "BOARD",
    "DIAGNOSTICS",
    "PROCESSES",
    "SECOND",
    "Answers",
    "Band",
    "BinaryQualitativeObserver",
    "BoardReadings",
    "Change",
    "Contact",
    "DiagnosticObserver",
    "Driver",
    "Evidence",
    "Filter",
    "FunctionObserver",
    "GeneralObserver",
    "HardwareObserver",
    "Levels",
    "Match",
    "MultipleObserver",
    "NoNumber",
    "NodeObserver",
    "Observer",
    "ObserverProblem",
    "PropertyObserver",
    "Publishers",
    "QualitativeObserver",
    "Rate",
    "ReadingObserver",
    "Readings",
    "Table",
    "Trend",
    "Verdict",
    "Wiring",
    "ns",
    "number",
]
