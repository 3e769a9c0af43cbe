# SPDX-License-Identifier: Apache-2.0
"""process: every answers each image in order, or says that it could not."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
from harness import HEIGHT, WIDTH, Rig, image_msg, info_msg, nanoseconds, plate, wall
from node_world import BIAS, camera, library, library_with_plate
from rclpy.qos import ReliabilityPolicy

from shadow_tracer import PointLight
from shadow_tracer.ros.cameras.frame_queue import FrameQueue
from shadow_tracer.ros.diagnostics import DEPTH, OK, PROCESSING, WARN
from shadow_tracer.ros.node import tracer_host

EVERY = {"process": "every", "tf_timeout": 5.0}


def burst(rig: Rig, count: int, info: bool = True) -> dict[int, np.ndarray]:
    """Send different images without a pause while nothing is spun; depth by stamp."""
    sent = {}
    for number in range(count):
        depth = wall(distance=1.5 + 0.05 * number)
        sent[rig.send_frame(depth, info=info)] = depth
    return sent


def stamps(rig: Rig) -> list[int]:
    """Of all masks, in the order in which they came."""
    return [nanoseconds(msg.header.stamp) for msg in rig.masks[""]]


def subscriptions(rig: Rig) -> list[Any]:
    """QoS of the node's image and camera_info."""
    return [rig.core.inputs.subscriptions[name].profile for name in ("depth", "info")]


def test_each_image_of_a_burst_is_answered_in_order() -> None:
    tracer = library_with_plate()
    lamp = [PointLight("lamp", (0.5, -0.5, 0.0))]
    with Rig(EVERY) as rig:
        rig.send_mesh(*plate())
        assert all(p.reliability == ReliabilityPolicy.RELIABLE and p.depth == 64 for p in subscriptions(rig))
        sent = burst(rig, 40)
        rig.until(lambda: len(rig.masks[""]) >= len(sent))
        assert stamps(rig) == list(sent)
        for stamp, depth in sent.items():
            np.testing.assert_array_equal(rig.mask_of(stamp), tracer.trace(depth, camera(), lamp, bias=BIAS).mask())
        rig.until(lambda: rig.value(PROCESSING, "traced") == "40")
        assert rig.value(PROCESSING, "dropped") == "0" and rig.value(DEPTH, "skipped before the node") == "0"
        rig.wait_status(PROCESSING, OK)


def test_images_are_traced_with_the_meshes_that_came_before_them() -> None:
    """However late they are answered, so that a replay gives the same masks each time."""
    with Rig(EVERY) as rig:
        rig.send_mesh(*plate(x=0.3))
        early = burst(rig, 1, info=False)
        rig.until(lambda: rig.value(PROCESSING, "waiting") == "1")
        rig.send_mesh(*plate(x=-0.3))
        late = burst(rig, 1)
        for stamp in early:
            rig.info.publish(info_msg(WIDTH, HEIGHT, stamp))
        tracer = library()
        lamp = [PointLight("lamp", (0.5, -0.5, 0.0))]
        for x, sent in ((0.3, early), (-0.3, late)):
            tracer.scene.put("mesh", *plate(x=x))
            for stamp, depth in sent.items():
                expected = tracer.trace(depth, camera(), lamp, bias=BIAS).mask()
                assert (expected == 0).sum() > 1
                np.testing.assert_array_equal(rig.mask_of(stamp), expected)


def test_one_that_waits_holds_up_the_others() -> None:
    with Rig({**EVERY, "camera_info_policy": "exact"}) as rig:
        sent = list(burst(rig, 6, info=False))
        for stamp in reversed(sent[1:]):
            rig.info.publish(info_msg(WIDTH, HEIGHT, stamp))
        rig.until(lambda: rig.value(PROCESSING, "waiting") == "6")
        assert not rig.masks[""]
        rig.info.publish(info_msg(WIDTH, HEIGHT, sent[0]))
        rig.until(lambda: len(rig.masks[""]) >= 6)
        assert stamps(rig) == sent
        # One that never gets its camera_info is answered, too, when its time is over: as unknown.
        assert rig.set(tf_timeout=0.0, mask__unknown_value=9) == ""
        lost = rig.send_frame(wall(), info=False)
        good = rig.send_frame(wall())
        assert (rig.mask_of(lost) == 9).all() and (rig.mask_of(good).ravel()[1:] == 255).all()
        assert stamps(rig)[-2:] == [lost, good]


def test_images_that_come_while_kernels_load_are_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = threading.Event()
    warm_up = tracer_host.ShadowTracer.warm_up
    held = lambda self, **what: gate.wait(60.0) and warm_up(self, **what)  # noqa: E731
    monkeypatch.setattr(tracer_host.ShadowTracer, "warm_up", held)
    with Rig(start=False) as rig:
        rig.start(EVERY, wait=False)
        rig.connected()
        sent = list(burst(rig, 20))
        rig.until(lambda: rig.value(PROCESSING, "waiting") == "20")
        rig.wait_status(PROCESSING, OK, "frames wait until kernels are ready")
        gate.set()
        rig.until(lambda: len(rig.masks[""]) >= 20)
        assert stamps(rig) == sent
        gate.clear()
        assert rig.set(pipeline="mesh_bvh") == ""  # and while another pipeline is loaded
        more = list(burst(rig, 10))
        rig.until(lambda: rig.value(PROCESSING, "waiting") == "10")
        gate.set()
        rig.until(lambda: len(rig.masks[""]) >= 30)
        assert stamps(rig) == sent + more


def test_more_than_can_wait_are_dropped_with_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = threading.Event()
    monkeypatch.setattr(tracer_host, "run", lambda *_, **__: gate.wait(60.0) and [])
    monkeypatch.setattr(FrameQueue, "CAPACITY_EVERY", 4)
    with Rig(EVERY) as rig:
        rig.core.host.self_test(lambda _outcome: None)
        sent = list(burst(rig, 10))
        rig.until(lambda: rig.value(PROCESSING, "dropped") == "6")
        gate.set()
        rig.until(lambda: len(rig.masks[""]) >= 4)
        assert stamps(rig) == sent[-4:]
        status = rig.wait_status(PROCESSING, WARN, "6 images were dropped although process is every")
        assert "--rate" in status.message and "shadow_tracer bag" in status.message


def test_back_to_the_newest_only() -> None:
    with Rig(EVERY) as rig:
        first = list(burst(rig, 5))
        rig.until(lambda: len(rig.masks[""]) >= 5)
        assert rig.set(process="latest") == ""
        assert all(p.reliability == ReliabilityPolicy.RELIABLE and p.depth == 1 for p in subscriptions(rig))
        rig.connected()
        sent = list(burst(rig, 30))
        rig.mask_of(sent[-1])
        answered = stamps(rig)[5:]
        assert stamps(rig)[:5] == first and len(answered) < 8 and answered[-1] == sent[-1]
        assert rig.set(process="every") == ""
        rig.connected()
        assert all(p.reliability == ReliabilityPolicy.RELIABLE and p.depth == 64 for p in subscriptions(rig))
        again = list(burst(rig, 20))
        rig.until(lambda: len(rig.masks[""]) >= 5 + len(answered) + 20)
        assert stamps(rig)[-20:] == again


def test_frames_that_wait_are_not_lost_by_switching() -> None:
    with Rig({**EVERY, "process": "latest"}) as rig:
        old = [rig.next_stamp() for _ in range(3)]
        for stamp in old:
            rig.depth.publish(image_msg(wall(), stamp))
            rig.until(lambda: rig.core.inputs.cameras[""].depth.count == old.index(stamp) + 1)  # noqa: B023
        assert rig.set(process="every") == ""
        rig.connected()
        for stamp in old:
            rig.info.publish(info_msg(WIDTH, HEIGHT, stamp))
        rig.until(lambda: len(rig.masks[""]) == 3)
        assert stamps(rig) == old


def test_a_best_effort_camera_is_heard_in_order_too() -> None:
    from harness import reliable
    from sensor_msgs.msg import CameraInfo, Image

    profile = reliable(50)
    profile.reliability = ReliabilityPolicy.BEST_EFFORT
    with Rig(EVERY) as rig:
        rig.friend.destroy_publisher(rig.depth)
        rig.friend.destroy_publisher(rig.info)
        rig.depth = rig.friend.create_publisher(Image, "depth/image_rect", profile)
        rig.info = rig.friend.create_publisher(CameraInfo, "depth/camera_info", profile)
        rig.until(lambda: all(p.reliability == ReliabilityPolicy.BEST_EFFORT for p in subscriptions(rig)))
        rig.connected()
        sent = list(burst(rig, 10))
        rig.until(lambda: len(rig.masks[""]) >= 10)
        assert stamps(rig) == sent
