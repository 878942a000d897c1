"""What a stranger installs: the built wheels in an empty environment, each file in one distribution only."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import zipfile
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from tests.once import made_once
from tests.release import looked_into

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Build both distributions as sdist, and the wheels from the sdists."""

    def build(folder: Path) -> None:
        for source in (ROOT, ROOT / "clients"):
            command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(source)]
            subprocess.run(command, check=True, capture_output=True, timeout=300)

    folder = made_once(tmp_path_factory, "wheels", build)
    found = {path.name.split("-")[0]: path for path in folder.glob("*.whl")}
    assert set(found) == {"robomend", "robomend_client"}
    return found


@pytest.fixture(scope="module")
def pip(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """An installer: the one of this environment, or one of its own where there is none."""
    options = ["--disable-pip-version-check", "--python"]
    if importlib.util.find_spec("pip") is not None:
        return [sys.executable, "-m", "pip", *options]

    def install(folder: Path) -> None:
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True, timeout=120)

    folder = made_once(tmp_path_factory, "pip", install)
    return [str(folder / "bin" / "pip"), *options]


def installed(pip: list[str], folder: Path, wheels: list[Path], long: bool) -> Path:
    """Install wheels, and what they require, into an empty environment; return its Python.

    pip takes most of its time for a search in the index that was made before: the environment of these
    tests has what the same requirements asked for. So what the wheels require is linked from there, and
    nothing else is; with --long it comes from the index.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True, timeout=120)
    python = folder / "bin" / "python"
    # Nothing is compiled beforehand: most of what is installed is not imported here.
    install = [*pip, str(python), "install", "--quiet", "--no-compile", *([] if long else ["--no-deps"])]
    subprocess.run([*install, *map(str, wheels)], check=True, timeout=500)
    if not long:
        (packages,) = folder.glob("lib/python*/site-packages")
        link_required(packages)
    return python


def link_required(packages: Path) -> None:
    """Link to what is installed there all that it requires, and what that requires, from this environment.

    Only what is required without an extra, unless the extra is asked for: as an installer does.
    """
    there = {one.name.lower().replace("-", "_"): one for one in Distribution.discover(path=[str(packages)])}
    waiting = [(one, "") for one in there.values()]
    seen = set(waiting)
    while waiting:
        one, extra = waiting.pop()
        for requirement in map(Requirement, one.requires or ()):
            if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
                continue
            name = requirement.name.lower().replace("-", "_")
            if name not in there:
                there[name] = distribution(requirement.name)
                link(there[name], packages)
            found = there[name]
            assert requirement.specifier.contains(found.version, prereleases=True), requirement
            more = {(found, wanted) for wanted in ("", *requirement.extras)} - seen
            seen |= more
            waiting += more


def link(one: Distribution, packages: Path) -> None:
    """Link the modules of a distribution, and what is said about it."""
    for name in {file.parts[0] for file in one.files or ()} - {"..", "__pycache__"}:
        (packages / name).symlink_to(Path(str(one.locate_file(name))))


def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


def test_no_file_is_in_both_distributions(wheels: dict[str, Path]) -> None:
    assert names(wheels["robomend"]) & names(wheels["robomend_client"]) == set()
    assert {name.split("/")[0] for name in names(wheels["robomend_client"])} == {"robomend_client"}


@pytest.mark.parametrize("name", ["robomend", "robomend_client"])
def test_a_wheel_carries_licence_and_readme(wheels: dict[str, Path], name: str) -> None:
    looked_into(wheels[name])


def test_the_wheel_carries_what_is_no_code(wheels: dict[str, Path]) -> None:
    inside = names(wheels["robomend"])
    for kind in ("encodings", "pddl", "examples"):
        for path in (ROOT / kind).rglob("*"):
            if path.suffix in {".lp", ".pddl", ".yaml"}:
                assert f"robomend/data/{kind}/{path.relative_to(ROOT / kind)}" in inside
    web = ROOT / "service" / "robomend" / "web"
    for path in (*web.rglob("*.html"), *(web / "static").iterdir()):
        assert f"robomend/web/{path.relative_to(web)}" in inside


def test_the_wheels_diagnose_in_an_empty_environment(
    wheels: dict[str, Path], pip: list[str], tmp_path: Path, long: bool
) -> None:
    python = installed(pip, tmp_path / "venv", list(wheels.values()), long)
    model = tmp_path / "tedusar.yaml"
    model.write_text((ROOT / "examples" / "tedusar.yaml").read_text())
    command = [str(python.parent / "robomend"), "diagnose", str(model), "--format", "json"]
    asked = ["--observe", "not on(jaguar)", "--observe", "not ok(odom)"]
    done = subprocess.run([*command, *asked], check=True, capture_output=True, timeout=60, cwd=tmp_path)
    assert [diagnosis["bad"] for diagnosis in json.loads(done.stdout)["diagnoses"]] == [["jaguar"]]


def test_the_robot_s_side_installs_alone_and_small(
    wheels: dict[str, Path], pip: list[str], tmp_path: Path, long: bool
) -> None:
    python = installed(pip, tmp_path / "venv", [wheels["robomend_client"]], long)
    asked = [str(python.parent / "robomend-agent"), "--help"]
    done = subprocess.run(asked, check=True, capture_output=True, timeout=60)
    assert b"usage" in done.stdout
    command = [*pip, str(python), "list", "--format", "json"]
    listed = subprocess.run(command, check=True, capture_output=True, timeout=60)
    heavy = {"python-sat", "clingo", "unified-planning", "fastapi", "sqlalchemy", "scipy"}
    assert heavy & {package["name"].lower() for package in json.loads(listed.stdout)} == set()
