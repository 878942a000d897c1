"""What is wrong with a log, as it is told."""

from __future__ import annotations

from robomend_batch.problems import Problems


def test_a_reason_is_one_line_whatever_a_librarys_error_looks_like() -> None:
    problems = Problems()
    for _ in range(2):
        problems.add(
            "a.mcap: imu", "the type cannot be used: Could not parse:\n'%%% nope\\n'\n26\n", bad=True
        )
    (found,) = problems.json()
    assert found["reason"] == "the type cannot be used: Could not parse: '%%% nope\\n' 26"
    assert found["count"] == 2
    assert problems.bad
