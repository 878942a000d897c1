"""Names, numbers and comments as the drafted YAML has them."""

from __future__ import annotations


def comment(text: str) -> str:
    """Return a text in which nothing ends the comment."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


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
