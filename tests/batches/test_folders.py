"""Folders of batches: what is made by one process while another removes what is left over."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from robomend.batches.folders import BatchFolders
from robomend.batches.one_batch import without_places


def test_a_folder_that_is_made_is_never_taken_for_left_over(tmp_path: Path) -> None:
    folders = BatchFolders(tmp_path)
    folders.place()
    over = threading.Event()

    def sweep() -> None:
        while not over.is_set():
            BatchFolders(tmp_path).sweep(frozenset)  # nothing is known yet

    sweeper = threading.Thread(target=sweep)
    sweeper.start()
    try:
        for _ in range(300):
            _, folder, lock = folders.make()
            assert folder.logs.is_dir()
            folder.remove()
            lock.close()
    finally:
        over.set()
        sweeper.join()


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("error: /data/batches/b-1/logs/night/a.mcap: no log", "error: night/a.mcap: no log"),
        ("/srv/logs/a.mcap, /srv/logs", "a.mcap, ."),
        ('File "/opt/robomend/lib/python3/x.py", line 3', 'File "…/x.py", line 3'),
        (
            "https://example.org/a/b, 3/4, a/b.mcap",
            "https://example.org/a/b, 3/4, a/b.mcap",
        ),
    ],
)
def test_what_a_batch_says_leaves_out_where_things_are_on_this_computer(said: str, shown: str) -> None:
    assert without_places(said, ["/data/batches/b-1/logs", "/data/batches/b-1", "/srv/logs", None]) == shown
