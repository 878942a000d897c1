"""Observation sets of others, on ISCAS-85 circuits: published ones, or your own.

They do not come with the package, as they have licences of their own: --data DIR names a folder with
observations/c432.obs and so on. Two forms of file are read:

    // MC = 3                                     so many gates at most
    observation obs_1 { i1 && !i2 && o1; }        of LyDiA
    [c432,1,[i1,-i2,o1]].                         lists

`i1`, `i2`, … and `o1`, `o2`, … are the inputs and outputs in the order of the circuit; a net's own name is
taken, too. An output that is an input says nothing of gates, and is left out: published sets have such
outputs free of their inputs. `MC` is how many faults the set's authors found; the minimum cardinality is
often less.
"""

from __future__ import annotations

import random
import re
from collections.abc import Iterator
from itertools import chain, zip_longest
from pathlib import Path
from typing import NamedTuple

from robomend.errors import InputError
from robomend_bench.generator import Circuit, read_circuit
from robomend_bench.suite import DATA, ONE, Group, Question, Wish
from robomend_bench.suites.iscas85 import BY_DEFAULT, CIRCUITS, COLD, Circuits, Observed, compiled
from robomend_client.literals import Atom, Literal

QUESTIONS = 30
"""A circuit, as many of each minimum cardinality as can be."""

STATED = r"//\s*MC\s*=\s*(?P<size>\d+)"
LYDIA = r"\bobservation\s+(?P<name>\w+)\s*\{(?P<body>[^}]*)\}"
LISTS = r"\[\s*[^\[\],]+,\s*(?P<index>\w+)\s*,\s*\[(?P<list>[^\]]*)\]\s*\]"
FOUND = re.compile(f"{STATED}|{LYDIA}|{LISTS}")

NAMED = re.compile(r"(?P<not>[!~-]?)\s*(?P<net>[^\s!~,&;-]+)")


class Stated(NamedTuple):
    """An observation, with what the file states of its cardinality."""

    name: str
    size: int | None  # the minimum cardinality is this at most
    seen: Observed


def read_observations(text: str, circuit: Circuit, file: str) -> list[Stated]:
    """Return the observations of a file.

    Raises:
        InputError: there are none, or one names a net that is no input or output of the circuit.
    """
    nets = {net: net for net in (*circuit.inputs, *circuit.outputs)}
    for letter, row in (("i", circuit.inputs), ("o", circuit.outputs)):
        for place, net in enumerate(row, 1):
            nets.setdefault(f"{letter}{place}", net)
    through = {f"o{place}" for place, net in enumerate(circuit.outputs, 1) if net in circuit.inputs}
    found: list[Stated] = []
    size: int | None = None
    for match in FOUND.finditer(text):
        if match["size"]:
            size = int(match["size"])
            continue
        name = match["name"] or match["index"]
        seen = []
        for each in NAMED.finditer(match["body"] if match["name"] else match["list"]):
            if each["net"] not in nets:
                line = text.count("\n", 0, match.start()) + 1
                raise InputError(
                    f"{file}, line {line}: {each['net']!r} of observation {name} is no input or output of "
                    f"the circuit: expected i1 to i{len(circuit.inputs)}, "
                    f"o1 to o{len(circuit.outputs)}, or a net"
                )
            if each["net"] in through:
                continue
            seen.append(Literal(Atom("v", (nets[each["net"]],)), not each["not"]))
        found.append(Stated(name, size, tuple(seen)))
    if not found:
        raise InputError(
            f"{file}: no observation; expected lines as "
            "'observation obs_1 { i1 && !o1; }' or '[c17,1,[i1,-o1]].'"
        )
    return found


class Observations(Circuits):
    """The circuits of iscas85 with observations from files."""

    def groups(self, wish: Wish) -> Iterator[Group]:
        """Yield a group a circuit that has a file; which of its observations is drawn by the seed."""
        folder = wish.data / self.name
        names = wish.only or tuple(name for name in BY_DEFAULT if (folder / f"{name}.obs").is_file())
        if not names:
            raise InputError(f"no {folder}/c17.obs, …: give --data DIR{self._source}")
        for name in names:
            text, path = self.text(name, wish), folder / f"{name}.obs"
            if not path.is_file():
                raise InputError(f"no {path}: give --data DIR{self._source}")
            stated = read_observations(path.read_text(), read_circuit(text), str(path))
            cnf = compiled(text, name)
            drawn = _drawn(stated, wish, random.Random(f"{wish.seed} {name}"))
            if not drawn:
                raise InputError(f"{path}: no observation has a minimum cardinality that --size names")
            questions = tuple(
                Question(one.name if one.size is None else f"{one.size:02d}-{one.name}", one.seen)
                for one in drawn
            )
            yield Group(name, len(cnf.components), text if wish.mode in COLD else cnf, questions)

    def circuit_file(self, name: str, wish: Wish) -> Path:
        """Return the circuit beside the observations, or the one of the package."""
        own = wish.data / "iscas85" / f"{name}.bench"
        return own if own.is_file() else DATA / "iscas85" / f"{name}.bench"


def _drawn(stated: list[Stated], wish: Wish, chance: random.Random) -> list[Stated]:
    """Return a sample, as many of each stated cardinality as can be, in the order of the file."""
    some = stated
    if wish.mode in ONE and isinstance(wish.sizes, tuple):
        least, most = wish.sizes
        some = [one for one in stated if one.size is not None and least <= one.size <= most]
    chance.shuffle(some := list(some))
    by_size: dict[int, list[Stated]] = {}
    for one in some:
        by_size.setdefault(-1 if one.size is None else one.size, []).append(one)
    rounds = chain.from_iterable(zip_longest(*(by_size[size] for size in sorted(by_size))))
    drawn = [one for one in rounds if one is not None][: wish.instances or QUESTIONS]
    return sorted(drawn, key=stated.index)


SUITE = Observations(
    "observations",
    "ISCAS-85 circuits with published observations, or yours; give --data",
    CIRCUITS,
    BY_DEFAULT,
    None,
    " with observations/c17.obs; docs/benchmarks.md says where they can be had",
)
