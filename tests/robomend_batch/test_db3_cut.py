"""What is left of a .db3 that is cut off is read, wherever SQLite has put its pages."""

from __future__ import annotations

import random
import sqlite3
from collections import Counter
from pathlib import Path

import pytest

from robomend_batch.logs.db3 import open_db3
from robomend_batch.logs.recorded import Message, Unreadable

WANTED = {1: True, 2: False}


def recording(file: Path, messages: int, most_bytes: int, page_bytes: int) -> None:
    """Write one as rosbag2 does; times are a little out of order."""
    chance = random.Random(messages)
    base = sqlite3.connect(file)
    base.execute(f"PRAGMA page_size = {page_bytes}")
    base.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
        "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
    )
    base.execute(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
        "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
    )
    base.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
    for topic in (1, 2):
        row = topic, f"/topic{topic}", "std_msgs/msg/Float64", "cdr", ""
        base.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", row)
    base.executemany(
        "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
        (
            (
                1 + number % 2,
                (number + chance.randrange(4)) * 10**7,
                chance.randbytes(chance.randrange(most_bytes)),
            )
            for number in range(messages)
        ),
    )
    base.commit()
    base.close()


def messages(file: Path) -> list[Message]:
    found = open_db3(file)
    try:
        return list(found.messages(WANTED))
    finally:
        found.close()


@pytest.mark.parametrize(
    ("count", "most_bytes", "page_bytes"),
    [(9000, 60, 512), (9000, 60, 4096), (300, 30_000, 4096), (300, 200_000, 65536)],
    ids=["deep", "flat", "long", "long-on-large-pages"],
)
def test_what_is_there_is_told_and_nothing_else(
    count: int, most_bytes: int, page_bytes: int, tmp_path: Path
) -> None:
    file = tmp_path / "a.db3"
    recording(file, count, most_bytes, page_bytes)
    whole = messages(file)
    assert len(whole) == count
    data = file.read_bytes()
    for share in (0.1, 0.5, 0.77, 0.999):
        file.write_bytes(data[: int(len(data) * share)])
        opened = open_db3(file)
        assert opened.cut == f"cut off: {int(len(data) * share)} of {len(data)} bytes"
        found = list(opened.messages(WANTED))
        from_ns = found[len(found) // 2][0]
        assert list(opened.messages(WANTED, from_ns)) == [one for one in found if one[0] >= from_ns]
        opened.close()
        assert Counter(found) <= Counter(whole)
        assert found == sorted(found, key=lambda one: one[0])
        assert len(found) > (share - 0.1) * count


def test_one_of_which_no_more_than_the_topics_is_there_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.db3"
    recording(file, 100, 60, 4096)
    data = file.read_bytes()
    for length in (100, 4096, 4097, 6000, 2 * 4096):  # behind these are the messages
        file.write_bytes(data[:length])
        with pytest.raises(Unreadable, match="cut off"):
            open_db3(file)


def test_a_message_whose_pages_lead_in_a_circle_is_left_out(tmp_path: Path) -> None:
    file = tmp_path / "a.db3"
    recording(file, 40, 3000, 512)
    data = bytearray(file.read_bytes())
    del data[16383 // 512 * 512 :]
    file.write_bytes(data)
    found = messages(file)
    longest = max((body for _, _, body in found if body is not None), key=len)
    begin = data.index(longest[:50])  # in its cell; the rest is in other pages
    length = data.rindex(bytes([0x80 | len(longest) + 16 >> 7]), begin - 20, begin)
    data[length : length + 2] = b"\xff\x7f"  # 16383, of which 127 behind the row's number are in the cell
    last = len(data) // 512
    data[length + 130 : length + 134] = last.to_bytes(4)
    data[(last - 1) * 512 : (last - 1) * 512 + 4] = last.to_bytes(4)
    file.write_bytes(data)
    left = messages(file)
    assert 0 < len(left) < len(found)
    assert Counter(left) <= Counter(found)
