"""Remedies that a graph offers: commented, and right once the comment is taken away."""

from __future__ import annotations

from pathlib import Path

from robomend.model.from_graph import offered_remedies
from robomend_client.agent.executors.base import read_actions
from robomend_client.ros_graph import RosGraph
from robomend_client.yaml_reader import read

GRAPH = RosGraph(
    services={
        "/front/camera/change_state": frozenset({"/front/camera"}),
        "/front/camera/get_state": frozenset({"/front/camera"}),
        "/other/change_state": frozenset({"/other"}),  # no lifecycle: it tells no state
        "/global_costmap/clear_entirely_global_costmap": frozenset({"/global_costmap"}),
        "/laser/reset": frozenset({"/laser"}),  # nobody knows what that does
    }
)


def test_lifecycles_and_costmaps_are_offered_and_nothing_that_nobody_knows() -> None:
    found = offered_remedies(GRAPH)
    assert [one.node for one in found] == ["/front/camera", "/global_costmap"]
    assert all(line.startswith("#") for one in found for line in (one.model, one.action))
    assert found[0].model == "#  bring_up_front_camera: {mends: front/camera}"


def test_an_offered_action_can_be_read_once_somebody_takes_the_comment_away(tmp_path: Path) -> None:
    lines = [one.action.removeprefix("#") for one in offered_remedies(GRAPH)]
    file = tmp_path / "agent.yaml"
    file.write_text("\n".join(("actions:", *lines, "")))
    specs = read_actions(read(file), tmp_path)
    assert [(one.kind, one.make().parameters) for one in specs] == [
        ("lifecycle", (("front/camera",),)),
        ("ros2_service", (("global_costmap",),)),
    ]
