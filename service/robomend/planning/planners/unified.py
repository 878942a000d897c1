"""Engines of Unified Planning, imported without what planning has no use for.

Unified Planning and its engines import ConfigSpace for the name of one type, and that brings scipy.stats:
more than four fifths of the time of the import. While an engine is made a stand-in has the name; who imports
ConfigSpace afterwards gets the real one.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

HEAVY = "ConfigSpace"


def oneshot_planner(name: str, **options: Any) -> Any:
    """Return an engine that plans, silent about its credits; ImportError without Unified Planning."""
    with _stand_in():
        from unified_planning.shortcuts import OneshotPlanner, get_environment

        get_environment().credits_stream = None
        return OneshotPlanner(name=name, **options)


@contextmanager
def _stand_in() -> Iterator[None]:
    if HEAVY in sys.modules:
        yield
        return
    module = ModuleType(HEAVY)
    vars(module)["ConfigurationSpace"] = type("ConfigurationSpace", (), {})
    sys.modules[HEAVY] = module
    try:
        yield
    finally:
        if sys.modules.get(HEAVY) is module:
            del sys.modules[HEAVY]
