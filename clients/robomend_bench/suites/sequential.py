"""Sequential circuits (ISCAS-89) over several time steps, from reset: a gate is one component in all of them.

A step is a copy of the gates; what a flip-flop stores in one step is what it gives in the next, and 0 in the
first. Flip-flops are taken to be healthy. Inputs and outputs of each step are observed, as `v(NET@STEP)`.
A broken gate may be wrong in one step and right in the next, so that a diagnosis holds for all steps at once.

ISCAS-89 does not come with the package: --data DIR names a folder with iscas89/s27.bench and so on.
`made-N` are circuits of N gates, made by the seed, a tenth of them feeding flip-flops.
"""

from __future__ import annotations

import random
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace

from robomend.errors import InputError
from robomend.model.cnf import HealthCnf
from robomend.model.loading import load_text
from robomend_bench import contenders
from robomend_bench.exporting import DiagnosisProblem, Exported
from robomend_bench.generator import ATTEMPTS, Circuit, fault_of, read_circuit
from robomend_bench.suite import Ask, Group, Question, Wish
from robomend_bench.suites.made_circuits import made_circuit
from robomend_client.literals import Atom, Literal

STEPS = 6

MADE = ("made-300", "made-1000", "made-3000")

FAULTS = (1, 3)

FLIP_FLOP = re.compile(r"\s*([^\s(),=#]+)\s*=\s*DFF\s*\(\s*([^\s(),=#]+)\s*\)", re.IGNORECASE)


class Sequential:
    """See the module."""

    name = "sequential"
    version = "1"
    summary = f"sequential circuits over {STEPS} steps: made by the seed, or ISCAS-89 with --data"
    modes: Mapping[str, str] = {
        mode: contenders.MODES[mode] for mode in ("few", "first", "once", "all", "subset")
    }

    def contenders(self, mode: str) -> tuple[str, ...]:
        """Return the engine and what it is held against in this mode."""
        return ("sat", *(("layered-full",) if mode in ("all", "subset") else contenders.RC2))

    def groups(self, wish: Wish) -> Iterator[Group]:
        """Yield a group a circuit. The questions of a circuit depend on the seed and its name only."""
        for name in wish.only or MADE:
            text = self.text(name, wish)
            cnf = unrolled(text, name, STEPS)
            circuit, stored = _cut(text)
            chance = random.Random(f"{wish.seed} {name} steps")
            least, most = wish.faults or FAULTS
            questions = []
            for index in range(wish.instances or 20):
                faults = chance.randint(least, most)
                seen = observe_steps(circuit, stored, faults, STEPS, chance)
                questions.append(Question(f"{index:03d}-{faults}f", seen))
            yield Group(name, len(cnf.components), cnf, tuple(questions))

    def text(self, name: str, wish: Wish) -> str:
        """Return a circuit in .bench form.

        Raises:
            InputError: there is none of this name.
        """
        if name.startswith("made-"):
            size = name.removeprefix("made-")
            if not size.isdecimal() or not 60 <= int(size) <= 30_000:
                raise InputError(f"--only {name}: made-N has 60 to 30000 gates")
            return made_sequential(int(size), random.Random(f"{wish.seed} {name}"))
        path = wish.data / "iscas89" / f"{name}.bench"
        if not path.is_file():
            raise InputError(
                f"no circuit {path}: choose made-N, or give --data DIR with iscas89/{name}.bench"
            )
        return path.read_text()

    def prepare(self, contender: str, group: Group, wish: Wish) -> Ask:
        """Return what answers the questions of one circuit."""
        if wish.mode == "once":
            return contenders.prepare_cold(contender, lambda: replace(group.model), wish)
        return contenders.prepare(contender, group.model, group, wish)

    def exported(self, question: Question, group: Group) -> Exported:
        """Return what was seen of the circuit in all steps."""
        return DiagnosisProblem(group.model, [question.payload])


def made_sequential(gates: int, chance: random.Random) -> str:
    """Return a circuit of so many gates in .bench form; a tenth of them feed a flip-flop that gates read."""
    lines = made_circuit(gates, chance).splitlines()
    inputs = [line[6:-1] for line in lines if line.startswith("INPUT(")]
    fed = chance.sample(range(gates), min(gates // 10, len(inputs) - 1))
    stored = chance.sample(inputs, len(fed))
    kept = [line for line in lines if line.startswith("INPUT(") and line[6:-1] not in set(stored)]
    cells = [f"{net} = DFF(g{gate})" for net, gate in zip(stored, fed, strict=True)]
    return "\n".join([*kept, *(line for line in lines if not line.startswith("INPUT(")), *cells, ""])


def unrolled(text: str, name: str, steps: int) -> HealthCnf:
    """Return the clauses of a sequential circuit over several steps from reset, one health variable a gate.

    Raises:
        ModelError: the text is no circuit.
    """
    circuit, stored = _cut(text)
    load_text(text, name=name, file=f"{name}.bench", format="bench")  # to name what is wrong with it
    lines = []
    for step in range(steps):
        lines += [f"INPUT({net}@{step})" for net in circuit.inputs if net not in stored or not step]
        lines += [f"OUTPUT({net}@{step})" for net in circuit.outputs]
        for net, (kind, reads) in circuit.gates.items():
            read = ", ".join(_at(other, step, stored) for other in reads)
            lines.append(f"{net}@{step} = {kind}({read})")
    flat = load_text("\n".join(lines), name=name, file=f"{name}.bench", format="bench").cnf
    gates = tuple(circuit.gates)
    place = {gate: index for index, gate in enumerate(gates, 1)}
    taken = len(flat.components)
    number = [0] + [place[each.rpartition("@")[0]] for each in flat.components]
    number += [variable - taken + len(gates) for variable in range(taken + 1, flat.variables + 1)]
    return replace(
        flat,
        components=gates,
        clauses=tuple(tuple(number[lit] if lit > 0 else -number[-lit] for lit in c) for c in flat.clauses),
        variables=flat.variables - taken + len(gates),
        circuit=False,
        inputs=(),
        outputs=(),
    )


def observe_steps(
    circuit: Circuit, stored: Mapping[str, str], faults: int, steps: int, chance: random.Random
) -> tuple[Literal, ...]:
    """Return what is seen at inputs and outputs of each step, with so many faults that show in one of them.

    Raises:
        InputError: after ATTEMPTS runs nothing was to be seen of any fault.
    """
    gates = list(circuit.gates)
    free = [net for net in circuit.inputs if net not in stored]
    for _ in range(ATTEMPTS):
        broken = {
            net: fault_of(circuit.gates[net], chance) for net in chance.sample(gates, min(faults, len(gates)))
        }
        seen: list[Literal] = [Literal(Atom("v", (f"{net}@0",)), False) for net in stored]
        states = [dict.fromkeys(stored, False), dict.fromkeys(stored, False)]
        shows = False
        for step in range(steps):
            inputs = {net: chance.random() < 0.5 for net in free}
            wrong, right = (
                circuit.simulate({**inputs, **state}, having)
                for state, having in zip(states, (broken, {}), strict=True)
            )
            shows |= any(wrong[net] != right[net] for net in circuit.outputs)
            states = [{net: values[source] for net, source in stored.items()} for values in (wrong, right)]
            shown = dict.fromkeys((*free, *circuit.outputs))
            seen += [Literal(Atom("v", (_at(net, step, stored),)), wrong[net]) for net in shown]
        if shows:
            return tuple(dict.fromkeys(seen))
    raise InputError(f"{faults} faults in this circuit are never seen at its outputs within {steps} steps")


def _at(net: str, step: int, stored: Mapping[str, str]) -> str:
    """Return the net's name in a step: a flip-flop gives what was before it in the step before."""
    while net in stored and step:
        net, step = stored[net], step - 1
    return f"{net}@{step}"


def _cut(text: str) -> tuple[Circuit, dict[str, str]]:
    """Return the gates with flip-flops as inputs, and flip-flop -> the net that it stores."""
    stored: dict[str, str] = {}
    lines = []
    for line in text.splitlines():
        if cell := FLIP_FLOP.match(line):
            stored[cell[1]] = cell[2]
            lines.append(f"INPUT({cell[1]})")
        else:
            lines.append(line)
    return read_circuit("\n".join(lines)), stored


SUITE = Sequential()
