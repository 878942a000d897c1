"""A worker of pytest-xdist that begins with our code: forked as in tests/forked.py.

xdist starts this small program in place of an interpreter. What it is to run is forked instead, with this
one's streams, and this one ends as that does.

    python -IS tests/forked_worker.py TEMPLATE -u -c CODE
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests import forked
from tests.forked_programs import stand_for

if __name__ == "__main__":
    _, template, _, *code = sys.argv
    forked.use(int(template))
    stand_for([sys.executable, *code])
