"""`robomend status`: all robots, and one."""

from __future__ import annotations

from tests.cli.remote.conftest import Say, Shared, answer, narrow


def test_all_robots_are_told_with_what_is_wrong_and_what_they_wait_for(
    say: Say, shared: Shared, robot: str
) -> None:
    shared.robot(f"{robot}-ill", "not ok(scan)", "running(hokuyo_node)", policy="observe")
    shared.robot(f"{robot}-well", "ok(scan)")
    code, out, _ = say("status", "--search", f"{robot}-")
    assert code == 0
    assert narrow(out)
    heading, ill, *rest = out.splitlines()
    assert heading.split()[:3] == ["robot", "state", "what"]
    assert ill.split()[:4] == [f"{robot}-ill", "unhealthy", "scan", "is"]
    assert "A person is needed: robomend only observes" in " ".join(
        word for line in [ill, *rest] for word in line.split()
    )
    assert any(line.split()[:4] == [f"{robot}-well", "healthy", "Healthy", "since"] for line in rest)
    known = answer(say("status", "--search", f"{robot}-", "--format", "json"))
    assert [one["robot"] for one in known["robots"]] == [f"{robot}-ill", f"{robot}-well"]
    assert known["found"] == 2
    assert known["complete"]
    only = answer(say("status", "--state", "healthy", "--search", f"{robot}-", "--format", "json"))
    assert [one["robot"] for one in only["robots"]] == [f"{robot}-well"]
    second = answer(say("status", "--search", f"{robot}-", "--rows", "1", "--page", "2", "--format", "json"))
    assert [one["robot"] for one in second["robots"]] == [f"{robot}-well"]


def test_one_robot_is_told_with_its_diagnoses_and_the_plan_that_waits(
    say: Say, shared: Shared, robot: str
) -> None:
    repair = shared.awaiting_approval(robot)
    code, out, _ = say("status", robot)
    assert code == 0
    assert narrow(out)
    for words in (
        f"{robot}: unhealthy; model tedusar, policy approve",
        "UTC; any of these explains what was seen:\n  hokuyo\n  hokuyo_node\n",
        f"repair {repair}: awaiting-approval",
        "\nscan is not as it should be since ",
        ", because of one of two: hokuyo",
        "\n  Stop hokuyo_node\n",
        f"yes: robomend approve {repair}; no: robomend cancel {repair}",
        "note: start_node, stop_node: no agent",
    ):
        assert words in out


def test_one_diagnosis_is_not_told_as_one_of_many(say: Say, shared: Shared, robot: str) -> None:
    shared.robot(robot, "not on(jaguar)", policy="observe")
    assert "UTC; this explains what was seen:\n  jaguar\n" in say("status", robot)[1]


def test_a_script_learns_by_the_exit_code_whether_a_robot_is_well(
    say: Say, shared: Shared, robot: str
) -> None:
    shared.robot(robot, "ok(scan)")
    assert say("status", robot, "--fail-on-fault")[0] == 0
    shared.robot(f"{robot}-ill", "not ok(scan)", policy="observe")
    assert say("status", f"{robot}-ill", "--fail-on-fault")[0] == 1
    assert say("status", "--fail-on-fault")[0] == 1


def test_a_robot_that_cannot_be_diagnosed_says_why(say: Say, shared: Shared, robot: str) -> None:
    source = "robomend: 1\nname: m\nnodes:\n  a: {publishes: [scan]}\nrules: [ok(scan)]\n"
    shared.client.put_model(f"odd-{robot}", source)
    shared.robot(robot, "not ok(scan)", model=f"odd-{robot}", policy="observe")
    code, out, _ = say("status", robot)
    assert code == 0
    assert "no diagnosis: not ok(scan) contradicts the rules" in out
    code, _, err = say("probes", robot)
    assert code == 2
    assert "not ok(scan) contradicts the rules" in err


def test_markup_in_names_is_shown_as_it_is(say: Say, shared: Shared, robot: str) -> None:
    source = 'robomend: 1\nname: m\nnodes:\n  "[bold]x": {publishes: [scan]}\n'
    shared.client.put_model(f"odd-{robot}", source)
    shared.robot(robot, "not ok(scan)", model=f"odd-{robot}", policy="observe")
    for arguments in (["status", robot], ["status"], ["probes", robot]):
        assert "[bold]x" in say(*arguments)[1]
