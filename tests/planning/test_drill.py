"""The plan of a drill: what planted faults would show, what is diagnosed then, and what is never planted."""

from __future__ import annotations

import pytest

from robomend.diagnosis.isolability.analysis import isolability
from robomend.model.loading import load_model, load_text
from robomend.planning.drill import FaultKind, PlantableFault, drill_plan
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


def plan(
    text: str = ROBOT, *, without: str = "", board: tuple[int, ...] | None = ()
) -> dict[str, PlantableFault]:
    system = load_text(text)
    assert system.parts is not None
    observed = [atom for atom in system.cnf.atoms if str(atom) not in without.split()]
    guarded = protection(system.parts)
    found = drill_plan(system, system.parts, observed, protected=guarded, board=board)
    return {f"{fault.kind}:{fault.component}": fault for fault in found}


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


def test_a_feeder_takes_what_it_feeds_with_it() -> None:
    off = plan()["device-off:hub"]
    assert shows(off) == {"not on(hub)", "not on(camera)", "not ok(image)", "not ok(objects)"}
    assert off.promise == "told"


def test_where_the_model_cannot_blame_a_device_its_driver_is_blamed() -> None:
    unplugged = plan()["device-unplugged:imu"]
    assert shows(unplugged) == {"not ok(imu_data)"}
    assert (unplugged.promise, unplugged.diagnoses) == ("missed", (("imu_driver",),))


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
    for fault in ("device-off:camera", "device-unplugged:camera", "device-off:hub"):
        assert "its driver camera_driver would have to be restarted" in (found[fault].refused or "")
    assert found["device-unplugged:imu"].refused is None


def test_without_a_board_nothing_is_switched_and_its_own_channels_are_protected() -> None:
    assert "no `board`" in (plan(board=None)["device-off:hub"].refused or "")
    assert plan(board=(2,))["device-off:camera"].refused == "nothing switches it off"
    assert plan(board=(3,))["device-off:camera"].refused is None


@pytest.mark.parametrize("share", [1, 2, 3])
def test_what_is_promised_to_be_told_can_be_told_by_isolability(share: int) -> None:
    system = load_model(str(resource("examples", "tedusar.yaml")))
    assert system.parts is not None
    observed = system.cnf.atoms[::share]
    told = isolability(system.cnf, observed)
    kept = 0
    for fault in drill_plan(system, system.parts, observed, protected={}, board=()):
        row = told.matrix[system.cnf.components.index(fault.component)]
        if fault.promise == "told":
            kept += 1
            assert "-" not in row
        elif fault.promise == "among":
            assert set(row) & {"-", "~"}
    assert kept


def test_every_kind_is_undone_in_words() -> None:
    found = plan()
    assert {fault.kind for fault in found.values()} == set(FaultKind)
    assert all(fault.act and fault.undo for fault in found.values())
