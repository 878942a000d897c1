"""./dev release: the files of a release, made in dist/ and tried. Nothing is published, tagged or changed.

    version      the same in both distributions, in the pin between them, and in what the commands say
    changes      CHANGELOG.md has a section of this version
    tree         everything is committed
    wheels       built from sdists; licence, notice and README inside
    fresh venv   the wheels installed: doctor, a diagnosis, a plan, the agent, the board
    docs         the site is built strictly
    deb          robomend and robomend-agent for Debian 12, each with all that it needs
    image        docs/deploy/Containerfile built on a bare Debian, as an archive of OCI
    checksums    SHA256SUMS of all files
    tried        tests/test_release_files.py: installed on a bare Debian, upgraded, rolled back, removed
    tests        the others are named, not run: they take minutes, and CI has run them

Each line says `ok` or what is amiss; the exit code is 1 if anything is. What a person does stands at the end.
`--dry-run` does the same in a folder that is gone afterwards. The Debian packages and the image need root on
a Debian with Python 3.11, as the wheels in them are of the interpreter that is asked for them.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.bare_root import PYTHON, Chroot, NoRoot, bare_root

ROOT = Path(__file__).resolve().parents[1]
LONGEST_S = 3600

BY_HAND = """\
Left to a person: ./dev check and ./dev test --client on this commit, the demo watched once (./dev demo),
the date in CHANGELOG.md, the tag, and the upload of what is in dist/ (docs/deploy/README.md, Publishing)."""


class Amiss(Exception):
    """A point of the check-list that does not hold; the message says what is found."""


@dataclass(frozen=True)
class Release:
    """What is looked at."""

    root: Path
    folder: Path  # for what is gone afterwards
    dist: Path  # for what is released

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
        build = ("-m", "build", "--no-isolation", "--outdir", release.dist, source)
        release.run(sys.executable, *build)
    found = sorted(release.dist.glob("*.whl"))
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
    built = sorted(release.dist.glob("*.whl"))
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


@dataclass(frozen=True)
class Package:
    """One of the packages for Debian; docs/deploy/debian/NAME has its control file and scripts."""

    name: str
    prefix: str  # where its environment is
    wants: str  # of pip
    commands: tuple[str, ...]
    units: tuple[str, ...]
    settings: str = ""  # a file of /etc/robomend, kept when a person changed it


PACKAGES = (
    Package(
        "robomend",
        "/opt/robomend",
        "robomend[postgres,batch,mcp]",
        ("robomend", "robomend-batch", "robomend-bench", "robomend-board"),
        ("robomend.service", "robomend@.service"),
        "robomend.yaml",
    ),
    Package(
        "robomend-agent",
        "/opt/robomend-client",
        "robomend-client[ros1,ros2,zenoh]",
        ("robomend-agent",),
        ("robomend-agent.service",),
    ),
)

SETTINGS = """\
# Settings of the service, all of which have a default: robomend config shows those in force.
"""

INSTALL = """
set -eu
apt-get -q update
apt-get -q -y --no-install-recommends install python3
python3 -m venv --without-pip "$1"
pip=$(echo /wheels/pip-*.whl)/pip
"$1/bin/python" "$pip" --quiet --disable-pip-version-check --no-cache-dir install \\
    --no-index --find-links /wheels --no-compile "$2"
# A package's files do not change: what is compiled needs no look at the text, nor at its time.
"$1/bin/python" -m compileall -q -j 2 --invalidation-mode unchecked-hash "$1/lib"
"""
"""In a bare Debian: an environment of its Python at its final place. Of the network it needs Debian only."""


def debian_architecture() -> str:
    return {"x86_64": "amd64", "aarch64": "arm64"}.get(platform.machine(), platform.machine())


def deb(release: Release) -> str:
    """Both packages for Debian."""
    if sys.version_info[:2] != tuple(map(int, PYTHON.split("."))):
        raise Amiss(
            f"Debian's Python is {PYTHON}: set PYTHON=python{PYTHON} and ROBOMEND_VENV=.venv-{PYTHON}"
        )
    base = bare_root() / "booting"
    wheelhouse = release.folder / "wheels"
    wheel = ("-m", "pip", "wheel", "--quiet", "--wheel-dir", wheelhouse, "--find-links", release.dist)
    python = release.folder / "venv" / "bin" / "python"  # of the point before
    release.run(python, *wheel, "pip", *(package.wants for package in PACKAGES))
    made = [packed(release, package, base, wheelhouse) for package in PACKAGES]
    return ", ".join(f"{path.name} ({path.stat().st_size >> 20} MB)" for path in made)


def packed(release: Release, package: Package, base: Path, wheelhouse: Path) -> Path:
    """Return one package, made."""
    chroot = Chroot(base, release.folder / package.name)
    install = ("sh", "-c", INSTALL, "-", package.prefix, package.wants)
    chroot.run(*install, binds=[(wheelhouse, "/wheels")])
    given = release.root / "docs" / "deploy"
    tree = release.folder / f"{package.name}-tree"
    environment = tree / package.prefix.lstrip("/")
    environment.parent.mkdir(parents=True)
    shutil.move(chroot.upper / package.prefix.lstrip("/"), environment)
    for command in package.commands:
        link(tree / "usr" / "bin" / command, f"{package.prefix}/bin/{command}")
    for unit in package.units:
        copy(given / unit, tree / "lib" / "systemd" / "system" / unit)
    about = tree / "usr" / "share" / "doc" / package.name
    copy(release.root / "LICENSE", about / "copyright")
    manual = Path("lib", f"python{PYTHON}", "site-packages", "robomend", "data", "docs")
    if (environment / manual).is_dir():
        link(about / "docs", f"{package.prefix}/{manual}")
    changelog = gzip.compress((release.root / "CHANGELOG.md").read_bytes(), mtime=0)
    (about / "changelog.gz").write_bytes(changelog)
    control = tree / "DEBIAN"
    if package.settings:
        written(tree / "etc" / "robomend" / package.settings, SETTINGS)
        written(control / "conffiles", f"/etc/robomend/{package.settings}\n")
    for script in sorted((given / "debian" / package.name).glob("p*")):
        copy(script, control / script.name)
    size = sum(one.lstat().st_size for one in tree.rglob("*") if one.is_file()) // 1024
    major, minor = PYTHON.split(".")
    text = (given / "debian" / package.name / "control").read_text(encoding="utf-8")
    for name, value in {
        "VERSION": release.version,
        "ARCHITECTURE": debian_architecture(),
        "SIZE": str(size),
        "PYTHON": PYTHON,
        "NEXT_PYTHON": f"{major}.{int(minor) + 1}",
    }.items():
        text = text.replace(f"@{name}@", value)
    written(control / "control", text)
    release.run("chmod", "-R", "u=rwX,go=rX", tree)
    path = release.dist / f"{package.name}_{release.version}_{debian_architecture()}.deb"
    release.run("dpkg-deb", "--root-owner-group", "-Zzstd", "-z9", "--build", tree, path)
    return path


def copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(source, target)


def written(target: Path, text: str) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text, encoding="utf-8")


def link(place: Path, target: str) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    place.symlink_to(target)


def image(release: Release) -> str:
    """The Containerfile's. Its base is what a registry has; here it is made from Debian's packages."""
    plain = bare_root() / "plain.tar"
    containerfile = release.root / "docs" / "deploy" / "Containerfile"
    [base] = re.findall(r"^FROM (\S+)$", containerfile.read_text(encoding="utf-8"), re.MULTILINE)
    store = release.folder / "images"
    buildah = ("buildah", "--root", store / "store", "--runroot", store / "run", "--storage-driver", "vfs")
    begun = release.run(*buildah, "from", "scratch").strip()
    release.run(*buildah, "add", begun, plain, "/")
    release.run(*buildah, "commit", "--rm", begun, base)
    build = ("bud", "--isolation", "chroot", "--pull-never", "--format", "docker", "--tag", "robomend")
    release.run(*buildah, *build, "--file", containerfile, release.dist)
    path = release.dist / f"robomend-{release.version}-{debian_architecture()}.oci.tar"
    path.unlink(missing_ok=True)
    release.run(*buildah, "push", "robomend", f"oci-archive:{path}:robomend:{release.version}")
    shutil.rmtree(store)
    return f"{path.name} ({path.stat().st_size >> 20} MB)"


def checksums(release: Release) -> str:
    """SHA256SUMS, of what is of this version."""
    files = sorted(path for path in release.dist.iterdir() if release.version in path.name)
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in files]
    (release.dist / "SHA256SUMS").write_text("".join(lines), encoding="utf-8")
    return f"{len(files)} files"


def tried(release: Release) -> str:
    """Installed, started, upgraded, rolled back and removed on a bare Debian."""
    file = release.root / "tests" / "test_release_files.py"
    options = ("-q", "-rs", "--rootdir", release.root, "--release", release.dist)
    run = (sys.executable, "-m", "pytest", *options, file)
    said = release.run(*run, PYTHONPATH=str(release.root)).strip()
    if "SKIPPED" in said:
        raise Amiss(" ".join(line for line in said.splitlines() if line.startswith("SKIPPED")))
    return said.splitlines()[-1].strip("= ")


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
    "deb": deb,
    "image": image,
    "checksums": checksums,
    "tried": tried,
    "tests": tests,
}


def walk(release: Release, points: dict[str, Callable[[Release], str]]) -> bool:
    """Walk the check-list, and return whether all of it holds."""
    good = True
    for name, point in points.items():
        try:
            told = f"ok     {name}: {point(release)}"
        except (Amiss, NoRoot, OSError, subprocess.TimeoutExpired) as error:
            told, good = f"AMISS  {name}: {error}", False
        print(told, flush=True)
    return good


def main(arguments: Sequence[str] | None = None) -> int:
    """Return the exit code."""
    parser = argparse.ArgumentParser(
        prog="./dev release",
        description="The files of a release, made in dist/ and tried; publishing is left to a person.",
    )
    parser.add_argument("--dry-run", action="store_true", help="keep none of them")
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="robomend-release-") as scratch:
        folder = Path(scratch)
        dist = folder / "dist" if asked.dry_run else ROOT / "dist"
        shutil.rmtree(dist, ignore_errors=True)
        dist.mkdir()
        good = walk(Release(ROOT, folder, dist), POINTS)
    print(BY_HAND)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
