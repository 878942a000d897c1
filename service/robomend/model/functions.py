"""Functions of the robot and their variants: the conditions on OBS, and what is wrong with a set of variants.

A condition (`when`) is a sentence of the language of rules that may compare readings as well:

    visibility >= 3.25 ± 0.1 and ok(camera_image)

A comparison becomes an atom of its own, `reading(visibility, >=, 3.25, 0.1)`, which no observation says: it
is judged over the number that was measured beside a literal of that name. Within ± of its bound it counts as
it did before: a variant that is active keeps it a bit longer, a better one waits a bit longer for it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import pairwise, product
from typing import NamedTuple, NoReturn

from robomend.errors import ModelError
from robomend.model.components import ComponentModel, Function, Variant
from robomend.model.formulas import AB, And, Formula, Iff, Implies, Leaf, Not, Or, Truth, leaves, truth
from robomend.model.rules import Sentence, mapped
from robomend.model.vocabulary import TRENDS, Vocabulary
from robomend_client.literals import Atom, Literal, quote
from robomend_client.near import did_you_mean

READING = "reading"

COMPARISON = re.compile(
    r"""(?P<name> "(?:[^"\\]|\\.)*" | [\w./](?:[\w./-]*[\w.])? (?:\(\s*[^()"]*\s*\))? ) \s*
        (?P<sign> >= | <= | ≥ | ≤ | (?<![-<])> | <(?!-) ) \s*
        (?P<bound> [-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)? )
        (?: \s* (?:±|\+-|\+/-) \s* (?P<margin> \d+(?:\.\d*)?(?:[eE][-+]?\d+)? ) )?
        (?![\w.])""",
    re.VERBOSE,
)
SIGNS = {"≥": ">=", "≤": "<="}
OPPOSITE = {">=": "<", "<": ">=", "<=": ">", ">": "<="}
IN_WORDS = {">=": "at least", "<=": "at most", ">": "above", "<": "below"}

MOST_CASES = 20_000
"""Combinations of what conditions speak of that are tried to find variants that are never the best."""


class Threshold(NamedTuple):
    """A measured number against a bound."""

    of: Atom
    sign: str
    bound: float
    margin: float

    @classmethod
    def of_atom(cls, atom: Atom) -> Threshold | None:
        """Return the comparison that an atom of a condition stands for, if it does."""
        if atom.predicate != READING or len(atom.args) < 5:
            return None
        *of, sign, bound, margin = atom.args
        return cls(Atom(of[0], tuple(of[1:])), sign, float(bound), float(margin))

    def atom(self) -> Atom:
        """Return the atom that stands for it."""
        said = (self.of.predicate, *self.of.args, self.sign, f"{self.bound:g}", f"{self.margin:g}")
        return Atom(READING, said)

    def holds(self, measured: float, shift: int = 0) -> bool:
        """Return whether it holds of a number.

        Args:
            shift: 1 by the whole margin, 0 by the bound itself, -1 up to the margin beyond it.
        """
        up = self.sign in {">=", ">"}
        bound = self.bound + shift * self.margin * (1 if up else -1)
        if self.sign == ">=":
            return measured >= bound
        if self.sign == "<=":
            return measured <= bound
        return measured > bound if up else measured < bound

    def __str__(self) -> str:
        return f"{IN_WORDS[self.sign]} {self.bound:g}"


Measured = Callable[[Atom], float | None]
"""What was measured beside a literal of an atom; None: nothing is known."""


def holds(
    formula: Formula, value: Callable[[Atom], bool | None], measured: Measured, shift: int
) -> bool | None:
    """Return whether a condition holds; None: what is known does not decide it. `shift`: see Comparison."""

    def known(atom: Atom) -> bool | None:
        compared = Threshold.of_atom(atom)
        if compared is None:
            return value(atom)
        number = measured(compared.of)
        return None if number is None else compared.holds(number, shift)

    return truth(formula, known)


def read_comparisons(
    text: str, vocabulary: Vocabulary, place: str, file: str | None, line: int | None
) -> str:
    """Return a condition with its comparisons as atoms, which the language of rules can read.

    Raises:
        ModelError: a comparison of a name that is nearly one of the model.
    """

    def comparison(found: re.Match[str]) -> str:
        name = found["name"].strip()
        if name.startswith('"'):
            name, bracket, rest = re.sub(r"\\(.)", r"\1", name[1:-1]), "", ""
        else:
            name, bracket, rest = name.partition("(")
        args = tuple(word.strip().lstrip("/") for word in rest.rstrip().rstrip(")").split(","))
        sort = vocabulary.sorts
        plain = name.lstrip("/") or name
        if bracket:
            of = vocabulary.canonical(Literal(Atom(name, args))).atom
            known = vocabulary.declares(of)
        else:
            of, known = Atom("ok", (plain,)), plain in {*sort["topics"], *sort["properties"]}
            if plain in sort["values"]:
                of, known = Atom(TRENDS[0], (plain,)), True
        if not known:
            names = [*sort["properties"], *sort["topics"], *sort["values"]]
            if near := did_you_mean(plain, names, quote):
                raise ModelError(
                    f"{place}: {found[0].strip()} compares a reading, and no property, topic or value is "
                    f"named {quote(plain)}{near}",
                    file,
                    line,
                )
        sign = SIGNS.get(found["sign"], found["sign"])
        atom = Threshold(of, sign, float(found["bound"]), float(found["margin"] or 0)).atom()
        return f"{READING}({', '.join(_quoted(word) for word in atom.args)})"

    return COMPARISON.sub(comparison, text)


def _quoted(word: str) -> str:
    escaped = word.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def condition(formula: Formula, sentence: Sentence, file: str | None) -> Formula:
    """Return a condition with negations of comparisons turned into the opposite comparisons.

    Raises:
        ModelError: it speaks of what a diagnosis decides.
    """
    for leaf in leaves(formula):
        if leaf.literal.atom.predicate == AB:
            raise ModelError(
                f"{sentence.place}: {leaf.literal.atom} is what a diagnosis decides; name the component "
                "under `needs:`",
                file,
                sentence.line,
            )
    return _pushed(formula, True)


def _pushed(formula: Formula, positive: bool) -> Formula:
    match formula:
        case Leaf(literal, position):
            literal = literal if positive else -literal
            compared = Threshold.of_atom(literal.atom)
            if compared is not None and not literal.positive:
                literal = Literal(compared._replace(sign=OPPOSITE[compared.sign]).atom())
            return Leaf(literal, position)
        case Truth(value):
            return Truth(value == positive)
        case Not(body):
            return _pushed(body, not positive)
        case And(parts) | Or(parts):
            pushed = tuple(_pushed(part, positive) for part in parts)
            return And(pushed) if isinstance(formula, And) == positive else Or(pushed)
        case Implies(left, right):
            return _pushed(Or((Not(left), right)), positive)
        case Iff(left, right):
            return _pushed(And((Implies(left, right), Implies(right, left))), positive)
    raise AssertionError("a ground formula has no quantifier")


def with_compared(vocabulary: Vocabulary) -> tuple[Vocabulary, list[str]]:
    """Return the vocabulary with what conditions compare instead of the comparisons, which no observation
    says; and a warning for each name that is declared by that alone.
    """
    atoms, warnings = set(vocabulary.atoms), []
    for atom in sorted(vocabulary.atoms):
        compared = Threshold.of_atom(atom)
        if compared is not None:
            atoms.discard(atom)
            if not vocabulary.declares(compared.of):
                atoms.add(compared.of)
                warnings.append(
                    f"a condition compares {compared.of.args[-1]}, which is no topic or property: taken as "
                    f"declared by it; it is read beside {compared.of}"
                )
    return replace(vocabulary, atoms=frozenset(atoms)), list(dict.fromkeys(warnings))


# --- what is needed


class Need(NamedTuple):
    """What a variant needs: a component, or a function of the robot, or one variant of it."""

    component: str | None = None
    function: str | None = None
    variant: str | None = None  # None: whichever


def need_of(name: str, model: ComponentModel) -> Need | None:
    """Return what a name under `needs:` stands for; None: for nothing."""
    if name in model.parts:
        return Need(component=name)
    if name in model.functions:
        return Need(function=name)
    for function in model.functions.values():
        for variant in function.variants:
            if name == f"{function.name}.{variant}":
                return Need(function=function.name, variant=variant)
    return None


def needs_of(variant: Variant, model: ComponentModel) -> tuple[Need, ...]:
    """Return what a variant needs."""
    return tuple(need for name in variant.needs if (need := need_of(name, model)) is not None)


def rests_on(names: Iterable[str], model: ComponentModel) -> frozenset[str]:
    """Return components with all that has to be good for them to do what they do: what feeds devices, what
    nodes drive, and who publishes their inputs.
    """
    publishers: dict[str, list[str]] = {}
    for node in model.nodes.values():
        for topic in node.publishes:
            publishers.setdefault(topic, []).append(node.name)
    found = set(names)
    pending = list(found)
    while pending:
        name = pending.pop()
        before: set[str] = set()
        if name in model.hardware:
            before.update(model.hardware[name].fed_by)
        elif name in model.nodes:
            driver = model.nodes[name]
            before.update(driver.drives)
            for inputs in driver.publishes.values():
                before.update(one for topic in inputs for one in publishers.get(topic, ()))
        pending += before - found
        found |= before
    return frozenset(found)


def all_of(variant: Variant, model: ComponentModel) -> frozenset[str]:
    """Return the components that a variant needs, with what those rest on."""
    return rests_on((name for name in variant.needs if name in model.parts), model)


def in_order(model: ComponentModel) -> tuple[Function, ...]:
    """Return the functions, each after those that it needs."""
    order, open_ = _ordered(model)
    assert not open_, "circles are refused when a model is read"
    return order


def _ordered(model: ComponentModel) -> tuple[tuple[Function, ...], dict[str, set[str]]]:
    left = {
        function.name: {
            need.function
            for variant in function.variants.values()
            for need in needs_of(variant, model)
            if need.function is not None
        }
        for function in model.functions.values()
    }
    order: list[Function] = []
    while free := [name for name, needed in left.items() if not needed]:
        for name in free:
            del left[name]
            order.append(model.functions[name])
        for needed in left.values():
            needed.difference_update(free)
    return tuple(order), left


def taken_away(variant: Variant) -> frozenset[str]:
    """Return what the acts of a variant switch off or stop."""
    return frozenset(args[0] for name, args in variant.do if name in {"shutdown", "stop_node"} and args)


def spoken_of(conditions: Mapping[tuple[str, str], Formula]) -> frozenset[Atom]:
    """Return the atoms that conditions rest on; of a comparison what it compares."""
    atoms = (leaf.literal.atom for formula in conditions.values() for leaf in leaves(formula))
    return frozenset(atom if (of := Threshold.of_atom(atom)) is None else of.of for atom in atoms)


def left_without(names: Iterable[str], model: ComponentModel) -> dict[str, str | None]:
    """Return of each function that has to work by a worse variant without these components the best that is
    left, conditions aside; None: none is. Without naming any, the best one of each.
    """
    gone, best = frozenset(names), dict[str, str | None]()
    for function in in_order(model):
        best[function.name] = None
        for variant in function.variants.values():
            needs = needs_of(variant, model)
            if not gone.isdisjoint(all_of(variant, model)):
                continue
            if any(
                best[need.function] is None or need.variant not in {None, best[need.function]}
                for need in needs
                if need.function is not None
            ):
                continue
            best[function.name] = variant.name
            break
    if not gone:
        return best
    whole = left_without((), model)

    def rank(name: str, variant: str | None) -> int:
        order = list(model.functions[name].variants)
        return len(order) if variant is None else order.index(variant)

    return {name: variant for name, variant in best.items() if rank(name, variant) > rank(name, whole[name])}


# --- checks


def check_functions(
    model: ComponentModel, conditions: Mapping[tuple[str, str], Formula], file: str | None
) -> None:
    """Refuse variants that can never be what a function works by.

    Raises:
        ModelError: with file and line.
    """

    def fail(message: str, line: int | None) -> NoReturn:
        raise ModelError(message, file, line or 1)

    for function in model.functions.values():
        if function.name in model.parts:
            fail(
                f"{quote(function.name)} is a component already; a function needs a name of its own",
                function.line,
            )
        for variant in function.variants.values():
            _check_variant(function, variant, model, fail)
    _, circle = _ordered(model)
    if circle:
        path = [next(iter(circle))]
        while path[-1] not in path[:-1]:
            path.append(min(circle[path[-1]] & circle.keys()))
        path = path[path.index(path[-1]) :]
        fail(
            f"the functions need each other in a circle: {' needs '.join(path)}",
            model.functions[path[0]].line,
        )
    everything = [
        (function, variant) for function in model.functions.values() for variant in function.variants.values()
    ]
    for index, (function, variant) in enumerate(everything):
        for other, against in everything[index + 1 :]:
            mine, theirs = all_of(variant, model), all_of(against, model)
            if other is function or not (mine & taken_away(against) and theirs & taken_away(variant)):
                continue
            names = ", ".join(sorted((mine & taken_away(against)) | (theirs & taken_away(variant))))
            fail(
                f"{function.name}.{variant.name} and {other.name}.{against.name} take away what the other "
                f"needs ({names}): they can never be active together",
                against.line,
            )
    for function in model.functions.values():
        _check_reachable(function, conditions, fail)
        for variant in function.variants.values():
            _check_together(function, variant, model, conditions, fail)


def _check_variant(
    function: Function, variant: Variant, model: ComponentModel, fail: Callable[[str, int | None], NoReturn]
) -> None:
    name = f"{function.name}.{variant.name}"
    for needed in variant.needs:
        need = need_of(needed, model)
        if need is None:
            known = [
                *model.components,
                *model.functions,
                *(f"{one.name}.{key}" for one in model.functions.values() for key in one.variants),
            ]
            hint = did_you_mean(needed, known, quote) or "; a component, a function, or function.variant"
            fail(f"{name} needs {quote(needed)}, which there is not{hint}", variant.line)
        if need.function == function.name:
            fail(f"{name} cannot need its own function", variant.line)
    lost = taken_away(variant) & all_of(variant, model)
    if lost:
        fail(f"{name} is never admissible: its own acts take away {', '.join(sorted(lost))}", variant.line)
    for act, args in variant.do:
        kinds = dict.fromkeys(("power_up", "shutdown"), frozenset(model.hardware))
        kinds |= dict.fromkeys(("start_node", "stop_node"), frozenset(model.nodes))
        if act in kinds and (len(args) != 1 or args[0] not in kinds[act]):
            what = "device" if act in {"power_up", "shutdown"} else "node"
            near = did_you_mean(args[0], kinds[act], quote) if args else ""
            fail(f"{name}: {act}({', '.join(args)}) wants one {what} of the model{near}", variant.line)


def _check_together(
    function: Function,
    variant: Variant,
    model: ComponentModel,
    conditions: Mapping[tuple[str, str], Formula],
    fail: Callable[[str, int | None], NoReturn],
) -> None:
    """Refuse a variant of which the variants that it needs, and those that they need, exclude each other."""
    name = f"{function.name}.{variant.name}"
    chosen: dict[str, Variant] = {}
    pending = [(function.name, variant)]
    while pending:
        of, needed = pending.pop()
        before = chosen.setdefault(of, needed)
        if before is not needed:
            names = f"{of}.{before.name} and {of}.{needed.name}"
            fail(f"{name} is never admissible: it needs both {names}", variant.line)
        pending += [
            (need.function, model.functions[need.function].variants[need.variant])
            for need in needs_of(needed, model)
            if need.function is not None and need.variant is not None
        ]
    if len(chosen) == 1:
        return
    for of, one in chosen.items():
        for other, needed in chosen.items():
            if lost := taken_away(one) & all_of(needed, model):
                names = ", ".join(sorted(lost))
                fail(
                    f"{name} is never admissible: {of}.{one.name} takes away {names}, which "
                    f"{other}.{needed.name} needs",
                    variant.line,
                )
    formulas = [conditions[of, one.name] for of, one in chosen.items() if (of, one.name) in conditions]
    cases = _cases(formulas)
    if cases is not None and not any(
        all(holds(formula, truths.get, numbers.get, 0) for formula in formulas) for truths, numbers in cases
    ):
        needed_names = ", ".join(f"{of}.{one.name}" for of, one in chosen.items() if of != function.name)
        fail(
            f"{name} is never admissible: nothing fulfils its condition and those of what it needs "
            f"({needed_names}) at once",
            variant.when_line or variant.line,
        )


def _check_reachable(
    function: Function,
    conditions: Mapping[tuple[str, str], Formula],
    fail: Callable[[str, int | None], NoReturn],
) -> None:
    """Refuse a variant whose condition nothing fulfils, or beside which a better one always is admissible."""
    formulas = {
        variant: conditions.get((function.name, variant), Truth(True)) for variant in function.variants
    }
    admissible: dict[str, bool] = dict.fromkeys(formulas, False)
    best: dict[str, bool] = dict.fromkeys(formulas, False)
    cases = _cases(formulas.values())
    if cases is None:
        return
    for truths, numbers in cases:
        enters = {
            name: holds(formula, truths.get, numbers.get, 1) is True for name, formula in formulas.items()
        }
        stays = {
            name: holds(formula, truths.get, numbers.get, 0) is True for name, formula in formulas.items()
        }
        better: list[str] = []
        for name, variant in function.variants.items():
            admissible[name] |= enters[name]
            # Without a component that only the better one needs, nothing stands in the way of this one.
            always = any(
                set(function.variants[other].needs) <= set(variant.needs) and stays[other] for other in better
            )
            best[name] |= stays[name] and not always
            better.append(name)
    for name, variant in function.variants.items():
        line = variant.when_line or variant.line
        if not admissible[name]:
            fail(
                f"{function.name}.{name} is never admissible: nothing fulfils `when: {variant.when}`"
                f"{_crossing(formulas[name])}",
                line,
            )
        if not best[name]:
            fail(
                f"{function.name}.{name} is never reached: whenever it is admissible, a variant that is "
                "preferred to it is as well",
                variant.line,
            )


def _crossing(formula: Formula) -> str:
    """Say that it is the margins of two bounds that cross, where it would be fulfilled without them."""

    def without(leaf: Leaf) -> Formula:
        compared = Threshold.of_atom(leaf.literal.atom)
        return leaf if compared is None else Leaf(Literal(compared._replace(margin=0.0).atom()))

    plain = mapped(formula, without)
    cases = _cases([plain]) or ()
    if any(holds(plain, truths.get, numbers.get, 0) for truths, numbers in cases):
        return "; with their ± the bounds cross"
    return ""


def _cases(
    formulas: Iterable[Formula],
) -> list[tuple[dict[Atom, bool], dict[Atom, float]]] | None:
    """Return what OBS may show of all that conditions speak of, as far as they tell it apart; None: too
    many cases.
    """
    atoms: dict[Atom, None] = {}
    bounds: dict[Atom, set[float]] = {}
    for formula in formulas:
        for leaf in leaves(formula):
            compared = Threshold.of_atom(leaf.literal.atom)
            if compared is None:
                atoms[leaf.literal.atom] = None
            else:
                margins = {-compared.margin, 0.0, compared.margin}
                bounds.setdefault(compared.of, set()).update(compared.bound + one for one in margins)
    ranges: dict[Atom, list[float]] = {}
    count = 2 ** len(atoms)
    for atom, found in bounds.items():
        edges = sorted(found)
        between = [(low + high) / 2 for low, high in pairwise(edges)]
        ranges[atom] = sorted({edges[0] - 1, *edges, *between, edges[-1] + 1})
        count *= len(ranges[atom])
    if count > MOST_CASES:
        return None
    return [
        (dict(zip(atoms, truths, strict=True)), dict(zip(ranges, numbers, strict=True)))
        for truths in product((True, False), repeat=len(atoms))
        for numbers in product(*ranges.values())
    ]
