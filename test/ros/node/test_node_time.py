# SPDX-License-Identifier: Apache-2.0
"""The node in this process: camera poses, transforms that come late, and time that jumps back."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from harness import Rig, plate, time_msg, wall
from tf_double import Buffer, module

from shadow_tracer.ros.diagnostics import ERROR, MESH, OK, PROCESSING, TRANSFORMS, WARN

UNKNOWN = 77


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig({"mask.unknown_value": UNKNOWN}) as made:
        yield made


def shadow_size(mask: np.ndarray) -> int:
    return int((mask == 0).sum())


def all_unknown(mask: np.ndarray) -> bool:
    return bool((mask == UNKNOWN).all())


def pose_msg(stamp: int, x: float, frame: str = "map", w: float = 1.0) -> PoseStamped:
    msg = PoseStamped()
    msg.header.stamp, msg.header.frame_id = time_msg(stamp), frame
    msg.pose.position.x = x
    msg.pose.orientation.w = w
    return msg


def test_camera_pose_from_a_topic() -> None:
    with Rig({"mask.unknown_value": UNKNOWN, "pose_source": "topic", "fixed_frame": "map", "tf_timeout": 0.3}) as rig:
        rig.send_mesh(*plate())
        assert all_unknown(rig.trace(wall()))
        rig.wait_status(TRANSFORMS, WARN, "no pose has arrived on camera_pose")
        stamp = rig.next_stamp()
        rig.pose.publish(pose_msg(stamp, 0.0))
        rig.pose.publish(pose_msg(stamp + 1_000_000, 0.1))
        at_zero = rig.trace(wall(), stamp=stamp)
        # The pose of this frame comes after the frame, and the frame waits for it.
        stamp = rig.send_frame(wall())
        rig.settle(0.1)
        rig.pose.publish(pose_msg(stamp, 0.5))
        moved = rig.mask_of(stamp)
        assert shadow_size(at_zero) and not np.array_equal(at_zero, moved)
        rig.pose.publish(pose_msg(stamp + 1, 0.0, frame="odom"))
        rig.wait_status(TRANSFORMS, ERROR, "expected fixed_frame 'map', got 'odom'")
        rig.pose.publish(pose_msg(stamp + 2, 0.0, w=0.0))
        rig.wait_status(TRANSFORMS, ERROR, "unit quaternion")
        # A pose that holds at all times
        rig.pose.publish(pose_msg(0, 0.0, frame=""))
        rig.until(lambda: rig.value(TRANSFORMS, "camera poses kept") == "1")
        np.testing.assert_array_equal(rig.trace(wall(), stamp=rig.next_stamp(10**12)), at_zero)


def test_fixed_frame_without_tf_says_what_to_set() -> None:
    if "tf2_ros" in sys.modules:
        pytest.skip("tf2_ros is installed here")
    with Rig({"mask.unknown_value": UNKNOWN, "fixed_frame": "map"}) as rig:
        rig.wait_status(TRANSFORMS, ERROR, "set pose_source to topic or parameter")
        assert all_unknown(rig.trace(wall()))
        assert rig.set(pose_source="parameter") == ""
        assert not all_unknown(rig.trace(wall()))
        rig.wait_status(TRANSFORMS, OK)


def test_frames_wait_for_tf(monkeypatch: pytest.MonkeyPatch) -> None:
    double, made = module()
    monkeypatch.setitem(sys.modules, "tf2_ros", double)
    parameters = {"mask.unknown_value": UNKNOWN, "fixed_frame": "map", "mesh.frame": "odom", "tf_timeout": 3.0}
    with Rig(parameters) as rig:
        buffer: Buffer = made[0]
        stamps = [rig.send_frame(wall()) for _ in range(3)]
        rig.settle(0.2)
        assert not rig.masks[""]
        buffer.put("map", "camera", 0.0, until=stamps[-1])
        rig.mask_of(stamps[-1], timeout=2.0)
        rig.send_mesh(*plate())
        late = rig.send_frame(wall(), stamps[-1])
        rig.settle(0.1)
        buffer.put("map", "odom", 0.0, until=stamps[-1])
        rig.until(lambda: any(shadow_size(np.frombuffer(m.data, np.uint8)) for m in rig.masks[""]), timeout=2.0)
        assert late == stamps[-1]
        assert rig.set(tf_timeout=0.0) == ""
        assert all_unknown(rig.trace(wall(), stamp=rig.next_stamp(10**9)))
        rig.wait_status(TRANSFORMS, WARN, "extrapolation")


def test_sim_time_that_jumps_back_clears_what_is_old() -> None:
    parameters = {"use_sim_time": True, "mask.unknown_value": UNKNOWN, "mesh.max_age": 5.0, "pose_source": "topic"}
    with Rig(parameters) as rig:
        rig.publish_clock(100.0)
        rig.settle(0.2)
        rig.send_mesh(*plate())
        rig.pose.publish(pose_msg(int(100e9), 0.0))
        rig.until(lambda: rig.value(TRANSFORMS, "camera poses kept") == "1")
        assert shadow_size(rig.trace(wall(), stamp=int(100e9)))
        rig.publish_clock(104.0)
        rig.until(lambda: rig.value(MESH, "age [s]") == "4.00")
        rig.publish_clock(3.0)
        rig.until(lambda: rig.value(PROCESSING, "time jumps back") == "1")
        assert rig.value(TRANSFORMS, "camera poses kept") == "0" and rig.value(MESH, "age [s]") == "0.00"
        rig.pose.publish(pose_msg(int(3e9), 0.0))
        rig.until(lambda: rig.value(TRANSFORMS, "camera poses kept") == "1")
        assert shadow_size(rig.trace(wall(), stamp=int(3e9)))
        assert rig.value(PROCESSING, "faults") == "0"


def printed(rig: Rig) -> list[str]:
    """All values of the last diagnostics and of the last timing."""
    arrays = [rig.reports[-1], rig.timings[-1]]
    return [pair.value for array in arrays for status in array.status for pair in status.values]


def test_use_sim_time_without_a_clock_is_noticed() -> None:
    """With the cure, with no age that nobody knows, and what came before the first /clock is not old after it."""
    with Rig({"use_sim_time": True, "mask.unknown_value": UNKNOWN, "mesh.max_age": 5.0}) as rig:
        status = rig.wait_status(PROCESSING, WARN, "use_sim_time is true and no /clock comes")
        assert "--clock" in status.message[:120]
        rig.send_mesh(*plate())
        assert shadow_size(rig.trace(wall()))
        rig.until(lambda: rig.value(PROCESSING, "traced") == "1")
        assert rig.value(PROCESSING, "age at publication, mean / 95 % / max [ms]") == "-"
        pairs = {pair.key: pair.value for pair in rig.timings[-1].status[0].values}
        assert pairs["age at publication [ms]"] == "-"
        assert not [value for value in printed(rig) if value.startswith("-") and value != "-"]
        rig.publish_clock(1000.0)
        rig.wait_status(PROCESSING, OK, "1 frames traced")
        assert shadow_size(rig.trace(wall()))
        assert float(rig.value(MESH, "age [s]")) < 5.0


def test_images_ahead_of_the_clock_have_no_negative_age() -> None:
    with Rig({"use_sim_time": True}) as rig:
        rig.publish_clock(10.0)
        rig.wait_status(PROCESSING, OK, "ready")
        rig.trace(wall(), stamp=int(11e9))
        rig.until(lambda: rig.value(PROCESSING, "traced") == "1")
        rig.until(lambda: rig.timings)
        assert rig.value(PROCESSING, "age at publication, mean / 95 % / max [ms]") == "0.0 / 0.0 / 0.0"
        assert not [value for value in printed(rig) if value.startswith("-") and value != "-"]


def test_a_change_of_use_sim_time_is_a_jump(rig: Rig) -> None:
    """From the time of the machine to that of a simulation: ages start again, none is negative."""
    rig.send_mesh(*plate())
    assert rig.set(use_sim_time=True, diagnostics_period=1.0) == ""  # no report between this and the first /clock
    rig.publish_clock(50.0)
    rig.until(lambda: rig.value(MESH, "age [s]").startswith("0.0"), what="ages start again")
    rig.wait_status(PROCESSING, OK)
    assert shadow_size(rig.trace(wall()))
    rig.until(lambda: rig.timings)
    assert not [value for value in printed(rig) if value.startswith("-") and value != "-"]


def test_images_that_start_again_earlier_are_a_time_jump(rig: Rig) -> None:
    first = rig.stamp
    rig.trace(wall(), stamp=rig.next_stamp(60 * 10**9))
    rig.trace(wall(), stamp=first)
    rig.until(lambda: rig.value(PROCESSING, "time jumps back") == "1")
    rig.trace(wall(), stamp=first - 10**8)  # a little late is no jump
    rig.settle(0.2)
    assert rig.value(PROCESSING, "time jumps back") == "1"
