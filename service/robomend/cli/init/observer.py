"""`robomend init observer`: a class of ten lines that judges readings, and its test."""

from __future__ import annotations

from pathlib import Path

import click

OBSERVER = '''\
"""ok({name}) while its readings do not jump. Say here what it is about."""

from __future__ import annotations

from typing import Any

from robomend_client.observers import ReadingObserver


class {camel}(ReadingObserver):
    """Good while no reading is further than `most` from the one before."""

    def __init__(self, most: float = 1.0, **rest: Any) -> None:
        super().__init__(**rest)  # atom, source, agreeing, …: docs/observers.md, Readings
        self.most = most
        self.last: float | None = None

    def judge(self, value: float) -> bool | None:
        """Return whether a reading is good; None where it says nothing."""
        last, self.last = self.last, value
        return None if last is None else abs(value - last) <= self.most
'''

TEST = '''\
"""Run it with: python -m pytest test_{name}.py"""

from __future__ import annotations

from pathlib import Path

from robomend_client.literals import Literal, fails, holds
from robomend_client.observers import Observer
from robomend_client.observers.kinds import read_observers
from robomend_client.yaml_reader import Section
from robomend_client.yaml_tree import read_tree

AGENT = """
observers:
  {name}: {{kind: "{name}.py:{camel}", source: "{name}:value", most: 0.5}}
"""


def observer() -> Observer:
    """Return the observer as the agent makes it of its file."""
    (spec,) = read_observers(Section(read_tree(AGENT), "agent.yaml", ""), Path(__file__).parent)
    return spec.make()


def said(*readings: float) -> tuple[Literal, ...]:
    """Return what it says after readings, one each second."""
    watching = observer()
    watching.reset(0)
    for second, reading in enumerate(readings):
        watching.feed("{name}:value", second * 10**9, reading)
    return watching.check(len(readings) * 10**9)


def test_steady_readings_are_good() -> None:
    assert said(1.0, 1.2, 1.1) == (holds("ok", "{name}"),)


def test_a_jump_is_bad() -> None:
    assert said(1.0, 1.2, 3.0) == (fails("ok", "{name}"),)


def test_one_reading_says_nothing() -> None:
    assert said(1.0) == ()
'''

ENTRY = """\
observers:
  {name}: {{kind: "{name}.py:{camel}", source: "TOPIC:FIELD", most: 0.5}}

and in the model, with a rule that says whose fault it is:

properties:
  {name}: {{}}
rules:
  - "not ab(COMPONENT) -> ok({name})"
"""


@click.command("observer")
@click.argument("name")
@click.option("--folder", type=click.Path(path_type=Path, file_okay=False), default=".", help="Write here.")
def command(name: str, folder: Path) -> None:
    """Write NAME.py, an observer of ok(NAME) of your own, and its test.

    \b
    robomend init observer motor_load
    python -m pytest test_motor_load.py
    """
    from robomend.cli.init.names import camel, snake
    from robomend.cli.init.writing import write_new

    words = {"name": snake(name), "camel": camel(name)}
    write_new(folder, {f"{name}.py": OBSERVER.format(**words), f"test_{name}.py": TEST.format(**words)})
    click.echo(
        f"next: python -m pytest {folder / f'test_{name}.py'} (pip install pytest); in agent.yaml, beside "
        f"{name}.py:\n\n" + ENTRY.format(**words),
        err=True,
        nl=False,
    )
