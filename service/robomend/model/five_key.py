"""The five-key format of the published system: read, checked, compiled, and written.

    ab: "AB"                  the word for abnormal, and
    nab: "NAB"                for not abnormal
    neg_prefix: "not_"        of a negative literal: not_on(jaguar)
    props: [ok(scan), …]      the propositions; each p implies p,not_p->false, here by what negation means
    rules: ["NAB(laser),ok(t)->ok(u)", …]

A rule is comma-joined antecedents, `->`, one literal or `false`. Components are the arguments of the ab and
nab words, wherever they stand; one that no rule constrains is kept as `NAB(imu)` in `props`. Negative
literals may stand on either side, and so may AB: any clause can be written, not only Horn clauses.

Propositions that rules use but `props` does not list are warned of, as the released models have such. A
name loses its leading `/`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass

from robomend.errors import ModelError, ObservationError
from robomend.model.cnf import Clause, HealthCnf, Rule
from robomend.model.sentences import plain, tokens
from robomend.model.system import System
from robomend.model.vocabulary import Vocabulary
from robomend_client import yaml_tree
from robomend_client.counts import counted
from robomend_client.literals import Atom, Literal
from robomend_client.yaml_tree import Scalar, Sequence, Tree

KEYS = ("ab", "nab", "neg_prefix", "props", "rules")
SHOWN = 20
"""Unlisted propositions that are warned of one by one."""

SIMPLE = re.compile(r"\s*([\w./-]+)\s*(?:\(([\w\s,./-]*)\)\s*)?\Z")
PUNCTUATION = re.compile(r"[(),]")
WORD = re.compile(r"\w[\w.-]*\Z")


@dataclass(frozen=True, slots=True)
class FiveKey:
    """The five keys as they are written; the lines say where props and rules stand, if they stand
    anywhere."""

    ab: str
    nab: str
    neg_prefix: str
    props: tuple[str, ...]
    rules: tuple[str, ...]
    prop_lines: tuple[int, ...] = ()
    rule_lines: tuple[int, ...] = ()


def read_five_key(tree: Tree, file: str | None = None) -> FiveKey:
    """Return the five keys of a YAML document.

    Raises:
        ModelError: a key is missing, unknown or not of its kind; with file and line.
    """
    if not isinstance(tree, yaml_tree.Mapping):
        raise ModelError(f"a five-key model has the keys {', '.join(KEYS)}", file, tree.line)
    for key in tree.items:
        if key not in KEYS:
            raise ModelError(
                f"no key `{key[:60]}` here; a five-key model has {', '.join(KEYS)}", file, tree.lines[key]
            )
    for key in KEYS:
        if key not in tree.items:
            raise ModelError(f"the key `{key}` is missing", file, tree.line)
    ab, nab, prefix = (_word(tree.items[key], key, file) for key in KEYS[:3])
    if len({ab, nab}) < 2 or not prefix:
        raise ModelError("`ab` and `nab` must differ, and `neg_prefix` must not be empty", file, tree.line)
    props = list(_texts(tree.items["props"], "props", file))
    rules = list(_texts(tree.items["rules"], "rules", file))
    return FiveKey(
        ab,
        nab,
        prefix,
        props=tuple(text for text, _ in props),
        rules=tuple(text for text, _ in rules),
        prop_lines=tuple(line for _, line in props),
        rule_lines=tuple(line for _, line in rules),
    )


def write_five_key(model: FiveKey) -> str:
    """Return the YAML text; reading it gives the same five keys."""
    lines = [f"{key}: {json.dumps(getattr(model, key), ensure_ascii=False)}" for key in KEYS[:3]]
    for key in KEYS[3:]:
        entries: tuple[str, ...] = getattr(model, key)
        lines.append(f"{key}:" if entries else f"{key}: []")
        lines.extend(f"  - {json.dumps(entry, ensure_ascii=False)}" for entry in entries)
    return "\n".join(lines) + "\n"


def system_of(model: FiveKey, *, name: str = "model", source: str = "", file: str | None = None) -> System:
    """Return the five keys compiled.

    Raises:
        ModelError: a rule or proposition that does not parse; with file and line.
    """
    reading = _Reading(model, file)
    cnf = reading.compile(name)
    vocabulary = Vocabulary(
        sorts={"components": cnf.components},
        atoms=frozenset(reading.listed | set(cnf.atoms)),
        negative_prefix=model.neg_prefix,
    )
    return System(
        name=name,
        format="five-key",
        source=source or write_five_key(model),
        cnf=cnf,
        parts=None,
        vocabulary=vocabulary,
        warnings=tuple(reading.warnings()),
    )


def five_key_of(cnf: HealthCnf) -> FiveKey:
    """Return any system description in five keys, clause by clause.

    A clause becomes the rule whose conclusion is its last literal, if that is no component. Auxiliary
    variables are written as propositions `aux(N)`, fault modes as `mode(component,name)`.
    """
    atoms = dict(enumerate(cnf.atoms, len(cnf.components) + 1))
    for component, named in cnf.modes.items():
        atoms.update({variable: Atom("mode", (component, mode)) for mode, variable in named.items()})
    used = {abs(literal) for clause in cnf.clauses for literal in clause}
    for variable in range(len(cnf.components) + len(cnf.atoms) + 1, cnf.variables + 1):
        atoms.setdefault(variable, Atom("aux", (str(variable),)))
    spelled = {atom.predicate for atom in atoms.values()}
    ab, nab, prefix = "AB", "NAB", "not_"
    while {ab, nab} & spelled:
        ab, nab = f"{ab}_", f"{nab}_"
    while any(word.startswith(prefix) for word in spelled | {ab, nab}):
        prefix = f"{prefix}_"

    def said(literal: int) -> str:
        if abs(literal) in atoms:
            atom = atoms[abs(literal)]
            return str(atom if literal > 0 else Atom(prefix + atom.predicate, atom.args))
        return str(Atom(nab if literal > 0 else ab, (cnf.components[abs(literal) - 1],)))

    rules = []
    for clause in cnf.clauses:
        *rest, last = clause
        conclusion = said(last) if abs(last) in atoms else "false"
        premises = [said(-literal) for literal in (rest if abs(last) in atoms else clause)]
        rules.append(f"{','.join(premises)}->{conclusion}")
    idle = [c for index, c in enumerate(cnf.components, 1) if index not in used]
    return FiveKey(
        ab,
        nab,
        prefix,
        (*(str(atoms[v]) for v in sorted(atoms) if v in used), *(str(Atom(nab, (c,))) for c in idle)),
        tuple(rules),
    )


def _parts(text: str) -> list[str]:
    """Split at the commas that stand in no parentheses: those after which no `)` comes before a `(`."""
    found: list[str] = []
    end, inside = len(text), False
    for match in reversed([*PUNCTUATION.finditer(text)]):
        if match[0] != ",":
            inside = match[0] == ")"
        elif not inside:
            found.append(text[match.end() : end])
            end = match.start()
    found.append(text[:end])
    return found[::-1]


class _Reading:
    """Numbers what the rules speak of: components and atoms as they come, put in order at the end."""

    def __init__(self, model: FiveKey, file: str | None) -> None:
        self.model = model
        self.file = file
        self.components: dict[str, int] = {}
        self.atoms: dict[Atom, int] = {}
        self.symbols = 0
        self.seen: dict[str, int | bool] = {}  # a literal's text -> signed symbol, or its truth
        self.listed: set[Atom] = set()
        self.raw_props: set[Atom] = set()
        self.plain_vocabulary = Vocabulary(negative_prefix="")
        lines = model.prop_lines or (None,) * len(model.props)
        parsed = [
            self._parse(text, f"proposition `{text[:60]}`", line)
            for text, line in zip(model.props, lines, strict=True)
        ]
        self.raw_props = {atom for atom in parsed if atom is not None}
        for atom in parsed:
            if atom is not None and not self._component(atom):
                self.listed.add(self._literal(atom).atom)

    def compile(self, name: str) -> HealthCnf:
        model = self.model
        symbolic: list[tuple[int, ...]] = []
        rules: list[Rule] = []
        origins: list[int] = []
        lines = model.rule_lines or (None,) * len(model.rules)
        for number, (text, line) in enumerate(zip(model.rules, lines, strict=True), 1):
            clause = self._rule(text, number, line)
            rules.append(Rule(text, f"five-key rule {number}", line))
            if clause is not None:
                symbolic.append(clause)
                origins.append(number - 1)
        order = {symbol: index for index, symbol in enumerate(self.components.values(), 1)}
        order.update(
            {symbol: index for index, symbol in enumerate(self.atoms.values(), len(self.components) + 1)}
        )
        clauses = [tuple(order[s] if s > 0 else -order[-s] for s in clause) for clause in symbolic]
        count = len(self.components)
        return HealthCnf(
            name=name,
            components=tuple(self.components),
            atoms=tuple(self.atoms),
            clauses=tuple(clauses),
            origins=tuple(origins),
            rules=tuple(rules),
            variables=count + len(self.atoms),
            weak=not any(0 < literal <= count for clause in clauses for literal in clause),
        )

    def warnings(self) -> Iterator[str]:
        missing = [atom for atom in self.atoms if atom not in self.listed]
        for atom in missing[:SHOWN]:
            yield f"{atom} is used by a rule, but `props` does not list it"
        if len(missing) > SHOWN:
            yield f"and {counted(len(missing) - SHOWN, 'more proposition')} that `props` does not list"

    def _rule(self, text: str, number: int, line: int | None) -> Clause | None:
        """Return the clause over symbols; None for a rule that always holds."""
        place = f"rule {number} `{text[:60]}`"
        premises, conclusion = self._split(text, place, line)
        clause: dict[int, None] = {}
        for index, part in enumerate((*premises, conclusion)):
            found = self.seen.get(part)
            if found is None:
                found = self._symbol(part, place, line)
                self.seen[part] = found
            concluded = index == len(premises)
            if isinstance(found, bool):
                if found == concluded:
                    return None  # `… -> true`, or a premise that is false
                continue
            clause[found if concluded else -found] = None
        if not clause:
            raise ModelError(f"{place} says false whatever holds", self.file, line)
        return None if any(-symbol in clause for symbol in clause) else tuple(clause)

    def _split(self, text: str, place: str, line: int | None) -> tuple[list[str], str]:
        if '"' in text:
            left, right = self._split_quoted(text, place, line)
        else:
            sides = text.split("->")
            if len(sides) != 2:
                raise ModelError(f"{place} needs exactly one `->`", self.file, line)
            left = _parts(sides[0]) if sides[0].strip() else []
            right = _parts(sides[1])
        if len(right) != 1:
            raise ModelError(
                f"{place} concludes more than one literal; write a rule for each", self.file, line
            )
        return left, right[0]

    def _split_quoted(self, text: str, place: str, line: int | None) -> tuple[list[str], list[str]]:
        """Split at the arrow and the commas that stand in no quotes and no parentheses."""
        try:
            found = tokens(text)
        except ObservationError as error:
            raise ModelError(f"{place}: {error.message}", self.file, line) from error
        sides: list[list[str]] = [[]]
        depth = start = 0
        for token in found:
            depth += (token.kind == "(") - (token.kind == ")")
            if depth == 0 and token.kind in ("->", ",", "end"):
                part = text[start : token.position]
                if part.strip() or token.kind != "->":
                    sides[-1].append(part)
                start = token.position + len(token.text)
                if token.kind == "->":
                    sides.append([])
        if len(sides) != 2:
            raise ModelError(f"{place} needs exactly one `->`", self.file, line)
        return sides[0], sides[1]

    def _symbol(self, text: str, place: str, line: int | None) -> int | bool:
        if text.strip() in ("true", "false"):
            return text.strip() == "true"
        atom = self._parse(text, place, line)
        component = self._component(atom)
        if component:
            return component
        literal = self._literal(atom)
        if literal.atom not in self.atoms:
            self.symbols += 1
            self.atoms[literal.atom] = self.symbols
        symbol = self.atoms[literal.atom]
        return symbol if literal.positive else -symbol

    def _component(self, atom: Atom) -> int:
        """Return the symbol of NAB(c), negated for AB(c); 0 for what speaks of no component."""
        model, predicate, positive = self.model, atom.predicate, True
        words = (model.ab, model.nab)
        if predicate not in words and predicate.startswith(model.neg_prefix):
            predicate, positive = predicate[len(model.neg_prefix) :], False
        if predicate not in words or len(atom.args) != 1:
            return 0
        name = atom.args[0]
        if name not in self.components:
            self.symbols += 1
            self.components[name] = self.symbols
        symbol = self.components[name]
        return symbol if (predicate == model.nab) == positive else -symbol

    def _literal(self, atom: Atom) -> Literal:
        """Return the literal that a written atom is: its prefix counts unless `props` lists it as it stands
        alone."""
        prefix = self.model.neg_prefix
        positive = True
        if atom.predicate.startswith(prefix) and len(atom.predicate) > len(prefix):
            rest = Atom(atom.predicate[len(prefix) :], atom.args)
            if atom not in self.raw_props or rest in self.raw_props:
                atom, positive = rest, False
        return self.plain_vocabulary.canonical(Literal(atom, positive))

    def _parse(self, text: str, place: str, line: int | None) -> Atom:
        match = SIMPLE.match(text)
        if match is not None and "->" not in text:
            if match[2] is None:
                return Atom(plain(match[1]))
            args = tuple(plain(arg.strip()) for arg in match[2].split(","))
            if all(args) and not any(c.isspace() for arg in args for c in arg):
                return Atom(plain(match[1]), args)
        try:
            return self._parse_quoted(text, place, line)
        except ObservationError as error:
            raise ModelError(f"{place}: {error.message}", self.file, line) from error

    def _parse_quoted(self, text: str, place: str, line: int | None) -> Atom:
        found = tokens(text)
        kinds = [token.kind for token in found]
        names = [token.text if token.kind == "quoted" else plain(token.text) for token in found]
        word = ("name", "quoted")
        whole = len(found) == 2 and kinds[0] in word
        applied = (
            len(found) >= 5
            and kinds[0] in word
            and kinds[1] == "("
            and kinds[-2] == ")"
            and all(kind in word for kind in kinds[2:-2:2])
            and all(kind == "," for kind in kinds[3:-2:2])
            and len(found) % 2 == 1
        )
        if not (whole or applied):
            raise ModelError(
                f"{place}: `{text.strip()[:60]}` is no literal; e.g. ok(scan), "
                f"{self.model.neg_prefix}ok(scan), {self.model.nab}(laser)",
                self.file,
                line,
            )
        return Atom(names[0], tuple(plain(name) for name in names[2:-2:2]) if applied else ())


def _word(tree: Tree, key: str, file: str | None) -> str:
    if not isinstance(tree, Scalar) or not WORD.match(tree.text):
        raise ModelError(f"`{key}` is a word, e.g. AB, NAB, not_", file, tree.line)
    return tree.text


def _texts(tree: Tree, key: str, file: str | None) -> Iterator[tuple[str, int]]:
    if isinstance(tree, Scalar) and tree.empty:
        return
    if not isinstance(tree, Sequence):
        raise ModelError(f"`{key}` is a list of strings", file, tree.line)
    for item in tree.items:
        if not isinstance(item, Scalar):
            raise ModelError(f"`{key}` is a list of strings; put this one in quotes", file, item.line)
        yield item.text, item.line
