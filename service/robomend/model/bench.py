"""Circuits in .bench form (ISCAS-85, ISCAS-89): every gate a component, every net an atom `v(NET)`.

    # comment                        case of the keywords does not matter
    INPUT(1)        OUTPUT(22)       PINPUT and POUTPUT are the same, as ITC-99 has them
    10 = NAND(1, 3)                  AND NAND OR NOR XOR XNOR of any arity; NOT, BUF (BUFF) of one
    5 = DFF(10)                      cut, as in a full scan: net 5 is an input, net 10 an output, no component

A gate is named by the net that it drives. A healthy gate computes its function; nothing is said of an
abnormal one. A net may be input and output at once (c2670 and c7552 have such); nets must be driven by an
input or one gate, and gates must not feed themselves.

Source of the form: F. Brglez, H. Fujiwara, ISCAS 1985; F. Brglez, D. Bryan, K. Kozminski, ISCAS 1989.
"""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product

from robomend.errors import ModelError
from robomend.model.cnf import Clause, HealthCnf, Rule
from robomend.model.system import System
from robomend.model.vocabulary import Vocabulary
from robomend_client.counts import first_few
from robomend_client.literals import Atom, quote

PORT = re.compile(r"P?(INPUT|OUTPUT)\s*\(\s*([^\s(),=#]+)\s*\)\Z", re.IGNORECASE)
GATE = re.compile(r"([^\s(),=#]+)\s*=\s*(\w+)\s*\(([^()]*)\)\Z")
GATES = ("AND", "NAND", "OR", "NOR", "XOR", "XNOR", "NOT", "BUF", "BUFF", "DFF")
UNARY = ("NOT", "BUF", "BUFF", "DFF")
DIRECT_PARITY = 5
"""XOR gates up to this arity become clauses directly (2 to that power); wider ones a chain of auxiliary
variables."""

MAX_NAME = 200


@dataclass(frozen=True, slots=True)
class GateLine:
    """One line of a circuit: net = KIND(inputs)."""

    net: str
    kind: str
    inputs: tuple[str, ...]
    line: int


def circuit(text: str, *, name: str | None = None, file: str | None = None) -> System:
    """Return the system description of a circuit.

    Raises:
        ModelError: a line that is none of the above, a net that nothing or two things drive, a cycle, no
        gate.
    """
    inputs, outputs, gates = _read(text, file)
    _check(inputs, outputs, gates, file)
    cnf = compile_gates(name or "circuit", inputs, outputs, gates)
    nets = dict.fromkeys((*inputs, *gates))
    return System(
        name=cnf.name,
        format="bench",
        source=text,
        cnf=cnf,
        parts=None,
        vocabulary=Vocabulary(
            sorts={
                "components": cnf.components,
                "nets": tuple(nets),
                "inputs": tuple(inputs),
                "outputs": tuple(outputs),
            },
            predicates={"v": (("nets",),)},
        ),
        warnings=tuple(_unused(inputs, outputs, gates)),
    )


def compile_gates(
    name: str, inputs: Mapping[str, int], outputs: Mapping[str, int], gates: Mapping[str, GateLine]
) -> HealthCnf:
    """Return the clauses of checked gates."""
    used = dict.fromkeys(net for gate in gates.values() for net in gate.inputs)
    nets = [*(net for net in inputs if net in used), *gates]
    wire = {net: index for index, net in enumerate(nets, len(gates) + 1)}
    atoms = {net: _wire(net) for net in nets}
    words = {net: str(atom) for net, atom in atoms.items()}
    last = len(gates) + len(nets)
    clauses: list[Clause] = []
    origins: list[int] = []
    rules: list[Rule] = []
    for healthy, gate in enumerate(gates.values(), 1):
        before = len(clauses)
        last = _gate_clauses(
            gate.kind, -healthy, wire[gate.net], [wire[i] for i in gate.inputs], last, clauses
        )
        origins.extend([healthy - 1] * (len(clauses) - before))
        rules.append(Rule(_sentence(gate, words), f"gate {gate.net}", gate.line))
    return HealthCnf(
        name=name,
        components=tuple(gates),
        atoms=tuple(atoms.values()),
        clauses=tuple(clauses),
        origins=tuple(origins),
        rules=tuple(rules),
        variables=last,
        circuit=True,
        inputs=tuple(atoms.get(net) or _wire(net) for net in inputs),
        outputs=tuple(atoms.get(net) or _wire(net) for net in outputs),
    )


def _wire(net: str) -> Atom:
    return Atom("v", (net,))


def _gate_clauses(kind: str, ab: int, out: int, ins: list[int], last: int, clauses: list[Clause]) -> int:
    """Add `ab` or the gate's function; return the highest variable used."""
    ins = list(dict.fromkeys(ins)) if kind in ("AND", "NAND", "OR", "NOR") else ins
    if kind in ("NAND", "NOR", "NOT", "XNOR"):
        out = -out
    if kind in ("AND", "NAND", "NOT", "BUF", "BUFF"):
        clauses.extend((ab, -out, i) for i in ins)
        clauses.append((ab, out, *(-i for i in ins)))
    elif kind in ("OR", "NOR"):
        clauses.extend((ab, out, -i) for i in ins)
        clauses.append((ab, -out, *ins))
    else:
        # a net that comes twice cancels itself in a parity
        waiting = deque(net for net, times in Counter(ins).items() if times % 2)
        while len(waiting) > DIRECT_PARITY:
            last += 1
            clauses.extend(_parity(ab, last, [waiting.popleft() for _ in range(DIRECT_PARITY - 1)]))
            waiting.append(last)
        clauses.extend(_parity(ab, out, [*waiting]))
    return last


def _parity(ab: int, out: int, ins: list[int]) -> Iterator[Clause]:
    """Yield `ab` or out = the parity of ins: each assignment of wrong parity is ruled out."""
    wires = [*ins, out]
    for signs in product((False, True), repeat=len(wires)):
        if sum(signs) % 2:
            yield (ab, *(-wire if sign else wire for wire, sign in zip(wires, signs, strict=True)))


def _sentence(gate: GateLine, words: Mapping[str, str]) -> str:
    """Return the gate as people read it; `words` are the nets as text."""
    nets = [words[net] for net in gate.inputs]
    if gate.kind in ("NOT", "BUF", "BUFF"):
        body = nets[0] if gate.kind != "NOT" else f"not {nets[0]}"
    else:
        word = {"AND": " and ", "NAND": " and ", "OR": " or ", "NOR": " or "}.get(gate.kind, " xor ")
        body = word.join(nets)
        if gate.kind in ("NAND", "NOR", "XNOR"):
            body = f"not ({body})"
        elif len(nets) > 1:
            body = f"({body})"
    return f"not ab({quote(gate.net)}) -> ({words[gate.net]} <-> {body})"


def _read(text: str, file: str | None) -> tuple[dict[str, int], dict[str, int], dict[str, GateLine]]:
    """Return inputs, outputs (net -> line) and gates (by net), flip-flops cut."""
    inputs: dict[str, int] = {}
    outputs: dict[str, int] = {}
    gates: dict[str, GateLine] = {}
    names: dict[str, str] = {}  # as written -> the name

    def name_of(text: str, number: int) -> str:
        known = names.get(text)
        if known is None:
            known = names[text] = _name(text, number, file)
        return known

    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.partition("#")[0].strip()
        if not line:
            continue
        if port := PORT.match(line):
            net = name_of(port[2], number)
            is_input = port[1].upper() == "INPUT"
            if is_input:
                _driven_once(net, number, inputs, gates, file)
            # some published files list an output twice: once is meant
            (inputs if is_input else outputs).setdefault(net, number)
        elif match := GATE.match(line):
            net, kind = name_of(match[1], number), match[2].upper()
            sources = tuple([name_of(part.strip(), number) for part in match[3].split(",")])
            if kind not in GATES:
                raise ModelError(f"no gate is named {match[2]}; there are {', '.join(GATES)}", file, number)
            if kind in UNARY and len(sources) != 1:
                raise ModelError(f"{kind} takes one net, not {len(sources)}", file, number)
            _driven_once(net, number, inputs, gates, file)
            if kind == "DFF":
                inputs[net] = number
                outputs.setdefault(sources[0], number)
            else:
                gates[net] = GateLine(net, kind, sources, number)
        else:
            raise ModelError(
                f"`{line[:60]}` is no line of a circuit; e.g. INPUT(1), OUTPUT(22), 10 = NAND(1, 3)",
                file,
                number,
            )
    return inputs, outputs, gates


def _name(text: str, line: int, file: str | None) -> str:
    name = text.strip().lstrip("/") or text
    if not name or len(name) > MAX_NAME or any(c.isspace() for c in name) or not name.isprintable():
        raise ModelError(f"`{text[:60]}` is no name of a net", file, line)
    return name


def _driven_once(
    net: str, line: int, inputs: Mapping[str, int], gates: Mapping[str, GateLine], file: str | None
) -> None:
    first = inputs.get(net) or (gates[net].line if net in gates else None)
    if first is not None:
        raise ModelError(f"net {net} is driven twice (first in line {first})", file, line)


def _check(
    inputs: Mapping[str, int], outputs: Mapping[str, int], gates: Mapping[str, GateLine], file: str | None
) -> None:
    if not gates:
        raise ModelError("the circuit has no gate", file)
    for gate in gates.values():
        for net in gate.inputs:
            if net not in gates and net not in inputs:
                raise ModelError(f"nothing drives net {net}, which {gate.net} reads", file, gate.line)
    for net, line in outputs.items():
        if net not in gates and net not in inputs:
            raise ModelError(f"nothing drives output {net}", file, line)
    done: set[str] = set()
    for start in gates:
        if start in done:
            continue
        # Depth first without recursion: circuits are deeper than Python's stack.
        path: dict[str, Iterator[str]] = {start: iter(gates[start].inputs)}
        while path:
            net, rest = next(reversed(path.items()))
            for source in rest:
                if source in path:
                    cycle = [*path][[*path].index(source) :]
                    loop = " <- ".join([*cycle[:8], *(["…"] if len(cycle) > 8 else []), source])
                    raise ModelError(f"gates feed themselves: {loop}", file, gates[source].line)
                if source in gates and source not in done:
                    path[source] = iter(gates[source].inputs)
                    break
            else:
                done.add(net)
                del path[net]


def _unused(
    inputs: Mapping[str, int], outputs: Mapping[str, int], gates: Mapping[str, GateLine]
) -> Iterator[str]:
    read = {net for gate in gates.values() for net in gate.inputs}
    idle = [net for net in (*inputs, *gates) if net not in read and net not in outputs]
    if idle:
        yield f"nothing reads {first_few(idle, 10)}, and no output shows it"
