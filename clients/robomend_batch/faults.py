"""The faults of a run: equal diagnoses are one fault, in whichever logs it shows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from robomend.diagnosis.result import Options
from robomend.errors import InputError
from robomend.oneshots.question import question
from robomend.oneshots.result_json import result_json
from robomend.oneshots.warm_model import WarmModel
from robomend_batch.answers import FAULTY
from robomend_batch.results import Bad, Interval, Results

EXPLAIN_S = 2.0
"""For the explanation of one fault."""


@dataclass
class Fault:
    """Diagnoses that some intervals share; none: the model cannot explain what was seen."""

    bad: Bad
    logs: set[str] = field(default_factory=set)
    intervals: int = 0
    span_ns: int = 0
    longest: tuple[str, Interval] | None = None

    def add(self, log: str, interval: Interval) -> None:
        """Count an interval."""
        self.logs.add(log)
        self.intervals += 1
        self.span_ns += interval.span_ns
        if self.longest is None or interval.span_ns > self.longest[1].span_ns:
            self.longest = log, interval


def find_faults(told: Iterable[tuple[str, Interval]]) -> list[Fault]:
    """Return the faults of intervals with their logs: those of most logs first, then the longest."""
    found: dict[Bad, Fault] = {}
    for log, interval in told:
        if interval.state in FAULTY:
            found.setdefault(interval.bad, Fault(interval.bad)).add(log, interval)
    return sorted(found.values(), key=lambda fault: (-len(fault.logs), -fault.span_ns, fault.bad))


def explain(results: Results, faults: Iterable[Fault]) -> list[list[str]]:
    """Return sentences for each fault: what clashed in its longest interval, and what explains it.

    Of windows that were explained together, what was seen in them: no single set of observations shows it.
    """
    if "together" in results.manifest.settings:
        longest = [fault.longest[1] for fault in faults if fault.longest is not None]
        return [[f"Seen in one window: {', '.join(one.observations)}."] for one in longest]
    system = results.system
    sentences = []
    unknown = results.manifest.settings["unknown"]
    with WarmModel(system, options=Options(timeout_s=EXPLAIN_S), unknown=unknown) as model:
        for fault in faults:
            assert fault.longest is not None
            try:
                result = model.ask(
                    question(fault.longest[1].observations, system.vocabulary, unknown=unknown)
                )
                said = result_json(result.result)
            except InputError as error:
                sentences.append([str(error)])
                continue
            sentences.append(
                [conflict["text"] for conflict in said["conflicts"]]
                + [diagnosis["text"] for diagnosis in said["diagnoses"][:5] if diagnosis["text"]]
            )
    return sentences
