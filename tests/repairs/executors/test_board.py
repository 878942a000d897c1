"""The board executor maps power actions to channels and guards the protected ones."""

from __future__ import annotations

import pytest

from robomend.board.link import LinkState
from robomend.errors import BoardError, BoardRefused, BoardTimeout, BoardUnreachable, Fenced
from robomend.repairs.executors.board import BoardExecutor
from robomend_client.actions import FAILED, OK, REFUSED, TIMED_OUT, UNREACHABLE, Action

pytestmark = pytest.mark.anyio


class Board:
    """Records what it is told, or fails."""

    def __init__(self, failure: BoardError | None = None) -> None:
        self.failure = failure
        self.told: list[tuple[int, bool]] = []
        self.asked: list[tuple[int, bool]] = []  # what was told before, each time measurements were asked for
        self.deaf: BoardError | None = None  # what comes of asking
        self.state = LinkState.CONNECTED

    async def wait_connected(self, timeout_s: float) -> None:
        pass

    async def switch(self, channel: int, on: bool, timeout_s: float | None = None) -> None:
        if self.failure is not None:
            raise self.failure
        self.told.append((channel, on))

    async def request(self, timeout_s: float | None = None) -> None:
        self.asked += self.told[-1:]
        if self.deaf is not None:
            raise self.deaf


def quiet(code: int, message: str) -> None:
    pass


async def lost() -> None:
    """Find out that another instance has taken over."""
    raise Fenced("r1 was taken over")


def executor(board: Board) -> BoardExecutor:
    return BoardExecutor(board, {"jaguar": 7, "pc": 2}, {2: "nothing switches it off"})


async def test_a_protected_channel_is_never_switched_off() -> None:
    board = Board()
    assert (await executor(board).execute(Action("r-1:0", "shutdown", ("pc",), 1.0), quiet)).code == REFUSED
    assert (await executor(board).execute(Action("r-1:1", "power_up", ("pc",), 1.0), quiet)).code == OK
    assert board.told == [(2, True)]


@pytest.mark.parametrize(
    ("failure", "code"),
    [
        (BoardRefused("channel faulty"), REFUSED),
        (BoardTimeout("no acknowledge"), TIMED_OUT),
        (BoardUnreachable("no connection"), UNREACHABLE),
        (BoardError("something else"), FAILED),
    ],
)
async def test_the_board_s_errors_are_results(failure: BoardError, code: int) -> None:
    done = await executor(Board(failure)).execute(Action("r-1:0", "power_up", ("jaguar",), 1.0), quiet)
    assert (done.code, done.message) == (code, str(failure))


@pytest.mark.parametrize("action", [("start_node", ("jaguar",)), ("power_up", ("imu",))])
async def test_what_a_board_cannot_do_is_refused(action: tuple[str, tuple[str, ...]]) -> None:
    name, parameters = action
    done = await executor(Board()).execute(Action("r-1:0", name, parameters, 1.0), quiet)
    assert done.code == REFUSED


async def test_what_was_switched_on_is_looked_at_at_once_and_what_is_off_stays_off_for_a_moment() -> None:
    board = Board()
    assert (await executor(board).execute(Action("r-1:0", "shutdown", ("jaguar",), 1.0), quiet)).ok
    assert board.asked == []
    assert (await executor(board).execute(Action("r-1:1", "power_up", ("jaguar",), 1.0), quiet)).ok
    assert board.asked == [(7, True)]
    assert board.told == [(7, False), (7, True)]


@pytest.mark.parametrize(
    "error", [BoardRefused("an older board"), BoardTimeout("late"), BoardUnreachable("gone")]
)
async def test_a_board_that_cannot_be_asked_has_switched_all_the_same(error: BoardError) -> None:
    board = Board()
    board.deaf = error
    done = await executor(board).execute(Action("r-1:0", "power_up", ("jaguar",), 1.0), quiet)
    assert (done.code, board.told) == (OK, [(7, True)])


async def test_who_has_lost_the_robot_switches_nothing() -> None:
    board = Board()
    with pytest.raises(Fenced):
        await BoardExecutor(board, {"jaguar": 7}, {}, lost).execute(
            Action("r-1:0", "power_up", ("jaguar",), 1.0), quiet
        )
    assert board.told == []
