"""Names, numbers and comments as the drafted YAML has them."""

from __future__ import annotations

import json
import re
from collections.abc import Collection

from robomend.model.from_graph import YAML_WORD
from robomend_client.literals import PLAIN_NAME

RESERVED = frozenset(("true", "false", "yes", "no", "on", "off", "null", "y", "n"))


def word(name: str) -> str:
    """Return a name as YAML and sentences have it."""
    plain = YAML_WORD.match(name) and PLAIN_NAME.match(name) and name.lower() not in RESERVED
    return name if plain else json.dumps(name, ensure_ascii=False)


def comment(text: str) -> str:
    """Return a text in which nothing ends the comment."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def slug(text: str, taken: Collection[str] = ()) -> str:
    """Return a plain name for a text, one that is not taken."""
    base = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_") or "value"
    base = base if base[0].isalpha() else f"v{base}"
    found, number = base, 2
    while found in taken:
        found, number = f"{base}{number}", number + 1
    return found


def upwards(value: float) -> str:
    """Return a positive number of three digits, not below it: a rounded bound is no tighter."""
    text = f"{value:.3g}"
    if float(text) < value:
        text = f"{value * 1.005:.3g}"
    return f"{float(text):g}"


def outwards(value: float, sign: int) -> str:
    """Return a limit of four digits that is no tighter; `sign`: 1 of an upper one, -1 of a lower one."""
    text = f"{value:.4g}"
    if sign * float(text) < sign * value:
        text = f"{value + sign * abs(value) * 0.0005:.4g}"
    return f"{float(text):.10g}"
