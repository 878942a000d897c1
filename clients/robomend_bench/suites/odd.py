"""Odd models with default options: chains, rings, fans, everything silent, problems that are hard by design.

The question of each is whether it is answered at all, within the time-out, and in how much memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.errors import ContradictoryModel, InputError
from robomend_bench.exporting import DiagnosisProblem, Exported
from robomend_bench.odd_models import MODELS
from robomend_bench.suite import Answer, Ask, Group, Question, Wish


class Odd:
    """See the module."""

    name = "odd"
    version = "1"
    summary = "models that break searches, with default options; --timeout is the engine's own"
    modes: Mapping[str, str] = {
        "default": "default options: subset-minimal, at most 100, with conflicts; solved: at least one",
        "cardinality": "the same, but of minimum cardinality",
    }

    def contenders(self, mode: str) -> tuple[str, ...]:
        """Return the engine; others can be named."""
        return ("sat",)

    def groups(self, wish: Wish) -> Iterator[Group]:
        """Yield a group a model and size; `--only` takes names with or without their size."""
        known = {f"{name}-{size}" for name, (_, sizes) in MODELS.items() for size in sizes}
        unknown = set(wish.only) - known - set(MODELS)
        if unknown:
            raise InputError(f"--only {min(unknown)}: choose from {', '.join(MODELS)}")
        for name, (make, sizes) in MODELS.items():
            for size in sizes:
                full = f"{name}-{size}"
                if not wish.only or name in wish.only or full in wish.only:
                    cnf, seen = make(size)
                    yield Group(full, len(cnf.components), cnf, (Question("0", seen),))

    def prepare(self, contender: str, group: Group, wish: Wish) -> Ask:
        """Return what asks an engine with default options."""
        name, _, solver = contender.partition(":")
        engine = make_engine(name, group.model, solver=solver or None)
        options = replace(Options(), timeout_s=wish.timeout_s)
        if wish.mode == "cardinality":
            options = replace(options, minimal="cardinality")

        def ask(question: Question) -> Answer:
            try:
                result = engine.diagnose(question.payload, options)
            except ContradictoryModel:
                return Answer((None,), complete=True)
            least = len(result.diagnoses[0].bad) if result.diagnoses else None
            return Answer((least,), complete=bool(result.diagnoses), shown=len(result.diagnoses))

        return ask

    def exported(self, question: Question, group: Group) -> Exported:
        """Return the model with what is seen of it."""
        return DiagnosisProblem(group.model, [question.payload])


SUITE = Odd()
