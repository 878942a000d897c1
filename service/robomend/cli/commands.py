"""`robomend`: one entry for the service and its one-shot tools.

Results go to stdout, the rest to stderr. Exit codes: 0 done, 1 a negative answer where that was asked for,
2 bad input, 3 a backend failed. To add a command: write cli/<name>.py with a click command, and one line in
COMMANDS. Another package adds one by an entry point of the group `robomend.commands`: the demo does.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from importlib.util import find_spec

import click
from click.exceptions import NoSuchCommand

from robomend.cli.main import INTERRUPTED
from robomend.errors import BackendError, RobomendError
from robomend.memory_limits import no_room, out_of_memory
from robomend_client.near import did_you_mean
from robomend_client.registry import Registry

# --- A click group that imports a command only when it is run: `robomend --help` must not load a solver.
#
# The table of a group holds one line per command, `name: ("module:attribute", "short help")`. A command
# whose module is not in this installation is left out of the help, and says so when it is called. Other
# packages add theirs by an entry point; as its short help is read from the command, its module must be
# light to import.

Table = Mapping[str, tuple[str, str]]


class LazyGroup(click.Group):
    """A group that knows its commands by a table of import paths, and by a group of entry points."""

    def __init__(self, *args: object, table: Table, others: str | None = None, **options: object) -> None:
        super().__init__(*args, **options)  # type: ignore[arg-type]  # handed through to click as it came
        self.table = table
        self.registry = Registry[object](
            "command", others, {name: path for name, (path, _) in table.items()}, broken=click.ClickException
        )

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands of this installation: ours in the order of the table, then the others'."""
        return [name for name in self.registry.names() if self._installed(name)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        if not self._installed(cmd_name):
            raise click.UsageError(f"`{cmd_name}` is not part of this installation of robomend")
        try:
            command = self.registry.load(cmd_name)
        except LookupError:
            return None
        if not isinstance(command, click.Command):
            raise TypeError(f"{cmd_name} is no click command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table, without importing a command of ours for its help."""
        rows = []
        for name in self.list_commands(ctx):
            rows.append((name, self.table[name][1] if name in self.table else self._short_help(ctx, name)))
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def _short_help(self, ctx: click.Context, name: str) -> str:
        """Return what another package's command says of itself, which may be that it is broken."""
        try:
            command = self.get_command(ctx, name)
        except click.ClickException as error:
            return error.message
        return "" if command is None else command.get_short_help_str(60)

    def _installed(self, name: str) -> bool:
        path = self.registry.built_in.get(name)
        return path is None or find_spec(path.partition(":")[0]) is not None


BAD_INPUT = 2
BACKEND_FAILED = 3

COMMANDS: Table = {
    "serve": ("robomend.cli.serve:command", "Run the service."),
    "diagnose": ("robomend.cli.diagnose:command", "Explain observations by minimal diagnoses."),
    "plan": ("robomend.cli.plan:command", "Plan a repair without carrying it out."),
    "compile": ("robomend.cli.compile:command", "Show the clauses of a model."),
    "model": ("robomend.cli.model:command", "Check a model."),
    "status": ("robomend.cli.remote.status:command", "Say how every robot is, or tell more of one."),
    "watch": ("robomend.cli.remote.watch:command", "Show what happens, live."),
    "observe": ("robomend.cli.remote.probes:observe", "Report what was observed on a robot."),
    "probes": ("robomend.cli.remote.probes:probes", "Say what to look at next, or answer it."),
    "repairs": ("robomend.cli.remote.repairs:repairs", "List repairs, or tell one in words."),
    "moments": ("robomend.cli.remote.moments:command", "Show what was around a fault; fetch its recording."),
    "repair": ("robomend.cli.remote.repairs:repair", "Begin a repair of a robot."),
    "approve": ("robomend.cli.remote.repairs:approve", "Say yes to the plan of a repair."),
    "cancel": ("robomend.cli.remote.repairs:cancel", "End a repair."),
    "stop": ("robomend.cli.remote.stop:command", "Stop all robots; lift or show the stop."),
    "robot": ("robomend.cli.remote.robot:command", "Configure, list, delete robots; release a component."),
    "mcp": ("robomend.cli.remote.mcp:command", "Let an assistant look at a running service."),
    "batches": ("robomend.cli.remote.batches:command", "Have a service diagnose logs."),
    "drill": ("robomend.cli.drill:command", "Plant faults on purpose, watch and undo them; score."),
    "keys": ("robomend.cli.keys:command", "Create and revoke API keys."),
    "config": ("robomend.cli.config:command", "Show the settings in force."),
    "doctor": ("robomend.cli.doctor:command", "Check this installation."),
    "export": ("robomend.cli.export:command", "Write everything that is stored."),
    "import": ("robomend.cli.import_:command", "Read what export wrote."),
    "schema": ("robomend.cli.schema:command", "Write the JSON Schema of a file, for editors."),
    "init": ("robomend.cli.init:command", "Write files to start from."),
}


OTHERS = "robomend.commands"

FEW = 8
"""Commands that are listed where none of them is near; of more there is the help."""


@click.group(
    cls=LazyGroup, table=COMMANDS, others=OTHERS, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.version_option(package_name="robomend", prog_name="robomend", message="%(prog)s %(version)s")
def cli() -> None:
    """Find out why a robot misbehaves, and repair it."""


def run(arguments: list[str], program: click.Group = cli) -> int:
    """Run a command of a program and return its exit code; nothing but a bug shows a traceback."""
    stdout = sys.stdout
    try:
        name = "robomend" if program is cli else program.name
        code = program.main(arguments, prog_name=name, standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)  # whoever types a name alone asks what there is
        return BAD_INPUT
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        if context is not None:
            click.echo(context.get_usage(), err=True)
        click.echo(f"error: {_message(error)}", err=True)
        return BAD_INPUT
    except RobomendError as error:
        click.echo(f"error: {error}", err=True)
        return BACKEND_FAILED if isinstance(error, BackendError) else BAD_INPUT
    except (click.Abort, KeyboardInterrupt):
        return INTERRUPTED
    except (MemoryError, RuntimeError) as error:
        if not out_of_memory(error):
            raise
        click.echo(f"error: {no_room('this')}", err=True)
        return BACKEND_FAILED
    except BrokenPipeError:
        return _nobody_reads()
    except SystemExit:
        if sys.stdout is not stdout:  # click met a closed pipe: it wraps stdout and exits with 1
            return _nobody_reads()
        raise
    return code if isinstance(code, int) else 0


def _message(error: click.ClickException) -> str:
    """Return what is wrong, with the command or option that was probably meant."""
    context = getattr(error, "ctx", None)
    if isinstance(error, NoSuchCommand) and context is not None:
        known = context.command.list_commands(context)
        others = f": there are {', '.join(known)}" if len(known) < FEW else ""
        return (
            f"no command is named {error.command_name!r}{did_you_mean(error.command_name, known) or others}"
        )
    if isinstance(error, click.NoSuchOption) and context is not None:
        options = [name for option in context.command.get_params(context) for name in option.opts]
        return f"no option is named {error.option_name!r}{did_you_mean(error.option_name, options)}"
    return error.format_message()


def _nobody_reads() -> int:
    """Whoever read our output has seen enough; keep Python from complaining while it flushes at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return 0
