"""Solvers of others as contenders, by a command line: MaxSAT, ASP, and PDDL planners.

    --external NAME=FORMAT:COMMAND

FORMAT is wcnf, lp, or for planners pddl, strips or strips-costs (robomend_bench.exporting); in the command
{file} is the question, for planners {domain} and {problem} are, and {plan} is a file that the plan may be
written to. The command runs in a folder of the question's own, so that what it leaves there is no trouble; a
word of it that is a file where robomend-bench was started is given with its whole path.

The process's time counts, reading the question included, writing it not; its memory is not told. What is
answered is verified: a diagnosis by a SAT solver of ours, a plan by carrying it out. That nothing is better
is the solver's word; where others have answered too, the answers are compared. Who says that the best was
not found, or is not done in time, has not solved the question; whatever else is no answer is an error, told
with how the process ended and its last words.

    wcnf    `s OPTIMUM FOUND`, `o COST` and `v …`, as signed literals or as a row of 0 and 1
    lp      clingo's text: the last `Answer:`, `Optimization: COST`, `OPTIMUM FOUND`
    pddl    lines `(action object …)` in {plan}, in `sas_plan` or `problem.soln`, where planners leave it that
            are not told, or in the last of these that are numbered (`sas_plan.2`); else on stdout
"""

from __future__ import annotations

import os
import re
import resource
import shlex
import signal
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from pysat.solvers import Solver

from robomend.errors import OptionRefused
from robomend_bench.exporting import FORMATS, PLANNING, DiagnosisProblem, PddlFiles, PlanningProblem, text_in
from robomend_bench.suite import ONE, Answer, Ask, External, Group, Question, Suite, Wish

SPARE_S = 2
"""Processor seconds beyond the time-out after which the system itself ends a solver."""

MAX_OUTPUT_BYTES = 64 * 1024 * 1024
"""Of an answer, that is read."""

LAST_WORDS = 300
"""Characters of what a process said at last, that are told of one that gave no answer."""

PLAN_FILES = ("plan", "sas_plan", "problem.soln")
"""{plan}, and where planners leave a plan that are not told: Fast Downward and its kin, pyperplan."""

PLACE = re.compile(r"\{(file|domain|problem|plan)\}")
ACTION = re.compile(r"^\s*\(([^()]+)\)", re.MULTILINE)

PLAN_MODES = ("time", "cost")

UNPROVED = {
    "wcnf": re.compile(r"^s (SATISFIABLE|UNKNOWN)\s*$", re.MULTILINE),
    "lp": re.compile(r"^(SATISFIABLE|UNKNOWN)\s*$", re.MULTILINE),
}
"""What says that no answer is proved to be the best."""


@dataclass(frozen=True, slots=True)
class _Ended:
    """What became of a process."""

    output: str
    code: int | None  # None: it was not done in time
    last_words: str
    plan: str | None  # that it wrote
    seconds: float

    def no_answer(self, missing: str) -> ValueError:
        """Return the error that tells what is missing, how it ended, and its last words."""
        code = self.code or 0
        how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
        words = f": {self.last_words}" if self.last_words else ", and said nothing"
        return ValueError(f"it {missing}; it ended {how}{words}")


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
    wanted = {"domain", "problem"} if kind in PLANNING else {"file"}
    places = {place for part in command for place in PLACE.findall(part)}
    if not wanted <= places <= wanted | ({"plan"} if kind in PLANNING else set()):
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
        kind = external.format
        if text_in(asked, kind) is None:
            raise OptionRefused(f"{external.name}: a question of {suite.name} cannot be said in {kind}")
        with TemporaryDirectory() as folder:
            if isinstance(asked, PlanningProblem):
                files = asked.written(kind)
                written = {"domain": files.domain, "problem": files.problem}
                ended = _run(external, written, Path(folder), wish)
                if ended.code is None:
                    return _unsolved("not done in time", ended)
                return _plan(asked, files, ended, wish)
            ended = _run(external, {"file": text_in(asked, kind) or ""}, Path(folder), wish)
        if ended.code is None:
            return _unsolved("not done in time", ended)
        if unproved := UNPROVED[kind].search(ended.output):
            return _unsolved(f"not proved to be the best ({unproved[1]})", ended)
        bad = _read_maxsat(ended, asked) if kind == "wcnf" else _read_answer_set(ended)
        _verify(asked, bad)
        return Answer((len(bad),), complete=True, shown=len(bad), seconds=ended.seconds)

    return ask


def _unsolved(note: str, ended: _Ended) -> Answer:
    return Answer((), complete=False, seconds=ended.seconds, note=note)


def _run(external: External, written: dict[str, str], folder: Path, wish: Wish) -> _Ended:
    """Let it answer a question, whose files these are, in a folder."""
    files = {name: folder / name for name in ("plan", *written, "stdout", "stderr")}
    if "file" in written:
        files["file"] = folder / f"question.{external.format}"
    for name, text in written.items():
        files[name].write_text(text)
    line = [
        os.path.abspath(part)  # no link is followed: a venv's python is one
        if os.path.isfile(part)  # of Path it raises, where a word is too long to be a name
        else PLACE.sub(lambda place: str(files[place[1]]), part)
        for part in external.command
    ]
    # for the case that we are killed ourselves, who would have ended it
    most_s = ceil(wish.timeout_s * (os.cpu_count() or 1)) + SPARE_S
    began, before = perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    with files["stdout"].open("wb") as stdout, files["stderr"].open("wb") as stderr:
        try:
            # a group of its own, so that what it starts ends with it
            process = subprocess.Popen(
                line,
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=stderr,
                cwd=folder,
                process_group=0,
                preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (most_s, most_s)),
            )
        except OSError as error:
            raise OptionRefused(f"{external.name}: {line[0]}: {error.strerror}") from error
        code: int | None = None
        try:
            code = process.wait(wish.timeout_s)
        except subprocess.TimeoutExpired:
            pass
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = perf_counter() - began
    if wish.clock == "cpu":
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    output = _text(files["stdout"])
    last_words = _last_words(_text(files["stderr"])) or _last_words(output)
    return _Ended(output, code, last_words, _plan_left_in(folder), seconds)


def _last_words(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return " / ".join(lines[-3:])[-LAST_WORDS:]


def _plan_left_in(folder: Path) -> str | None:
    """Return what it wrote as a plan: of numbered ones, which get better, the last."""
    for name in PLAN_FILES:
        numbered = [path for path in folder.glob(f"{name}.*") if path.suffix[1:].isdecimal()]
        latest = max(numbered, key=lambda path: int(path.suffix[1:]), default=folder / name)
        if latest.is_file():
            return _text(latest)
    return None


def _text(path: Path) -> str:
    with path.open("rb") as file:
        return file.read(MAX_OUTPUT_BYTES).decode(errors="replace")


def _read_maxsat(ended: _Ended, asked: DiagnosisProblem) -> list[int]:
    """Return what a MaxSAT solver's optimal solution makes false of health.

    Raises:
        ValueError: there is none, or its cost is not what it says.
    """
    lines = ended.output.splitlines()
    if "s OPTIMUM FOUND" not in map(str.strip, lines):
        raise ended.no_answer("printed no line `s OPTIMUM FOUND`")
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


def _read_answer_set(ended: _Ended) -> list[int]:
    """Return the components of clingo's last answer set.

    Raises:
        ValueError: there is none that is proved to be the best.
    """
    lines = ended.output.splitlines()
    answers = [index for index, line in enumerate(lines) if line.startswith("Answer:")]
    if "OPTIMUM FOUND" not in map(str.strip, lines) or not answers:
        raise ended.no_answer("printed no line `OPTIMUM FOUND` after an `Answer:`")
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


def _plan(asked: PlanningProblem, files: PddlFiles, ended: _Ended, wish: Wish) -> Answer:
    """Read a plan and carry it out.

    Raises:
        ValueError: there is none, or it does not work.
    """
    from robomend.planning.validation import Named, validate

    named: list[Named] = []
    for words in ACTION.findall(ended.output if ended.plan is None else ended.plan):
        action = files.named(words.lower().split())
        if action is None:
            raise ValueError(f"({words}) is no action of the problem")
        named.append(action)
    if not named and asked.problem.goal:
        places = ", ".join(PLAN_FILES)
        raise ended.no_answer(f"left no plan, lines `(action object …)` in {places} or on stdout")
    flaw = validate(asked.domain, asked.problem, named, asked.problem.goal)
    if flaw is not None:
        raise ValueError(f"its plan fails: {flaw}")
    cost = sum(asked.domain.schemas[name].cost for name, _ in named)
    if wish.mode != "cost":
        return Answer((), complete=True, shown=len(named), seconds=ended.seconds)
    return Answer((), complete=True, shown=len(named), cost=cost, bound=float("inf"), seconds=ended.seconds)
