"""`robomend init action`: an action of PDDL, the program that carries it out, and the test of both."""

from __future__ import annotations

from pathlib import Path
from textwrap import indent

import click

PDDL = """\
;; {name}.pddl: brings {device} back. Say here how.
;;
;; Text of the robot's `domain`, which adds to the repair domain: docs/planning.md, "Your own actions".

(define (domain robot-repair)
  (:predicates
    (can_{name} ?h - hardware))         ; static: what it is for
  (:action {name}
    :parameters (?h - hardware)
    :precondition (and (can_{name} ?h) (bad ?h))
    :effect (and (good ?h) (not (bad ?h))
      ;; A device that comes back needs its driver restarted. Costs are about seconds.
      (forall (?n - node) (when (drives ?n ?h) (and (bad ?n) (not (good ?n)))))
      (increase (total-cost) 5)))
  (:init (can_{name} {device})))
"""

PROGRAM = '''\
"""Carries out {name}; the agent runs it with the action's parameters. Exit code 0: it is done."""

from __future__ import annotations

import sys


def main(device: str) -> int:
    """Do it, and return 0 if it worked."""
    print(f"{name} of {{device}}: put here what it does")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
'''

ENTRY = """\
actions:
  {name}:
    kind: process
    command: [python3, {name}.py, "{{device}}"]
    directory: .                        # of this file
    parameters: {{device: [{device}]}}    # what each may be, in the order of the PDDL
"""

TEST = '''\
"""Run it with: python -m pytest test_{name}.py"""

from __future__ import annotations

import asyncio
from pathlib import Path

from robomend.model.loading import load_text
from robomend.planning.plan import Outcome
from robomend.planning.planning import PlanOptions, plan_for
from robomend_client.actions import OK, Action
from robomend_client.agent.executors.base import read_actions
from robomend_client.literals import holds
from robomend_client.yaml_reader import Section
from robomend_client.yaml_tree import read_tree

HERE = Path(__file__).parent

MODEL = """
robomend: 1
hardware: {{{device}: {{blame_hardware: true}}}}
nodes: {{driver: {{drives: [{device}]}}}}
"""

AGENT = """
{entry}"""


def test_a_plan_uses_it_for_the_device_and_restarts_the_driver() -> None:
    domain = (HERE / "{name}.pddl").read_text()
    parts = load_text(MODEL).parts
    assert parts is not None
    plan = plan_for(parts, [holds("running", "driver")], ["{device}"], PlanOptions(domain=domain))
    assert plan.outcome is Outcome.SOLVED
    assert str(plan.steps[0]) == "{name}({device})"
    assert str(plan.steps[-1]) == "start_node(driver)"


def test_the_agent_carries_it_out() -> None:
    (spec,) = read_actions(Section(read_tree(AGENT), "agent.yaml", ""), HERE)
    executor = spec.make()
    told: list[str] = []
    result = asyncio.run(
        executor.execute(Action("test", "{name}", ("{device}",), 60.0), lambda _, text: told.append(text))
    )
    assert result.code == OK, result.message
'''


@click.command("action")
@click.argument("name")
@click.argument("device")
@click.option("--folder", type=click.Path(path_type=Path, file_okay=False), default=".", help="Write here.")
@click.option("--model", type=click.Path(path_type=Path, exists=True), help="The model that has DEVICE.")
def command(name: str, device: str, folder: Path, model: Path | None) -> None:
    """Write NAME.pddl, an action that brings DEVICE back, NAME.py, which does it, and their test.

    \b
    robomend init action reset_camera camera
    python -m pytest test_reset_camera.py
    """
    from robomend.cli.init.names import snake
    from robomend.cli.init.writing import write_new
    from robomend.errors import InputError
    from robomend.model.loading import load_model
    from robomend.planning.domain.loading import load_domain
    from robomend_client.literals import PLAIN_NAME
    from robomend_client.near import did_you_mean

    if not PLAIN_NAME.match(device):
        raise InputError(f"{device!r} is no name that PDDL and YAML have without quotes")
    if model is not None:
        parts = load_model(model).parts
        known = () if parts is None else tuple(parts.hardware)
        if device not in known:
            near = did_you_mean(device, known) or f"; it has {', '.join(known) or 'none at all'}"
            node = " (it is a node)" if parts is not None and device in parts.nodes else ""
            raise InputError(f"{model} has no device {device!r}{node}{near}")
    words = {"name": snake(name), "device": device}
    pddl = PDDL.format(**words)
    if name in load_domain().schemas:
        raise InputError(f"{name} is an action of the repair domain already")
    load_domain(pddl, f"{name}.pddl")
    entry = ENTRY.format(**words)
    write_new(
        folder,
        {
            f"{name}.pddl": pddl,
            f"{name}.py": PROGRAM.format(**words),
            f"test_{name}.py": TEST.format(**words, entry=entry),
        },
    )
    click.echo(
        f"next: python -m pytest {folder / f'test_{name}.py'} (pip install pytest); in agent.yaml, beside "
        f"{name}.py:\n\n{entry}\n"
        f"and in robot.yaml the text of {name}.pddl:\n\ndomain: |\n" + indent(pddl, "  "),
        err=True,
        nl=False,
    )
