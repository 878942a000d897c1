"""ISCAS-85 circuits with seeded faults, inputs and outputs observed: the field's standard benchmark."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from robomend.errors import InputError
from robomend.model.cnf import HealthCnf
from robomend.model.loading import load_text
from robomend_bench import contenders
from robomend_bench.baselines import RC2_OPTIONS
from robomend_bench.circuit_questions import questions_about
from robomend_bench.suite import ONE, Ask, Group, Wish

CIRCUITS = ("c17", "c432", "c499", "c880", "c1355", "c1908", "c2670", "c3540", "c5315", "c6288", "c7552")
BY_DEFAULT = tuple(name for name in CIRCUITS if name != "c6288")
"""c6288, a multiplier, is hard for everyone: it is run by itself, with `--only c6288`."""

SIZES = (1, 20)
"""Minimum cardinalities of questions for one diagnosis, equally many of each: injected faults mask each
other, so that most observations of random faults need one or two gates only."""


class Iscas85:
    """See the module."""

    name = "iscas85"
    summary = "ISCAS-85 circuits, seeded faults"
    modes: Mapping[str, str] = contenders.CIRCUIT_MODES

    def contenders(self, mode: str) -> tuple[str, ...]:
        """Return the engine and what it is held against in this mode."""
        if mode in ONE:
            return ("sat", *RC2_OPTIONS)
        return ("sat", "clingo-domain" if mode == "subset" else "layered-full")

    def groups(self, wish: Wish) -> Iterator[Group]:
        """Yield a group a circuit. The questions of a circuit depend on the seed and its name only."""
        for name in wish.only or BY_DEFAULT:
            path = wish.data / "iscas85" / f"{name}.bench"
            if not path.is_file():
                raise InputError(f"no circuit {path}: choose from {', '.join(CIRCUITS)}, or give --data DIR")
            text = path.read_text()
            cnf = _compiled(text, name)
            sizes = wish.sizes or (SIZES if wish.mode in ONE else None)
            questions = questions_about(text, cnf, f"{wish.seed} {name}", sizes, wish)
            yield Group(name, len(cnf.components), text if wish.mode == "cold" else cnf, questions)

    def prepare(self, contender: str, group: Group, wish: Wish) -> Ask:
        """Return what answers the questions of one circuit."""
        if wish.mode == "cold":
            return contenders.prepare_cold(contender, lambda: _compiled(group.model, group.name), wish)
        if wish.mode == "once":
            return contenders.prepare_cold(contender, lambda: _uncached(group.model), wish)
        return contenders.prepare(contender, group.model, group, wish)


def _compiled(text: str, name: str) -> HealthCnf:
    return load_text(text, name=name, file=f"{name}.bench", format="bench").cnf


def _uncached(cnf: HealthCnf) -> HealthCnf:
    """Return the model without what an earlier question left in it."""
    return replace(cnf)


SUITE = Iscas85()
