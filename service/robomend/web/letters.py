"""How wide a text is in a picture, so that what does not fit is cut, and nothing spills over.

A picture is made before any font is known. The widths are those of DejaVu Sans, the widest of the fonts that
the page asks for: in another one a text takes less.
"""

from __future__ import annotations

from functools import lru_cache
from unicodedata import combining, east_asian_width

WIDTHS = {
    0.3: "Iijl.,:;'`| ",
    0.4: "frt()[]/-!\\",
    0.5: '_"*?',
    0.55: "csvxyzkFLJ",
    0.64: "0123456789abdeghnopquEPTYZ{}$",
    0.7: "ABCKRSVX",
    0.79: "DGHNOQU&#",
    0.84: "w+<>=~^",
    1.0: "mMW@%…",
}
"""Of a letter, at most, in units of the font's size."""

_OF_LETTER = {letter: width for width, letters in WIDTHS.items() for letter in letters}
_WIDE, _OTHER = 1.05, 0.75


@lru_cache(maxsize=4096)
def width(text: str, size: float) -> float:
    """Return how many pixels a text takes at most."""
    return size * sum(map(_of, text))


def _of(letter: str) -> float:
    if combining(letter):
        return 0.0
    known = _OF_LETTER.get(letter)
    if known is None:
        return _WIDE if east_asian_width(letter) in "WF" else _OTHER
    return known


@lru_cache(maxsize=4096)
def cut(text: str, most: float, size: float) -> str:
    """Return a text if it takes no more than so many pixels, else its beginning, a sign, and its end.

    Names of one robot often begin alike, and often end alike.
    """
    if width(text, size) <= most:
        return text
    left = most - width("…", size)
    begin = _fitting(text, left / 2, size)
    end = _fitting(text[:begin:-1], left - width(text[:begin], size), size)
    tail = text[len(text) - end :]
    while tail and combining(tail[0]):  # it would stand on the sign
        tail = tail[1:]
    return f"{text[:begin]}…{tail}"


def _fitting(text: str, left: float, size: float) -> int:
    """Return how many letters of a text fit into so many pixels."""
    for number, letter in enumerate(text):
        left -= size * _of(letter)
        if left < 0:
            return number
    return len(text)
