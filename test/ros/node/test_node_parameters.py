# SPDX-License-Identifier: Apache-2.0
"""Parameters of a running node: what changes the mask at once, what is refused and why."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import probe
import pytest
import test_node_cameras
import test_node_dose
import test_node_ground
import test_node_lights
import test_node_markers
import test_several_cameras
from harness import FOCAL, HEIGHT, SMALL, WIDTH, Rig, info_msg, nanoseconds, plate, wall
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image
from shape_msgs.msg import Mesh
from test_parameters import BAD

from shadow_tracer import available_pipelines
from shadow_tracer.ros.cameras.mask_shape import shadow_grown
from shadow_tracer.ros.diagnostics import DEVICE, ERROR, MESH, OK, PROCESSING, WARN
from shadow_tracer.ros.node.core import StartupError
from shadow_tracer.ros.parameters.parameters import (
    LIGHT_PARAMETERS,
    PARAMETERS,
    ParameterError,
    default_of,
    names_for,
    row_of,
)
from shadow_tracer.ros.wire.cdr import encode_mesh

STANDARD = {"pose_source": "parameter", "tf_timeout": 0.0}


@pytest.fixture(scope="module")
def shared() -> Iterator[Rig]:
    with Rig(STANDARD) as made:
        yield made


@pytest.fixture
def rig(shared: Rig) -> Rig:
    """One node for many tests, with the same parameters and mesh at the start of each."""
    assert shared.set(light_names=["lamp"]) == ""
    start = {**SMALL, **STANDARD}
    names = [name for name in names_for(["lamp"]) if not (row := row_of(name)) or not row.read_only]
    assert shared.set(**{name.replace(".", "__"): start.get(name, default_of(name)) for name in names}) == ""
    shared.until(lambda: shared.node and shared.node.ready)
    shared.send_part("mesh", Mesh, encode_mesh(*plate()))
    shared.connected()
    return shared


DOWN = {"fixed_frame": "map", "camera_pose": [0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0]}  # z of the map is up, x to the right
SUN = {**DOWN, "lights.lamp.type": "sun", "lights.lamp.sun.time": "2026-06-21T12:00:00Z"}
SPHERE = {"lights.lamp.type": "sphere"}
SPOT = {"lights.lamp.type": "spot"}
DEPTH = {"occluders": "depth", "bias.constant": 0.01}
PLAIN: dict[str, Any] = {}

# name, its new value, and what else is set before: the mask is another one afterwards.
CHANGES: list[tuple[str, Any, dict[str, Any]]] = [
    ("fixed_frame", "map", {"mesh.frame": "map"}),
    ("pose_source", "topic", PLAIN),
    ("camera_pose", [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], PLAIN),
    ("camera_pose", [1, 0, 0, 0, 0, 0, 1], PLAIN),
    ("mesh.frame", "camera", {"camera_pose": [0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]}),
    ("mesh.max_age", 1e-6, {"mask.unknown_value": 9}),
    ("mesh.files", ["{plate}"], PLAIN),
    ("mesh.files_scale", 0.5, {"mesh.files": ["{plate}"]}),
    ("occluders", "depth", PLAIN),
    ("occluders", "mesh+depth", PLAIN),
    ("depth_occluder.step", 4, DEPTH),
    ("depth_occluder.max_jump", 1.0, DEPTH),
    ("light_names", ["other", "lamp"], {"lights.lamp.position": [-0.5, 0.5, 0.0]}),
    ("light_names", [""], {"mask.unknown_value": 5}),
    ("bias.constant", 0.9, PLAIN),
    ("bias.constant", 1, PLAIN),
    ("bias.quadratic", 0.1, {"bias.constant": 0.5}),
    ("bias.normal", 0.0, {"bias.constant": 0.5}),
    ("mask.unknown_value", 99, PLAIN),
    ("lights.lamp.type", "directional", PLAIN),
    ("lights.lamp.type", "spot", PLAIN),
    ("lights.lamp.type", "sphere", PLAIN),
    ("lights.lamp.type", "sun", SUN | {"lights.lamp.type": "point"}),
    ("lights.lamp.enabled", False, {"mask.unknown_value": 3}),
    ("lights.lamp.frame", "camera", {"camera_pose": [0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]}),
    ("lights.lamp.position", [0.2, 0.3, 0.0], PLAIN),
    ("lights.lamp.direction", [0.0, 0.2, 1.0], {"lights.lamp.type": "directional"}),
    ("lights.lamp.direction", [-0.3, 0.0, 1.0], SPOT),
    ("lights.lamp.outer_angle", 0.2, SPOT),
    ("lights.lamp.range", 2.1, PLAIN),
    ("lights.lamp.range", 2.1, SPHERE),
    ("lights.lamp.radius", 0.3, SPHERE),
    *[("lights.lamp.type", kind, PLAIN) for kind in ("disc", "rectangle", "tube")],
    ("lights.lamp.axis", [0.0, 1.0, 0.0], {"lights.lamp.type": "tube"}),
    ("lights.lamp.length", 0.5, {"lights.lamp.type": "tube"}),
    ("lights.lamp.size", [0.1, 0.5], {"lights.lamp.type": "rectangle"}),
    ("lights.lamp.two_sided", True, {"lights.lamp.type": "disc", "lights.lamp.direction": [0.0, 0.0, -1.0]}),
    ("lights.lamp.angular_diameter", 0.1, {"lights.lamp.type": "directional"}),
    ("lights.lamp.ignore", ["mesh"], PLAIN),
    ("mesh.cast_no_shadows", ["mesh"], PLAIN),
    ("lights.lamp.sun.latitude", 40.0, SUN),
    ("lights.lamp.sun.longitude", 20.0, SUN),
    ("lights.lamp.sun.time", "2026-06-21T10:00:00Z", SUN),
    ("lights.lamp.sun.time", "", SUN),
]


def corner() -> np.ndarray:
    """A wall with a box before it."""
    depth = wall()
    depth[12:25, 30:43] = 1.7
    return depth


@pytest.fixture
def file(tmp_path: Path) -> str:
    """A mesh that casts."""
    vertices, triangles = plate(x=0.3)
    corners = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in vertices.tolist())
    path = tmp_path / "plate.obj"
    path.write_text(corners + "".join("f {} {} {}\n".format(*(row + 1)) for row in triangles))
    return str(path)


@pytest.mark.parametrize(
    ("name", "value", "given"), CHANGES, ids=[f"{name}={value}".replace(" ", "") for name, value, _ in CHANGES]
)
def test_a_change_shows_in_the_next_mask(rig: Rig, file: str, name: str, value: Any, given: dict[str, Any]) -> None:
    """Set while it runs; and a node that was started so gives the same mask."""
    if given.get("lights.lamp.sun.time") or "sun" in str(value):
        pytest.importorskip("ephem")
    if name.startswith("mesh.files"):
        pytest.importorskip("trimesh")
    given, value = ({key: [file] if v == ["{plate}"] else v for key, v in m.items()} for m in (given, {name: value}))
    if given:
        assert rig.set(**{key.replace(".", "__"): v for key, v in given.items()}) == ""
    if "fixed_frame" in given:
        rig.send_part("mesh", Mesh, encode_mesh(*plate(distance=4.0)))  # below the camera, in the map
    stamp = rig.next_stamp()
    before = rig.trace(corner(), stamp=stamp)
    assert rig.set(**{key.replace(".", "__"): v for key, v in value.items()}) == ""
    after = rig.trace(corner())
    assert not np.array_equal(after, before)
    assert (
        rig.set(**{key.replace(".", "__"): given.get(key, STANDARD.get(key, default_of(key))) for key in value}) == ""
    )
    np.testing.assert_array_equal(rig.trace(corner()), before)


def test_every_parameter_is_shown_to_change_something() -> None:
    shown = {name for name, _, _ in CHANGES} | set(SHOWN_BELOW)
    assert shown == set(names_for(["lamp"], ["rear"]))


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("device", "cpu", "device is read-only: buffers and kernels live on one device"),
        (
            "bounds__max_triangles",
            5,
            "bounds.max_triangles is read-only: device buffers of this size are allocated once",
        ),
        ("bounds__max_rays", 5, "bounds.max_rays is read-only"),
        ("bounds__max_lights", 5, "bounds.max_lights is read-only"),
        ("bounds__queue_capacity", 5, "bounds.queue_capacity is read-only"),
        ("bounds__grid_entries", 5, "bounds.grid_entries is read-only"),
        ("bias__constant", -1.0, "bias.constant: expected double (0 to 1 m), got -1.0"),
        ("bias__constant", math.nan, "bias.constant: expected double (0 to 1 m), got nan"),
        ("bias__constant", "small", "bias.constant: expected double (0 to 1 m), got 'small'"),
        ("mask__unknown_value", 255, "mask.unknown_value: expected integer (0 to 254), got 255"),
        ("pose_source", "gps", "pose_source: expected string (tf, topic, parameter), got 'gps'"),
        ("variant", "float64", "variant: expected one of packed, spherical"),
        ("camera_pose", [0.0], "camera_pose: expected double array (7 numbers)"),
        ("light_names", ["a b"], "light_names: expected names"),
        ("light_names", ["a", "a"], "light_names: expected different names"),
        ("lights__lamp__position", [0.0, math.inf, 0.0], "lights.lamp.position: expected double array (3 numbers [m])"),
        ("lights__lamp__direction", [0.0, 0.0, 0.0], "lights.lamp.direction: expected a length"),
        ("lights__lamp__postion", [0.0, 0.0, 0.0], "did you mean lights.lamp.position?"),
        ("lights__sun__position", [0.0, 0.0, 0.0], "'sun' is not in light_names ['lamp']"),
        ("bias__constnt", 1.0, "did you mean bias.constant?"),
    ],
)
def test_what_is_refused_changes_nothing(rig: Rig, name: str, value: Any, reason: str) -> None:
    before = rig.trace(wall())
    settings = rig.node and rig.node.settings
    assert reason in rig.set(**{name: value})
    assert rig.node and rig.node.settings is settings
    np.testing.assert_array_equal(rig.trace(wall()), before)


def test_every_bad_value_of_the_table_is_refused_while_it_runs(rig: Rig) -> None:
    settings, names = rig.core.settings, set()
    for name, value, _ in BAD:
        if isinstance(value, list) and math.nan in value:
            value = [float(item) for item in value]  # of one type, as all arrays of ROS
        reason = rig.set(**{name.replace(".", "__"): value})
        assert reason.startswith(name), (value, reason)
        assert rig.core.settings is settings
        names.add(name)
    assert names == set(names_for(["lamp"]))
    rig.trace(wall())


def test_several_at_once_are_taken_or_refused_together(rig: Rig) -> None:
    assert "variant" in rig.set(bias__constant=1.0, pipeline="brute_force", variant="refit")
    assert rig.node and rig.node.settings.bias_constant == 0.02 and rig.node.settings.pipeline == "light_grid"
    assert rig.set(bias__constant=1.0, pipeline="brute_force", variant="float64") == ""
    assert rig.node.settings.bias_constant == 1.0


def test_pipelines_can_be_switched_and_give_the_same_mask(rig: Rig) -> None:
    before = rig.trace(wall())
    for pipeline, variant in (
        ("brute_force", ""),
        ("brute_force", "float64"),
        ("mesh_bvh", "rebuild"),
        ("mesh_bvh", ""),
        ("cone_hierarchy", "precise_seatp"),
        ("cone_hierarchy", ""),
        ("light_grid", "spherical"),
        ("light_grid", ""),
    ):
        assert rig.set(pipeline=pipeline, variant=variant) == ""
        np.testing.assert_array_equal(rig.mask_of(rig.send_frame(wall()), timeout=120.0), before)
        full = variant or available_pipelines()[pipeline][0]
        rig.wait_status(DEVICE, OK, f"{pipeline}/{full} on cpu")
    assert rig.value(PROCESSING, "faults") == "0"


def test_front_faces_are_culled_if_asked_for(rig: Rig) -> None:
    """The plate shows the light its back; turned over, its front."""
    vertices, triangles = plate()
    shadow = rig.trace(wall())
    assert rig.set(front_face_culling=True) == ""
    np.testing.assert_array_equal(rig.trace(wall()), shadow)
    rig.send_mesh(vertices, triangles[:, ::-1])
    culled = rig.trace(wall())
    assert (culled == 255).sum() == culled.size - 1 and (shadow == 0).sum() > 100
    assert rig.set(front_face_culling=False) == ""
    np.testing.assert_array_equal(rig.trace(wall()), shadow)


def test_lights_come_and_go(rig: Rig) -> None:
    lamp_only = rig.trace(wall())
    assert rig.set(light_names=["lamp", "sun"]) == ""
    assert rig.node and rig.node.get_parameter("lights.sun.type").value == "point"
    assert rig.set(lights__sun__type="directional", lights__sun__direction=[1, 0, 1]) == ""
    rig.listen_to_light("sun")
    rig.listen_to_light("lamp")
    stamp = rig.send_frame(wall())
    lamp, sun = rig.mask_of(stamp, "lamp"), rig.mask_of(stamp, "sun")
    np.testing.assert_array_equal(lamp, lamp_only)
    np.testing.assert_array_equal(rig.mask_of(stamp), np.maximum(lamp, sun))
    assert not np.array_equal(lamp, sun)
    assert rig.set(light_names=["sun"]) == ""
    assert not rig.node.has_parameter("lights.lamp.type")
    rig.until(lambda: rig.friend.count_publishers("/shadow_tracer/mask/lamp") == 0)
    np.testing.assert_array_equal(rig.trace(wall()), sun)


def test_descriptors_say_what_is_allowed(rig: Rig) -> None:
    assert rig.node
    for name in names_for(["lamp"]):
        descriptor = rig.node.describe_parameter(name)
        assert descriptor.description and not descriptor.dynamic_typing
    bias = rig.node.describe_parameter("bias.constant")
    assert bias.floating_point_range[0].to_value == 1.0 and "m" in bias.additional_constraints
    assert rig.node.describe_parameter("mask.unknown_value").integer_range[0].to_value == 254
    device = rig.node.describe_parameter("device")
    assert device.read_only and "auto, cpu, cuda:N; read-only: buffers" in device.additional_constraints


def test_declared_are_the_parameters_of_the_table_and_no_others() -> None:
    with Rig() as rig:
        assert rig.node
        names = {name for name in rig.node.list_parameters([], 0).names if not name.startswith("qos_overrides.")}
        assert names == {*names_for(["lamp"]), "use_sim_time", "start_type_description_service"}
        assert len(names) == len(PARAMETERS) + len(LIGHT_PARAMETERS) + 2


def test_every_topic_takes_qos_overrides() -> None:
    with Rig() as rig:
        assert rig.node
        names = {
            name.split(".")[1] for name in rig.node.list_parameters([], 0).names if name.startswith("qos_overrides.")
        }
    inputs = {"depth/image_rect", "depth/camera_info", "camera_pose", "query", "shadow_tracer/lights/lamp/pose"}
    inputs |= {"mesh", "mesh_markers", "mesh_marker", "mesh_cloud"}
    outputs = {"mask", "mask/lamp", "light_bits", "overlay", "camera_info", "timing", "query/visibility"}
    outputs |= {"mask/camera_info", "mask/lamp/camera_info", "depth_lit", "depth_shadowed"}
    outputs |= {"scene_markers", "light_markers"}
    topics = {*inputs, *(f"shadow_tracer/{name}" for name in outputs), "diagnostics"}
    assert {name for name in names if name not in ("/tf", "/tf_static")} >= {f"/{topic}" for topic in topics}


def test_integers_and_yaml_style_values_are_taken_at_start() -> None:
    arguments = [
        "-p",
        "bias.constant:=1",
        "-p",
        "lights.lamp.position:=[1, 2, 3]",
        "-p",
        "camera_pose:=[0,0,0,0,0,0,1]",
    ]
    with Rig(arguments=arguments) as rig:
        assert rig.node and rig.node.settings.bias_constant == 1.0
        assert rig.node.settings.lights[0].position == (1.0, 2.0, 3.0)
        assert rig.node.get_parameter("bias.constant").type_ == Parameter.Type.DOUBLE


def test_bad_overrides_are_all_named() -> None:
    with Rig(start=False) as rig, pytest.raises(ParameterError) as caught:
        rig.start({"bias.constant": -1.0, "lights.lamp.type": "laser", "mesh.max_age": "old"})
    assert len(str(caught.value).splitlines()) == 3


def test_misspelt_overrides_are_warned_about(capfd: pytest.CaptureFixture[str]) -> None:
    with Rig({"bias.constnt": 1.0, "lights.lamp.tpye": "spot", "qos_overrides./mesh.subscription.depht": 3}):
        pass
    printed = capfd.readouterr()
    text = printed.out + printed.err
    assert "bias.constnt has no effect" in text and "did you mean bias.constant?" in text
    assert "did you mean lights.lamp.type?" in text
    assert "did you mean qos_overrides./mesh.subscription.depth?" in text


@pytest.mark.slow
def test_diagnostics_period(rig: Rig) -> None:
    rig.settle(0.2)
    assert rig.set(diagnostics_period=1.0) == ""
    rig.settle(0.1)
    count = len(rig.reports)
    rig.settle(0.6)
    assert len(rig.reports) - count <= 1
    rig.until(lambda: len(rig.reports) - count >= 2)


def test_tf_timeout(rig: Rig) -> None:
    assert rig.set(tf_timeout=10.0, camera_info_policy="exact", mask__unknown_value=7) == ""
    stamp = rig.send_frame(wall(), info=False)
    rig.until(lambda: rig.value(PROCESSING, "waiting") == "1")
    count = len(rig.masks[""])
    rig.settle(0.3)
    assert len(rig.masks[""]) == count
    assert rig.set(tf_timeout=0.0) == ""
    assert (rig.mask_of(stamp) == 7).all()


def test_camera_info_policy(rig: Rig) -> None:
    good = rig.trace(wall())
    for policy in ("exact", "latest", "auto"):
        assert rig.set(camera_info_policy=policy) == ""
        found = rig.trace(wall(), info=False)
        np.testing.assert_array_equal(found, np.zeros_like(good) if policy == "exact" else good)
    for focal in (70.0, 80.0):  # a lens that moves
        rig.info.publish(info_msg(WIDTH, HEIGHT, rig.stamp + 1, focal))
    rig.until(lambda: not rig.trace(wall(), info=False).any(), what="the two that differ have arrived")


def test_mask_publish(rig: Rig) -> None:
    sent: list[Any] = []
    rig.core.outputs.cameras[""].bits.publish = sent.append
    rig.trace(wall())
    assert not sent
    assert rig.set(mask__publish="always") == ""
    rig.trace(wall())
    assert len(sent) == 1


def _dark_and_deep() -> np.ndarray:
    depth = wall()
    depth[:3] = np.nan
    return depth


def test_mask_dilate(rig: Rig) -> None:
    rig.send_mesh(*plate())
    plain, known = rig.trace(_dark_and_deep()), np.isfinite(_dark_and_deep())
    assert rig.set(mask__dilate=2, mask__unknown_value=7) == ""
    grown = rig.trace(_dark_and_deep())
    np.testing.assert_array_equal(grown, np.where(known, shadow_grown(plain, known, 2), 7))
    assert 100 < (plain[known] == 0).sum() < (grown[known] == 0).sum()


def _at(rig: Rig, messages: list[Image], stamp: int) -> Image:
    """The message of that stamp."""
    return rig.until(lambda: next((m for m in messages if nanoseconds(m.header.stamp) == stamp), None))


def test_mask_invert(rig: Rig) -> None:
    """All masks, also of what is unknown; what is to be looked at stays."""
    lamp, overlays = rig.listen_to_light("lamp"), rig.collect(Image, "shadow_tracer/overlay")
    stamps, masks = [], []
    for invert in (False, True):
        assert rig.set(mask__invert=invert) == ""
        stamps.append(rig.send_frame(_dark_and_deep()))
        masks.append(rig.mask_of(stamps[-1]))
    np.testing.assert_array_equal(masks[1], 255 - masks[0])
    np.testing.assert_array_equal(np.frombuffer(_at(rig, lamp, stamps[1]).data, np.uint8), masks[1].reshape(-1))
    assert _at(rig, overlays, stamps[0]).data == _at(rig, overlays, stamps[1]).data
    assert rig.set(camera_info_policy="exact") == ""
    assert (rig.trace(_dark_and_deep(), info=False) == 255).all(), "unknown is not lit"


@pytest.mark.parametrize("packed", [False, True])
def test_depth_where_light_reaches_and_where_none_does(rig: Rig, packed: bool) -> None:
    lit, dark = (rig.collect(Image, f"shadow_tracer/depth_{name}") for name in ("lit", "shadowed"))
    image = _dark_and_deep()
    if packed:
        assert rig.set(depth__unit=0.0005) == ""
        image = np.nan_to_num(2000.0 * image).astype(np.uint16)

    def traced() -> tuple[np.ndarray, Image, Image]:
        stamp = rig.send_frame(image)
        return rig.mask_of(stamp), _at(rig, lit, stamp), _at(rig, dark, stamp)

    mask, *messages = traced()
    for message, wanted in zip(messages, (mask == 255, (mask == 0) & np.isfinite(_dark_and_deep())), strict=True):
        assert message.encoding == ("16UC1" if packed else "32FC1") and message.header.frame_id == "camera"
        found = np.frombuffer(message.data, image.dtype).reshape(image.shape)
        assert wanted.sum() > 100 and np.array_equal(found[wanted], image[wanted])
        assert not np.nan_to_num(found[~wanted]).any()
    assert rig.set(mask__dilate=3, mask__invert=True) == ""
    inverted, message, _ = traced()
    found = np.frombuffer(message.data, image.dtype).reshape(image.shape)
    assert np.array_equal(np.nan_to_num(found) > 0, inverted == 0), "inverting is for masks alone"


def test_process(rig: Rig) -> None:
    def answered(count: int) -> int:
        before = len(rig.masks[""])
        stamps = [rig.send_frame(wall()) for _ in range(count)]  # nothing is spun meanwhile
        rig.mask_of(stamps[-1])
        return len(rig.masks[""]) - before

    assert answered(30) < 8
    assert rig.set(process="every") == ""
    rig.connected()
    assert answered(30) == 30


def test_verify_every(rig: Rig) -> None:
    def verified(count: int) -> int:
        before = rig.core.processors[""].verified
        for _ in range(count):
            rig.trace(wall())
        return rig.core.processors[""].verified - before

    assert verified(2) == 0
    assert rig.set(verify_every=2) == ""
    assert verified(4) == 2
    assert rig.set(verify_every=1) == ""
    assert verified(4) == 4


def test_ranges_are_those_of_a_slider_where_one_makes_sense(rig: Rig) -> None:
    """Tools make a slider of each range, which nobody can set a value on if it goes to a million."""
    assert rig.node
    ranges, texts = {}, {}
    for name in names_for(["lamp"]):
        found = rig.node.describe_parameter(name)
        texts[name] = found.additional_constraints
        for given in [*found.floating_point_range, *found.integer_range]:
            ranges[name] = (given.from_value, given.to_value)
    assert {"bias.constant", "bias.quadratic", "tf_timeout", "lights.lamp.outer_angle"} < set(ranges)
    assert ranges["bias.constant"] == (0.0, 1.0) and ranges["mask.unknown_value"] == (0, 254)
    assert all(high - low <= 1000 for low, high in ranges.values()), ranges
    assert not {"lights.lamp.range", "mesh.max_age", "verify_every", "bounds.max_rays", "threads"} & set(ranges)
    assert texts["mesh.max_age"] == "0 to 1000000 s", "the bounds are said all the same"
    assert texts["lights.lamp.position"] == "3 numbers [m]" and texts["camera_pose"] == "7 numbers"
    assert rig.set(mesh__max_age=1e7).startswith("mesh.max_age: expected double (0 to 1000000 s)")


def nested(values: dict[str, Any]) -> dict[str, Any]:
    """The dictionary that `ros2 param dump` makes of full names: a group for each part before a dot."""
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *groups, last = name.split(".")
        place = tree
        for group in groups:
            place = place.setdefault(group, {})
        assert isinstance(place, dict) and last not in place, name
        place[last] = value
    return tree


def plain_values(node: Any) -> dict[str, Any]:
    """Every parameter of a node, as `ros2 param dump` asks for them."""
    values = {}
    for name in node.list_parameters([], 0).names:
        value = node.get_parameter(name).value
        values[name] = value if isinstance(value, (bool, int, float, str)) else list(value)
    return values


@pytest.mark.parametrize("cameras", [{}, {"camera_names": ["front", "rear"], "cameras.rear.rate": 5.0}])
def test_what_param_dump_writes_starts_the_same_node(tmp_path: Path, cameras: dict[str, Any]) -> None:
    """Every parameter that a running node has, those of its QoS included, as nested YAML and back."""
    yaml = pytest.importorskip("yaml")
    given = {**STANDARD, "light_names": ["lamp", "sky"], "lights.sky.type": "directional", "bias.constant": 0.07}
    given |= cameras
    with Rig(given) as rig:
        assert rig.node
        before = plain_values(rig.node)
    path = tmp_path / "dump.yaml"
    path.write_text(yaml.dump({"/shadow_tracer": {"ros__parameters": nested(before)}}))
    assert len(before) > 50 and "light_names" in before and "lights.sky.type" in before
    with Rig(arguments=["--params-file", str(path)]) as rig:
        assert rig.node
        assert plain_values(rig.node) == before
        assert [light.type for light in rig.node.settings.lights] == ["point", "directional"]
        assert [camera.rate for camera in rig.node.settings.cameras] == ([0.0, 5.0] if cameras else [])
        assert rig.core.server.warnings() == []


def test_the_former_name_of_the_list_of_lights(rig: Rig) -> None:
    """Given at the start, and set later: taken, with a warning that says what to write."""
    with Rig({"lights": ["one", "two"], "lights.two.type": "spot"}) as other:
        assert other.node
        assert [light.type for light in other.node.settings.lights] == ["point", "spot"]
        (warning,) = other.core.server.warnings()
        assert "write light_names: [one, two]" in warning
        assert not other.node.has_parameter("lights")
    assert rig.set(lights=["sun"]) == "" and rig.node
    assert [light.name for light in rig.node.settings.lights] == ["sun"]
    assert rig.set(lights=["a"], light_names=["b"]).startswith("lights: expected only light_names")
    assert rig.set(lights=["a", "a"]).startswith("light_names: expected different names")
    assert [light.name for light in rig.node.settings.lights] == ["sun"]
    with Rig(start=False) as other, pytest.raises(ParameterError, match="lights: expected only light_names"):
        other.start({"lights": ["a"], "light_names": ["b"]})


def test_pipeline_and_variant(rig: Rig) -> None:
    for pipeline, variant in (("mesh_bvh", ""), ("mesh_bvh", "rebuild"), ("light_grid", "spherical")):
        assert rig.set(pipeline=pipeline, variant=variant) == ""
        rig.wait_status(DEVICE, OK, f"{pipeline}/{variant or available_pipelines()[pipeline][0]} on cpu")


def test_device() -> None:
    with Rig() as rig:
        rig.wait_status(DEVICE, OK, "on cpu")
    with Rig(start=False) as rig:
        rig.start({"device": "cuda:63"}, wait=False)
        with pytest.raises(StartupError, match=r"device: expected one of .*, or auto"):
            rig.until(lambda: False, 20.0)


def test_threads() -> None:
    for threads in (1, 2):
        with Rig({"threads": threads, "bounds.max_rays": 2 * 16384}) as rig:
            rig.until(lambda expected=str(threads): rig.value(DEVICE, "threads") == expected)
            assert rig.set(threads=3).startswith("threads is read-only")


@pytest.mark.parametrize(
    ("bound", "value", "status", "text"),
    [
        ("max_triangles", 1, MESH, "bounds.max_triangles: the mesh has 2 triangles, the bound is 1"),
        ("max_rays", 64 * 48 - 1, PROCESSING, "bounds.max_rays: the image has 64 x 48 = 3072 pixels"),
    ],
)
def test_bounds_that_refuse(bound: str, value: int, status: str, text: str) -> None:
    with Rig({f"bounds.{bound}": value, "mask.unknown_value": 7}) as rig:
        rig.send_mesh(*plate())
        mask = rig.trace(wall())
        rig.wait_status(status, ERROR, text)
        assert (mask == 7).all()  # what casts shadow is not known if the first mesh is refused


def test_bounds_max_lights() -> None:
    with Rig({"bounds.max_lights": 2}) as rig:
        assert rig.set(light_names=["a", "b"]) == ""
        assert "at most bounds.max_lights = 2 names, got 3" in rig.set(light_names=["a", "b", "c"])


@pytest.mark.parametrize("bound", ["queue_capacity", "grid_entries"])
def test_bounds_that_cost_passes(bound: str) -> None:
    """Less room for what waits: more passes, the same mask, and a warning that names the bound. On the CPU no pair
    waits."""
    # Rays that meet the edges of this plate exactly cannot be decided at once, and wait.
    mesh = plate(half=2.0 * 8.5 / FOCAL)
    masks = []
    for values in ({}, {f"bounds.{bound}": 1}):
        with Rig({"lights.lamp.type": "directional", **values}) as rig:
            rig.send_mesh(*mesh)
            masks.append(rig.trace(wall()))
            rig.until(lambda: rig.value(PROCESSING, "traced") == "1")
            costs = bool(values) and (bound == "grid_entries" or not probe.wide("cpu"))
            assert (int(rig.value(PROCESSING, "overflow passes")) > 0) == costs
            if costs:
                rig.wait_status(PROCESSING, WARN, f"bounds.{bound}")
    np.testing.assert_array_equal(*masks)


SHOWN_BELOW = {
    "front_face_culling": test_front_faces_are_culled_if_asked_for,
    "pipeline": test_pipeline_and_variant,
    "variant": test_pipeline_and_variant,
    "device": test_device,
    "threads": test_threads,
    "tf_timeout": test_tf_timeout,
    "camera_frame": test_node_cameras.test_camera_frame_stands_for_that_of_the_header,
    "depth_image_transport": test_node_cameras.test_the_transport_can_be_changed_while_the_node_runs,
    "depth.unit": test_node_cameras.test_a_unit_gives_the_masks_of_metres,
    "camera_names": test_several_cameras.test_topics_of_cameras_are_under_their_names,
    **{f"cameras.rear.{key}": test for key, test in test_several_cameras.SHOWN.items()},
    "camera_info_policy": test_camera_info_policy,
    "distortion": test_node_cameras.test_distortion,
    "mask.publish": test_mask_publish,
    "mask.dilate": test_mask_dilate,
    "mask.invert": test_mask_invert,
    "markers.max_triangles": test_node_markers.test_markers_max_triangles,
    "process": test_process,
    "verify_every": test_verify_every,
    "diagnostics_period": test_diagnostics_period,
    **{
        f"lights.lamp.{key}": test_node_lights.test_every_parameter_of_a_strength
        for key in ("power", "intensity", "exitance", "irradiance", "model", "output")
    },
    **{
        f"lights.lamp.ies.{key}": test_node_lights.test_a_light_of_an_ies_file
        for key in ("file", "unit", "lumens_per_watt")
    },
    **{
        f"dose.{key}": test_node_dose.test_dose_of_a_part
        for key in ("parts", "target", "goal", "max_edge", "side", "folder")
    },
    "grid_map.layer": test_node_ground.test_a_map_casts_shadow_moves_and_goes,
    **{
        f"grid_map.{key}": test_node_ground.test_shadow_grid_is_what_the_library_says_of_points_over_the_ground
        for key in ("height_above", "dark_value", "period")
    },
    **{
        f"sun_map.{key}": test_node_ground.test_sun_map_counts_hours_of_the_ground_alone
        for key in ("hours", "step", "period")
    },
    "bounds.max_triangles": test_bounds_that_refuse,
    "bounds.max_rays": test_bounds_that_refuse,
    "bounds.max_lights": test_bounds_max_lights,
    "bounds.queue_capacity": test_bounds_that_cost_passes,
    "bounds.grid_entries": test_bounds_that_cost_passes,
}
