"""Solvers of others as contenders, by a command line: MaxSAT, ASP, and PDDL planners.

    --external NAME=FORMAT:COMMAND

FORMAT is wcnf, lp or pddl; in the command {file} is the question, for pddl {domain} and {problem} are, and
{plan} is a file that the planner may write its plan to. The process's time counts, reading the question
included, writing it not; its memory is not told. What is answered is verified: a diagnosis by a SAT solver of
ours, a plan by carrying it out. That nothing is better is the solver's word; where others have answered too,
the answers are compared.

    wcnf    `s OPTIMUM FOUND`, `o COST` and `v …`, as signed literals or as a row of 0 and 1
    lp      clingo's text: the last `Answer:`, `Optimization: COST`, `OPTIMUM FOUND`
    pddl    lines `(action object …)`, in {plan} or, where the command has no {plan}, on stdout
"""

from __future__ import annotations

import os
import re
import resource
import shlex
import signal
import subprocess
from contextlib import suppress
from math import ceil
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from pysat.solvers import Solver

from robomend.errors import OptionRefused
from robomend_bench.exporting import FORMATS, DiagnosisProblem, Exported, PlanningProblem
from robomend_bench.suite import ONE, Answer, Ask, External, Group, Question, Suite, Wish

SPARE_S = 2
"""Processor seconds beyond the time-out after which the system itself ends a solver."""

MAX_OUTPUT_BYTES = 64 * 1024 * 1024
"""Of an answer, that is read."""

PLACE = re.compile(r"\{(file|domain|problem|plan)\}")
ACTION = re.compile(r"^\s*\(([^()]+)\)", re.MULTILINE)

PLAN_MODES = ("time", "cost")


def read_external(text: str) -> External:
    """Read NAME=FORMAT:COMMAND.

    Raises:
        OptionRefused: it is not of that form.
    """
    name, equals, rest = text.partition("=")
    kind, colon, line = rest.partition(":")
    if not (name and equals and colon) or kind not in FORMATS:
        raise OptionRefused(f"{text!r}: give NAME=FORMAT:COMMAND, the format one of {', '.join(FORMATS)}")
    try:
        command = tuple(shlex.split(line))
    except ValueError as error:
        raise OptionRefused(f"{text!r}: {error}") from error
    wanted = {"domain", "problem"} if kind == "pddl" else {"file"}
    places = {place for part in command for place in PLACE.findall(part)}
    if not wanted <= places <= wanted | ({"plan"} if kind == "pddl" else set()):
        needed = " and ".join(f"{{{place}}}" for place in sorted(wanted))
        raise OptionRefused(f"{text!r}: a command for {kind} has {needed} where its question belongs")
    return External(name, kind, command)


def prepare_external(external: External, suite: Suite, group: Group, wish: Wish) -> Ask:
    """Return what asks such a solver.

    Raises:
        OptionRefused: the suite's mode is none that it can answer.
    """
    if wish.mode not in (*ONE, *PLAN_MODES, "default", "cardinality"):
        raise OptionRefused(f"{external.name} has no mode {wish.mode!r}: others are asked for one answer")

    def ask(question: Question) -> Answer:
        asked = suite.exported(question, group)
        text = FORMATS[external.format](asked)
        if text is None:
            raise OptionRefused(
                f"{external.name}: a question of {suite.name} cannot be said in {external.format}"
            )
        with TemporaryDirectory() as folder:
            output, plan, seconds = _run(external, asked, text, Path(folder), wish)
        if output is None:
            return Answer((), complete=False, seconds=seconds)
        if isinstance(asked, PlanningProblem):
            return _plan(asked, plan if plan is not None else output, wish, seconds)
        bad = _read_maxsat(output, asked) if external.format == "wcnf" else _read_answer_set(output)
        if bad is None:
            return Answer((), complete=False, seconds=seconds)
        _verify(asked, bad)
        return Answer((len(bad),), complete=True, shown=len(bad), seconds=seconds)

    return ask


def _run(
    external: External, asked: Exported, text: str, folder: Path, wish: Wish
) -> tuple[str | None, str | None, float]:
    """Return what it printed, None if it was not done in time; the plan that it wrote; what it took."""
    files = {name: folder / name for name in ("plan", "domain", "problem", "stdout")}
    files["file"] = folder / f"question.{external.format}"
    if isinstance(asked, PlanningProblem):
        files["domain"].write_text(asked.domain.pddl)
        files["problem"].write_text(text)
    else:
        files["file"].write_text(text)
    line = [PLACE.sub(lambda place: str(files[place[1]]), part) for part in external.command]
    # for the case that we are killed ourselves, who would have ended it
    most_s = ceil(wish.timeout_s * (os.cpu_count() or 1)) + SPARE_S
    began, before = perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    with files["stdout"].open("wb") as stdout:
        try:
            # a group of its own, so that what it starts ends with it
            process = subprocess.Popen(
                line,
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=subprocess.DEVNULL,
                process_group=0,
                preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (most_s, most_s)),
            )
        except OSError as error:
            raise OptionRefused(f"{external.name}: {line[0]}: {error.strerror}") from error
        try:
            process.wait(wish.timeout_s)
            ended = True
        except subprocess.TimeoutExpired:
            ended = False
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = perf_counter() - began
    if wish.clock == "cpu":
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if not ended:
        return None, None, seconds
    wrote = _text(files["plan"]) if files["plan"].is_file() else None
    return _text(files["stdout"]), wrote, seconds


def _text(path: Path) -> str:
    with path.open("rb") as file:
        return file.read(MAX_OUTPUT_BYTES).decode(errors="replace")


def _read_maxsat(output: str, asked: DiagnosisProblem) -> list[int] | None:
    """Return what a MaxSAT solver's optimal solution makes false of health; None: it has none.

    Raises:
        ValueError: its cost is not what it says.
    """
    lines = output.splitlines()
    if "s OPTIMUM FOUND" not in map(str.strip, lines):
        return None
    values = " ".join(line[2:] for line in lines if line.startswith("v ")).split()
    if not values:
        raise ValueError("it printed no solution, a line that begins with v")
    n = len(asked.cnf.components)
    if len(values) == 1 and set(values[0]) <= {"0", "1"} and len(values[0]) >= n:
        bad = [place for place, value in enumerate(values[0][:n], 1) if value == "0"]
    else:
        true = {int(value) for value in values}
        bad = [variable for variable in range(1, n + 1) if variable not in true]
    costs = [int(line[2:]) for line in lines if line.startswith("o ")]
    if costs and costs[-1] != len(bad):
        raise ValueError(f"it says that the cost is {costs[-1]}, but its solution has {len(bad)}")
    return bad


def _read_answer_set(output: str) -> list[int] | None:
    """Return the components of clingo's last answer set, if it is proved to be the best; else None."""
    lines = output.splitlines()
    answers = [index for index, line in enumerate(lines) if line.startswith("Answer:")]
    if "OPTIMUM FOUND" not in map(str.strip, lines) or not answers:
        return None
    atoms = lines[answers[-1] + 1].split() if answers[-1] + 1 < len(lines) else []
    return [int(atom[3:-1]) for atom in atoms if re.fullmatch(r"ab\(\d+\)", atom)]


def _verify(asked: DiagnosisProblem, bad: list[int]) -> None:
    """Ask a solver of ours whether SD and OBS allow just these to be abnormal.

    Raises:
        ValueError: they do not.
    """
    n = len(asked.cnf.components)
    unknown = [variable for variable in bad if not 1 <= variable <= n]
    healthy = [variable for variable in range(1, n + 1) if variable not in set(bad)]
    with Solver("glucose4", bootstrap_with=asked.hard) as solver:
        if unknown or not solver.solve(healthy):
            raise ValueError(f"{bad} is no diagnosis")


def _plan(asked: PlanningProblem, text: str, wish: Wish, seconds: float) -> Answer:
    """Read a plan and carry it out.

    Raises:
        ValueError: it does not work.
    """
    from robomend.planning.validation import Named, validate

    named: list[Named] = []
    for action in ACTION.findall(text):
        name, *words = action.lower().split()
        if name not in asked.domain.schemas or not asked.names.keys() >= set(words):
            raise ValueError(f"({action}) is no action of the problem")
        named.append((name, tuple(asked.names[word] for word in words)))
    if not named and asked.problem.goal:
        return Answer((), complete=False, seconds=seconds)
    flaw = validate(asked.domain, asked.problem, named, asked.problem.goal)
    if flaw is not None:
        raise ValueError(f"its plan fails: {flaw}")
    cost = sum(asked.domain.schemas[name].cost for name, _ in named)
    if wish.mode != "cost":
        return Answer((), complete=True, shown=len(named), seconds=seconds)
    return Answer((), complete=True, shown=len(named), cost=cost, bound=float("inf"), seconds=seconds)
