"""`robomend moments`: what was around a fault, for people, and its recording for tools."""

from __future__ import annotations

from pathlib import Path

from tests.cli.remote.conftest import Say, Shared, answer, narrow


def test_moments_are_listed_shown_and_their_recordings_fetched(
    say: Say, shared: Shared, robot: str, tmp_path: Path
) -> None:
    shared.robot(robot)
    assert say("moments", robot) == (0, "no moments yet\n", "")
    assert say("moments", robot, "newest")[0] == 2
    kept = shared.client.keep_moment(
        robot,
        {
            "agent": "onboard",
            "key": "k1",
            "at_ns": 1764000000000000000,
            "literals": [{"literal": "not ok(scan)", "reading": "0 of 10 Hz"}],
            "frame": {
                "topics": [{"topic": "/scan", "messages": [{"at_s": -0.3, "text": "ranges: [1, 2]"}]}],
                "logs": [{"node": "hokuyo_node", "lines": ["cannot open \x1b[31m/dev/lidar"]}],
                "processes": [{"node": "hokuyo_node", "about": "exit code 1"}],
            },
        },
    )
    code, out, _ = say("moments", robot)
    assert code == 0
    assert narrow(out)
    assert kept["id"] in out
    assert "not ok(scan) (0 of 10 Hz)" in out
    _, out, _ = say("moments", robot, "newest")
    assert "cannot open \\x1b[31m/dev/lidar" in out
    assert "process hokuyo_node: exit code 1" in out
    assert "ranges: [1, 2]" in out
    assert answer(say("moments", robot, kept["id"], "--format", "json"))["agent"] == "onboard"

    file = tmp_path / "a.mcap"
    code, _, err = say("moments", robot, "newest", "--mcap", str(file))
    assert (code, f"moment {kept['id']} has no recording" in err) == (2, True)
    assert shared.client.keep_recording(robot, kept["id"], at=0, size=3, data=b"abc") == 3
    assert say("moments", robot, "newest", "--mcap", str(file))[0] == 0
    assert file.read_bytes() == b"abc"
    code, _, err = say("moments", robot, "--mcap", str(file))
    assert (code, "name it" in err) == (2, True)
