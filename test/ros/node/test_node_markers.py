# SPDX-License-Identifier: Apache-2.0
"""~/scene_markers and ~/light_markers of a node: to listeners, late ones too, after changes, with the meshes and lights
that masks are made with."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from harness import Rig, plate, reliable, wall
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from visualization_msgs.msg import Marker, MarkerArray

from shadow_tracer.ros.wire.cdr_markers import DELETE, MarkerMessage, encode_marker
from shadow_tracer.ros.wire.messages import rigid
from shadow_tracer.ros.world import marker_feed
from shadow_tracer.ros.world.marker_feed import NAMELESS

SCENE, LIGHTS = "shadow_tracer/scene_markers", "shadow_tracer/light_markers"
KEPT = DurabilityPolicy.TRANSIENT_LOCAL


def corners(marker: Marker) -> np.ndarray:
    """(N, 3) points of a marker in its frame."""
    p, q = marker.pose.position, marker.pose.orientation
    pose = rigid((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), "pose")
    points = np.array([(point.x, point.y, point.z) for point in marker.points]).reshape(-1, 3)
    return points @ pose[:3, :3].T + pose[:3, 3]


def names(message: MarkerArray) -> dict[tuple[str, int], Marker]:
    """What a viewer that has nothing shows after a message."""
    assert message.markers[0].action == Marker.DELETEALL
    return {(marker.ns, marker.id): marker for marker in message.markers[1:]}


class Viewer:
    """Somebody who comes, listens for what is kept, and leaves."""

    def __init__(self, rig: Rig, topic: str, name: str = "viewer") -> None:
        self._rig = rig
        self.node = Node(name, context=rig.context)
        self.heard: list[MarkerArray] = []
        self.node.create_subscription(MarkerArray, topic, self.heard.append, reliable(10, KEPT))
        rig.executor.add_node(self.node)

    def shows(self, *wanted: tuple[str, int]) -> dict[tuple[str, int], Marker]:
        """Wait until exactly these are shown."""

        def found() -> list[dict[tuple[str, int], Marker]]:
            shown = [names(message) for message in self.heard[-1:]]
            return [markers for markers in shown if set(markers) == set(wanted)]

        return self._rig.until(found, what=f"{wanted} are shown")[0]

    def leave(self) -> None:
        self._rig.executor.remove_node(self.node)
        self.node.destroy_node()


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    monkeypatch.setattr(marker_feed, "PERIOD", 0.05)
    with Rig({"fixed_frame": "camera"}) as made:
        yield made


def arm(x: float = 0.0, **values: Any) -> bytes:
    triangle = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
    return encode_marker(
        MarkerMessage(
            ns="arm", id=3, frame="/tool", frame_locked=True, position=(x, 0, 0), scale=(2, 2, 2), points=triangle,
            **values,
        )
    )  # fmt: skip


def test_late_viewers_see_all_that_casts_and_what_goes_goes(rig: Rig) -> None:
    rig.send_mesh(*plate())
    early = Viewer(rig, SCENE)
    shown = early.shows(("mesh", 0))
    vertices, triangles = plate()
    np.testing.assert_array_equal(corners(shown["mesh", 0]), vertices[triangles].reshape(-1, 3))
    assert shown["mesh", 0].header.frame_id == "camera"
    rig.send_part("mesh_marker", Marker, arm(5.0))
    shown = early.shows(("mesh", 0), ("markers/arm", 3))
    marker = shown["markers/arm", 3]
    assert (marker.header.frame_id, marker.frame_locked, marker.type) == ("tool", True, Marker.TRIANGLE_LIST)
    np.testing.assert_array_equal(corners(marker), [(5, 0, 0), (7, 0, 0), (5, 2, 0)])
    late = Viewer(rig, SCENE, "late")
    rig.until(lambda: late.heard)
    assert set(names(late.heard[0])) == {("mesh", 0), ("markers/arm", 3)}  # in the first message, which was kept
    rig.send_part("mesh_marker", Marker, arm(action=DELETE))
    for viewer in (early, late):
        viewer.shows(("mesh", 0))
    assert rig.set(occluders="depth") == ""
    early.shows()
    assert rig.value("processing", "faults") in ("", "0")


def test_what_was_kept_is_all_also_for_who_comes_while_nothing_is_sent(rig: Rig) -> None:
    """The timers stand still: what arrives is the middleware's doing."""
    rig.send_mesh(*plate())
    rig.send_part("mesh_marker", Marker, arm())
    early = Viewer(rig, SCENE)
    early.shows(("mesh", 0), ("markers/arm", 3))
    for timer in (rig.core._marking, rig.core._drawing):
        timer.cancel()
    Viewer(rig, SCENE, "late").shows(("mesh", 0), ("markers/arm", 3))


def test_nothing_is_drawn_for_nobody_or_for_no_change(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(marker_feed, "PERIOD", 1.0)
    for timer in (rig.core._marking, rig.core._drawing):
        timer.cancel()
    sent: list[bytes] = []
    outputs, now = rig.core.outputs, [1e6]

    def turn(seconds: float) -> None:
        now[0] += seconds
        core = rig.core
        while core.markers.step(core.settings, core.inputs.camera_frame, core.inputs.last_stamp, now[0], 1):
            pass

    publish = outputs.scene_markers.publish
    outputs.scene_markers.publish = lambda data: (sent.append(data), publish(data))
    rig.send_mesh(*plate())
    turn(2.0)
    assert sent == []
    viewer = Viewer(rig, SCENE)
    rig.until(outputs.scene_markers.get_subscription_count)
    turn(2.0)
    assert len(sent) == 1
    for _ in range(5):
        rig.send_mesh(*plate())  # the same again: other arrays, equal numbers
        rig.trace(wall())
        turn(2.0)
    assert len(sent) == 1
    rig.send_mesh(*plate(x=0.1))
    turn(0.5)
    assert len(sent) == 1  # it looks once a second
    turn(0.5)
    assert len(sent) == 2
    rig.send_mesh(*plate(x=0.2))
    turn(0.9)
    assert len(sent) == 2
    turn(0.1)
    assert len(sent) == 3
    viewer.shows(("mesh", 0))


def test_lights_follow_their_parameters(rig: Rig) -> None:
    assert rig.set(light_names=["lamp", "beam"]) == ""
    assert rig.set(lights__beam__type="spot", lights__beam__frame="hand") == ""
    viewer = Viewer(rig, LIGHTS)
    shown = viewer.shows(("lamp", 0), ("lamp", 2), ("beam", 0), ("beam", 1), ("beam", 2))
    assert [shown[name, 0].header.frame_id for name in ("lamp", "beam")] == ["camera", "hand"]
    p = shown["lamp", 0].pose.position
    assert (p.x, p.y, p.z) == (0.5, -0.5, 0.0) and shown["lamp", 2].text == "lamp"
    assert rig.set(lights__lamp__enabled=False) == ""
    rig.until(lambda: names(viewer.heard[-1])["lamp", 2].text == "lamp (off)")
    assert rig.set(light_names=["beam"]) == ""
    viewer.shows(("beam", 0), ("beam", 1), ("beam", 2))


def test_the_first_image_names_a_world_without_parameters_and_without_any_name_it_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(marker_feed, "PERIOD", 0.05)
    with Rig() as rig:
        viewer = Viewer(rig, LIGHTS)
        viewer.shows()
        rig.trace(wall())
        assert viewer.shows(("lamp", 0), ("lamp", 2))["lamp", 0].header.frame_id == "camera"
        said: list[str] = []
        rig.core.markers._warn = said.append
        assert rig.set(pose_source="parameter") == ""
        viewer.shows()
        assert set(said) == {NAMELESS}


def test_markers_max_triangles(rig: Rig) -> None:
    rig.send_mesh(*plate())
    viewer = Viewer(rig, SCENE)
    viewer.shows(("mesh", 0))
    assert rig.set(markers__max_triangles=1) == ""
    shown = viewer.shows(("mesh", 0), ("mesh (text)", 0))
    assert shown["mesh", 0].type == Marker.LINE_LIST and "2 triangles" in shown["mesh (text)", 0].text
    assert rig.set(markers__max_triangles=2) == ""
    assert viewer.shows(("mesh", 0))["mesh", 0].type == Marker.TRIANGLE_LIST


def test_viewers_may_come_and_go(rig: Rig) -> None:
    rig.send_mesh(*plate())
    for k in range(3):
        viewer = Viewer(rig, SCENE, f"viewer{k}")
        viewer.shows(("mesh", 0))
        viewer.leave()
        rig.trace(wall())
    assert rig.value("processing", "faults") in ("", "0")
