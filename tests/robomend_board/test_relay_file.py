"""The relays outlive the process."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomend_board.relay_file import RelayFileError, read_relays, write_relays


def test_what_was_written_is_read_and_nothing_else_is_left(tmp_path: Path) -> None:
    path = tmp_path / "board.json"
    write_relays(path, (True, False, True))
    write_relays(path, (False, False, True))
    assert read_relays(path, 3) == (False, False, True)
    assert list(tmp_path.iterdir()) == [path]


def test_the_file_is_replaced_and_never_written_over(tmp_path: Path) -> None:
    path = tmp_path / "board.json"
    write_relays(path, (True, False))
    old = path.read_text()
    with path.open() as opened_before:
        write_relays(path, (False, True))
        assert opened_before.read() == old


def test_a_file_that_is_not_there_yet_says_nothing(tmp_path: Path) -> None:
    assert read_relays(tmp_path / "board.json", 3) is None


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"relays": 7}', '{"relays": [1, 0, 1]}', "\x00"])
def test_a_file_that_is_no_state_is_refused_with_the_remedy(tmp_path: Path, text: str) -> None:
    path = tmp_path / "board.json"
    path.write_text(text)
    with pytest.raises(RelayFileError, match=r"board\.json.*remove it"):
        read_relays(path, 3)


def test_the_state_of_another_board_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "board.json"
    write_relays(path, (True,) * 8)
    with pytest.raises(RelayFileError, match="8 channels, not 10"):
        read_relays(path, 10)


def test_a_failed_write_leaves_the_old_state_and_no_rubbish(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "board.json"
    write_relays(path, (True, False))

    def full(descriptor: int) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="no space"):
        write_relays(path, (False, True))
    assert read_relays(path, 2) == (True, False)
    assert list(tmp_path.iterdir()) == [path]
