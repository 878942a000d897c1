"""What may be asked for, and what the line's faults do to a frame."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend_board.faults import FAULTS, FaultError, Line, Scope, parse_fault


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_can_be_asked_for_with_its_defaults(name: str) -> None:
    request: dict[str, Any] = {"fault": name}
    if FAULTS[name].scope is Scope.CHANNEL:
        request["channel"] = 7
    fault = parse_fault(request, 10)
    assert fault.parameters == {key: rule.default for key, rule in FAULTS[name].parameters.items()}


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        ({"fault": "gremlins"}, "there are stuck, open"),
        ({"fault": "stuck"}, "channel is missing; the board has 0 to 9"),
        ({"fault": "stuck", "channel": -1}, "0 to 9"),
        ({"fault": "stuck", "channel": True}, "0 to 9"),
        ({"fault": "stuck", "channel": 7, "at": "half"}, '"on" or "off"'),
        ({"fault": "open", "channel": 7, "at": "on"}, "it takes channel"),
        ({"fault": "late", "delay_s": -1}, "from 0 to 60"),
        ({"fault": "late", "delay_s": float("nan")}, "from 0 to 60"),
        ({"fault": "late", "delay_s": 10**400}, "from 0 to 60"),
        ({"fault": "split", "size": 1.5}, "a whole number"),
        ({"fault": "drop", "size": 1}, "it takes nothing"),
    ],
)
def test_a_wrong_request_is_told_what_is_allowed(request_: dict[str, Any], says: str) -> None:
    with pytest.raises(FaultError, match=says):
        parse_fault(request_, 10)


@given(st.binary(min_size=1, max_size=200), st.integers(1, 50), st.floats(0, 5), st.floats(0, 1))
def test_pieces_put_together_in_order_of_time_are_the_frame(
    frame: bytes, size: int, delay_s: float, pause_s: float
) -> None:
    pieces = Line(delay_s=delay_s, size=size, pause_s=pause_s).pieces(frame)
    assert b"".join(piece for _, piece in pieces) == frame
    times = [wait_s for wait_s, _ in pieces]
    assert times == sorted(times)
    assert times[0] == delay_s
    assert max(len(piece) for _, piece in pieces) <= size
