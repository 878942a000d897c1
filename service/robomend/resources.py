"""Where encodings/, pddl/, examples/ and docs/ are: inside the wheel, or at the root of a checkout."""

from __future__ import annotations

from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


def resource(kind: str, name: str) -> Path:
    """Return the path of a data file, e.g. resource("encodings", "diagnosis.lp").

    Raises:
        FileNotFoundError: neither the installed package nor the checkout has it: the installation is broken.
    """
    for root in (PACKAGE / "data", PACKAGE.parent.parent):
        path = root / kind / name
        if path.is_file():
            return path
    raise FileNotFoundError(f"{kind}/{name} is missing from this installation of robomend")


def resources(kind: str, pattern: str) -> list[Path]:
    """Return the paths of the data files of a kind, e.g. resources("docs", "*.md"), by name."""
    for root in (PACKAGE / "data", PACKAGE.parent.parent):
        if found := sorted((root / kind).glob(pattern)):
            return found
    return []
