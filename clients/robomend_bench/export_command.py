"""`robomend-bench export`: a suite's questions as files for other solvers, with their answers and checksums.

    DIR/manifest.json             suite, version, seed, command; of each file its SHA-256 and its answer
    DIR/GROUP-QUESTION.wcnf       one file a question; or .lp, or .pddl with DIR/domain.pddl; as STRIPS, which
                                  is ground, with DIR/GROUP-QUESTION-domain.pddl

The same suite, version, seed and options write the same bytes, so that whoever has a manifest can tell
whether they asked the same questions: its `sha256` is that of all files.
"""

from __future__ import annotations

import hashlib
import json
import re
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from robomend.errors import InputError, OptionRefused, StateConflict
from robomend_bench.exporting import FORMATS, PLANNING, DiagnosisProblem, PlanningProblem, text_in
from robomend_bench.suite import DATA, Wish, find_suite
from robomend_client.counts import counted

COMMENT = {"wcnf": "c ", "lp": "% ", **dict.fromkeys(PLANNING, ";; ")}

NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9_.-]+")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("suite")
@click.option("--format", "format_", type=click.Choice(FORMATS), help="  [default: what the suite allows]")
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="A new folder.")
@click.option("--mode", help="The suite's mode, which decides on the questions; its first one if not given.")
@click.option("--only", default="", help="Groups, comma-separated.")
@click.option("--instances", type=click.IntRange(1, 100_000), help="Questions a group.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--no-answers", is_flag=True, help="Do not look for the answers, which may take long.")
@click.option(
    "--data",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    default=DATA,
    show_default="built in",
    help="Folder with the suite's data.",
)
def command(
    suite: str,
    format_: str | None,
    out: Path,
    mode: str | None,
    only: str,
    instances: int | None,
    seed: int,
    no_answers: bool,
    data: Path,
) -> None:
    """Write the questions of one SUITE as files that other solvers read.

    \b
    robomend-bench export iscas85 --only c432 --out c432/            WCNF, for MaxSAT solvers
    robomend-bench export robots-v1 --format lp --out robots/        for clingo
    robomend-bench export plans --mode cost --out plans/             PDDL
    robomend-bench export plans --format strips --out strips/        for planners that read no more
    """
    found = find_suite(suite)
    wish = Wish(
        mode=mode or next(iter(found.modes)),
        only=tuple(filter(None, only.split(","))),
        instances=instances,
        seed=seed,
        data=data,
    )
    if wish.mode not in found.modes:
        raise InputError(f"suite {suite} has no mode {mode!r}: choose from {', '.join(found.modes)}")
    if out.exists() and any(out.iterdir()):
        raise StateConflict(f"{out} is not empty: name a new folder")
    out.mkdir(parents=True, exist_ok=True)
    manifest = export(
        suite, wish, format_, out, answers=not no_answers, told=lambda name: click.echo(name, err=True)
    )
    click.echo(f"{counted(len(manifest['files']), 'question')}, sha256 {manifest['sha256']}")


def export(
    suite: str,
    wish: Wish,
    format_: str | None,
    out: Path,
    *,
    answers: bool = True,
    told: Callable[[str], object] = lambda name: None,
) -> dict[str, Any]:
    """Write the files and the manifest; return what the manifest says.

    Args:
        told: called with the name of each file.

    Raises:
        OptionRefused: the suite has no questions that can be said in this format.
    """
    found = find_suite(suite)
    files: list[dict[str, Any]] = []
    everything = hashlib.sha256()
    for group in found.groups(wish):
        for question in group.questions:
            asked = found.exported(question, group)
            kind = format_ or ("wcnf" if isinstance(asked, DiagnosisProblem) else "pddl")
            text = text_in(asked, kind)
            if text is None:
                raise OptionRefused(f"suite {suite} has no questions that can be said in {kind}")
            answer = asked.answer() if answers else None
            title = f"{suite} version {found.version}, seed {wish.seed}: {group.name}, {question.name}"
            data = f"{COMMENT[kind]}{title}\n{text}".encode()
            stem = NOT_IN_NAMES.sub("_", f"{group.name}-{question.name}")
            name = f"{stem}.{'pddl' if kind in PLANNING else kind}"
            entry: dict[str, Any] = {"file": name, "sha256": _written(out / name, data, everything)}
            if isinstance(asked, PlanningProblem):
                domain = asked.written(kind).domain
                if kind == "pddl":  # the same for all
                    (out / "domain.pddl").write_text(domain)
                else:
                    beside = f"{stem}-domain.pddl"
                    entry["domain"] = beside
                    entry["domain_sha256"] = _written(out / beside, domain.encode(), everything)
            files.append({**entry, "answer": answer})
            told(name)
    manifest = {
        "suite": suite,
        "version": found.version,
        "mode": wish.mode,
        "seed": wish.seed,
        "command": shlex.join(["robomend-bench", *sys.argv[1:]]),
        "sha256": everything.hexdigest(),
        "files": files,
    }
    (out / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n")
    return manifest


def _written(path: Path, data: bytes, everything: Any) -> str:
    """Write a file, add it to the checksum of all, and return its own."""
    path.write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    everything.update(f"{path.name} {digest}\n".encode())
    return digest
