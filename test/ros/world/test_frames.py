# SPDX-License-Identifier: Apache-2.0
"""Where things are: poses by stamp, the three pose sources, tf and what of it is kept."""

from __future__ import annotations

import re
import sys
from typing import Any

import numpy as np
import pytest
from tf_double import SECOND, Buffer, module, transform

from shadow_tracer.ros.diagnostics import ERROR, WARN, Missing
from shadow_tracer.ros.parameters.parameters import settings_from
from shadow_tracer.ros.world.frames import STATIC_PERIOD, Frames, PoseBuffer, Poses, Tf2

MS = 1_000_000


def pose(x: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[0, 3] = x
    return matrix


def test_nearest_pose() -> None:
    buffer = PoseBuffer()
    for stamp in (300, 100, 200):
        buffer.add(stamp * MS, pose(stamp))
    assert buffer.nearest(200 * MS, 0.0, False)[0, 3] == 200
    assert buffer.nearest(160 * MS, 0.05, False)[0, 3] == 200
    assert buffer.nearest(140 * MS, 0.05, False)[0, 3] == 100
    assert buffer.nearest(90 * MS, 0.05, False)[0, 3] == 100
    with pytest.raises(Missing, match=r"0\.050 s away") as caught:
        buffer.nearest(150 * MS, 0.04, False)
    assert not caught.value.wait  # a later pose has come: no nearer one will


def test_a_pose_before_the_stamp_is_only_taken_in_the_end() -> None:
    buffer = PoseBuffer()
    buffer.add(300 * MS, pose(3))
    with pytest.raises(Missing) as caught:
        buffer.nearest(320 * MS, 0.05, False)
    assert caught.value.wait
    assert buffer.nearest(320 * MS, 0.05, True)[0, 3] == 3
    with pytest.raises(Missing):
        buffer.nearest(360 * MS, 0.05, True)


def test_pose_without_stamp_holds_always_and_survives_a_time_jump() -> None:
    buffer = PoseBuffer()
    with pytest.raises(Missing, match="no pose has arrived on camera_pose"):
        buffer.nearest(5, 1.0, True)
    buffer.add(100 * MS, pose(1))
    buffer.add(0, pose(2))
    buffer.clear()
    assert buffer.nearest(10**15, 0.0, False)[0, 3] == 2
    buffer.add(100 * MS, pose(3))
    with pytest.raises(Missing):
        buffer.nearest(10**15, 0.0, True)


def test_pose_buffer_is_bounded() -> None:
    buffer = PoseBuffer(capacity=4)
    for stamp in range(1, 50):
        buffer.add(stamp, pose(stamp))
        buffer.add(stamp, pose(stamp))
    assert len(buffer) == 4
    assert buffer.nearest(1, 1.0, True)[0, 3] == 46


def no_tf() -> Any:
    raise ImportError("No module named 'tf2_ros'")


def frames_for(values: dict[str, Any], open_tf: Any = no_tf) -> tuple[Frames, Any]:
    settings = settings_from(values)
    frames = Frames(open_tf)
    frames.configure(settings)
    return frames, settings


def test_empty_fixed_frame_needs_nothing() -> None:
    frames, settings = frames_for({})
    found = frames.at(settings, "camera", 5)
    np.testing.assert_array_equal(found.camera_to_world, np.eye(4))
    np.testing.assert_array_equal(found.frame_to_world("", "mesh.frame"), np.eye(4))
    np.testing.assert_array_equal(found.frame_to_world("camera", "mesh.frame"), np.eye(4))


def test_pose_from_parameter_and_a_light_on_the_camera() -> None:
    frames, settings = frames_for(
        {"pose_source": "parameter", "camera_pose": [1, 2, 3, 0, 0, 0, 1], "fixed_frame": "map"}
    )
    found = frames.at(settings, "camera", 5)
    np.testing.assert_array_equal(found.camera_to_world[:3, 3], (1, 2, 3))
    np.testing.assert_array_equal(found.frame_to_world("camera", "lights.lamp.frame"), found.camera_to_world)
    np.testing.assert_array_equal(found.frame_to_world("map", "mesh.frame"), np.eye(4))


@pytest.mark.parametrize(
    ("values", "field", "message"),
    [
        ({"fixed_frame": "map"}, "", "tf2_ros cannot be imported .* set pose_source to topic or parameter"),
        ({"mesh.frame": "odom"}, "odom", "tf2_ros cannot be imported .* leave mesh.frame empty"),
        ({"mesh.frame": "odom", "pose_source": "parameter"}, "odom", "mesh.frame is 'odom' but fixed_frame is empty"),
    ],
)
def test_without_tf_the_setting_that_helps_is_named(values: dict[str, Any], field: str, message: str) -> None:
    frames, settings = frames_for(values)
    found = frames.at(settings, "camera", 5)
    with pytest.raises(Missing) as caught:
        _ = found.frame_to_world(field, "mesh.frame") if field else found.camera_to_world
    assert re.search(message, caught.value.text)
    assert caught.value.level == ERROR and not caught.value.wait


def test_the_camera_is_only_looked_for_when_it_is_asked_for() -> None:
    frames, settings = frames_for({"pose_source": "topic", "fixed_frame": "map"})
    found = frames.at(settings, "camera", 5)
    np.testing.assert_array_equal(found.frame_to_world("map", "mesh.frame"), np.eye(4))
    with pytest.raises(Missing, match="no pose has arrived"):
        _ = found.camera_to_world
    with pytest.raises(Missing, match="no pose has arrived"):
        found.frame_to_world("camera", "lights.lamp.frame")
    frames.camera_poses.add(5, pose(1))
    assert found.camera_to_world[0, 3] == 1.0


def test_the_camera_at_another_stamp() -> None:
    frames, settings = frames_for({"pose_source": "topic", "fixed_frame": "map", "tf_timeout": 0.0})
    for stamp in (100, 200):
        frames.camera_poses.add(stamp, pose(stamp))
    found = frames.at(settings, "camera", 200)
    assert found.frame_to_world("camera", "header.frame_id", 100)[0, 3] == 100
    assert found.frame_to_world("camera", "header.frame_id")[0, 3] == 200
    with pytest.raises(Missing):
        found.frame_to_world("camera", "header.frame_id", 150)


def test_what_was_found_is_shared_and_cannot_be_changed() -> None:
    asked: list[tuple[str, int | None]] = []

    def lookup(frame: str, field: str, stamp: int | None) -> np.ndarray:
        asked.append((frame, stamp))
        return pose(len(asked))

    found = Poses("map", "camera", lambda stamp: pose(9), lookup)
    first = found.frame_to_world("odom", "one")
    assert found.frame_to_world("odom", "two") is first
    assert found.frame_to_world("odom", "two", 7) is not first
    assert asked == [("odom", None), ("odom", 7)]
    for matrix in (first, found.camera_to_world, found.frame_to_world("map", "one")):
        with pytest.raises(ValueError, match="read-only"):
            matrix[0, 3] = 1.0


class Clock:
    """Steady time that goes when it is told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Tf:
    """A double of tf2_ros, frames that use it, and a clock of their own."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        double, self.made = module()
        monkeypatch.setitem(sys.modules, "tf2_ros", double)
        self.clock = Clock()
        self.node: Any = object()
        self.settings: Any = None

    def frames(self, values: dict[str, Any]) -> Frames:
        self.settings = settings_from(values)
        frames = Frames(lambda: Tf2(self.node), clock=self.clock)
        frames.configure(self.settings)
        return frames

    @property
    def buffer(self) -> Buffer:
        (made,) = self.made
        return made


@pytest.fixture
def tf(monkeypatch: pytest.MonkeyPatch) -> Tf:
    return Tf(monkeypatch)


def test_tf_is_asked_at_the_stamp_of_the_image(tf: Tf) -> None:
    frames = tf.frames({"fixed_frame": "map", "mesh.frame": "odom"})
    assert frames.has_tf and tf.buffer.node is tf.node
    with pytest.raises(Missing, match=r"for the depth image at the stamp .* does not exist.*tf2_echo map camera") as no:
        _ = frames.at(tf.settings, "camera", 50).camera_to_world
    assert no.value.wait and no.value.level == WARN
    tf.buffer.put("map", "camera", 2.0, until=100)
    with pytest.raises(Missing, match="extrapolation into the future"):
        _ = frames.at(tf.settings, "camera", 101).camera_to_world
    found = frames.at(tf.settings, "camera", 100)
    np.testing.assert_allclose(found.camera_to_world @ [1, 0, 0, 1], [2, 1, 0, 1], atol=1e-15)
    with pytest.raises(Missing, match="'odom' to 'map' for mesh.frame at"):
        found.frame_to_world("odom", "mesh.frame")
    tf.buffer.put("map", "odom", 3.0, until=100)
    assert found.frame_to_world("odom", "mesh.frame")[0, 3] == 3.0
    frames.clear()
    assert tf.buffer.cleared == 1
    with pytest.raises(Missing, match="when looking up transform from frame"):
        _ = frames.at(tf.settings, "camera", 100).camera_to_world


def test_between_two_stamps_tf_interpolates(tf: Tf) -> None:
    frames = tf.frames({"fixed_frame": "map"})
    half = np.sqrt(0.5)
    tf.buffer.set_transform(transform("map", "camera", SECOND, (1, 0, 0)), "")
    tf.buffer.set_transform(transform("map", "camera", 2 * SECOND, (3, 4, 0), (0, 0, half, half)), "")
    found = frames.at(tf.settings, "camera", SECOND * 3 // 2).camera_to_world
    np.testing.assert_allclose(found[:3, 3], (2, 2, 0))
    np.testing.assert_allclose(found[:3, 0], (half, half, 0))
    with pytest.raises(Missing, match="into the past"):
        _ = frames.at(tf.settings, "camera", SECOND - 1).camera_to_world


def test_a_transform_that_comes_late(tf: Tf) -> None:
    frames = tf.frames({"fixed_frame": "map"})
    tf.buffer.put("map", "camera", 1.0, until=SECOND)
    stamp = SECOND + 10 * MS
    found = frames.at(tf.settings, "camera", stamp)
    with pytest.raises(Missing, match="into the future") as late:
        _ = found.camera_to_world
    assert late.value.wait
    tf.buffer.put("map", "camera", 2.0, until=stamp)
    assert found.camera_to_world[0, 3] == 2.0


def test_two_trees_are_explained(tf: Tf) -> None:
    frames = tf.frames({"fixed_frame": "map"})
    tf.buffer.put("odom", "camera", 1.0, until=SECOND)
    tf.buffer.put("earth", "map", 1.0, until=SECOND)
    with pytest.raises(Missing, match="not part of the same tree"):
        _ = frames.at(tf.settings, "camera", SECOND).camera_to_world


def test_static_transforms_are_kept_for_a_while(tf: Tf) -> None:
    frames = tf.frames({"fixed_frame": "map"})
    for child, parent in (("camera", "base"), ("base", "map")):
        tf.buffer.set_transform_static(transform(parent, child, 0, (1, 0, 0)), "")

    def x(stamp: int) -> float:
        return float(frames.at(tf.settings, "camera", stamp).camera_to_world[0, 3])

    assert x(5) == 2.0
    asked = tf.buffer.asked
    assert [x(stamp) for stamp in (6, 7 * SECOND, 3)] == [2.0, 2.0, 2.0]
    assert tf.buffer.asked == asked
    tf.buffer.set_transform_static(transform("base", "camera", 0, (5, 0, 0)), "")  # published anew
    assert x(8) == 2.0
    tf.clock.now += STATIC_PERIOD
    assert x(9) == 6.0
    # From then on it moves: what was kept is forgotten, and a stamp that is not known is said.
    tf.buffer.set_transform(transform("base", "camera", SECOND, (7, 0, 0)), "")
    tf.clock.now += STATIC_PERIOD
    with pytest.raises(Missing, match="extrapolation"):
        x(9)
    assert x(SECOND) == 8.0


def test_moving_transforms_are_never_kept(tf: Tf) -> None:
    frames = tf.frames({"fixed_frame": "map"})
    tf.buffer.set_transform_static(transform("base", "camera", 0, (1, 0, 0)), "")
    for k in range(4):
        tf.buffer.set_transform(transform("map", "base", (k + 1) * SECOND, (k, 0, 0)), "")
    for k in (0, 3, 1, 2):
        assert frames.at(tf.settings, "camera", (k + 1) * SECOND).camera_to_world[0, 3] == k + 1.0


def test_after_a_time_jump_static_transforms_are_still_there_and_right(tf: Tf) -> None:
    frames = tf.frames({"fixed_frame": "map", "mesh.frame": "odom"})
    tf.buffer.set_transform_static(transform("map", "camera", 0, (1, 0, 0)), "")
    tf.buffer.put("map", "odom", 4.0, until=SECOND)
    found = frames.at(tf.settings, "camera", SECOND)
    assert (found.camera_to_world[0, 3], found.frame_to_world("odom", "mesh.frame")[0, 3]) == (1.0, 4.0)
    tf.buffer.set_transform_static(transform("map", "camera", 0, (2, 0, 0)), "")  # the simulation starts again
    frames.clear()
    found = frames.at(tf.settings, "camera", SECOND)
    assert found.camera_to_world[0, 3] == 2.0
    with pytest.raises(Missing):
        found.frame_to_world("odom", "mesh.frame")


def test_an_image_without_stamp_does_not_get_the_latest_transform(tf: Tf) -> None:
    frames = tf.frames({"fixed_frame": "map", "mesh.frame": "odom"})
    tf.buffer.put("map", "camera", 1.0, until=SECOND)
    tf.buffer.set_transform_static(transform("map", "odom", 0, (3, 0, 0)), "")
    for stamp in (0, -5 * SECOND):
        found = frames.at(tf.settings, "camera", stamp)
        with pytest.raises(Missing, match=r"header.stamp is -?\d s; set it in the driver") as caught:
            _ = found.camera_to_world
        assert not caught.value.wait
        assert found.frame_to_world("odom", "mesh.frame")[0, 3] == 3.0


def test_the_stamp_of_a_message_is_another(tf: Tf) -> None:
    frames = tf.frames({"fixed_frame": "map"})
    for k in range(3):
        tf.buffer.set_transform(transform("map", "arm", (k + 1) * SECOND, (k, 0, 0)), "")
    found = frames.at(tf.settings, "camera", 3 * SECOND)
    field = "header.frame_id of mesh_markers 'arm' 3"
    assert found.frame_to_world("arm", field, 2 * SECOND)[0, 3] == 1.0
    assert found.frame_to_world("arm", field)[0, 3] == 2.0
    with pytest.raises(Missing, match=f"for {field} at the stamp of its message: .*into the future"):
        found.frame_to_world("arm", field, 4 * SECOND)


def test_tf_is_listened_to_once_a_message_needs_it(tf: Tf) -> None:
    frames = tf.frames({"pose_source": "parameter", "fixed_frame": "map"})
    assert not frames.has_tf and not tf.made
    found = frames.at(tf.settings, "camera", SECOND)
    with pytest.raises(Missing) as caught:
        found.frame_to_world("arm", "header.frame_id of mesh_markers 'arm' 3")
    assert caught.value.wait and frames.has_tf
    tf.buffer.put("map", "arm", 1.0, until=SECOND)
    assert found.frame_to_world("arm", "header.frame_id of mesh_markers 'arm' 3")[0, 3] == 1.0


def test_closed_frames_listen_no_more_and_can_be_opened_again(tf: Tf) -> None:
    frames = tf.frames({"fixed_frame": "map"})
    buffer = tf.buffer
    frames.close()
    assert not frames.has_tf and buffer.node is None
    frames.configure(tf.settings)
    assert frames.has_tf and tf.made[1].node is tf.node


def test_empty_fixed_frame_with_tf_looks_into_the_camera(tf: Tf) -> None:
    frames = tf.frames({"mesh.frame": "odom"})
    tf.buffer.put("camera", "odom", 4.0, until=100)
    assert frames.at(tf.settings, "camera", 5).frame_to_world("odom", "mesh.frame")[0, 3] == 4.0


def test_transform_that_is_none_is_an_error(tf: Tf, monkeypatch: pytest.MonkeyPatch) -> None:
    """tf2 keeps infinite translations."""
    frames = tf.frames({"fixed_frame": "map"})
    tf.buffer.put("map", "camera", float("inf"), until=100)
    with pytest.raises(Missing, match="transform from camera to map: expected finite") as caught:
        _ = frames.at(tf.settings, "camera", 100).camera_to_world
    assert not caught.value.wait


def test_image_without_frame_is_explained(tf: Tf) -> None:
    frames = tf.frames({"fixed_frame": "map"})
    with pytest.raises(Missing, match="header.frame_id of the depth image is empty"):
        _ = frames.at(tf.settings, "", 5).camera_to_world


def test_a_leading_slash_is_left_out(tf: Tf) -> None:
    """tf2 refuses it, though it drops the one of the transforms themselves."""
    frames = tf.frames({"fixed_frame": "map"})
    tf.buffer.put("map", "camera", 1.0, until=100)
    tf.buffer.put("map", "arm", 2.0, until=100)
    poses = frames.at(tf.settings, "/camera", 100)
    assert poses.camera_to_world[0, 3] == 1.0 and poses.frame_to_world("/arm", "a light")[0, 3] == 2.0
