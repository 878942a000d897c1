"""A file has one subject: one of more than 400 lines is split, or docs/design.md says why it is one."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LONG = 400


def test_each_long_file_is_named_with_its_reason() -> None:
    long = {
        str(file.relative_to(ROOT))
        for place in ("service", "clients", "board_emulator")
        for file in (ROOT / place).rglob("*.py")
        if len(file.read_text(encoding="utf-8").splitlines()) > LONG
    }
    section = (ROOT / "docs/design.md").read_text(encoding="utf-8").partition("\n## Long files\n")[2]
    named = re.findall(r"^\| `([^`]+)` \| ([^|]{20,}) \|$", section.partition("\n## ")[0], re.MULTILINE)
    assert {file for file, _ in named} == long
