# SPDX-License-Identifier: Apache-2.0
"""Depth images as cameras send them: packed, in other units, with frames of other names."""

from __future__ import annotations

import numpy as np
import pytest
from compressed_images import compressed_msg
from harness import FOCAL, HEIGHT, SMALL, WIDTH, Rig, image_msg, info_msg, nanoseconds, plate, reliable, wall
from node_world import BIAS
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from shadow_tracer import Bounds, Camera, PointLight, ShadowTracer
from shadow_tracer.ros.cameras.frame_queue import WaitingFrame
from shadow_tracer.ros.diagnostics import DEPTH, ERROR, OK, PROCESSING
from shadow_tracer.ros.node.answer import Answer
from shadow_tracer.ros.wire import messages
from shadow_tracer.ros.wire.compressed_depth import decode
from shadow_tracer.ros.wire.messages import intrinsics
from shadow_tracer.scene.depth_mesh import depth_mesh

PACKED = {"depth_image_transport": "compressedDepth"}
TOPIC = "depth/image_rect/compressedDepth"
RNG = np.random.default_rng(3)
MILLIMETRES = RNG.integers(1500, 2500, (HEIGHT, WIDTH)).astype(np.uint16)
MILLIMETRES[RNG.random(MILLIMETRES.shape) < 0.1] = 0


def library(depth: np.ndarray, camera: Camera | None = None) -> np.ndarray:
    """The mask by the library."""
    tracer = ShadowTracer(device="cpu", bounds=Bounds(max_triangles=64, max_rays=WIDTH * HEIGHT, queue_capacity=4096))
    tracer.scene.put("mesh", *plate())
    camera = camera or Camera(WIDTH, HEIGHT, FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    return tracer.trace(depth, camera, [PointLight("lamp", (0.5, -0.5, 0.0))], bias=BIAS).mask()


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
        infos = rig.core.outputs.cameras[""].infos
        kinds = ("mask", "visibility", "irradiance")
        names = {f"/shadow_tracer/{kind}/{light}camera_info" for kind in kinds for light in ("", "lamp/", "other/")}
        assert {publisher.topic_name for publisher in infos.values()} == names
        for publisher in infos.values():
            publish, name = publisher.publish, publisher.topic_name.removeprefix("/shadow_tracer/")
            publisher.publish = lambda msg, name=name, publish=publish: (sent.append((name, msg)), publish(msg))
        rig.trace(wall())
        assert not sent  # nobody listens
        heard = {name: rig.collect(CameraInfo, f"shadow_tracer/{name}") for name in BESIDE}
        rig.until(lambda: all(infos[key].get_subscription_count() for key in ("mask/", "mask/lamp/")))
        assert rig.set(camera_info_policy="latest") == ""
        old = info_msg(WIDTH, HEIGHT, 17, frame="elsewhere")
        rig.info.publish(old)
        rig.until(lambda: rig.core.inputs.cameras[""].queue._infos._kept.get(17), what="the other camera_info has come")
        stamp = rig.send_frame(wall(), info=False)
        rig.mask_of(stamp)
        rig.until(lambda: all(heard.values()))
        expected = info_msg(WIDTH, HEIGHT, stamp)
        assert all(messages == [expected] for messages in heard.values())
        assert rig.until(lambda: nanoseconds(rig.infos[-1].header.stamp) == stamp and rig.infos[-1]) == expected
        assert rig.set(mask__publish="always", light_names=["other"], lights__other__enabled=True) == ""
        sent.clear()
        rig.trace(wall(), info=False)
        assert set(infos) == {f"{kind}/{light}" for kind in kinds for light in ("", "other/")}
        assert [name for name, _ in sent] == ["mask/camera_info", "mask/other/camera_info"]


FISHEYE = [0.3, 0.1, -0.05, 0.02]
RAW = "/camera/depth/image_raw"


def lens(model: str, d: list[float]) -> Camera:
    """The camera of :func:`send_distorted`."""
    return Camera.distorted(WIDTH, HEIGHT, FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, model, d)


def send_distorted(
    rig: Rig, depth: np.ndarray, model: str, d: list[float], p: float = FOCAL, focal: float = FOCAL
) -> np.ndarray:
    """The mask of a frame whose camera_info has a distortion."""
    stamp = rig.next_stamp()
    info = info_msg(WIDTH, HEIGHT, stamp, focal)
    info.distortion_model, info.d, info.p[0] = model, d, p
    rig.info.publish(info)
    rig.depth.publish(image_msg(depth, stamp))
    return rig.mask_of(stamp)


def test_distortion() -> None:
    """What auto makes of it, and what the user says it is. A P of twice the focal length tells that P is used."""
    pinhole = Camera(WIDTH, HEIGHT, 2 * FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    of_p, of_d = library(MILLIMETRES, pinhole), library(MILLIMETRES, lens("equidistant", FISHEYE))
    assert (of_p != of_d).sum() > 50
    for topic, by_name in (("depth/image_rect", of_p), (RAW, of_d)):
        with Rig(start=False) as rig:
            rig.depth = rig.friend.create_publisher(Image, topic, reliable())
            rig.start({}, ["-r", f"depth/image_rect:={topic}"])
            rig.send_mesh(*plate())
            for value, expected in (("auto", by_name), ("ignore", of_p), ("apply", of_d), ("auto", by_name)):
                assert rig.set(distortion=value) == ""
                mask = send_distorted(rig, MILLIMETRES, "equidistant", FISHEYE, 2 * FOCAL)
                np.testing.assert_array_equal(mask, expected, err_msg=f"{topic}: {value}")
                model = "equidistant" if expected is of_d else "none"
                rig.until(lambda model=model: rig.value(DEPTH, "distortion") == model)
            rig.wait_status(DEPTH, OK)


def test_distortion_of_every_model_and_its_own_surface() -> None:
    """The depth image casts shadow along the same rays; a picture is made, and camera_info is passed on as it came."""
    cases: list[tuple[str, list[float]]] = [
        ("plumb_bob", [-0.2, 0.05, 0.01, -0.002, 0.003]),
        ("rational_polynomial", [5.7, 3.6, 1e-4, -5e-5, 0.19, 6.0, 5.4, 1.0]),
        ("equidistant", FISHEYE),
    ]
    with Rig({"distortion": "apply"}) as rig:
        rig.send_mesh(*plate())
        overlays = rig.collect(Image, "shadow_tracer/overlay")
        masks = []
        for model, d in cases:
            masks.append(send_distorted(rig, MILLIMETRES, model, d))
            np.testing.assert_array_equal(masks[-1], library(MILLIMETRES, lens(model, d)), err_msg=model)
            rig.until(lambda d=d: bool(rig.infos) and list(rig.infos[-1].d) == d)
        assert (masks[0] != masks[1]).any() and (masks[1] != masks[2]).any()
        rig.until(lambda: len(overlays) >= 3)
        assert rig.set(occluders="depth", bias__constant=0.0, bias__quadratic=0.0) == ""
        camera = lens(*cases[1])
        tracer = ShadowTracer(device="cpu", bounds=Bounds(max_triangles=9000, max_rays=WIDTH * HEIGHT))
        tracer.scene.put("depth", *depth_mesh(MILLIMETRES, camera, 2, 0.05))
        expected = tracer.trace(MILLIMETRES, camera, [PointLight("lamp", (0.5, -0.5, 0.0))], bias=0.0).mask()
        np.testing.assert_array_equal(send_distorted(rig, MILLIMETRES, *cases[1]), expected)


def test_pixels_without_a_ray_are_unknown() -> None:
    """In masks and in images of depth."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    known = (np.hypot(u - 31.5, v - 23.5) / 20.0 < 0.5 * np.pi) & (MILLIMETRES > 0)
    assert 1000 < known.sum() < (MILLIMETRES > 0).sum() - 300
    ideal = "equidistant", [0.0] * 4
    with Rig({"distortion": "apply", "mask.unknown_value": 7}) as rig:
        lit = rig.collect(Image, "shadow_tracer/depth_lit")
        assert (send_distorted(rig, MILLIMETRES, *ideal, 20.0, 20.0) == np.where(known, 255, 7)).all()
        rig.until(lambda: bool(lit))
        seen = np.frombuffer(lit[-1].data, np.uint16).reshape(HEIGHT, WIDTH)
        np.testing.assert_array_equal(seen, np.where(known, MILLIMETRES, 0))


def test_distortion_that_cannot_be_undone_gives_an_unknown_mask() -> None:
    with Rig({"distortion": "apply", "mask.unknown_value": 7}) as rig:
        good = send_distorted(rig, MILLIMETRES, "equidistant", FISHEYE)
        for model, d, message in (
            ("fisheye", FISHEYE, "camera_info.distortion_model: expected one of plumb_bob, rational_polynomial, equid"),
            ("plumb_bob", FISHEYE[:3], "camera_info.d: expected 4 or 5 coefficients of plumb_bob, got 3"),
            ("plumb_bob", [-3.0, 0.0, 0.0, 0.0], "camera_info.d: expected coefficients of plumb_bob that give every"),
        ):
            assert (send_distorted(rig, MILLIMETRES, model, d) == 7).all()
            rig.wait_status(DEPTH, ERROR, message)
            np.testing.assert_array_equal(send_distorted(rig, MILLIMETRES, "equidistant", FISHEYE), good)
            rig.wait_status(DEPTH, OK)
        assert rig.value(PROCESSING, "faults") == "0"


def test_an_image_beyond_the_bounds_gets_no_rays() -> None:
    with Rig({"distortion": "apply"}) as rig:
        size = 2 * SMALL["bounds.max_rays"], 1
        before, stamp = messages._ray_table.cache_info().misses, rig.next_stamp()
        info = info_msg(*size, stamp)
        info.distortion_model, info.d = "equidistant", FISHEYE
        rig.info.publish(info)
        rig.depth.publish(image_msg(np.ones(size[::-1], np.float32), stamp))
        assert not rig.mask_of(stamp).any()
        rig.wait_status(PROCESSING, ERROR, "bounds.max_rays")
        assert messages._ray_table.cache_info().misses == before


def test_pixels_without_a_ray_where_no_light_shines() -> None:
    """As at night, when the sun reaches none of them: those that have a ray are dark, the others unknown."""
    info = info_msg(WIDTH, HEIGHT, 1, 20.0)
    info.distortion_model, info.d = "equidistant", [0.0] * 4
    optics = intrinsics(info, WIDTH, HEIGHT, raw=True)
    frame = WaitingFrame(image_msg(MILLIMETRES, 1), MILLIMETRES, 1, 0.0)
    answer = Answer(frame, info, None, ("sun",), ("sun",), (), 7, optics=optics)
    assert optics.rays is not None and 1000 < optics.rays.known.sum() < optics.rays.known.size - 300
    np.testing.assert_array_equal(answer.mask(), np.where(optics.rays.known & (MILLIMETRES > 0), 0, 7))
