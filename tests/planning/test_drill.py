"""The plan of a drill: what planted faults would show, what is diagnosed then, and what is never planted."""

from __future__ import annotations

import pytest

from robomend.diagnosis.isolability.analysis import isolability
from robomend.model.loading import load_model, load_text
from robomend.planning.drill import PlantableFault, drill_plan
from robomend.planning.faults import DrilledBoard
from robomend.planning.protection import protection
from robomend.resources import resource

ROBOT = """\
robomend: 1
name: r
protected_channels: [9]
hardware:
  hub: {channel: 1}
  camera: {channel: 2, fed_by: [hub]}
  imu: {}
  computer: {channel: 9}
nodes:
  camera_driver: {drives: [camera], publishes: {image: []}}
  imu_driver: {drives: [imu], publishes: {imu_data: []}}
  detector: {publishes: {objects: [image]}}
  recorder: {restartable: false}
  arbiter: {publishes: {cmd: [goal]}, protected: true}
topics: {goal: }
"""


BOARD = DrilledBoard()


def plan(
    text: str = ROBOT, *, without: str = "", board: DrilledBoard | None = BOARD, meant_off: str = ""
) -> dict[str, PlantableFault]:
    system = load_text(text)
    assert system.parts is not None
    observed = [atom for atom in system.cnf.atoms if str(atom) not in without.split()]
    guarded = protection(system.parts)
    found = drill_plan(
        system, system.parts, observed, protected=guarded, board=board, meant_off=meant_off.split()
    )
    return {fault.name: fault for fault in found}


def shows(fault: PlantableFault) -> set[str]:
    return set(map(str, fault.shows))


def test_a_killed_node_is_told_and_a_frozen_one_still_runs() -> None:
    found = plan()
    killed, frozen = found["node-killed:camera_driver"], found["node-frozen:camera_driver"]
    assert shows(killed) == {"not running(camera_driver)", "not ok(image)", "not ok(objects)"}
    assert killed.promise == "told"
    assert shows(frozen) == {"not ok(image)", "not ok(objects)"}
    assert frozen.promise == "among"
    assert set(frozen.diagnoses) == {
        ("camera",),
        ("camera_driver",),
        ("hub",),
    }  # a hub that hangs looks the same


def test_a_device_that_is_off_is_told_and_one_that_is_unplugged_is_still_on() -> None:
    found = plan()
    assert shows(found["device-off:camera"]) == {"not on(camera)", "not ok(image)", "not ok(objects)"}
    assert found["device-off:camera"].promise == "told"
    assert shows(found["device-unplugged:camera"]) == {"not ok(image)", "not ok(objects)"}
    assert found["device-unplugged:camera"].promise == "among"


def test_what_nobody_observes_would_not_be_noticed() -> None:
    assert plan(without="ok(imu_data)")["node-frozen:imu_driver"].promise == "unseen"


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ("device-off:computer", "protected"),
        ("device-unplugged:computer", "protected"),
        ("node-killed:arbiter", "protected"),
        ("node-frozen:arbiter", "protected"),
        ("node-killed:recorder", "no undo"),
    ],
)
def test_what_is_protected_or_has_no_undo_is_refused(fault: str, why: str) -> None:
    assert why in (plan()[fault].refused or "")


def test_what_a_protected_driver_rests_on_is_refused() -> None:
    guarded = ROBOT.replace("camera_driver: {", "camera_driver: {protected: true, ")
    found = plan(guarded)
    for fault in ("device-off:camera", "device-unplugged:camera"):
        why = "camera_driver, its driver, which would have to restart after it, is protected"
        assert found[fault].refused == why
    assert found["device-off:hub"].refused == "camera, which it feeds, is protected"
    assert found["device-unplugged:imu"].refused is None


def test_without_a_board_nothing_is_switched_and_its_own_channels_are_protected() -> None:
    assert "no `board`" in (plan(board=None)["device-off:hub"].refused or "")
    assert plan(board=DrilledBoard((2,)))["device-off:camera"].refused == "nothing switches it off"
    assert plan(board=DrilledBoard((3,)))["device-off:camera"].refused is None


@pytest.mark.parametrize("share", [1, 2, 3])
def test_what_is_promised_to_be_told_can_be_told_by_isolability(share: int) -> None:
    system = load_model(str(resource("examples", "tedusar.yaml")))
    assert system.parts is not None
    observed = system.cnf.atoms[::share]
    told = isolability(system.cnf, observed)
    kept = 0
    for fault in drill_plan(system, system.parts, observed, protected={}, board=DrilledBoard()):
        row = told.matrix[system.cnf.components.index(fault.component)]
        if fault.promise == "told":
            kept += 1
            assert "-" not in row
        elif fault.promise == "among":
            assert set(row) & {"-", "~"}
    assert kept


def test_a_disturbed_topic_takes_what_rests_on_it_and_spares_what_its_node_says_besides() -> None:
    two = ROBOT.replace("publishes: {image: []}}", "publishes: {image: [], info: []}}")
    found = plan(two)
    for kind in ("topic-dropped", "topic-delayed"):
        assert shows(found[f"{kind}:image"]) == {"not ok(image)", "not ok(objects)"}
        assert shows(found[f"{kind}:info"]) == {"not ok(info)"}
        assert found[f"{kind}:image"].component == "camera_driver"
    # The camera would silence the other topic, too, if it showed itself wherever it can; it need not.
    assert ("camera_driver",) in found["topic-dropped:info"].diagnoses
    assert found["topic-dropped:objects"].diagnoses == (("detector",),)
    assert "protected" in (found["topic-dropped:cmd"].refused or "")


def test_a_topic_that_a_protected_node_reads_or_that_two_publish_is_not_disturbed() -> None:
    reader = ROBOT.replace("detector: {", "detector: {protected: true, ")
    assert plan(reader)["topic-dropped:image"].refused == "detector reads image, and is protected"
    twice = ROBOT.replace("recorder: {", "other: {publishes: {image: []}}\n  recorder: {")
    assert "2 publishers" in (plan(twice)["topic-delayed:image"].refused or "")


def test_an_emulated_board_has_its_faults_and_another_none() -> None:
    found = plan(board=DrilledBoard(emulated=True))
    off = found["device-off:camera"]
    for kind in ("channel-stuck", "channel-short"):
        assert (found[f"{kind}:camera"].shows, found[f"{kind}:camera"].promise) == (off.shows, "told")
    unplugged = found["device-unplugged:camera"]
    assert found["channel-open:camera"].shows == unplugged.shows  # its relay is on
    for kind in ("late", "split", "mute", "refuse", "garbage", "drop"):
        line = found[f"board-{kind}"]
        assert (line.component, line.shows, line.promise, line.refused) == (None, (), "unseen", None)
    assert "its driver camera_driver" not in (found["board-brown-out"].refused or "")
    assert "computer" in (found["board-brown-out"].refused or "")
    assert "protected" in (found["channel-short:computer"].refused or "")
    assert not any(name.startswith(("board-", "channel-")) for name in plan())


def test_too_little_voltage_takes_all_devices_of_the_board_which_the_model_blames_together() -> None:
    free = ROBOT.replace("  computer: {channel: 9}\n", "").replace("protected_channels: [9]\n", "")
    low = plan(free, board=DrilledBoard(emulated=True))["board-brown-out"]
    assert shows(low) == {"not ok(image)", "not ok(objects)"}
    assert (low.refused, low.promise) == (None, "missed")


def test_a_fault_names_the_remedies_of_the_model_that_mend_what_is_at_fault() -> None:
    text = (
        ROBOT + 'remedies: {reset: {mends: detector}, "set_mode(low)": {mends: [detector, camera_driver]}}\n'
    )
    found = plan(text)
    assert found["node-frozen:detector"].remedies == ("reset(detector)", "set_mode(low)")
    assert found["node-killed:camera_driver"].remedies == ("set_mode(low)",)
    assert found["device-off:camera"].remedies == ()
