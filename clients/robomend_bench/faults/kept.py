"""The scores of a run in pieces: a file that each piece adds to, and that says what is done already.

A line of JSON each: the first has the terms, which all pieces share, the others a score. What was left out
or broke is not in it, so that the next piece plays it again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from robomend_bench.faults.scoring import Score

NAMES = frozenset(field.name for field in fields(Score))


class OtherTerms(ValueError):
    """The file has scores of another kind of run; the argument says in what they differ."""


class Kept:
    """See the module. `scores` are those of earlier pieces and of this one, by trial."""

    def __init__(self, path: Path, terms: Mapping[str, Any]) -> None:
        """Read what is there.

        Raises:
            OtherTerms: the file is of other terms, or no such file at all.
        """
        self.scores: dict[str, Score] = {}
        self._path = path
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        if not lines:
            path.write_text(json.dumps({"terms": terms}) + "\n", encoding="utf-8")
            return
        try:
            theirs = json.loads(lines[0])["terms"]
            differ = [
                f"{n}: {theirs.get(n)!r} there, {terms.get(n)!r} now"
                for n in {**theirs, **terms}
                if theirs.get(n) != terms.get(n)
            ]
        except (ValueError, TypeError, KeyError, AttributeError):
            raise OtherTerms(f"{path} is no file of scores") from None
        if differ:
            raise OtherTerms(f"{path} is of another kind of run: {'; '.join(differ)}")
        for number, line in enumerate(lines[1:], start=2):
            try:
                found = json.loads(line)
                score = Score(**{name: value for name, value in found.items() if name in NAMES})
            except (ValueError, TypeError):
                if number == len(lines):  # cut off as it was written: it is played again
                    path.write_text("".join(f"{each}\n" for each in lines[:-1]), encoding="utf-8")
                    return
                raise OtherTerms(f"{path}, line {number}: no score") from None
            self.scores[score.trial] = score

    def add(self, score: Score) -> None:
        """Keep one more."""
        self.scores[score.trial] = score
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(score.as_json()) + "\n")
