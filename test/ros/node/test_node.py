# SPDX-License-Identifier: Apache-2.0
"""The node in this process: what goes in comes out as the library says, and what is missing is said and never lit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from harness import FOCAL, HEIGHT, WIDTH, Rig, image_msg, info_msg, nanoseconds, plate, wall
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo
from shape_msgs.msg import Mesh

from shadow_tracer import Bias, Bounds, Camera, DirectionalLight, PointLight, ShadowTracer, SpotLight
from shadow_tracer.ros.diagnostics import DEPTH, DEVICE, ERROR, MESH, OK, PROCESSING, TRANSFORMS, WARN
from shadow_tracer.ros.wire.cdr import encode_mesh

UNKNOWN = 77


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig({"mask.unknown_value": UNKNOWN}) as made:
        yield made


def shadow_size(mask: np.ndarray) -> int:
    return int((mask == 0).sum())


def all_unknown(mask: np.ndarray) -> bool:
    return bool((mask == UNKNOWN).all())


def test_without_a_mesh_every_valid_pixel_is_lit_and_diagnostics_warns(rig: Rig) -> None:
    mask = rig.trace(wall())
    assert mask[0, 0] == UNKNOWN
    assert (mask.ravel()[1:] == 255).all()
    status = rig.wait_status(MESH, WARN, "no mesh: every valid pixel is lit")
    assert (
        status.name == "shadow_tracer: input mesh"
        and "/mesh" in status.message
        and status.hardware_id == "shadow_tracer"
    )


def test_masks_are_those_of_the_library() -> None:
    """Three kinds of lights, a camera pose, both depth formats, a mesh that moves and changes: equal bits."""
    half = math.sqrt(0.5)
    parameters = {
        "mask.unknown_value": UNKNOWN,
        "pose_source": "parameter",
        "camera_pose": [0.3, -0.2, 0.1, 0.0, half, 0.0, half],
        "light_names": ["lamp", "spot", "sun"],
        "lights.lamp.position": [0.4, -0.7, 0.3],
        "lights.lamp.range": 2.4,
        "lights.spot.type": "spot",
        "lights.spot.frame": "camera",
        "lights.spot.position": [0.5, -0.1, 0.0],
        "lights.spot.outer_angle": 0.3,
        "lights.sun.type": "directional",
        "lights.sun.direction": [1.0, 0.3, 0.1],
        "bias.constant": 0.01,
        "bias.quadratic": 0.002,
    }
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    pose[:3, 3] = (0.3, -0.2, 0.1)
    tracer = ShadowTracer(device="cpu", bounds=Bounds(max_triangles=4096, max_rays=128 * 96, queue_capacity=16384))
    camera = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, pose)
    lights = [
        PointLight("lamp", (0.4, -0.7, 0.3), range=2.4),
        SpotLight("spot", pose[:3, :3] @ (0.5, -0.1, 0.0) + pose[:3, 3], pose[:3, 2], 0.3),
        DirectionalLight("sun", (1.0, 0.3, 0.1)),
    ]
    rng = np.random.default_rng(5)
    with Rig(parameters) as rig:
        names = [light.name for light in lights]
        for name in names:
            rig.listen_to_light(name)
        seen = set()
        for number in range(8):
            if number % 3 == 0:
                corners = rng.integers(0, 60, (40, 3))
            vertices = rng.uniform(-0.5, 0.5, (60, 3)) + (1.3, -0.2, 0.1)
            depth = (2.0 + 0.1 * rng.random((HEIGHT, WIDTH))).astype(np.float32)
            depth[rng.random(depth.shape) < 0.05] = np.nan
            if number % 2:
                depth = np.nan_to_num(depth * 1000).astype(np.uint16)
            rig.send_mesh(vertices, corners)
            stamp = rig.send_frame(depth)
            tracer.scene.put("mesh", vertices, corners)
            frame = tracer.trace(depth, camera, lights, bias=Bias(0.01, 0.002, 0.6))
            np.testing.assert_array_equal(rig.mask_of(stamp), frame.mask(unknown=UNKNOWN))
            for name in names:
                mask = rig.mask_of(stamp, name)
                np.testing.assert_array_equal(mask, frame.mask(name, unknown=UNKNOWN))
                seen |= {(name, value) for value in np.unique(mask).tolist()}
        assert seen == {(name, value) for name in names for value in (0, UNKNOWN, 255)}
        rig.until(lambda: rig.value(MESH, "deformed") == "5" and rig.value(MESH, "replaced") == "3")


def test_a_plate_casts_a_shadow_that_follows_it(rig: Rig) -> None:
    rig.send_mesh(*plate())
    first = rig.trace(wall())
    # Lamp at x = 0.5, plate at half the distance: its shadow lies around x = -0.5, 15 pixels left of the centre.
    columns = np.flatnonzero((first == 0).any(axis=0))
    assert abs(columns.mean() - (31.5 - 15)) < 1.0
    rig.send_mesh(*plate(x=0.2))
    second = np.flatnonzero((rig.trace(wall()) == 0).any(axis=0))
    assert second.mean() - columns.mean() == pytest.approx(0.4 * FOCAL / 2, abs=1.0)


def test_a_mesh_in_a_moving_frame_moves_without_being_sent_again() -> None:
    parameters = {"pose_source": "parameter", "fixed_frame": "map", "mesh.frame": "camera", "bias.quadratic": 0.0}
    tracer = ShadowTracer(device="cpu", bounds=Bounds(max_triangles=4096, max_rays=128 * 96, queue_capacity=16384))
    masks = []
    with Rig(parameters) as rig:
        rig.send_mesh(*plate())
        for x in (0.0, 0.3, -0.2):
            assert rig.set(camera_pose=[x, 0.1, 0.0, 0.0, 0.0, 0.0, 1.0]) == ""
            pose = np.eye(4)
            pose[:3, 3] = (x, 0.1, 0.0)
            tracer.scene.put("mesh", *plate(), pose=pose)
            camera = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, pose)
            frame = tracer.trace(wall(), camera, [PointLight("lamp", (0.5, -0.5, 0.0))], bias=Bias(0.02, normal=0.6))
            masks.append(rig.trace(wall()))
            np.testing.assert_array_equal(masks[-1], frame.mask())
        rig.until(lambda: rig.value(PROCESSING, "traced") == "3")
        assert (rig.value(MESH, "replaced"), rig.value(MESH, "deformed")) == ("1", "0")
    assert not np.array_equal(masks[0], masks[1]) and not np.array_equal(masks[1], masks[2])


GARBAGE = [
    ("cut", encode_mesh(*plate())[:-1], "need 96 bytes"),
    ("nothing", b"", "header"),
    ("two bytes", b"\x00\x01", "header"),
    ("counts", b"\x00\x01\x00\x00" + b"\xff" * 64, "bounds.max_triangles"),
    ("index", encode_mesh(plate()[0], np.array([(0, 1, 4)])), "out of range"),
    ("nan", encode_mesh(plate()[0] * np.nan, plate()[1]), "not finite"),
    (
        "too large",
        encode_mesh(plate()[0], np.zeros((4097, 3), int)),
        "bounds.max_triangles: the mesh has 4097 triangles",
    ),
]


def test_a_first_mesh_that_is_refused_is_not_called_an_earlier_one(rig: Rig) -> None:
    """There is none that could stay: nothing is known of what it should cover until a good one comes."""
    rig.send_mesh_bytes(GARBAGE[-2][1])
    status = rig.wait_status(MESH, ERROR, "there is no earlier one and masks are unknown")
    assert "not finite" in status.message and status.message.startswith("correct the publisher of /mesh - ")
    assert (rig.trace(wall()) == UNKNOWN).all()
    vertices, triangles = plate()
    rig.send_mesh(np.vstack([vertices, np.full((1, 3), np.nan)]), triangles)  # of no triangle: taken
    assert shadow_size(rig.trace(wall())) > 100
    rig.send_mesh_bytes(GARBAGE[-2][1])
    rig.wait_status(MESH, ERROR, "the last good one stays")
    assert shadow_size(rig.trace(wall())) > 100


def test_garbage_on_the_mesh_topic_leaves_the_last_good_mesh_in_force(rig: Rig) -> None:
    rig.send_mesh(*plate())
    good = rig.trace(wall())
    assert shadow_size(good) > 100
    for number, (name, data, reason) in enumerate(GARBAGE, 1):
        rig.send_mesh_bytes(data)
        status = rig.wait_status(MESH, ERROR, reason)
        assert "the last good one stays" in status.message, name
        assert rig.value(MESH, "refused") == str(number)
        np.testing.assert_array_equal(rig.trace(wall()), good)
    rng = np.random.default_rng(3)
    valid = encode_mesh(*plate())
    for _ in range(200):
        data = bytearray(valid)
        data[int(rng.integers(0, 12))] ^= int(rng.integers(1, 256))
        rig.mesh.publish(bytes(data[: int(rng.integers(4, len(data)))]))
        rig.executor.spin_once(timeout_sec=0.01)
    np.testing.assert_array_equal(rig.trace(wall()), good)
    rig.send_mesh(*plate(x=0.1))
    assert not np.array_equal(rig.trace(wall()), good)
    assert rig.value(PROCESSING, "faults") == "0"


def test_an_empty_mesh_takes_the_shadow_away_and_diagnostics_warns(rig: Rig) -> None:
    rig.send_mesh(*plate())
    assert shadow_size(rig.trace(wall()))
    rig.send_mesh(np.empty((0, 3)), np.empty((0, 3), int))
    assert shadow_size(rig.trace(wall())) == 0
    rig.wait_status(MESH, WARN, "the meshes have no triangles")
    rig.send_mesh(*plate())
    assert shadow_size(rig.trace(wall()))


def test_without_camera_info_the_mask_says_unknown(rig: Rig) -> None:
    rig.send_mesh(*plate())
    assert all_unknown(rig.trace(wall(), info=False))
    rig.wait_status(DEPTH, WARN, "no camera_info has arrived")
    timing = rig.until(lambda: rig.timings and rig.timings[-1]).status[0]
    assert timing.level == WARN and timing.message.startswith("unknown: no camera_info")
    assert rig.set(camera_info_policy="exact") == ""
    rig.trace(wall())
    assert all_unknown(rig.trace(wall(), info=False))
    rig.wait_status(DEPTH, WARN, "set camera_info_policy to auto, or to latest")
    assert rig.set(camera_info_policy="auto") == ""
    assert shadow_size(rig.trace(wall(), info=False))
    rig.wait_status(DEPTH, OK)


def test_one_latched_camera_info_from_before_the_node_will_do() -> None:
    with Rig(start=False) as rig:
        profile = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        rig.friend.destroy_publisher(rig.info)
        rig.info = rig.friend.create_publisher(CameraInfo, "depth/camera_info", profile)
        rig.info.publish(info_msg(WIDTH, HEIGHT, 5))
        rig.start({"mask.unknown_value": UNKNOWN})
        rig.send_mesh(*plate())
        rig.until(lambda: shadow_size(rig.trace(wall(), info=False)) > 100, what="the latched camera_info counts")


def test_camera_info_may_come_after_the_image(rig: Rig) -> None:
    assert rig.set(tf_timeout=5.0) == ""
    stamp = rig.send_frame(wall(), info=False)
    rig.until(lambda: rig.value(PROCESSING, "waiting") == "1")
    rig.info.publish(info_msg(WIDTH, HEIGHT, stamp))
    assert (rig.mask_of(stamp, timeout=3.0).ravel()[1:] == 255).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"k": [0.0] * 9, "p": [0.0] * 12}, "uncalibrated"),
        ({"p": [math.nan] * 12}, "camera_info.p"),
        ({"width": 32}, "camera_info says 32 x 48"),
        ({"binning_x": 3, "width": WIDTH * 2}, "42 x 48 with its region of interest and binning"),
    ],
)
def test_bad_camera_info_makes_the_mask_unknown(rig: Rig, changes: dict[str, Any], message: str) -> None:
    stamp = rig.next_stamp()
    info = info_msg(WIDTH, HEIGHT, stamp)
    for field, value in changes.items():
        setattr(info, field, value)
    rig.info.publish(info)
    rig.depth.publish(image_msg(wall(), stamp))
    assert all_unknown(rig.mask_of(stamp))
    rig.wait_status(DEPTH, ERROR, message)


def test_a_doubtful_region_of_interest_is_a_warning_whatever_the_name(rig: Rig) -> None:
    """The size of camera_info is that of the image, and yet there is an offset: traced as image_geometry has it."""
    stamp = rig.next_stamp()
    info = info_msg(WIDTH, HEIGHT, stamp)
    info.roi.x_offset = 5
    rig.info.publish(info)
    rig.depth.publish(image_msg(wall(), stamp))
    assert (rig.mask_of(stamp).ravel()[1:] == 255).all()
    rig.wait_status(DEPTH, WARN, "camera_info.roi, binning: the image has the full 64 x 48 pixels though")


def test_bad_images_are_refused_and_explained(rig: Rig) -> None:
    for number, change in enumerate(({"encoding": "bgr8"}, {"step": 3}, {"height": 4000}, {"width": 0}), 1):
        msg = image_msg(wall(), rig.next_stamp())
        for name, value in change.items():
            setattr(msg, name, value)
        rig.depth.publish(msg)
        rig.until(lambda count=str(number): rig.value(DEPTH, "refused") == count)
    assert "image refused, width, height" in rig.wait_status(DEPTH, ERROR).message
    assert not rig.masks[""]
    rig.trace(wall())


def test_an_image_beyond_the_bounds_is_unknown(rig: Rig) -> None:
    assert all_unknown(rig.trace(wall(200, 100)))
    rig.wait_status(PROCESSING, ERROR, "bounds.max_rays: the image has 200 x 100")
    assert not all_unknown(rig.trace(wall()))
    rig.wait_status(PROCESSING, OK)


def test_resolution_and_intrinsics_may_change_between_frames(rig: Rig) -> None:
    rig.send_mesh(*plate())
    sizes = []
    for width, height, focal in ((64, 48, 60.0), (128, 96, 120.0), (32, 24, 30.0), (64, 48, 30.0), (1, 1, 1.0)):
        stamp = rig.next_stamp()
        rig.info.publish(info_msg(width, height, stamp, focal))
        rig.depth.publish(image_msg(np.full((height, width), 2.0, np.float32), stamp))
        mask = rig.mask_of(stamp)
        assert mask.shape == (height, width)
        sizes.append(shadow_size(mask))
    assert sizes[1] == pytest.approx(4 * sizes[0], rel=0.1) and sizes[2] == pytest.approx(sizes[0] / 4, rel=0.2)
    assert sizes[3] == 15 * 15  # half the focal length: the whole shadow, 1 m at 2 m, is in the image


def test_always_the_newest_frame_and_dropped_ones_are_counted(rig: Rig) -> None:
    rig.trace(wall())
    stamps = [rig.next_stamp() for _ in range(30)]
    for stamp in stamps:  # nothing spins meanwhile: the burst meets a busy node
        rig.info.publish(info_msg(WIDTH, HEIGHT, stamp))
        rig.depth.publish(image_msg(wall(), stamp))
    rig.mask_of(stamps[-1])
    answered = len(rig.masks[""]) - 1
    assert answered < 5
    rig.until(lambda: rig.value(PROCESSING, "traced") == str(answered + 1))
    missed = int(rig.value(DEPTH, "skipped before the node")) + int(rig.value(PROCESSING, "dropped"))
    assert missed == len(stamps) - answered


@pytest.mark.slow
def test_a_stale_mesh_makes_the_mask_unknown() -> None:
    with Rig({"mask.unknown_value": UNKNOWN, "mesh.max_age": 1.0}) as rig:
        rig.send_mesh(*plate())
        assert shadow_size(rig.trace(wall()))
        rig.until(lambda: float(rig.value(MESH, "age [s]") or 0) > 1.0)
        assert all_unknown(rig.trace(wall()))
        rig.wait_status(MESH, WARN, "set mesh.max_age to 0")
        rig.send_mesh(*plate())
        assert shadow_size(rig.trace(wall()))


def test_without_a_light_the_mask_says_unknown(rig: Rig) -> None:
    assert rig.set(light_names=[""]) == ""
    assert all_unknown(rig.trace(wall()))
    rig.wait_status(PROCESSING, WARN, "no light is enabled")


def test_what_is_published_beside_the_mask(rig: Rig) -> None:
    rig.send_mesh(*plate())
    stamp = rig.send_frame(wall())
    rig.mask_of(stamp)
    timing = rig.until(lambda: rig.timings and rig.timings[-1])
    assert nanoseconds(timing.header.stamp) == stamp
    values = {pair.key: pair.value for pair in timing.status[0].values}
    stages = [key for key in values if key.endswith(" [ms]")]
    for stage in ("decode", "wait", "transforms", "mesh", "trace", "masks", "publish", "total"):
        assert 0.0 <= float(values[f"{stage} [ms]"]) < 10_000.0
    assert any(stage.startswith("trace.") for stage in stages)
    assert (values["rays"], values["triangles"]) == (str(WIDTH * HEIGHT - 1), "2")
    assert timing.status[0].level == OK and timing.status[0].hardware_id == "cpu"
    info = rig.until(lambda: rig.infos and rig.infos[-1])
    assert info == info_msg(WIDTH, HEIGHT, stamp)
    rig.wait_status(MESH, OK)
    names = [status.name for status in rig.reports[-1].status]
    assert names == [f"shadow_tracer: {name}" for name in (DEPTH, MESH, TRANSFORMS, DEVICE, PROCESSING)]
    assert all(status.hardware_id and status.message and len(status.level) == 1 for status in rig.reports[-1].status)


def test_a_mesh_published_before_the_node_came_arrives() -> None:
    with Rig(start=False, latched=True) as rig:
        rig.mesh.publish(encode_mesh(*plate()))
        rig.start()
        rig.wait_status(MESH, OK, "2 triangles")
        assert shadow_size(rig.trace(wall()))


@pytest.mark.slow
def test_durability_follows_all_publishers() -> None:
    """With one volatile publisher a transient local subscription would be deaf to it."""
    with Rig(latched=True) as rig:
        rig.send_mesh(*plate())
        assert rig.node is not None
        subscription = rig.node.core.inputs.subscriptions["mesh"]
        rig.until(lambda: subscription.profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)
        other = rig.friend.create_publisher(Mesh, "mesh", 1)
        rig.until(lambda: other.get_subscription_count(), what="the volatile publisher is heard")
        other.publish(encode_mesh(*plate(x=0.3)))
        rig.until(lambda: rig.value(MESH, "deformed") == "0" and rig.value(MESH, "refused") == "0")
        rig.until(lambda: int(rig.value(MESH, "received")) >= 2)


def test_a_best_effort_mesh_publisher_is_explained_and_the_setting_works() -> None:
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    with Rig() as rig:
        rig.friend.create_publisher(Mesh, "mesh", best_effort)
        status = rig.wait_status(MESH, ERROR, "publishes /mesh best effort")
        setting = status.message[:120].split("-p ")[1].split()[0]
    name, value = setting.split(":=")
    with Rig({name: value}) as rig:
        publisher = rig.friend.create_publisher(Mesh, "mesh", best_effort)
        rig.until(publisher.get_subscription_count)
        publisher.publish(encode_mesh(*plate()))
        rig.wait_status(MESH, OK, "2 triangles")


def test_another_type_on_the_mesh_topic_is_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    with Rig(arguments=["-r", "mesh:=other"], start=False) as rig:
        publisher = rig.friend.create_publisher(PoseStamped, "elsewhere", 1)
        rig.connected = lambda *_: None  # type: ignore[method-assign]
        node = rig.start()
        # The same process refuses two types on one topic, so the subscription is shown another one.
        monkeypatch.setattr(type(node.core.inputs.subscriptions["mesh"]), "topic", publisher.topic_name)
        rig.wait_status(MESH, ERROR, "publishes geometry_msgs/msg/PoseStamped on /elsewhere")
