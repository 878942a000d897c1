"""Feature models with requirements that cannot all be met: which of them to drop, made by the seed.

A product line is a tree of features: a parent's children are mandatory or optional, or a group of which one
(alternative) or at least one (or) is chosen; across the tree features require or exclude others. A customer
wants some features and does without others. The components are these requirements, each "broken" when it is
not kept, and a diagnosis is a smallest set to give up. Observed is which requirements were stated.

Source of the question: A. Felfernig, M. Schubert, C. Zehentner. An efficient diagnosis algorithm for
inconsistent constraint sets. AI EDAM 26(1), 2012.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping

from pysat.solvers import Solver

from robomend.errors import InputError
from robomend.model.cnf import Clause, HealthCnf, Rule
from robomend_bench import contenders
from robomend_bench.exporting import DiagnosisProblem, Exported
from robomend_bench.suite import Ask, Group, Question, Wish
from robomend_client.literals import Atom, Literal

SIZES = ("100", "500", "2000", "10000")

CROSS = 0.2
"""Requires and excludes across the tree, for each feature."""

STATED = 0.1, 60
"""The share of features that a customer says something of, and how many at most."""

ATTEMPTS = 1_000


class FeatureModels:
    """See the module."""

    name = "feature-models"
    version = "1"
    summary = "product lines of 100 to 10,000 features, and requirements that cannot all be met"
    modes: Mapping[str, str] = {
        mode: contenders.MODES[mode] for mode in ("few", "first", "all", "subset", "conflicts")
    }

    def contenders(self, mode: str) -> tuple[str, ...]:
        """Return the engine and what it is held against in this mode."""
        others = {"all": ("layered-full",), "subset": ("layered-full",), "conflicts": ("marco", "optux")}
        return ("sat", *others.get(mode, (*contenders.RC2, "hs_dag")))

    def groups(self, wish: Wish) -> Iterator[Group]:
        """Yield a group a size: one product line, many customers."""
        for size in wish.only or SIZES:
            if not size.isdecimal() or not 10 <= int(size) <= 100_000:
                raise InputError(f"--only {size}: give numbers of features, 10 to 100000")
            chance = random.Random(f"{wish.seed} {size} features")
            cnf = feature_model(int(size), chance)
            yield Group(size, len(cnf.components), cnf, tuple(_questions(cnf, wish.instances or 20, chance)))

    def prepare(self, contender: str, group: Group, wish: Wish) -> Ask:
        """Return what answers the customers of one product line."""
        return contenders.prepare(contender, group.model, group, wish)

    def exported(self, question: Question, group: Group) -> Exported:
        """Return the product line with what one customer stated."""
        return DiagnosisProblem(group.model, [question.payload])


def feature_model(features: int, chance: random.Random) -> HealthCnf:
    """Return a product line: components `with(f)` and `without(f)`, atoms `stated(...)` and `chosen(f)`."""
    names = [f"f{index:05d}" for index in range(features)]
    kept = [f"{word}({name})" for name in names for word in ("with", "without")]
    atoms = [Atom("stated", (one,)) for one in kept] + [Atom("chosen", (name,)) for name in names]
    first = len(kept) + 1
    chosen = {name: first + len(kept) + index for index, name in enumerate(names)}
    clauses: list[Clause] = []
    origins: list[int] = []
    rules: list[Rule] = []

    def say(text: str, source: str, *made: Clause) -> None:
        rules.append(Rule(text, source))
        clauses.extend(made)
        origins.extend([len(rules) - 1] * len(made))

    say(f"chosen({names[0]})", "root", (chosen[names[0]],))
    for parent, children, kind in _tree(names, chance):
        have = [chosen[child] for child in children]
        up = chosen[parent]
        say(f"children of {parent} need it", kind, *((-one, up) for one in have))
        if kind == "mandatory":
            say(f"{parent} needs {', '.join(children)}", kind, *((-up, one) for one in have))
        elif kind in ("or", "alternative"):
            say(f"{parent} needs one of {', '.join(children)}", kind, (-up, *have))
        if kind == "alternative":
            pairs = [(-a, -b) for index, a in enumerate(have) for b in have[index + 1 :]]
            say(f"{parent} takes one of {', '.join(children)} only", kind, *pairs)
    for one, other, requires in _across(names, clauses, chosen, chance):
        if requires:
            say(f"{one} requires {other}", "requires", (-chosen[one], chosen[other]))
        else:
            say(f"{one} excludes {other}", "excludes", (-chosen[one], -chosen[other]))
    for index, text in enumerate(kept):
        feature = chosen[names[index // 2]]
        asked = first + index
        wanted = feature if index % 2 == 0 else -feature
        say(f"not ab({text}) and stated({text}) -> {text}", "requirement", (-(index + 1), -asked, wanted))
    return HealthCnf(
        name=f"features-{features}",
        components=tuple(kept),
        atoms=tuple(atoms),
        clauses=tuple(clauses),
        origins=tuple(origins),
        rules=tuple(rules),
        variables=len(kept) + len(atoms),
    )


def _tree(names: list[str], chance: random.Random) -> Iterator[tuple[str, list[str], str]]:
    """Yield parent, children, and how they hang on it."""
    waiting, place = [names[0]], 1
    while place < len(names):
        parent = waiting.pop(chance.randrange(len(waiting)))
        children = names[place : place + chance.randint(2, 6)]
        place += len(children)
        waiting += children
        groups = ["mandatory", "optional", "optional"] + ["or", "alternative"] * (len(children) > 1)
        yield parent, children, chance.choice(groups)


def _across(
    names: list[str], tree: list[Clause], chosen: Mapping[str, int], chance: random.Random
) -> Iterator[tuple[str, str, bool]]:
    """Yield one feature, another, and whether it requires or excludes it; each feature stays possible."""
    with Solver("cadical153", bootstrap_with=tree) as solver:
        for _ in range(int(CROSS * len(names))):
            one, other = chance.sample(names[1:], 2)
            requires = chance.random() < 0.5
            clause = [-chosen[one], chosen[other] if requires else -chosen[other]]
            switch = solver.nof_vars() + 1
            solver.add_clause([*clause, -switch])
            if all(solver.solve([switch, chosen[name]]) for name in (one, other)):
                solver.add_clause([switch])
                yield one, other, requires
            else:
                solver.add_clause([-switch])


def _questions(cnf: HealthCnf, instances: int, chance: random.Random) -> Iterator[Question]:
    """Yield what customers state, as observations; what not is stated is known not to be.

    Raises:
        InputError: this product line can meet whatever is asked.
    """
    features = len(cnf.components) // 2
    share, most = STATED
    stated_of = {text: Atom("stated", (text,)) for text in cnf.components}
    found = 0
    with Solver("cadical153", bootstrap_with=cnf.clauses) as solver:
        for _ in range(ATTEMPTS):
            of = chance.sample(range(features), max(3, min(most, int(share * features))))
            stated = {cnf.components[2 * index + (chance.random() < 0.5)] for index in of}
            healthy = range(1, len(cnf.components) + 1)
            asked = [cnf.atom_variable[stated_of[text]] for text in stated]
            if not solver.solve([*healthy, *asked]):
                yield Question(
                    f"{found:03d}", tuple(Literal(atom, text in stated) for text, atom in stated_of.items())
                )
                found += 1
                if found == instances:
                    return
    if not found:
        raise InputError("these product lines meet whatever is asked: give another --seed")


SUITE = FeatureModels()
