"""`robomend compile`: the clauses of a model, for people, for solvers, and for other tools."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from robomend.cli.models import MODEL, load

if TYPE_CHECKING:
    from robomend.model.cnf import HealthCnf

FORMATS = ("clauses", "dimacs", "five-key", "json")


@click.command("compile")
@click.argument("model", type=MODEL)
@click.option("--format", "format_", type=click.Choice(FORMATS), default="clauses", show_default=True)
def command(model: str, format_: str) -> None:
    """Print the clauses of MODEL: a component model, a five-key model, or a circuit (- for stdin)."""
    system = load(model)
    for warning in system.warnings:
        click.echo(f"warning: {warning}", err=True)
    if format_ == "clauses":
        lines = clause_lines(system.cnf)
    elif format_ == "dimacs":
        lines = dimacs_lines(system.cnf)
    elif format_ == "five-key":
        from robomend.model.five_key import five_key_of, write_five_key

        if system.cnf.modes:
            click.echo("warning: fault modes become propositions mode(component,name)", err=True)
        lines = iter((write_five_key(five_key_of(system.cnf)).rstrip("\n"),))
    else:
        lines = iter((json_text(system.cnf),))
    for line in lines:
        click.echo(line)


def clause_lines(cnf: HealthCnf) -> Iterator[str]:
    """Yield each clause in the model's words, with the rule that it came from."""
    words = _words(cnf)
    for clause, origin in zip(cnf.clauses, cnf.origins, strict=True):
        rule = cnf.rules[origin]
        text = " or ".join(words(literal) for literal in clause)
        place = f", line {rule.line}" if rule.line else ""
        yield f"{text}    # {rule.source}{place}: {rule.text}"


def dimacs_lines(cnf: HealthCnf) -> Iterator[str]:
    """Yield DIMACS CNF; comments name the variables (a health variable is true when its component is
    healthy)."""
    words = _words(cnf)
    for variable in range(1, cnf.variables + 1):
        yield f"c {variable} {words(variable)}"
    yield f"p cnf {cnf.variables} {len(cnf.clauses)}"
    for clause in cnf.clauses:
        yield f"{' '.join(map(str, clause))} 0"


def json_text(cnf: HealthCnf) -> str:
    """Return everything as one JSON object; variables are numbered components first, then atoms."""
    import json

    return json.dumps(
        {
            "name": cnf.name,
            "components": cnf.components,
            "atoms": [str(atom) for atom in cnf.atoms],
            "variables": cnf.variables,
            "clauses": cnf.clauses,
            "origins": cnf.origins,
            "rules": [{"text": rule.text, "source": rule.source, "line": rule.line} for rule in cnf.rules],
            "priors": dict(cnf.priors),
            "costs": {str(atom): cost for atom, cost in cnf.costs.items()},
            "modes": {component: dict(modes) for component, modes in cnf.modes.items()},
            "weak": cnf.weak,
            "circuit": cnf.circuit,
            "inputs": [str(atom) for atom in cnf.inputs],
            "outputs": [str(atom) for atom in cnf.outputs],
        },
        ensure_ascii=False,
        separators=(",", ":"),
    )


class _words:  # noqa: N801  # a function with a memory
    """The model's word for a signed variable; auxiliary ones are `aux(N)`, modes `mode(component,name)`."""

    def __init__(self, cnf: HealthCnf) -> None:
        self.cnf = cnf
        self.named = len(cnf.components) + len(cnf.atoms)
        self.modes = {
            variable: f"mode({component},{mode})"
            for component, modes in cnf.modes.items()
            for mode, variable in modes.items()
        }

    def __call__(self, literal: int) -> str:
        variable = abs(literal)
        if variable <= self.named:
            return self.cnf.word(literal)
        word = self.modes.get(variable, f"aux({variable})")
        return word if literal > 0 else f"not {word}"
