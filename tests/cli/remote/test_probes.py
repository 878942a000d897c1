"""`robomend observe` and `probes`: saying what was seen, and what to look at next."""

from __future__ import annotations

from tests.cli.remote.conftest import Say, Shared, answer, narrow


def test_an_observation_is_answered_with_the_diagnosis_of_it(say: Say, shared: Shared, robot: str) -> None:
    shared.robot(robot, policy="observe")
    code, out, _ = say("observe", robot, "not ok(scan)", "on(hokuyo)")
    assert code == 0
    assert out == "taken in as revision 1: not ok(scan), on(hokuyo)\nbad: hokuyo or hokuyo_node\n"
    _, out, _ = say("observe", robot, "not ok(scan)")
    assert out.startswith("taken in as revision 1: nothing new\n")
    _, out, _ = say("observe", robot, "ok(scan)", "--source", "a person", "--lifetime", "60")
    assert out.endswith("no fault: nothing that is observed points to one\n")
    entries = {one["literal"]: one for one in shared.client.observations(robot)["observations"]}
    assert entries["ok(scan)"]["source"] == "a person"
    assert entries["ok(scan)"]["expires_ns"] is not None
    known = answer(say("observe", robot, "not ok(scan)", "--format", "json"))
    assert known["revision"] == known["diagnosis"]["revision"] == 3


def test_what_was_measured_is_given_with_the_sentence_and_shown_by_status(
    say: Say, shared: Shared, robot: str
) -> None:
    shared.robot(robot, policy="observe")
    code, _, _ = say(
        "observe", robot, "not ok(scan)", "ok(map)", "--reading", "0 of 10 Hz", "--reading", "9 Hz"
    )
    assert code == 0
    assert "\nseen: scan is not as it should be (0 of 10 Hz)\n" in say("status", robot)[1]
    assert "9 Hz" not in say("status", robot)[1]  # of what is good nobody asks
    assert [
        one["reading"]["text"] for one in answer(say("status", robot, "--format", "json"))["measured"]
    ] == ["0 of 10 Hz"]
    code, _, err = say("observe", robot, "not ok(scan)", "ok(map)", "--reading", "0 of 10 Hz")
    assert code == 2
    assert "1 readings for 2 sentences: give --reading once for each" in err


def test_sentences_that_cannot_be_read_are_refused_with_the_place(
    say: Say, shared: Shared, robot: str
) -> None:
    shared.robot(robot)
    code, out, err = say("observe", robot, "ok(scn)")
    assert (code, out) == (2, "")
    assert "'ok(scn)', position 0: no topic or property is named scn; did you mean scan?" in err
    assert shared.client.observations(robot)["revision"] == 0


def test_probes_say_what_to_look_at_and_an_answer_leaves_fewer_diagnoses(
    say: Say, shared: Shared, robot: str
) -> None:
    shared.robot(robot, "not ok(scan)", "on(hokuyo)", policy="observe")
    code, out, _ = say("probes", robot)
    assert code == 0
    assert narrow(out)
    bad, _, heading, row, _, then, rest = out.splitlines()
    assert bad == "bad: hokuyo or hokuyo_node"
    assert heading.split("  ")[0] == "look at"
    assert row.split()[:4] == ["running(hokuyo_node)", "hokuyo", "or", "hokuyo_node"]
    assert row.split()[4] == "hokuyo_node"
    assert then.startswith(f'then: robomend probes {robot} --answer "running(hokuyo_node)"')
    assert rest.startswith("  ")
    found = answer(say("probes", robot, "--format", "json"))
    assert found["probes"][0]["atom"] == "running(hokuyo_node)"
    assert found["probes"][0]["gain_bits"] > 0
    code, out, _ = say("probes", robot, "--answer", "not running(hokuyo_node)")
    assert code == 0
    assert out.startswith("bad: hokuyo_node\nnothing to look at: ")
