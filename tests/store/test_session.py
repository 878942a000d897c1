"""What an instance says of itself, and when it knows that others cannot have taken it for dead."""

from __future__ import annotations

import pytest

from robomend.store import ownership
from robomend.store.ownership import GONE_S, SURE_S, InstanceSession


class Saying(InstanceSession):
    """A session whose word goes nowhere, at a clock of the test's."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s, self.starved_s = 100.0, 0.0
        monkeypatch.setattr(ownership, "boot_s", lambda: self.now_s)
        monkeypatch.setattr(ownership, "waited_s", lambda: self.starved_s)
        super().__init__(lambda newest: None, lambda: None)
        self._taken("us")
        self.said: list[float] = []

    def _holds(self, *_: object) -> bool:
        return True

    def _silent_s(self, *_: object) -> float:
        return 0.0

    def _hold(self) -> None:
        raise AssertionError

    def goes_on(self, seconds: float, *, turns: bool = True, starved_s: float = 0.0) -> None:
        """Let time pass, and say whatever there is to say then."""
        self.now_s += seconds
        self.starved_s += starved_s
        if turns:
            self.turned()
        self._beat(self.said.append)


@pytest.fixture
def ours(monkeypatch: pytest.MonkeyPatch) -> Saying:
    ours = Saying(monkeypatch)
    ours.goes_on(0.5)
    return ours


def test_an_event_loop_that_turns_is_said_to(ours: Saying) -> None:
    for _ in range(10):
        ours.goes_on(0.5)
    assert ours.said[-1] == ours.now_s
    assert ours.sure
    assert ours.naps == 0


def test_an_event_loop_that_is_held_is_not_said_to_turn(ours: Saying) -> None:
    held_s = ours.now_s
    for _ in range(7):
        ours.goes_on(0.5, turns=False)
    assert ours.said[-1] == held_s
    assert ours.now_s - ours.said[-1] > GONE_S
    assert not ours.sure


def test_an_event_loop_that_gets_no_processor_is_said_to_turn(ours: Saying) -> None:
    for _ in range(20):
        ours.goes_on(0.5, turns=False, starved_s=0.45)
    assert ours.now_s - ours.said[-1] == pytest.approx(20 * 0.05)
    assert ours.sure
    assert ours.naps == 0


def test_a_sleep_is_a_nap_once(ours: Saying) -> None:
    ours.now_s += 60.0
    assert not ours.sure
    ours.goes_on(0.0)
    ours.goes_on(0.5)
    assert ours.sure
    assert ours.naps == 1


def test_a_late_word_is_a_nap_however_lately_the_event_loop_turned(ours: Saying) -> None:
    ours.now_s += SURE_S - 0.1
    ours.turned()
    ours.goes_on(GONE_S - SURE_S + 0.2, turns=False)  # others may have taken over just before it
    assert ours.sure
    assert ours.naps == 1
