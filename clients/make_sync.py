"""Make the code for threads from the code for asyncio.

    python clients/make_sync.py           write it; `./dev check --fix` does so
    python clients/make_sync.py --check   name the files that are not what they would be made

The two differ in nothing but the words below, so only the one for asyncio is written by hand.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

PACKAGE = Path(__file__).parent / "robomend_client"

MADE = {PACKAGE / "rest" / "sync.py": PACKAGE / "rest" / "asynchronous.py"}
"""What is made from what."""

WORDS = (
    (r"\b(for|with) asyncio\b", r"\1 threads"),
    (r"\basync (?=def|with|for)", ""),
    (r"\bawait ", ""),
    (r"\bAsync(?=[A-Z])", ""),
    (r"\b__a(?=enter__|exit__)", "__"),
    (r"\.a(?=close\(\)|read\(\)|iter_bytes\(\))", "."),
    (r"\bimport asyncio\b", "import time"),
    (r"\basyncio(?=\.sleep)", "time"),
    (r"\brest\.asynchronous\b", "rest.sync"),
    # An asynchronous generator cannot delegate.
    (r"for event in (\S+):\n\s+yield event\n", r"yield from \1\n"),
)
"""Asyncio's words, and what threads say instead."""


def made_from(source: Path) -> str:
    """Return the code for threads, formatted."""
    text = source.read_text(encoding="utf-8")
    for pattern, replacement in WORDS:
        text = re.sub(pattern, replacement, text)
    here = source.relative_to(PACKAGE.parent).as_posix()
    told = rf"\1\n\n# Made from {here} by make_sync.py: change that one.\n"
    text = re.sub(r'\A(""".*?""")\n', told, text, flags=re.DOTALL)
    for step in (("check", "--fix", "--select=I"), ("format",)):
        ruff = [sys.executable, "-m", "ruff", *step, "--quiet", f"--stdin-filename={source}", "-"]
        text = subprocess.run(ruff, input=text, capture_output=True, text=True, check=True, timeout=60).stdout
    return text


def main(arguments: list[str]) -> int:
    """Write what is made, or with --check look at it."""
    texts = {made: made_from(source) for made, source in MADE.items()}
    stale = {made: text for made, text in texts.items() if not made.exists() or made.read_text() != text}
    for made, text in stale.items():
        print(made.relative_to(PACKAGE.parent.parent))
        if "--check" not in arguments:
            made.write_text(text, encoding="utf-8")
    return 1 if stale and "--check" in arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
