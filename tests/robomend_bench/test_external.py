"""Solvers of others by a command line: real ones, and some that are late, wrong or silent."""

from __future__ import annotations

import os
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from tests.waiting import until

from robomend.errors import OptionRefused
from robomend_bench.external import prepare_external, read_external
from robomend_bench.running import run_suite
from robomend_bench.suite import Answer, External, Wish, find_suite
from robomend_bench.tables import markdown

PYTHON = shlex.quote(sys.executable)
RC2 = f"rc2-command=wcnf:{PYTHON} -m pysat.examples.rc2 -vv {{file}}"
CLINGO = f"clingo-command=lp:{PYTHON} -m clingo {{file}}"


def test_a_maxsat_solver_and_clingo_take_part_by_their_command_lines() -> None:
    others = tuple(map(read_external, (RC2, CLINGO)))
    wish = Wish(mode="first", only=("c17",), timeout_s=300.0, external=others)
    run = run_suite(find_suite("iscas85"), wish, ("sat",), repeats=1)
    assert run.contenders == ("sat", "rc2-command", "clingo-command")
    assert run.disagreements == ()
    assert {(sample.status, sample.note) for sample in run.samples} == {("ok", "")}
    assert all(sample.seconds > 0 for sample in run.samples)


def script(folder: Path, text: str, name: str = "mine") -> External:
    """Return a solver that is a script of this text."""
    path = folder / "solver.py"
    path.write_text(text)
    return read_external(f"{name}=wcnf:{PYTHON} {shlex.quote(str(path))} {{file}}")


def asked(external: External, **more: float) -> Answer:
    """Ask it the first question of c17, which needs one gate."""
    wish = Wish(mode="first", only=("c17",), external=(external,), **{"timeout_s": 300.0, **more})  # type: ignore[arg-type]  # fields of Wish, by name
    suite = find_suite("iscas85")
    (group,) = suite.groups(wish)
    return prepare_external(external, suite, group, wish)(group.questions[0])


def test_a_cost_that_is_not_that_of_the_solution_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="says that the cost is 2, but its solution has 6"):
        asked(script(tmp_path, "print('s OPTIMUM FOUND\\no 2\\nv 000000')"))


def test_a_diagnosis_that_is_not_the_smallest_disagrees_with_the_others(tmp_path: Path) -> None:
    everything = script(tmp_path, "print('s OPTIMUM FOUND\\no 6\\nv 000000')")
    wish = Wish(
        mode="first", only=("c17",), instances=1, timeout_s=300.0, external=(everything,), sizes=(1, 1)
    )
    run = run_suite(find_suite("iscas85"), wish, ("sat",), repeats=1)
    assert run.disagreements == ("c17/01-0: (1,) by sat, (6,) by mine",)


def test_what_is_not_proved_is_not_solved_and_the_table_says_so(tmp_path: Path) -> None:
    unsure = script(tmp_path, "print('s SATISFIABLE\\no 3\\nv 000000')")
    assert not asked(unsure).complete
    wish = Wish(mode="first", only=("c17",), instances=1, timeout_s=300.0, external=(unsure,), sizes=(1, 1))
    run = run_suite(find_suite("iscas85"), wish, ("sat",), repeats=1)
    assert "Note: mine on c17: not proved to be the best (SATISFIABLE)." in markdown(run)


@pytest.mark.parametrize(
    ("text", "ending"),
    [
        ("raise SystemExit('no licence')", "with exit code 1: no licence"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGTERM)", "by signal 15, and said nothing"),
        ("print('s OPTIMUM')", "with exit code 0: s OPTIMUM"),
    ],
)
def test_what_is_no_answer_is_told_with_how_the_process_ended(text: str, ending: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"printed no line `s OPTIMUM FOUND`; it ended {ending}"):
        asked(script(tmp_path, text))
    path = tmp_path / "solver.py"
    with pytest.raises(ValueError, match=f"printed no line `OPTIMUM FOUND` after .* ended {ending}"):
        asked(read_external(f"mine=lp:{PYTHON} {shlex.quote(str(path))} {{file}}"))


def test_who_is_late_is_ended_with_all_that_they_started(tmp_path: Path) -> None:
    pid = tmp_path / "pid"
    late = script(
        tmp_path,
        "import subprocess, pathlib\n"
        "child = subprocess.Popen(['sleep', '600'])\n"
        f"part = pathlib.Path({str(pid)!r} + '.part')\n"
        "part.write_text(str(child.pid))\n"
        f"part.rename({str(pid)!r})\n"
        "child.wait()\n",
    )
    timeout_s = 1.0
    answer = asked(late, timeout_s=timeout_s)
    while not pid.is_file():  # it was ended before it had begun
        timeout_s *= 2
        assert timeout_s < 100
        answer = asked(late, timeout_s=timeout_s)
    assert not answer.complete
    until(lambda: ended(int(pid.read_text())), "what it started ends", 60.0)


def ended(pid: int) -> bool:
    """Whether a process is gone, or only waits for its parent to notice."""
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (ProcessLookupError, FileNotFoundError):
        return True


def planned(line: str, kind: str = "pddl", mode: str = "time") -> Answer:
    """Ask a planner to shut the paper's robot's base down and bring it up again."""
    external = read_external(f"mine={kind}:{line}")
    suite, wish = find_suite("plans"), Wish(mode="time", only=("tedusar",), timeout_s=300.0)
    (group,) = suite.groups(wish)
    return prepare_external(external, suite, group, replace(wish, mode=mode))(group.questions[1])


def by_script(folder: Path, text: str, kind: str = "pddl") -> Answer:
    """Ask a planner that is a script of this text."""
    path = folder / "planner.py"
    path.write_text(text)
    return planned(f"{PYTHON} {shlex.quote(str(path))} {{domain}} {{problem}}", kind)


PYPERPLAN = f"{PYTHON} -m pyperplan -s gbf -H hff {{domain}} {{problem}}"


def test_pyperplan_takes_part_by_its_own_command_line() -> None:
    others = (read_external(f"pyperplan=strips:{PYPERPLAN}"),)
    wish = Wish(mode="cost", only=("small-robots",), instances=2, timeout_s=300.0, external=others)
    run = run_suite(find_suite("plans"), wish, ("asp",), repeats=1)
    assert {(sample.contender, sample.status, sample.note) for sample in run.samples} == {
        ("asp", "ok", ""),
        ("pyperplan", "ok", ""),
    }
    assert run.disagreements == ()
    of = {(sample.contender, sample.question): sample.cost or 0.0 for sample in run.samples}
    assert all(of["pyperplan", question] >= of["asp", question] > 0 for _, question in of)


def test_a_plan_that_fails_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="does not hold"):
        by_script(tmp_path, "print('(power_up jaguar)\\n(power_up jaguar)')")
    with pytest.raises(ValueError, match="no action of the problem"):
        by_script(tmp_path, "print('(dance jaguar)')")
    with pytest.raises(ValueError, match="no action of the problem"):
        by_script(tmp_path, "print('(power_up jaguar)')", "strips")


@pytest.mark.parametrize(
    "text",
    [
        "rc2",
        "rc2=wcnf",
        "rc2=dimacs:rc2 {file}",
        "rc2=wcnf:rc2",
        "rc2=wcnf:rc2 {domain} {problem}",
        "fd=pddl:fd {domain}",
        "fd=strips:fd {file}",
        "rc2=wcnf:rc2 '{file}",
    ],
)
def test_a_command_line_that_cannot_be_asked_is_refused(text: str) -> None:
    with pytest.raises(OptionRefused):
        read_external(text)


def test_a_program_that_is_not_there_and_a_mode_that_is_not_theirs_are_refused() -> None:
    with pytest.raises(OptionRefused, match="no-such-solver: No such file"):
        asked(read_external("mine=wcnf:no-such-solver {file}"))
    external = read_external(RC2)
    wish = Wish(mode="all", only=("c17",), external=(external,))
    suite = find_suite("iscas85")
    (group,) = suite.groups(wish)
    with pytest.raises(OptionRefused, match="no mode 'all'"):
        prepare_external(external, suite, group, wish)
