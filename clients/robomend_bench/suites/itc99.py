"""ITC-99 circuits, combinational, with seeded faults: five to ten times as large as ISCAS-85.

They do not come with the package, as they have a licence of their own (CC BY-SA 4.0): --data DIR names a
folder with itc99/b14.bench and so on, which are the files b14_C.bench … of the I99T release.
"""

from __future__ import annotations

from robomend_bench.suites.iscas85 import Circuits

NAMES = ("b14", "b15", "b17")

SIZES = (1, 10)
"""Minimum cardinalities of questions for one diagnosis."""

SUITE = Circuits(
    "itc99",
    "ITC-99 circuits, seeded faults; give --data",
    NAMES,
    NAMES[:2],
    SIZES,
    "; docs/benchmarks.md says where they can be had",
)
