"""The clients for threads and for asyncio are twins: what one says, the other says with `await`."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from robomend_client.rest import asynchronous, sync

TRANSLATED = (
    (r"\basync (?=def|with|for)", ""),
    (r"\bawait ", ""),
    (r"\bAsync(?=[A-Z])", ""),
    (r"\b__a(?=enter__|exit__)", "__"),
    (r"\.a(?=close\(\)|read\(\)|iter_bytes\(\))", "."),
    (r"\basyncio\b", "time"),
)
"""Asyncio's words, and what threads say instead."""


def methods(source: str) -> dict[str, str]:
    """Return the methods of the client as text without layout and comments, by name."""
    (client,) = (node for node in ast.parse(source).body if isinstance(node, ast.ClassDef))
    return {node.name: ast.unparse(node) for node in client.body if isinstance(node, ast.FunctionDef)}


def test_the_asyncio_client_is_the_other_one_with_await() -> None:
    translated = Path(asynchronous.__file__).read_text()
    for pattern, replacement in TRANSLATED:
        translated = re.sub(pattern, replacement, translated)
    # An asynchronous generator cannot delegate.
    translated = re.sub(r"for event in (\S+):\n\s+yield event\n", r"yield from \1\n", translated)
    ours, theirs = methods(translated), methods(Path(sync.__file__).read_text())
    assert list(ours) == list(theirs)
    for name, text in theirs.items():
        assert ours[name] == text
