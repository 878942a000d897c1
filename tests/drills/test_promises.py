"""What is promised to be told apart is told apart when it is drilled, on robots that nobody has seen."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
from tests.drills.drilled_robot import drilled_robot
from tests.waiting import until

from robomend.cli.commands import run
from robomend_bench.intervals import wilson


def generated(rng: random.Random) -> tuple[str, frozenset[str]]:
    """Return a model of a robot, drivers and what rests on them, and the topics that nobody watches."""
    channels = rng.sample([1, 3, 4, 5, 6, 7], k=rng.randint(2, 4))
    hardware = [f"  dev{n}: {{channel: {channel}}}" for n, channel in enumerate(channels)]
    nodes, topics = [], []
    for n in range(len(channels)):
        said = [f"raw{n}_{k}" for k in range(rng.randint(1, 2))]
        topics += said
        nodes.append(f"  drv{n}: {{drives: [dev{n}], publishes: {{{', '.join(f'{t}: []' for t in said)}}}}}")
    for n in range(rng.randint(3, 5)):
        inputs = rng.sample(topics, k=rng.randint(1, 2))
        nodes.append(f"  work{n}: {{publishes: {{out{n}: [{', '.join(inputs)}]}}}}")
        topics.append(f"out{n}")
    rates = [f"  {topic}: {{rate_hz: 10}}" for topic in topics]
    parts = ["robomend: 1", "name: made", "hardware:", *hardware, "nodes:", *nodes, "topics:", *rates]
    return "\n".join(parts) + "\n", frozenset(topic for topic in topics if rng.random() < 0.2)


@pytest.mark.long  # a robot of its own, and minutes of drills: test_command.py has a short one
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", range(16))
def test_what_is_promised_to_be_told_apart_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], seed: int
) -> None:
    source, unwatched = generated(random.Random(seed))
    limits = {"limits": {"attempts_per_hour": 1000}}
    with drilled_robot(tmp_path, source=source, unwatched=unwatched, config=limits) as robot:
        of_it = ["drill", "r1", "--url", robot.url, "--format", "json"]
        assert run([*of_it, "--plan"]) == 0
        faults = json.loads(capsys.readouterr().out)["faults"]
        told = [one for one in faults if one["promise"] == "told" and not one["refused"]]
        names = [
            f"{one['kind']}:{one['topic'] or one['component']}" for one in told if one["by"] != "a person"
        ]
        run([*of_it, "--yes", *(word for name in names for word in ("--fault", name))])
        out, progress = capsys.readouterr()
        report = json.loads(out)
        until(lambda: not robot.leftovers(), "everything is undone", 60.0)
    sums = report["totals"]
    with capsys.disabled():
        print(f"seed {seed}: {sums}")
        for row in report["faults"]:
            if row["outcome"] != "told":
                print(f"    {json.dumps(row)}")
    assert (sums["faults"], sums["watched"], sums["not_undone"]) == (len(names), len(names), 0), progress
    assert wilson(sums["promised_and_told"], sums["promised_told"])[1] >= 0.99  # no worse than chance allows
