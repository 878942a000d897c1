"""The paper's observers, pure: values and times in, literals out. base.py says how to add one.

general.py   GObs: ok(topic) by the rate of its messages
node.py      NObs: running(node)
"""

from robomend_client.observers.base import SECOND, Observer, ns
from robomend_client.observers.general import GeneralObserver, Rate
from robomend_client.observers.node import PROCESSES, NodeObserver

__all__ = ["PROCESSES", "SECOND", "GeneralObserver", "NodeObserver", "Observer", "Rate", "ns"]
