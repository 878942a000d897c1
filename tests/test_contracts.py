"""Every package and every room has its place among the import contracts of pyproject.toml."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
LINTER: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
LAYERS = [contract for contract in LINTER["contracts"] if contract["type"] == "layers"]


def test_every_package_is_looked_at() -> None:
    found = {
        init.parent.name
        for place in ("service", "clients", "board_emulator")
        for init in (ROOT / place).glob("*/__init__.py")
    }
    assert set(LINTER["root_packages"]) == found


def test_every_package_stands_in_the_order_of_packages() -> None:
    [between] = [contract for contract in LAYERS if "containers" not in contract]
    assert set(re.findall(r"\w+", " ".join(between["layers"]))) == set(LINTER["root_packages"])


def test_a_room_that_no_layer_names_breaks_the_contract_of_its_package() -> None:
    exhaustive = {
        name for contract in LAYERS if contract.get("exhaustive") for name in contract["containers"]
    }
    assert set(LINTER["root_packages"]) <= exhaustive
