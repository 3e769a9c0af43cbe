# SPDX-License-Identifier: Apache-2.0
"""Depth images as cameras send them: packed, in other units, with frames of other names."""

from __future__ import annotations

import numpy as np
import pytest
from compressed_images import compressed_msg
from harness import FOCAL, HEIGHT, SMALL, WIDTH, Rig, info_msg, nanoseconds, plate, wall
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from shadow_tracer import Bias, Bounds, Camera, PointLight, ShadowTracer
from shadow_tracer.ros.compressed_depth import decode
from shadow_tracer.ros.diagnostics import DEPTH, ERROR, OK, PROCESSING

PACKED = {"depth_image_transport": "compressedDepth"}
TOPIC = "depth/image_rect/compressedDepth"
RNG = np.random.default_rng(3)
MILLIMETRES = RNG.integers(1500, 2500, (HEIGHT, WIDTH)).astype(np.uint16)
MILLIMETRES[RNG.random(MILLIMETRES.shape) < 0.1] = 0


def library(depth: np.ndarray) -> np.ndarray:
    """The mask by the library."""
    tracer = ShadowTracer(device="cpu", bounds=Bounds(max_triangles=64, max_rays=WIDTH * HEIGHT, queue_capacity=4096))
    tracer.scene.put("mesh", *plate())
    camera = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    bias = Bias(SMALL.get("bias.constant", 0.02), SMALL.get("bias.quadratic", 0.003))
    return tracer.trace(depth, camera, [PointLight("lamp", (0.5, -0.5, 0.0))], bias=bias).mask()


@pytest.mark.parametrize("codec", ["png", "rvl"])
def test_packed_images_get_the_masks_of_what_is_in_them(codec: str) -> None:
    metres = (MILLIMETRES / 1000.0).astype(np.float32)
    with Rig(PACKED, codec=codec) as rig:
        rig.send_mesh(*plate())
        for depth in (MILLIMETRES, metres):
            msg = compressed_msg(depth, 1, "camera", codec)
            expected = library(decode(msg.format, msg.data))
            assert (expected == 0).sum() > 100
            np.testing.assert_array_equal(rig.trace(depth), expected)
        rig.until(lambda: rig.value(DEPTH, "format") == f"32FC1 {WIDTH} x {HEIGHT}, compressedDepth")
        assert rig.value(DEPTH, "topic") == f"/{TOPIC}"
        rig.wait_status(DEPTH, OK)


def test_damaged_images_are_refused_and_the_next_good_one_is_answered() -> None:
    with Rig(PACKED, codec="png") as rig:
        rig.trace(MILLIMETRES)
        for number, change in enumerate(({"format": "jpeg"}, {"data": b""}, {"data": b"\0" * 40}), 1):
            msg = compressed_msg(MILLIMETRES, rig.next_stamp())
            for name, value in change.items():
                setattr(msg, name, value)
            rig.depth.publish(msg)
            rig.until(lambda count=str(number): rig.value(DEPTH, "refused") == count)
        big = compressed_msg(np.ones((200, 100), np.uint16), rig.next_stamp())
        rig.depth.publish(big)
        rig.wait_status(DEPTH, ERROR, "image refused, data: expected at most bounds.max_rays = ")
        assert rig.value(PROCESSING, "faults") == "0"
        rig.trace(MILLIMETRES)


def test_the_transport_can_be_changed_while_the_node_runs() -> None:
    with Rig() as rig:
        expected = rig.trace(MILLIMETRES)
        for _ in range(2):
            assert rig.set(depth_image_transport="compressedDepth") == ""
            publisher, stamp = rig.publisher(CompressedImage, TOPIC), rig.next_stamp()
            rig.info.publish(info_msg(WIDTH, HEIGHT, stamp))
            publisher.publish(compressed_msg(MILLIMETRES, stamp))
            np.testing.assert_array_equal(rig.mask_of(stamp), expected)
            rig.until(lambda: not rig.depth.get_subscription_count())
            assert rig.set(depth_image_transport="raw") == ""
            rig.connected()
            np.testing.assert_array_equal(rig.trace(MILLIMETRES), expected)


@pytest.mark.parametrize(
    ("remap", "topic"),
    [
        ("depth/image_rect:=/camera/depth", "/camera/depth/compressedDepth"),
        (f"{TOPIC}:=/packed", "/packed"),
        ("__ns:=/front", f"/front/{TOPIC}"),
    ],
)
def test_the_packed_topic_is_beside_the_remapped_one(remap: str, topic: str) -> None:
    with Rig(start=False) as rig:
        rig.start(PACKED, ["-r", remap], wait=False)
        assert rig.core.inputs.topic("depth") == topic


@pytest.mark.parametrize("unit", [0.0001, 0.0002, 0.001, 0.0025])
def test_a_unit_gives_the_masks_of_metres(unit: float) -> None:
    """Same bits as float32(step * unit) in 32FC1; a millimetre is what it was without the parameter."""
    steps = np.clip(MILLIMETRES * 0.001 / unit, 0, 65535).astype(np.uint16)
    metres = (steps.astype(np.float64) * unit).astype(np.float32)
    with Rig({"depth.unit": unit}) as rig:
        rig.send_mesh(*plate())
        expected = library(steps if unit == 0.001 else metres)
        assert (expected == 0).sum() > 100
        np.testing.assert_array_equal(rig.trace(steps), expected)
        np.testing.assert_array_equal(rig.trace(metres), library(metres))  # which has no unit but metres
        assert rig.set(depth__unit=0.003) == ""
        np.testing.assert_array_equal(rig.trace(steps), library((steps.astype(np.float64) * 0.003).astype(np.float32)))


def test_a_unit_holds_for_packed_images_too() -> None:
    steps = (MILLIMETRES * 5.0).astype(np.uint16)
    with Rig({**PACKED, "depth.unit": 0.0002}, codec="rvl") as rig:
        rig.send_mesh(*plate())
        expected = library((steps.astype(np.float64) * 0.0002).astype(np.float32))
        np.testing.assert_array_equal(rig.trace(steps), expected)


def test_camera_frame_stands_for_that_of_the_header() -> None:
    """A driver that names the wrong frame: the light is in the optical frame by its right name."""
    with Rig({"lights.lamp.frame": "optical", "mask.unknown_value": 9}) as rig:
        rig.send_mesh(*plate())
        assert (rig.trace(wall()) == 9).all()
        assert rig.set(camera_frame="optical") == ""
        mask = rig.trace(wall())
        assert (mask == 0).sum() > 100
        assert rig.masks[""][-1].header.frame_id == "camera"  # as it came
        assert rig.set(camera_frame="") == "" and (rig.trace(wall()) == 9).all()


def test_frames_with_a_leading_slash() -> None:
    with Rig({"lights.lamp.frame": "camera"}) as rig:
        rig.send_mesh(*plate())
        expected = rig.trace(wall())
        stamp = rig.send_frame(wall(), frame="/camera")
        found: list[Image] = []
        rig.until(lambda: found.extend(m for m in rig.masks[""] if nanoseconds(m.header.stamp) == stamp) or found)
        np.testing.assert_array_equal(np.frombuffer(found[0].data, np.uint8).reshape(HEIGHT, WIDTH), expected)
        assert found[0].header.frame_id == "/camera"


BESIDE = ("mask/camera_info", "mask/lamp/camera_info")


def test_camera_info_beside_every_mask_is_sent_to_listeners_with_the_header_of_the_mask() -> None:
    with Rig({"light_names": ["lamp", "other"], "lights.other.enabled": False}) as rig:
        sent: list[tuple[str, CameraInfo]] = []
        infos = rig.core.outputs.infos
        names = {f"/shadow_tracer/{name}" for name in (*BESIDE, "mask/other/camera_info")}
        assert {publisher.topic_name for publisher in infos.values()} == names
        for publisher in infos.values():
            publish, name = publisher.publish, publisher.topic_name.removeprefix("/shadow_tracer/")
            publisher.publish = lambda msg, name=name, publish=publish: (sent.append((name, msg)), publish(msg))
        rig.trace(wall())
        assert not sent  # nobody listens
        heard = {name: rig.collect(CameraInfo, f"shadow_tracer/{name}") for name in BESIDE}
        rig.until(lambda: all(infos[key].get_subscription_count() for key in ("", "lamp")))
        assert rig.set(camera_info_policy="latest") == ""
        old = info_msg(WIDTH, HEIGHT, 17, frame="elsewhere")
        rig.info.publish(old)
        rig.until(lambda: rig.core.inputs.queue._infos._kept.get(17), what="the other camera_info has come")
        stamp = rig.send_frame(wall(), info=False)
        rig.mask_of(stamp)
        rig.until(lambda: all(heard.values()))
        expected = info_msg(WIDTH, HEIGHT, stamp)
        assert all(messages == [expected] for messages in heard.values())
        assert rig.until(lambda: nanoseconds(rig.infos[-1].header.stamp) == stamp and rig.infos[-1]) == expected
        assert rig.set(mask__publish="always", light_names=["other"], lights__other__enabled=True) == ""
        sent.clear()
        rig.trace(wall(), info=False)
        assert set(infos) == {"", "other"}
        assert [name for name, _ in sent] == ["mask/camera_info", "mask/other/camera_info"]
