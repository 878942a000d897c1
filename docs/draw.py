"""Write the diagrams of the pages beside this file, and the schemas of examples/, from the code.

    ./dev run python docs/draw.py      or ./dev check --fix, before a commit

A diagram stands between `<!-- drawn: NAME -->` and `<!-- end -->`; tests/test_drawn_docs.py holds the pages
to what this writes.
"""

from __future__ import annotations

import re
from pathlib import Path

from robomend.batches import record as batches
from robomend.cli.schema import FILES, schema_name, schema_text
from robomend.drills import record as drills
from robomend.repairs import states as repairs
from robomend.transitions import diagram

PAGES = Path(__file__).parent
EXAMPLES = PAGES.parent / "examples"

DIAGRAMS = {
    "repair": diagram(repairs.REPAIR, repairs.INITIAL, together=("any open state", repairs.OPEN)),
    "drill": diagram(
        drills.DRILL,
        drills.INITIAL,
        together=("what may be planted", drills.MAYBE_PLANTED),
    ),
    "batch": diagram(batches.BATCH, batches.INITIAL),
}

BLOCK = re.compile(r"(<!-- drawn: (?P<name>\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def drawn(page: str) -> str:
    """Return the text of a page with its diagrams as the code has them."""
    return BLOCK.sub(lambda block: f"{block[1]}```mermaid\n{DIAGRAMS[block['name']]}\n```\n{block[3]}", page)


def main() -> None:
    """Write them."""
    for path in sorted(PAGES.glob("*.md")):
        text = path.read_text(encoding="utf-8")
        if text != drawn(text):
            path.write_text(drawn(text), encoding="utf-8")
    for file in FILES:
        (EXAMPLES / schema_name(file)).write_text(schema_text(file), encoding="utf-8")


if __name__ == "__main__":
    main()
