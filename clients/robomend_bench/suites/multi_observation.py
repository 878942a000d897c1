"""Several observations of one faulty circuit: the 144 published instances, published times beside ours.

Every count of subset-minimal diagnoses is compared with the published one; a difference is reported as any
other disagreement between contenders.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

from robomend.diagnosis.result import Options
from robomend.diagnosis.snapshots import SnapshotEngine
from robomend.diagnosis.wcnf import read_wcnf
from robomend.errors import InputError, OptionRefused
from robomend_bench.exporting import DiagnosisProblem, Exported
from robomend_bench.suite import Answer, Ask, Group, Question, Wish

PUBLISHED = "hsd-published"
CIRCUITS = ("c17", "c432", "c499", "c880", "c1908", "c2670", "c3540", "c5315", "c7552")


class MultiObservation:
    """See the module."""

    name = "multi-observation"
    version = "1"
    summary = "144 published instances with several observations each (IJCAI 2019)"
    modes: Mapping[str, str] = {
        "subset": "all subset-minimal diagnoses of several observations, reading and building included",
        "all": "all minimum-cardinality diagnoses of several observations",
    }

    def contenders(self, mode: str) -> tuple[str, ...]:
        """Return our engine, and the published figures where there are any."""
        return ("snapshots", PUBLISHED) if mode == "subset" else ("snapshots",)

    def groups(self, wish: Wish) -> Iterator[Group]:
        """Yield a group a circuit; --instances bounds its files."""
        folder = wish.data / "multi_observation"
        if not folder.is_dir():
            raise InputError(f"no folder {folder}: give --data DIR")
        published = json.loads((folder / "hsd.json").read_text())["stats"]
        for name in wish.only or CIRCUITS:
            files = sorted((folder / name).glob("*.wcnf.gz"))[: wish.instances]
            if not files:
                raise InputError(f"no instances in {folder / name}: choose from {', '.join(CIRCUITS)}")
            yield Group(
                name,
                len(read_wcnf(files[0]).cnf.components),
                None,
                tuple(
                    Question(
                        path.name.removesuffix(".wcnf.gz"),
                        (str(path), published.get(f"iscas85-mobs/{name}/{path.name.removesuffix('.gz')}")),
                    )
                    for path in files
                ),
            )

    def prepare(self, contender: str, group: Group, wish: Wish) -> Ask:
        """Return what diagnoses one file, or repeats what was published of it."""
        name, _, solver = contender.partition(":")
        if contender == PUBLISHED:
            return _published
        if name != "snapshots":
            raise OptionRefused(f"{contender}: this suite runs snapshots[:SOLVER] and {PUBLISHED}")
        options = Options(
            minimal="subset" if wish.mode == "subset" else "cardinality",
            limit=None,
            timeout_s=wish.timeout_s,
            conflicts=False,
        )

        def ask(question: Question) -> Answer:
            read = read_wcnf(Path(question.payload[0]))
            engine = SnapshotEngine(read.cnf, solver=solver or None)
            try:
                result = engine.diagnose(read.snapshots, options)
            finally:
                engine.close()
            count = len(result.diagnoses)
            return Answer((count,), complete=result.complete, shown=count)

        return ask

    def exported(self, question: Question, group: Group) -> Exported:
        """Return all observations of one file."""
        read = read_wcnf(Path(question.payload[0]))
        return DiagnosisProblem(read.cnf, read.snapshots)


def _published(question: Question) -> Answer:
    """Return the published count; its time is the published one too, on the authors' machine."""
    figures = question.payload[1]
    if figures is None:
        raise OptionRefused("nothing was published of this file")
    count = figures["diags"]
    return Answer((count,), complete=bool(figures["status"]), shown=count, seconds=figures["rtime"])


SUITE = MultiObservation()
