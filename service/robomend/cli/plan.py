"""`robomend plan`: observations in, the repair to make out. Nothing is carried out."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.completion import PartName, components_option
from robomend.cli.files import ExistingFile
from robomend.cli.models import MODEL, load
from robomend.diagnosis.engines import ENGINES
from robomend.planning.planners import DEFAULT, PLANNERS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robomend.diagnosis.result import DiagnosisResult
    from robomend.model.system import System
    from robomend.planning.advice import Situation
    from robomend.planning.choice import Choice
    from robomend.planning.plan import Plan
    from robomend.planning.planning import PlanOptions


@click.command("plan")
@click.argument("model", type=MODEL)
@click.option("--observe", "-o", multiple=True, metavar="SENTENCE", help='E.g. "not ok(scan)"; repeatable.')
@components_option("--bad", "Repair this instead of diagnosing; repeatable.")
@click.option(
    "--planner",
    type=PartName("planner", PLANNERS.names),
    default=DEFAULT,
    show_default=True,
    help=f"{', '.join(PLANNERS.built_in)}, or one installed.",
)
@click.option(
    "--domain",
    type=ExistingFile(),
    help="Your PDDL actions, or domain.",
)
@click.option(
    "--engine",
    type=PartName("engine", ENGINES.names),
    default="sat",
    show_default=True,
    help="Of the diagnosis.",
)
@click.option("--timeout", type=float, default=5.0, show_default=True, help="Seconds to plan; inf: none.")
@components_option("--expect-stopped", "This is meant to be off.")
@components_option("--protect", "Never shut this down.")
@click.option("--unknown", type=click.Choice(("refuse", "keep")), default="refuse", help="Undeclared names.")
@click.option("--pddl", is_flag=True, help="Show the planning problem too.")
@click.option("--format", "format_", type=click.Choice(("table", "json")), default="table", show_default=True)
def command(model: str, **given: Any) -> int:
    """Plan the repair of MODEL, a component model, for what was observed."""
    from robomend.oneshots.plan_json import choice_json
    from robomend.planning.advice import parts_of
    from robomend.planning.domain.loading import load_domain
    from robomend.planning.planner_pool import PlannerPool, advise_now
    from robomend.planning.planning import may_be_little

    system = load(model)
    parts = parts_of(system)
    options = _options(system, given)
    load_domain(options.domain, options.domain_file)  # refuse it before the planner is started
    for warning in system.warnings:
        click.echo(f"warning: {warning}", err=True)
    pool = PlannerPool(size=1, spare=0, planners=(options.planner,))
    try:
        if not may_be_little(parts, options):
            pool.start()  # it warms up while we diagnose
        situation = _situation(system, given)
        choice = advise_now(pool, situation, options)
    finally:
        pool.close()
    if given["format_"] == "json":
        click.echo(json.dumps(choice_json(choice, situation.model.components), ensure_ascii=False))
    else:
        show(choice, situation.result, observed=bool(given["observe"] or given["bad"]))
    return 0


def _options(system: System, given: dict[str, Any]) -> PlanOptions:
    from robomend.planning.planning import PlanOptions

    timeout = given["timeout"]
    if math.isnan(timeout) or timeout <= 0:
        raise click.UsageError("--timeout is a number of seconds above 0")
    PLANNERS.check(given["planner"])
    domain: Path | None = given["domain"]
    return PlanOptions(
        planner=given["planner"],
        timeout_s=None if math.isinf(timeout) else timeout,
        domain=None if domain is None else domain.read_text(encoding="utf-8", errors="replace"),
        domain_file=None if domain is None else str(domain),
        expected_stopped=system.named(given["expect_stopped"]),
        protected=system.named(given["protect"]),
        pddl=given["pddl"],
    )


def _situation(system: System, given: dict[str, Any]) -> Situation:
    """Return what was observed with its diagnoses, or with the one that was given."""
    from robomend.oneshots.warm_model import WarmModel, given_diagnosis
    from robomend.planning.advice import Situation, parts_of

    stopped = given["expect_stopped"]
    with WarmModel(system, given["engine"], unknown=given["unknown"], expected_stopped=stopped) as model:
        asked = model.question(given["observe"])
        result = given_diagnosis(given["bad"], system) if given["bad"] else model.ask(asked).result
    return Situation(parts_of(system), tuple(sorted(asked.literals)), result, cnf=system.cnf)


def show(choice: Choice, result: DiagnosisResult, *, observed: bool = True) -> None:
    """Write the choice for people."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from robomend.planning.plan import action_titles

    console = Console(highlight=False, soft_wrap=True)
    if result.healthy:
        seen = "" if observed else "; nothing was observed: see --observe"
        console.print(f"[green]healthy[/]: nothing to repair{seen}")
        return
    if choice.plan is None or choice.diagnosis is None:
        console.print(f"[red]nothing to do[/]: {escape(choice.reason)}")
    else:
        if choice.probe is not None:
            console.print(f"[yellow]look first[/] at {escape(str(choice.probe.atom))}")
        console.print(f"[bold]repair[/] {escape(', '.join(choice.diagnosis.bad))}")
        console.print(f"because {escape(choice.reason)}")
        console.print(_steps(choice.plan))
        _notes(console.print, choice.plan)
    others = [one for one in choice.alternatives if one.diagnosis != choice.diagnosis]
    if others:
        table = Table("instead", "probability", "cost", "actions", title="alternatives", title_justify="left")
        for one in others:
            steps = [{"name": step.name, "parameters": step.parameters} for step in one.plan.steps]
            actions = ", ".join(action_titles(steps)) or "; ".join(one.plan.unreachable) or one.reason
            names = escape(", ".join(one.diagnosis.bad))
            table.add_row(names, f"{one.weight:.2g}", f"{one.plan.cost:g}", escape(actions))
        console.print(table)


def _steps(plan: Plan) -> Any:
    from rich.markup import escape
    from rich.table import Table

    from robomend.planning.plan import action_title

    table = Table("step", "action", "in PDDL", "after", "cost")
    for step in plan.steps:
        after = ", ".join(map(str, step.after))
        title = escape(action_title(step.name, step.parameters))
        table.add_row(str(step.index), title, escape(str(step)), after, f"{step.cost:g}")
    return table


def _notes(say: Any, plan: Plan) -> None:
    from rich.markup import escape

    notes: list[tuple[str, Sequence[str]]] = [
        ("assumed, as it is not observed", [str(one) for one in plan.assumed]),
        ("cannot be repaired", plan.unreachable),
        ("left alone", plan.excluded),
    ]
    for title, lines in notes:
        for line in lines:
            say(f"{title}: {escape(line)}")
    for text in plan.pddl or ():
        say(escape(text))
