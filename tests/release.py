"""./dev release --dry-run: the check-list before a release, walked. Nothing is published, tagged or changed.

    version      the same in both distributions, in the pin between them, and in what the commands say
    changes      CHANGELOG.md has a section of this version
    tree         everything is committed
    wheels       built from sdists; licence, notice and README inside
    fresh venv   the wheels installed: doctor, a diagnosis, a plan, the agent, the board
    docs         the site is built strictly
    tests        named, not run: they take minutes, and CI has run them

Each line says `ok` or what is amiss; the exit code is 1 if anything is. What a person does stands at the end.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LONGEST_S = 900

BY_HAND = """\
Left to a person: ./dev check and ./dev clients on this commit, the demo watched once (./dev demo),
the date in CHANGELOG.md, the tag, and the upload of what is in dist/."""


class Amiss(Exception):
    """A point of the check-list that does not hold; the message says what is found."""


@dataclass(frozen=True)
class Release:
    """What is looked at."""

    root: Path
    folder: Path  # for what is built

    def project(self, path: str) -> dict[str, object]:
        """Return the section `project` of a pyproject file."""
        found: dict[str, object] = tomllib.loads((self.root / path / "pyproject.toml").read_text())["project"]
        return found

    @property
    def version(self) -> str:
        return str(self.project(".")["version"])

    def run(self, *command: str | Path, **settings: str) -> str:
        """Return what a command writes."""
        words = [str(word) for word in command]
        environment = {**os.environ, **settings}
        done = subprocess.run(
            words, cwd=self.folder, env=environment, capture_output=True, text=True, timeout=LONGEST_S
        )
        if done.returncode:
            said = (done.stderr or done.stdout).strip()[-400:]
            raise Amiss(f"{' '.join(words[:4])} … ended with {done.returncode}: {said}")
        return done.stdout


def version(release: Release) -> str:
    """The same everywhere."""
    ours = release.version
    client = release.project("clients")["version"]
    if client != ours:
        raise Amiss(f"robomend is {ours}, robomend-client {client}")
    if f"robomend-client == {ours}" not in str(release.project(".")["dependencies"]):
        raise Amiss(f"robomend does not pin robomend-client == {ours}")
    return ours


def changes(release: Release) -> str:
    """CHANGELOG.md has a section of this version."""
    text = (release.root / "CHANGELOG.md").read_text(encoding="utf-8")
    section = re.search(rf"^## {re.escape(release.version)}\b(.*)$", text, re.MULTILINE)
    if section is None:
        raise Amiss(f"CHANGELOG.md has no section of {release.version}")
    return section[0].removeprefix("## ")


def tree(release: Release) -> str:
    """Everything is committed."""
    left = release.run("git", "-C", release.root, "status", "--porcelain").splitlines()
    if left:
        raise Amiss(f"{len(left)} files are not committed, {left[0].split()[-1]} first")
    return release.run("git", "-C", release.root, "rev-parse", "--short", "HEAD").strip()


def wheels(release: Release) -> str:
    """Built from sdists, with what belongs inside."""
    for source in (release.root, release.root / "clients"):
        build = ("-m", "build", "--no-isolation", "--outdir", release.folder / "dist", source)
        release.run(sys.executable, *build)
    found = sorted((release.folder / "dist").glob("*.whl"))
    for wheel in found:
        looked_into(wheel)
    return ", ".join(f"{wheel.name} ({wheel.stat().st_size // 1024} kB)" for wheel in found)


def looked_into(wheel: Path) -> None:
    """Look for the licence and the README in a wheel.

    Raises:
        Amiss: one is not there.
    """
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        [metadata] = [name for name in names if name.endswith(".dist-info/METADATA")]
        text = archive.read(metadata).decode()
    if not any(name.endswith(".dist-info/licenses/LICENSE") for name in names):
        raise Amiss(f"{wheel.name} has no LICENSE")
    if "Description-Content-Type: text/markdown" not in text or "\n# robomend" not in text:
        raise Amiss(f"{wheel.name} has no README")


def fresh(release: Release) -> str:
    """Installed into an empty environment, and asked."""
    folder = release.folder / "venv"
    release.run(sys.executable, "-m", "venv", folder)
    python = folder / "bin" / "python"
    built = sorted((release.folder / "dist").glob("*.whl"))
    release.run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *built)
    robomend = folder / "bin" / "robomend"
    said = release.run(robomend, "--version").strip()
    if not said.endswith(f" {release.version}"):
        raise Amiss(f"robomend --version says {said}")
    release.run(robomend, "doctor", "--data", release.folder / "data", ROBOMEND_PORT="0")
    seen = ("-o", "not on(jaguar)", "-o", "not ok(odom)")
    model = release.root / "examples" / "tedusar.yaml"
    for asked in ("diagnose", "plan"):
        if "jaguar" not in release.run(robomend, asked, model, *seen):
            raise Amiss(f"robomend {asked} does not find the fault of the example")
    release.run(folder / "bin" / "robomend-agent", release.root / "examples" / "agent.yaml", "--check")
    release.run(folder / "bin" / "robomend-board", "--help")
    return said


def docs(release: Release) -> str:
    """The site is built strictly."""
    config = release.root / "mkdocs.yml"
    site = release.folder / "site"
    command = ("-m", "mkdocs", "build", "--strict", "--quiet", "--config-file", config, "--site-dir", site)
    release.run(sys.executable, *command, NO_MKDOCS_2_WARNING="1")
    return f"{len(list(site.rglob('*.html')))} pages"


def tests(release: Release) -> str:
    """Named."""
    files = list((release.root / "tests").rglob("test_*.py"))
    return f"{len(files)} files, not run here: ./dev check"


POINTS: dict[str, Callable[[Release], str]] = {
    "version": version,
    "changes": changes,
    "tree": tree,
    "wheels": wheels,
    "fresh venv": fresh,
    "docs": docs,
    "tests": tests,
}


def walk(release: Release, points: dict[str, Callable[[Release], str]]) -> bool:
    """Walk the check-list, and return whether all of it holds."""
    good = True
    for name, point in points.items():
        try:
            told = f"ok     {name}: {point(release)}"
        except (Amiss, OSError, subprocess.TimeoutExpired) as error:
            told, good = f"AMISS  {name}: {error}", False
        print(told, flush=True)
    return good


def main(arguments: Sequence[str] | None = None) -> int:
    """Return the exit code."""
    parser = argparse.ArgumentParser(prog="./dev release", description="The check-list before a release.")
    parser.add_argument("--dry-run", action="store_true", help="walk it; publishing is left to a person")
    if not parser.parse_args(arguments).dry_run:
        parser.error("only --dry-run is known: this publishes nothing")
    with tempfile.TemporaryDirectory(prefix="robomend-release-") as folder:
        good = walk(Release(ROOT, Path(folder)), POINTS)
    print(BY_HAND)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
