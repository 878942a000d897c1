"""A component model to a System: schemes, user rules and fault modes to clauses, and the vocabulary beside
them."""

from __future__ import annotations

from dataclasses import replace
from itertools import zip_longest

from robomend.errors import ModelError, ObservationError
from robomend.model.budget import MODEL_STEPS, scheme_steps
from robomend.model.clauses import Modes, compile_rules
from robomend.model.cnf import Rule
from robomend.model.components import KINDS, LOAD, ComponentModel
from robomend.model.formulas import AB, Formula, Interlock
from robomend.model.functions import check_functions, condition, read_comparisons, with_compared
from robomend.model.loops import loops_of
from robomend.model.rules import Sentence, read_rules
from robomend.model.schemes import outputs, publishers_of, schemes
from robomend.model.system import System
from robomend.model.vocabulary import ACTIVE, HAS_VARIANT, Vocabulary
from robomend_client.literals import Atom


def compile_robot(
    model: ComponentModel, *, source: str = "", file: str | None = None, most: int = MODEL_STEPS
) -> System:
    """Return a checked component model, ready to use.

    Args:
        most: steps that this may take (robomend.model.budget).

    Raises:
        ModelError: a rule of the user's that cannot be read, or names what the model does not have; more
            steps than that.
    """
    spent = scheme_steps(model)
    if spent > most:
        raise ModelError(
            f"the clause schemes take {spent:,} steps; at most {most:,} are taken: most are for nodes with "
            "many devices and topics, for related values of topics with many publishers, or for fault modes",
            file,
        )
    rules = [
        Sentence(text, f"rule {number}", line)
        for number, (text, line) in enumerate(
            zip_longest(model.rules, model.rule_lines[: len(model.rules)]), start=1
        )
    ]
    parts = model.parts.values()
    mode_sentences = [
        (part, mode, Sentence(text, f"mode {mode} of {part.name}", part.line))
        for part in parts
        for mode, texts in part.modes.items()
        for text in texts
    ]
    act_when = [] if model.act_when is None else [Sentence(model.act_when, "act_when", model.act_when_line)]
    variants = [
        (function.name, variant)
        for function in model.functions.values()
        for variant in function.variants.values()
        if variant.when is not None
    ]
    known = vocabulary_of(model)
    whens = [
        Sentence(
            read_comparisons(one.when or "", known, f"when of {function}.{one.name}", file, one.when_line),
            f"when of {function}.{one.name}",
            one.when_line,
        )
        for function, one in variants
    ]
    formulas, vocabulary, warnings = read_rules(
        [*rules, *(sentence for _, _, sentence in mode_sentences), *whens, *act_when],
        known,
        file,
        most,
        spent,
    )
    _check_kinds(model, vocabulary, file)
    first = len(rules) + len(mode_sentences)
    conditions = {
        (function, one.name): condition(formula, sentence, file)
        for (function, one), sentence, formula in zip(variants, whens, formulas[first:], strict=False)
    }
    vocabulary, compared = with_compared(vocabulary)
    check_functions(model, conditions, file)
    user = [
        (formula, Rule(rule.text, f"user rule {number}", rule.line))
        for number, (formula, rule) in enumerate(zip(formulas, rules, strict=False), start=1)
    ]
    modes = []
    said = list(zip(mode_sentences, formulas[len(rules) : len(rules) + len(mode_sentences)], strict=True))
    for part in parts:
        if part.modes:
            modes.append(
                Modes(
                    part.name,
                    {
                        mode: tuple(f for (owner, m, _), f in said if owner is part and m == mode)
                        for mode in part.modes
                    },
                    part.exhaustive_modes,
                    part.line,
                )
            )
    cnf = compile_rules(
        model.name,
        model.components,
        [*schemes(model), *user],
        modes=modes,
        priors={part.name: part.prior for part in parts if part.prior is not None},
        costs=observation_costs(model),
        puts_out=outputs(model),
        partial=model.partial_failure,
    )
    return System(
        name=model.name,
        format="component",
        source=source,
        cnf=cnf,
        parts=model,
        vocabulary=vocabulary,
        warnings=(*doubtful(model), *warnings, *compared),
        act_when=_interlock(model, formulas[-1], file) if act_when else None,
        loops=loops_of(model),
        conditions=conditions,
    )


def _interlock(model: ComponentModel, formula: Formula, file: str | None) -> Interlock:
    """Return what must be observed before anything is sent; ModelError if it is no observation."""
    assert model.act_when is not None
    found = Interlock(model.act_when, formula)
    for atom in found.atoms:
        if atom.predicate == AB:
            raise ModelError(
                f"act_when: {atom} is what a diagnosis decides; say what must be observed before an action",
                file,
                model.act_when_line,
            )
    if not found.atoms:
        raise ModelError(
            "act_when names nothing that could be observed; an example is `ok(parked)`",
            file,
            model.act_when_line,
        )
    return found


def _check_kinds(model: ComponentModel, vocabulary: Vocabulary, file: str | None) -> None:
    """Refuse what the clauses of a kind speak of and the model does not have."""
    for kind in KINDS:
        for name in model.others.get(kind.section, ()):
            part = model.others[kind.section][name]
            try:
                for premises, conclusion in part.clauses():
                    for literal in (*premises, conclusion):
                        vocabulary.check(literal)
            except ObservationError as error:
                raise ModelError(f"{kind.what} {name}: {error}", file, part.line) from error


def vocabulary_of(model: ComponentModel) -> Vocabulary:
    """Return what observations and rules of this robot may speak of, rules of the user's aside.

    Besides topics and properties, `ok` takes a property of one component, `ok(temperature,arm)`; the
    resources of a process, `ok(CPU,node)`; and the current of a board channel, written `ok(current(jaguar))`
    or `ok(current,jaguar)`.
    """
    nodes = model.nodes.values()
    topics = dict.fromkeys(model.topics)
    topics.update(dict.fromkeys(topic for node in nodes for topic in node.publishes))
    known = Vocabulary(
        sorts={
            "components": tuple(model.parts),
            "switchable": tuple(name for name in model.hardware if model.switchable(name)),
            **{kind.section: tuple(model.of(kind)) for kind in KINDS},
            "topics": tuple(topics),
            "properties": tuple(dict.fromkeys((*model.properties, *([LOAD] if model.computers else [])))),
            "values": tuple(model.values),
            "node_resources": ("CPU", "Mem"),
            "channel_readings": ("current",),
        },
        predicates={
            **{kind.state: ((kind.section,),) for kind in KINDS},
            "ok": (
                ("topics",),
                ("properties",),
                ("properties", "components"),
                ("node_resources", "nodes"),
                ("channel_readings", "switchable"),
            ),
            "inc": (("values",),),
            "dec": (("values",),),
            "const": (("values",),),
            "matched": (("values", "values"),),
        },
        relations={
            "drives": frozenset((node.name, device) for node in nodes for device in node.drives),
            "publishes": frozenset((node.name, topic) for node in nodes for topic in node.publishes),
            "reads": frozenset(
                (node.name, topic) for node in nodes for inputs in node.publishes.values() for topic in inputs
            ),
            "rests_on": frozenset(
                (topic, source)
                for node in nodes
                for topic, inputs in node.publishes.items()
                for source in inputs
            ),
            "feeds": frozenset(
                (feeder, device.name) for device in model.hardware.values() for feeder in device.fed_by
            ),
            "on_host": frozenset(
                (part.name, part.host) for part in model.parts.values() if part.host is not None
            ),
            "carries": frozenset((value.topic, value.name) for value in model.values.values()),
        },
    )
    functions = model.functions.values()
    variants = frozenset((function.name, variant) for function in functions for variant in function.variants)
    if not variants:
        return known
    names = {"functions": {name for name, _ in variants}, "variants": {variant for _, variant in variants}}
    return replace(
        known,
        sorts={**known.sorts, **{sort: tuple(sorted(some)) for sort, some in names.items()}},
        predicates={**known.predicates, ACTIVE: (("functions", "variants"),)},
        relations={**known.relations, HAS_VARIANT: variants},
    )


def observation_costs(model: ComponentModel) -> dict[Atom, float]:
    """Return what observing costs where the model says so, in seconds."""
    costs = {topic.name: topic.cost for topic in model.topics.values() if topic.cost is not None}
    return {Atom("ok", (name,)): cost for name, cost in {**costs, **model.property_costs}.items()}


def doubtful(model: ComponentModel) -> list[str]:
    """Return warnings: what is allowed, and yet seldom what was meant."""
    publishers = publishers_of(model)
    found = [
        f"topic {topic} has {len(nodes)} publishers ({', '.join(node.name for node in nodes)}): "
        "when it is not ok, each of them is to blame"
        for topic, nodes in publishers.items()
        if len(nodes) > 1
    ]
    for one, other in model.related:
        for value in (one, other):
            topic = model.values[value].topic
            if topic not in publishers:
                found.append(
                    f"related values {one} and {other}: no node publishes {topic}, so nothing can be blamed"
                )
    return found
