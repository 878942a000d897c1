"""A circuit, found again in its clauses: which gate drives which net, and by which function.

Engines read nothing of a model but its clauses, so the netlist is recovered from them. A component is a gate
with output o when o occurs in each of its clauses and the clauses fix o for every input: its truth table is
total and single-valued. A wide parity comes as a chain of narrow ones over auxiliary variables; their sum
modulo 2, in which these cancel out, is the gate. Everything here is checked, not believed: where a clause
belongs to no single gate, a net has two drivers, or nets feed back, there is no netlist, and the engine falls
back on methods that need none.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import reduce
from itertools import product
from operator import or_

from robomend.model.cnf import Clause, HealthCnf

CHECK_EVERY = 256
"""Gates between two looks at the clock."""

WIDEST_TABLE = 6
"""Variables of a parity, and inputs of a gate of no other known kind: their truth tables are gone through."""


@dataclass(frozen=True, slots=True)
class Gate:
    """One component: output = function(inputs), as a Python expression over bit-parallel values."""

    component: int  # its health variable
    output: int
    inputs: tuple[int, ...]
    expression: str  # {0}, {1}, … stand for the inputs, M for all ones
    controlling: int | None = None  # the input value that alone decides the output, if there is one
    operator: str = ""  # &, | or ^ if the output is all inputs joined by it, or the complement of that
    inverted: bool = False  # … the complement


@dataclass(frozen=True)
class Netlist:
    """The gates in topological order; nets are variables."""

    gates: tuple[Gate, ...]
    sources: frozenset[int]  # nets that no gate drives

    def driver(self) -> dict[int, int]:
        """Return net -> the index of the gate that drives it."""
        return {gate.output: index for index, gate in enumerate(self.gates)}


Shape = tuple[int, ...]
"""The clauses of a gate, whatever its nets are: gates of one kind have the same."""


@dataclass(frozen=True, slots=True)
class Shapes:
    """What is known of gates by their shape: of thousands of gates some dozen are looked at in earnest."""

    common: dict[Shape, tuple[int, ...]] = field(default_factory=dict)  # places of nets in all clauses
    # Of an output at that place: the operator that joins the inputs, and whether it is the complement.
    joined: dict[tuple[Shape, int], tuple[str, bool]] = field(default_factory=dict)


def recover(cnf: HealthCnf, check: Callable[[], None] = lambda: None) -> Netlist | None:
    """Return the netlist behind the clauses of a circuit, or None when they are not those of one.

    Args:
        check: called now and then; may raise to end the work.
    """
    if not cnf.circuit or not cnf.weak or cnf.modes:
        return None
    n = len(cnf.components)
    own: dict[int, list[Clause]] = defaultdict(list)
    title: dict[int, str] = {}
    owner: dict[int, int] = {}  # auxiliary variable -> the one component that speaks of it
    after = n + len(cnf.atoms)
    for clause, origin in zip(cnf.clauses, cnf.origins, strict=True):
        health, body = (clause[0], clause[1:]) if clause else (0, ())
        if not -n <= health < 0:  # mostly it comes first
            health = next((literal for literal in clause if -n <= literal < 0), 0)
            body = tuple([literal for literal in clause if literal != health])
        for literal in body:
            if -n <= literal <= n:
                return None
            if abs(literal) > after and owner.setdefault(abs(literal), health) != health:
                return None
        if not health:
            return None
        component = -health
        own[component].append(body)
        if component not in title:
            title[component] = cnf.rules[origin].source.partition(" ")[2]
    gates: dict[int, Gate] = {}
    shapes = Shapes()
    for component in range(1, n + 1):
        if component % CHECK_EVERY == 0:
            check()
        names = {cnf.components[component - 1], title.get(component, "")}
        gate = _gate(own.get(component, []), names, cnf, gates, component, shapes)
        if gate is None:
            return None
        gates[gate.output] = gate
    return _in_order(gates)


def _gate(
    clauses: list[Clause],
    names: set[str],
    cnf: HealthCnf,
    taken: dict[int, Gate],
    component: int,
    shapes: Shapes,
) -> Gate | None:
    """Return the gate. Where several nets could be its output (a buffer, a parity), its name decides."""
    if not clauses:
        return None
    first = len(cnf.components) + 1
    after = first + len(cnf.atoms)  # auxiliary variables come after the atoms
    place, shape = _shape(clauses)
    parity = _parity(clauses, after) if cnf.variables >= after and max(place, default=0) >= after else None
    if parity is not None:
        common: Iterable[int] = parity[0]
    elif shape in shapes.common:
        nets = list(place)
        common = [nets[one] for one in shapes.common[shape]]
    else:
        common = set.intersection(*({abs(literal) for literal in clause} for clause in clauses))
        shapes.common[shape] = tuple(place[net] for net in common)
    shared = [net for net in common if net not in taken]
    named = [
        net
        for net in shared
        if net - first < len(cnf.atoms)
        and cnf.atoms[net - first].args
        and cnf.atoms[net - first].args[0] in names
    ]
    for output in sorted(named or shared):
        if parity is not None:
            inputs = tuple(sorted(parity[0] - {output}))
            return _joined(component, output, inputs, "^", inverted=parity[1])
        joined = shapes.joined.get((shape, place[output]))
        if joined is not None:
            return _joined(component, output, tuple(sorted(place.keys() - {output})), *joined)
        gate = _function(component, output, clauses)
        if gate is not None:
            if gate.operator:
                shapes.joined[shape, place[output]] = gate.operator, gate.inverted
            return gate
    return None


def _shape(clauses: list[Clause]) -> tuple[dict[int, int], Shape]:
    """Return the place at which each variable comes first, and the clauses with these for the variables."""
    place: dict[int, int] = {}
    shape = []
    for clause in clauses:
        for literal in clause:
            if literal > 0:
                shape.append(place.setdefault(literal, len(place)) + 1)
            else:
                shape.append(-1 - place.setdefault(-literal, len(place)))
        shape.append(0)
    return place, tuple(shape)


def _joined(component: int, output: int, inputs: tuple[int, ...], operator: str, inverted: bool) -> Gate:
    """Return the gate whose output is all inputs joined by the operator, or the complement of that."""
    body = operator.join(f"{{{i}}}" for i in range(len(inputs)))
    controlling = {"&": 0, "|": 1}.get(operator) if len(inputs) > 1 else None
    return Gate(
        component, output, inputs, f"M^({body})" if inverted else body, controlling, operator, inverted
    )


def _function(component: int, output: int, clauses: list[Clause]) -> Gate | None:
    """Return the gate with this output, if the clauses define one."""
    inputs = tuple(sorted({abs(lit) for clause in clauses for lit in clause} - {output}))
    position = {variable: index for index, variable in enumerate(inputs)}
    wide = _and_or(output, clauses, inputs)
    if wide is not None:
        return _joined(component, output, inputs, *wide)
    if len(inputs) > WIDEST_TABLE:
        return None
    minterms: list[str] = []
    ones: list[tuple[bool, ...]] = []
    for row in product((False, True), repeat=len(inputs)):
        forced = set()
        for clause in clauses:
            value = 0
            for literal in clause:
                if abs(literal) == output:
                    value = 1 if literal > 0 else -1
                elif row[position[abs(literal)]] == (literal > 0):
                    break
            else:
                forced.add(value)
        if len(forced) != 1:
            return None
        if forced == {1}:
            ones.append(row)
            minterms.append(
                "&".join(f"{{{i}}}" if bit else f"(M^{{{i}}})" for i, bit in enumerate(row)) or "M"
            )
    if inputs and len(ones) == 2 ** (len(inputs) - 1) and len({sum(row) % 2 for row in ones}) == 1:
        return _joined(component, output, inputs, "^", inverted=sum(ones[0]) % 2 == 0)
    return Gate(component, output, inputs, "|".join(f"({term})" for term in minterms) or "0")


def _and_or(output: int, clauses: list[Clause], inputs: tuple[int, ...]) -> tuple[str, bool] | None:
    """Recognise AND, NAND, OR, NOR, NOT and BUF of any width.

    Their clauses are one long one, and one of two literals an input.

    Returns:
        The operator between the inputs, and whether the output is the complement.
    """
    long = [clause for clause in clauses if len(clause) == len(inputs) + 1]
    if len(inputs) == 1:
        long = [clause for clause in clauses if output in clause]
    if len(long) != 1 or len(clauses) != len(inputs) + 1 or not inputs:
        return None
    body = [literal for literal in long[0] if abs(literal) != output]
    head = output if output in long[0] else -output
    short = {frozenset((-literal, -head)) for literal in body}
    if {frozenset(clause) for clause in clauses if clause is not long[0]} != short or len(body) != len(
        inputs
    ):
        return None
    signs = {literal > 0 for literal in body}
    if len(signs) != 1:
        return None
    # body all negative: the inputs being all true forces `head`; all positive: being all false does.
    return ("|", head > 0) if signs == {True} else ("&", head < 0)


def _parity(clauses: list[Clause], after: int) -> tuple[frozenset[int], bool] | None:
    """Return the parity that a chain of parities over auxiliary variables amounts to, or None: it is no such.

    A variable that is in two equations and nowhere else can have the value that one of them wants, so that
    what both say of the others is their sum.

    Args:
        after: variables from here on are auxiliary.

    Returns:
        The variables other than auxiliary ones, and whether an odd number of them is true.
    """
    blocks: dict[frozenset[int], set[Clause]] = defaultdict(set)
    for clause in clauses:
        blocks[frozenset(map(abs, clause))].add(tuple(sorted(clause)))
    equations: list[tuple[frozenset[int], bool]] = []
    for variables, block in blocks.items():
        ruled_out = {sum(literal < 0 for literal in clause) % 2 for clause in block}
        if len(variables) > WIDEST_TABLE or len(ruled_out) != 1:
            return None
        if len(block) != 2 ** (len(variables) - 1) or any(len(c) != len(variables) for c in block):
            return None
        equations.append((variables, ruled_out == {0}))
    for auxiliary in sorted({v for variables in blocks for v in variables if v >= after}):
        holding = [equation for equation in equations if auxiliary in equation[0]]
        if not holding:
            continue  # it cancelled out together with another
        if len(holding) != 2:
            return None
        (some, odd), (others, other_odd) = holding
        equations = [equation for equation in equations if equation not in holding]
        equations.append((some ^ others, odd != other_odd))
    return equations[0] if len(equations) == 1 and equations[0][0] else None


def _in_order(gates: dict[int, Gate]) -> Netlist | None:
    """Sort topologically, without recursion; None when nets feed back."""
    users: dict[int, list[int]] = defaultdict(list)
    waits: dict[int, int] = {}
    for output, gate in gates.items():
        driven = [net for net in gate.inputs if net in gates]
        waits[output] = len(driven)
        for net in driven:
            users[net].append(output)
    ready = [output for output, count in waits.items() if count == 0]
    for output in ready:  # grows while it is read
        for user in users[output]:
            waits[user] -= 1
            if waits[user] == 0:
                ready.append(user)
    if len(ready) < len(gates):
        return None
    nets = {net for gate in gates.values() for net in gate.inputs}
    return Netlist(tuple(gates[output] for output in ready), frozenset(nets - gates.keys()))


# --- dominators and cones: which gates of a circuit need not be blamed first.
#
# A gate t dominates a gate d when every path from d to an observed net goes through t. The gates that
# nothing dominates are the top level; the gates that t dominates, and t itself, are the cone of t:
#
#         d1 ─┐
#             ├─► d3 ──► t ──► observed          cone(t) = {t, d1, d2, d3}
#         d2 ─┘
#
# If d is in a minimum-cardinality diagnosis, putting its top-level dominator in its place gives one too:
# t's output is now free and may keep its value, and the gates between d and t, being healthy functions of
# their inputs, follow suit unseen. No two members share a cone, or that would save one. So it is enough to
# enumerate the minimum-cardinality diagnoses of top-level gates, and then to ask of each member which gates
# of its cone can stand in for it.
#
# Under weak fault models only. The observed nets are part of the picture: other sensors, other cones.
#
# Sources:
#     A. Metodi, R. Stern, M. Kalech, M. Codish. A novel SAT-based approach to model based diagnosis. JAIR 51,
#         2014.
#     S. Siddiqi, J. Huang. Hierarchical diagnosis of multiple faults. IJCAI 2007 (cones).
#     T. Lengauer, R. Tarjan. A fast algorithm for finding dominators in a flowgraph. TOPLAS 1(1), 1979 (the
#         problem; an acyclic graph needs only one sweep from the observed nets back).

UNSEEN = -2  # no path to an observed net: such a gate is in no minimal diagnosis
OBSERVED = -1  # the root: beyond the observed nets


@dataclass(frozen=True)
class Cones:
    """Indices are of the netlist's gates; a cone is in topological order and ends with its top-level gate."""

    top: tuple[int, ...]
    members: dict[int, tuple[int, ...]]  # top-level gate -> its cone
    seen: tuple[int, ...]  # the gates with a path to an observed net, in topological order


def find_cones(netlist: Netlist, observed: Iterable[int]) -> Cones:
    """Return the cones of the netlist when these nets are observed."""
    gates = netlist.gates
    sinks = set(observed)
    users: dict[int, list[int]] = defaultdict(list)
    for index, gate in enumerate(gates):
        for net in gate.inputs:
            users[net].append(index)
    above = [UNSEEN] * len(gates)  # the immediate dominator
    depth = [0] * len(gates)
    for index in range(len(gates) - 1, -1, -1):
        output = gates[index].output
        if output in sinks:
            above[index] = OBSERVED
            continue
        meet = UNSEEN
        for user in users[output]:
            if above[user] != UNSEEN:
                meet = user if meet == UNSEEN else _common(above, depth, meet, user)
        above[index] = meet
        if meet >= 0:
            depth[index] = depth[meet] + 1
    top_of = list(range(len(gates)))
    members: dict[int, list[int]] = defaultdict(list)
    for index in range(len(gates) - 1, -1, -1):
        if above[index] >= 0:
            top_of[index] = top_of[above[index]]
        if above[index] != UNSEEN:
            members[top_of[index]].append(index)
    cones = {top: tuple(reversed(cone)) for top, cone in members.items()}
    seen = tuple(index for index in range(len(gates)) if above[index] != UNSEEN)
    return Cones(tuple(sorted(cones)), cones, seen)


def by_output(netlist: Netlist, cones: Cones, observed: Iterable[int]) -> list[int]:
    """Return the top-level gates: first those behind the output with the fewest inputs, and so on.

    A solver that is told in this order that they are healthy meets the conflicts of one output before it
    looks at the others: fewer gates are in them, and they are found sooner.

    Args:
        observed: nets that gates drive.
    """
    gates, driver = netlist.gates, netlist.driver()
    inputs = {net: 1 << position for position, net in enumerate(netlist.sources)}
    for gate in gates:
        inputs[gate.output] = reduce(or_, [inputs.get(net, 0) for net in gate.inputs], 0)
    left = set(range(len(gates)))
    listed: list[int] = []
    for output in sorted(observed, key=lambda net: (inputs[net].bit_count(), net)):
        behind: list[int] = []
        todo = [driver[output]]
        while todo:
            index = todo.pop()
            if index in left:
                left.remove(index)
                behind.append(index)
                todo += [driver[net] for net in gates[index].inputs if net in driver]
        listed += sorted(behind)
    return [index for index in listed if index in cones.members]


def few_behind(netlist: Netlist, cones: Cones, observed: Iterable[int], at_most: int) -> list[list[int]]:
    """Return of each of these nets the top-level gates behind it, none where they are more than that.

    Args:
        observed: nets that gates drive.
    """
    driver = netlist.driver()
    behind: dict[int, set[int] | None] = {}  # of a gate; None: too many
    for index in cones.seen:
        before = [behind[driver[net]] for net in netlist.gates[index].inputs if net in driver]
        here = {index} if index in cones.members else set()
        reached = None if None in before else here.union(*filter(None, before))
        behind[index] = None if reached is None or len(reached) > at_most else reached
    return [sorted(behind[driver[net]] or ()) for net in observed]


def _common(above: list[int], depth: list[int], one: int, other: int) -> int:
    """Return the lowest common dominator; both have a path to an observed net."""
    while one != other:
        if one == OBSERVED or other == OBSERVED:
            return OBSERVED
        if depth[one] >= depth[other]:
            one = above[one]
        else:
            other = above[other]
    return one
