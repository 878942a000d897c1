"""Intervals as lines of JSON, made while what they have in common is at hand.

A log has few different answers, and few different grounds: each is written as JSON once, by polars, and a
line is put together of its times and these texts. The bytes are those of polars' own `write_ndjson` of the
part (a test holds the two together), which has to read every list of every row for them.
"""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import polars as pl

    from robomend_batch.track import Times

SLICE = 2048
"""Lines that are made together: they stay in the processor's cache."""

TAILS = 1 << 15
"""Lines whose different ends are made together."""

BEFORE = ("state", "bad", "probability", "conflicts")
AFTER = ("complete", "stopped_by", "smallest_proved", "size_at_least", "size_at_most")
"""Columns before and behind the observations."""


def lines(
    log: str,
    segment: NDArray[np.int32],
    start: Times,
    end: Times,
    answers: pl.DataFrame,
    answer_of: NDArray[np.intp],
    observations: pl.Series,
    ground_of: NDArray[np.intp],
) -> Iterator[bytes]:
    """Yield the lines of intervals, many at once.

    Args:
        log: its name.
        segment, start, end: of each interval.
        answers: the different ones.
        answer_of: which of them each interval has.
        observations: the different grounds.
        ground_of: which of them each interval has.
    """
    import polars as pl

    head = b"{" + _texts(pl.DataFrame({"log": [log]}))[0] + b',"segment":'
    before, after = _texts(answers.select(BEFORE)), _texts(answers.select(AFTER))
    grounds = _texts(observations.to_frame("observations"))
    pair = answer_of.astype(np.int64) * len(grounds) + ground_of
    for group in range(0, len(start), TAILS):
        different, tail_of = np.unique(pair[group : group + TAILS], return_inverse=True)
        tails = [
            b",%b,%b,%b}\n" % (before[answer], grounds[ground], after[answer])
            for answer, ground in (divmod(one, len(grounds)) for one in different.tolist())
        ]
        for first in range(0, len(tail_of), SLICE):
            here = slice(group + first, min(group + first + SLICE, group + len(tail_of)))
            columns = segment[here].tolist(), start[here].tolist(), end[here].tolist()
            tail = tail_of[first : first + SLICE].tolist()
            yield b"".join(
                [
                    piece
                    for number, begins, ends, of in zip(*columns, tail, strict=True)
                    for piece in (b'%b%d,"start_ns":%d,"end_ns":%d' % (head, number, begins, ends), tails[of])
                ]
            )


def _texts(frame: pl.DataFrame) -> list[bytes]:
    """Return the rows of a table as JSON, without their braces."""
    texts: list[bytes] = []
    for piece in frame.iter_slices(SLICE):
        text = BytesIO()
        piece.write_ndjson(text)
        texts += [line[1:-1] for line in text.getvalue().split(b"\n")[: len(piece)]]
    return texts
