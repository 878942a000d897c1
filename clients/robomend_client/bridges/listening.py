"""What others' observers say on /observations, handed on to the service like our own verdicts.

Their sentences wait on the disk while the service is away, hold for a lifetime, and are unknown after it.
What agents of robomend say there themselves is not heard: the service has it already.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Iterable
from fnmatch import fnmatchcase

from robomend_client.agent.feeds import AgentParts
from robomend_client.agent.reporter import VerdictReporter
from robomend_client.beats import beat
from robomend_client.bridges.names import Names, resolved
from robomend_client.bridges.problems import Problems
from robomend_client.buffer import DiskBuffer
from robomend_client.literals import Atom, Literal, parse_atom
from robomend_client.observers import Change, Verdict, ns
from robomend_client.outbox import Outbox
from robomend_client.python310 import end

# --- what others say on /observations, as literals: the paper's sentences, and the spellings of its released
# observers.
#
#     ok (temp_cpu1) and ok (temp_cpu2)     two literals
#     not ok(scan)  ~ok(scan)  n_ok(scan)  not_ok(scan)  ~Ok(scan)     all the same
#     con(v)  cons(v)                       const(v)
#
# A sentence holds until it was not repeated for a while, or its opposite was said: the last one counts.

MOST_ATOMS = 1000
LONGEST = 4000
"""Characters of a sentence."""

AND = re.compile(r"\s+and\s+|\s*[&∧]+\s*")
NEGATED = re.compile(
    r"(?:not\s+|[~!¬]\s*)(?=[^\s(]+\s*\()|n_(?=ok\s*\()"
    r"|not_(?=(?:ok|on|running|matched|inc|dec|const?|cons)\s*\()",
    re.IGNORECASE,
)
PREDICATES = {"con": "const", "cons": "const"}


def read_sentence(text: str, name: Callable[[str], str] = str) -> list[Literal]:
    """Return the literals of a sentence; `name` gives the model's name of an argument.

    Raises:
        ValueError: it is none that is read here.
    """
    if len(text) > LONGEST:
        raise ValueError(f"a sentence of {len(text)} characters")
    return [_literal(part, name) for part in AND.split(text.strip())]


def _literal(text: str, name: Callable[[str], str]) -> Literal:
    positive = True
    rest = text.strip()
    while found := NEGATED.match(rest):
        positive = not positive
        rest = rest[found.end() :]
    if "(" not in rest:
        raise ValueError(f"{text[:80]!r} is no literal; write e.g. not ok(scan)")
    atom = parse_atom(rest)
    predicate = atom.predicate[:1].lower() + atom.predicate[1:]
    return Literal(Atom(PREDICATES.get(predicate, predicate), tuple(map(name, atom.args))), positive)


class Sentences:
    """What holds of all that was said. Times are integer nanoseconds."""

    def __init__(self, lifetime_ns: int) -> None:
        self._lifetime_ns = lifetime_ns
        self._said: dict[Atom, tuple[Literal, int]] = {}  # with when it was last said

    def heard(self, literals: Iterable[Literal], now_ns: int) -> list[Change]:
        """Somebody said so; return what is new."""
        changes = []
        for literal in literals:
            before = self._said.get(literal.atom)
            if before is None and len(self._said) >= MOST_ATOMS:
                continue
            self._said[literal.atom] = (literal, now_ns)
            if before is None or before[0] != literal:
                changes.append(Change(now_ns, literal.atom, literal, now_ns))
        return changes

    def expired(self, now_ns: int) -> list[Change]:
        """Forget what nobody repeats; return what is unknown from now on."""
        old = [atom for atom, (_, said_ns) in self._said.items() if now_ns - said_ns >= self._lifetime_ns]
        for atom in old:
            del self._said[atom]
        return [Change(now_ns, atom, None) for atom in old]

    def standing(self) -> list[Verdict]:
        """Return what holds, with when it was last said."""
        return [Verdict(literal, said_ns) for literal, said_ns in self._said.values()]


SOURCE = "ROS /observations"
LOOK_S = 0.5
"""How often it is looked what nobody repeats; a tenth of the lifetime, if that is less."""


class Listening:
    """Reads /observations."""

    def __init__(
        self,
        parts: AgentParts,
        names: Names,
        problems: Problems,
        lifetime_s: float,
        ignored: tuple[str, ...],
        folder: str,
    ) -> None:
        """`folder`, in the agent's state directory, is where sentences wait; `ignored` are nodes."""
        self._parts = parts
        self._names = names
        self._problems = problems
        self._ignored = ignored
        self._look_s = min(LOOK_S, lifetime_s / 10)
        self._sentences = Sentences(ns(lifetime_s))
        self._buffer = DiskBuffer(parts.state_dir / folder, parts.buffer_bytes)
        self._reporter = VerdictReporter(
            Outbox(parts.client, parts.robot, self._buffer),
            SOURCE,
            parts.heartbeat_s,
            lifetime_s,
            self._sentences.standing,
            parts.clock,
        )

    def ignores(self, node: str) -> bool:
        """Return whether what this node says is not heard."""
        return any(fnmatchcase(node, pattern) for pattern in self._ignored)

    def heard(self, node: str, sentences: Iterable[str]) -> None:
        """A node has said this."""
        now_ns = self._parts.clock.now_ns()
        for text in sentences:
            try:
                literals = read_sentence(text, lambda name: self._names.ours(resolved(name)))
            except ValueError as error:
                self._problems.tell(f"/observations by {node}", f"not understood: {error}"[:300])
            else:
                self._reporter.report(self._sentences.heard(literals, now_ns))

    async def run(self) -> None:
        """Report until cancelled."""
        report = asyncio.create_task(self._reporter.run())
        try:
            while not report.done():
                await beat(self._look_s)
                self._reporter.report(self._sentences.expired(self._parts.clock.now_ns()))
            report.result()
        finally:
            await end([report])
            self._buffer.close()
