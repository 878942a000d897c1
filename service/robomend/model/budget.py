"""How many steps it takes to ground and compile what somebody sent: known before the first one is taken.

    sentence, vocabulary ──► steps ──► within the budget? ── no ──► refused: place, number, bound, remedy
                                              │ yes
                                              └──► robomend.model.rules, robomend.model.clauses

A step is one leaf of a ground formula, or one instance of a quantifier; it takes 10 to 50 µs all in all. The
instances of quantifiers inside one another are a product, so a line of text can ask for more of them than
there are atoms in the universe. A guard makes the product smaller by what the model fixes:

    forall n in nodes, h in hardware where drives(n, h): …    at most as many as there are pairs in `drives`

What the guards leave is bounded from above, never guessed: no sentence takes more steps than it is counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from robomend.errors import ObservationError
from robomend.model.components import ComponentModel
from robomend.model.formulas import (
    And,
    Formula,
    Iff,
    Implies,
    Leaf,
    Not,
    Or,
    Quantified,
    Truth,
    Variable,
)
from robomend.model.vocabulary import Vocabulary

MODEL_STEPS = 1_000_000
"""Of a model: some 20 s. Rules that need more say the same thing too often."""

ASSERTION_STEPS = 20_000
"""Of one richer observation: under a second. It is compiled anew for the robot that made it."""


@dataclass(frozen=True, slots=True)
class Product:
    """The quantifiers around a place of a sentence."""

    sorts: tuple[tuple[Variable, str], ...] = ()
    instances: int = 1
    """The most bindings that they have, guards considered."""


class StepCount:
    """Counts the steps of sentences over one vocabulary."""

    def __init__(self, vocabulary: Vocabulary) -> None:
        self._vocabulary = vocabulary
        self._degrees: dict[tuple[str, int], int] = {}

    def of(self, formula: Formula) -> int:
        """Return the most steps that grounding and compiling the formula takes."""
        return sum(product.instances for product in self._places(formula, Product()))

    def check(self, formula: Formula, most: int, sentence: str) -> int:
        """Return the steps of the formula.

        Raises:
            ObservationError: there are more than `most`.
        """
        steps = self.of(formula)
        if steps > most:
            message = f"it takes {steps:,} steps; at most {most:,} are taken{self.remedy(formula)}"
            raise ObservationError(message, sentence)
        return steps

    def remedy(self, formula: Formula) -> str:
        """Return what to do about a sentence with too many steps, to be put behind the error."""
        widest = max(self._places(formula, Product()), key=lambda product: product.instances)
        if not widest.sorts:
            return ": say less in one sentence"
        sizes = " × ".join(f"{len(self._vocabulary.sorts[sort]):,} {sort}" for _, sort in widest.sorts)
        return (
            f": its quantifiers range over {sizes}, of which {widest.instances:,} combinations count; "
            "join them with `where`, or use fewer quantifiers"
        )

    def _places(self, formula: Formula, around: Product) -> Iterator[Product]:
        """Yield, for each leaf and each quantifier, what is around it."""
        match formula:
            case Leaf() | Truth():
                yield around
            case Not(body):
                yield from self._places(body, around)
            case And(parts) | Or(parts):
                for part in parts:
                    yield from self._places(part, around)
            case Implies(left, right) | Iff(left, right):
                yield from self._places(left, around)
                yield from self._places(right, around)
            case Quantified(body=body):
                within = self._within(formula, around)
                yield within
                yield from self._places(body, within)

    def _within(self, quantifier: Quantified, around: Product) -> Product:
        variable, sort = quantifier.variable, quantifier.sort
        scope = (*around.sorts, (variable, sort))
        bounds = [around.instances * len(self._vocabulary.sorts[sort])]
        for literal in quantifier.guard:
            relation, args = literal.atom.predicate, literal.atom.args
            if not literal.positive:
                continue
            named = {arg for arg in args if isinstance(arg, Variable)}  # a quoted "n" is no variable
            if variable in named and args[0] != args[1]:  # so many values go with each one at the other place
                place = args.index(variable)
                bounds.append(around.instances * self._degree(relation, place))
            if relation != "same":  # each pair, with any values of what it does not speak of
                bound = len(self._vocabulary.relations[relation])
                for other, other_sort in scope:
                    if other not in named:
                        bound *= len(self._vocabulary.sorts[other_sort])
                bounds.append(bound)
        return Product(scope, min(bounds))

    def _degree(self, relation: str, place: int) -> int:
        """Return how many names at a place of the relation go with one name at the other place, at most."""
        if relation == "same":  # a name goes with itself
            return 1
        if (relation, place) not in self._degrees:
            counted = Counter(pair[1 - place] for pair in self._vocabulary.relations[relation])
            self._degrees[relation, place] = max(counted.values(), default=0)
        return self._degrees[relation, place]


def check_steps(steps: int, most: int, sentence: str) -> None:
    """Refuse a sentence that, with the richer ones before it, takes too many steps."""
    if steps > most:
        raise ObservationError(
            f"with the richer sentences before it, it takes {steps:,} steps; at most {most:,} are taken: "
            "withdraw some, or say it in the model's rules",
            sentence,
        )


def scheme_steps(model: ComponentModel) -> int:
    """Return how many steps the six schemes take: the literals of their clauses, and fault modes."""
    publishers: Counter[str] = Counter(topic for node in model.nodes.values() for topic in node.publishes)
    steps = 0
    for device in model.hardware.values():
        steps += 2 + len(device.fed_by)
    fed: dict[str, int] = {}  # driven device -> its feeders, all the way up
    for node in model.nodes.values():
        for name in node.drives:
            if name not in fed and steps <= MODEL_STEPS:
                fed[name] = len(model.feeders(name))
                steps += fed[name]
        needed = sum(2 + 2 * fed.get(name, 0) for name in node.drives)
        steps += 2 + sum(2 + needed + len(inputs) for inputs in node.publishes.values())
    for one, other in model.related:
        steps += 3 * publishers[model.values[one].topic] * publishers[model.values[other].topic]
    steps += sum(
        2 + len(list(premises))
        for others in model.others.values()
        for part in others.values()
        for premises, _ in part.clauses()
    )
    modes = [part.modes for part in model.parts.values()]
    steps += sum((len(named) + 1) ** 2 for named in modes if named)  # at most one: each pair is a clause
    return steps
