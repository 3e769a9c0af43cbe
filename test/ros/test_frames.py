# SPDX-License-Identifier: Apache-2.0
"""Where things are: poses by stamp, the three pose sources, and frames that wait."""

from __future__ import annotations

import re
import sys
from typing import Any

import numpy as np
import pytest
from harness import image_msg, info_msg
from tf_double import Buffer, module

from shadow_tracer.ros.diagnostics import ERROR, WARN, Complaint, Missing, RateMeter, Window
from shadow_tracer.ros.frame_queue import FrameQueue, WaitingFrame
from shadow_tracer.ros.frames import Frames, PoseBuffer, Tf2
from shadow_tracer.ros.parameters import settings_from

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
    with pytest.raises(Missing) as caught:
        frames.at(settings, "camera", 5).frame_to_world(field, "mesh.frame")
    assert re.search(message, caught.value.text)
    assert caught.value.level == ERROR and not caught.value.wait


@pytest.fixture
def tf(monkeypatch: pytest.MonkeyPatch) -> list[Buffer]:
    double, made = module()
    monkeypatch.setitem(sys.modules, "tf2_ros", double)
    return made


def test_tf_is_asked_at_the_stamp_of_the_image(tf: list[Buffer]) -> None:
    node: Any = object()
    frames, settings = frames_for({"fixed_frame": "map", "mesh.frame": "odom"}, lambda: Tf2(node))
    assert frames.has_tf and tf[0].node is node
    with pytest.raises(Missing, match="tf2_echo map camera") as caught:
        frames.at(settings, "camera", 50)
    assert caught.value.wait and caught.value.level == WARN
    tf[0].put("map", "camera", 2.0, until=100)
    with pytest.raises(Missing, match="extrapolation"):
        frames.at(settings, "camera", 101)
    found = frames.at(settings, "camera", 100)
    np.testing.assert_allclose(found.camera_to_world @ [1, 0, 0, 1], [2, 1, 0, 1], atol=1e-15)
    with pytest.raises(Missing, match="'odom' to 'map'"):
        found.frame_to_world("odom", "mesh.frame")
    tf[0].put("map", "odom", 3.0, until=100)
    assert found.frame_to_world("odom", "mesh.frame")[0, 3] == 3.0
    frames.clear()
    assert tf[0].cleared == 1


def test_empty_fixed_frame_with_tf_looks_into_the_camera(tf: list[Buffer]) -> None:
    frames, settings = frames_for({"mesh.frame": "odom"}, lambda: Tf2(object()))  # type: ignore[arg-type]
    tf[0].put("camera", "odom", 4.0, until=100)
    assert frames.at(settings, "camera", 5).frame_to_world("odom", "mesh.frame")[0, 3] == 4.0


def test_transform_that_is_none_is_an_error(tf: list[Buffer]) -> None:
    frames, settings = frames_for({"fixed_frame": "map"}, lambda: Tf2(object()))  # type: ignore[arg-type]
    tf[0].put("map", "camera", float("nan"), until=100)
    with pytest.raises(Missing, match="transform from camera to map: expected finite") as caught:
        frames.at(settings, "camera", 5)
    assert not caught.value.wait


def test_image_without_frame_is_explained(tf: list[Buffer]) -> None:
    frames, settings = frames_for({"fixed_frame": "map"}, lambda: Tf2(object()))  # type: ignore[arg-type]
    with pytest.raises(Missing, match="header.frame_id of the depth image is empty"):
        frames.at(settings, "", 5)


def frame(stamp: int) -> WaitingFrame:
    depth = np.ones((2, 2), np.float32)
    return WaitingFrame(image_msg(depth, stamp), depth, stamp, 0.0)


def test_taking_a_frame_drops_those_before_it() -> None:
    queue = FrameQueue(capacity=3)
    frames = [frame(stamp) for stamp in range(5)]
    for item in frames:
        queue.put(item)
    assert list(queue.newest_first()) == frames[:1:-1] and queue.dropped == 2
    queue.take(frames[3])
    assert list(queue.newest_first()) == [frames[4]] and queue.dropped == 3
    queue.put(frame(9))
    queue.keep_newest()
    assert len(queue) == 1 and queue.dropped == 4
    queue.clear()
    assert len(queue) == 0 and queue.dropped == 5


def test_camera_info_by_stamp_or_the_latest() -> None:
    queue = FrameQueue(infos=3)
    with pytest.raises(Missing, match="no camera_info has arrived"):
        queue.info_for(frame(1), "latest")
    for stamp in (1, 2, 3, 4):
        queue.put_info(info_msg(2, 2, stamp))
    assert queue.info_for(frame(3), "exact").header.stamp.nanosec == 3
    assert queue.info_for(frame(3), "latest").header.stamp.nanosec == 4
    with pytest.raises(Missing, match="camera_info_policy to latest"):
        queue.info_for(frame(1), "exact")


def test_meters() -> None:
    rate = RateMeter()
    assert rate.rate(0.0) == 0.0 and rate.age(0.0) == np.inf
    for k in range(11):
        rate.tick(k * 0.1)
    assert rate.rate(1.0) == pytest.approx(10.0) and rate.age(1.5) == pytest.approx(0.5)
    assert rate.rate(9.0) == 0.0 and rate.count == 11
    complaint = Complaint(remember=2.0)
    assert not complaint.recent(0.0)
    complaint.add("no", 1.0)
    assert complaint.recent(3.0) and not complaint.recent(3.1) and complaint.count == 1
    window = Window()
    assert window.summary() == "-"
    window.add(2.0)
    assert window.summary() == "2.0 / 2.0 / 2.0"
