# SPDX-License-Identifier: Apache-2.0
"""Masks of a recorded bag: those of the library, every time the same, and without ROS."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("rich")
pytest.importorskip("scipy")
pytest.importorskip("yaml")

from bag_maker import BagMaker, cloud, image, info, pixels, pose, read, transform

from shadow_tracer import (
    Bias,
    Bounds,
    Camera,
    DirectionalLight,
    DiscLight,
    DoseMap,
    PointLight,
    ShadowTracer,
    SpotLight,
    Strength,
)
from shadow_tracer.apps import cli
from shadow_tracer.apps.bag import bag
from shadow_tracer.ros.wire.cdr import encode_mesh
from shadow_tracer.ros.wire.cdr_markers import ADD, TRIANGLE_LIST, MarkerMessage, encode_marker, encode_markers
from shadow_tracer.ros.wire.grid_map import GRID_MAP, GridMap, encode_grid_map
from shadow_tracer.ros.wire.messages import rigid
from shadow_tracer.scene.depth_mesh import depth_mesh
from shadow_tracer.scene.sun import sun_direction

ROOT = Path(__file__).resolve().parents[3]
W, H, FOCAL = 64, 48, 60.0
SECOND = 10**9
UNKNOWN = 77
SMALL = ["device:=cpu", "bounds.max_triangles:=4096", "bounds.max_rays:=12288", "bounds.queue_capacity:=16384"]
BOUNDS = Bounds(max_triangles=4096, max_rays=12288, queue_capacity=16384)
DEPTH, INFO = "/depth/image_rect", "/depth/camera_info"
MESH = "shape_msgs/msg/Mesh"
FORWARD = (0.0, -(0.5**0.5), 0.0, 0.5**0.5)  # turns +x, where light poses point, to +z, where cameras look


def depth_image(seed: int) -> np.ndarray:
    """Something uneven two metres away, with holes."""
    rng = np.random.default_rng(seed)
    depth = (2.0 + 0.1 * rng.random((H, W))).astype(np.float32)
    depth[rng.random(depth.shape) < 0.05] = np.nan
    return depth


def plate(x: float = 0.0, z: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A square across the optical axis, in two triangles."""
    corners = np.array([(-0.25, -0.25, z), (0.25, -0.25, z), (0.25, 0.25, z), (-0.25, 0.25, z)]) + (x, 0, 0)
    return corners, np.array([(0, 1, 2), (0, 2, 3)])


def shifted(*position: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = position
    return matrix


def camera(to_world: np.ndarray) -> Camera:
    return Camera(W, H, FOCAL, FOCAL, (W - 1) / 2, (H - 1) / 2, to_world)


def marker(points: np.ndarray, frame: str, stamp: int, **changes: Any) -> MarkerMessage:
    fields = {
        "ns": "arm", "id": 3, "type": TRIANGLE_LIST, "action": ADD, "frame": frame, "stamp": stamp,
        "position": (0.0, 0.0, 0.0), "orientation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0),
        "color": (1.0, 1.0, 1.0, 1.0), "lifetime": 0, "frame_locked": True, "points": points,
    }  # fmt: skip
    return MarkerMessage(**(fields | changes))


def run(folder: Path, output: Path, *options: str, expect: int = 0) -> dict[str, list[Any]]:
    """The program on a bag; its output by topic."""
    given = [part for value in SMALL for part in ("--param", value)]
    assert cli.main(["bag", str(folder), str(output), *given, *options]) == expect
    return read(output) if expect in (0, 3) else {}


def grid_of(message: Any) -> np.ndarray:
    """(R, C) of a grid map, from the rows along x of an OccupancyGrid."""
    return message.data.reshape(message.info.height, message.info.width).T[::-1, ::-1]


def parameters(**values: Any) -> list[str]:
    """Options for parameters, ``__`` standing for a dot."""
    return [part for name, value in values.items() for part in ("--param", f"{name.replace('__', '.')}:={value}")]


def still_life(**changes: Any) -> BagMaker:
    """A bag of one frame and a mesh; empty fixed_frame, so that no transform is needed."""
    made = BagMaker()
    made.raw("/mesh", MESH, encode_mesh(*plate()))
    made.add(INFO, info(W, H, SECOND, FOCAL))
    made.add(DEPTH, image(depth_image(0), SECOND))
    return made


@pytest.fixture
def drive(tmp_path: Path) -> tuple[Path, list[np.ndarray]]:
    """Six frames of a camera that moves; all that belongs to a frame stands behind it. Returns also the poses."""
    made, poses = BagMaker(), []
    made.add("/tf_static", transform("base", "camera", 0, (0.0, 0.125, 0.0)))
    for k in range(6):
        stamp = 100 * SECOND + k * SECOND // 8
        x = 0.25 * (k - 2)
        made.raw("/mesh", MESH, encode_mesh(plate(0.1 * k)[0], plate()[1]))
        corners = np.array([(0.0, -0.2, 0.8), (0.3, 0.2, 0.8), (-0.3, 0.2, 0.8)]) + (0.0, 0.02 * k, 0.0)
        if k % 2 == 0:
            made.raw("/mesh_marker", "visualization_msgs/msg/Marker", encode_marker(marker(corners, "arm", 0)))
        made.add("/mesh_cloud", cloud(np.float32(corners - (0.5, 0.0, 0.0)), stamp, "odom"))
        made.add("/shadow_tracer/lights/spot/pose", pose(stamp, "camera", (0.3 + 0.01 * k, 0.0, 0.0), FORWARD))
        depth = depth_image(k)
        made.add(DEPTH, image(depth if k % 2 else np.uint16(np.nan_to_num(depth) * 1000), stamp))
        made.add(INFO, info(W, H, stamp, FOCAL))
        for side in (-1, 1):  # known before and after the stamp, never at it
            made.add("/tf", transform("odom", "base", stamp + side * SECOND // 32, (x + 0.125 * side, 0.0, 0.25)))
            made.add("/tf", transform("odom", "arm", stamp + side * SECOND // 32, (0.0, 0.0, 0.25 * k + 0.5 * side)))
        poses.append(shifted(x, 0.125, 0.25))
    return made.write(tmp_path / "drive"), poses


DRIVE = parameters(
    fixed_frame="odom", mask__unknown_value=UNKNOWN, light_names="[lamp, spot]",
    lights__lamp__position="[0.4, -0.7, 0.3]", lights__lamp__range=2.4, lights__spot__type="spot",
    lights__spot__outer_angle=0.3, bias__constant=0.01, bias__quadratic=2e-3,
)  # fmt: skip


def test_masks_are_those_of_the_library(drive: tuple[Path, list[np.ndarray]], tmp_path: Path) -> None:
    folder, poses = drive
    found = run(folder, tmp_path / "out.mcap", *DRIVE)
    tracer = ShadowTracer("brute_force", device="cpu", bounds=BOUNDS)
    sent = read(folder)
    soups = [message.data.view(np.float32).reshape(-1, 3).astype(float) for message in sent["/mesh_cloud"]]
    seen = set()
    for k, to_world in enumerate(poses):
        scene = tracer.scene
        scene.put("mesh", plate(0.1 * k)[0], plate()[1])
        corners = np.array([(0.0, -0.2, 0.8), (0.3, 0.2, 0.8), (-0.3, 0.2, 0.8)]) + (0.0, 0.02 * (k - k % 2), 0.0)
        scene.put("marker", corners, [(0, 1, 2)], pose=shifted(0.0, 0.0, 0.25 * k))
        scene.put("cloud", soups[k], [(0, 1, 2)])
        spot = to_world @ rigid((0.3 + 0.01 * k, 0.0, 0.0), FORWARD, "")
        lights = [PointLight("lamp", (0.4, -0.7, 0.3), range=2.4), SpotLight("spot", spot[:3, 3], spot[:3, 0], 0.3)]
        message = sent[DEPTH][k]
        kind = np.float32 if message.encoding == "32FC1" else np.uint16
        bias = Bias(0.01, 0.002, 0.6)
        frame = tracer.trace(message.data.view(kind).reshape(H, W), camera(to_world), lights, bias=bias)
        for topic, name in (("mask/lamp", "lamp"), ("mask/spot", "spot"), ("mask", None)):
            answer = found[f"/shadow_tracer/{topic}"][k]
            assert repr(answer.header) == repr(message.header) and (answer.encoding, answer.step) == ("mono8", W)
            mask = pixels(answer)
            np.testing.assert_array_equal(mask, frame.mask(name, unknown=UNKNOWN))
            seen |= {(name, value) for value in np.unique(mask).tolist()}
        np.testing.assert_array_equal(pixels(found["/shadow_tracer/light_bits"][k]), frame.bits())
    assert seen == {(name, value) for name in ("lamp", "spot", None) for value in (0, UNKNOWN, 255)}
    assert [repr(m.header) for m in found["/shadow_tracer/camera_info"]] == [repr(m.header) for m in sent[INFO]]
    timing = found["/shadow_tracer/timing"]
    assert len(timing) == 6 and {message.status[0].message for message in timing} == {"traced"}
    assert {"trace [ms]", "rays", "write [ms]"} <= {pair.key for pair in timing[0].status[0].values}


_WITHOUT_ROS = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {blocked!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Blocker())
from shadow_tracer.apps import cli
sys.exit(cli.main({arguments!r}))
"""
_ROS = ("rclpy", "rcl_interfaces", "builtin_interfaces", "sensor_msgs", "shape_msgs", "geometry_msgs", "std_msgs",
        "visualization_msgs", "diagnostic_msgs", "std_srvs", "tf2_ros", "ament_index_python")  # fmt: skip


@pytest.mark.slow
def test_it_needs_no_ros_and_gives_the_same_bytes_twice(drive: tuple[Path, list[np.ndarray]], tmp_path: Path) -> None:
    folder, _ = drive
    files = [tmp_path / name / "out.mcap" for name in ("here", "there")]
    options = [*DRIVE, "--no-timing", *parameters(verify_every=2)]
    run(folder, files[0], *options)
    arguments = ["bag", str(folder), str(files[1]), *(part for value in SMALL for part in ("--param", value)), *options]
    code = _WITHOUT_ROS.format(blocked=_ROS, arguments=arguments)
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH", ""))))
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (
        "6 frames in" in done.stdout
        and "6 traced, 0 unknown" in done.stdout
        and "/shadow_tracer/mask  6" in done.stdout
    )
    assert "3 frames traced by a second pipeline too, 0 pixels differ" in done.stdout
    assert "warning" not in done.stderr
    assert files[0].read_bytes() == files[1].read_bytes()
    assert [path.name for path in (tmp_path / "here").iterdir()] == ["out.mcap"]


def shadow(message: Any) -> int:
    return int((pixels(message) == 0).sum())


def test_what_comes_later_in_the_log_has_no_effect_before(tmp_path: Path) -> None:
    made = BagMaker()
    for k in range(6):
        if k == 1:
            made.raw("/mesh", MESH, encode_mesh(*plate()))
        if k == 2:
            made.add("/shadow_tracer/lights/lamp/pose", pose(0, "camera", (30.0, 0.0, 0.0)))
        if k == 3:
            made.add("/shadow_tracer/lights/lamp/pose", pose(0, "camera", (0.5, -0.5, 0.0)))
            made.raw("/mesh", MESH, encode_mesh(*plate())[:-4])  # refused: the last good one stays
        if k == 4:
            made.raw("/mesh", MESH, encode_mesh(np.empty((0, 3)), np.empty((0, 3), int)))
            short = marker(plate()[0][[0, 1, 2]], "camera", 0, lifetime=3_500_000)  # until the next frame but one
            made.raw("/mesh_markers", "visualization_msgs/msg/MarkerArray", encode_markers([short]))
        made.add(INFO, info(W, H, SECOND + k, FOCAL))
        made.add(DEPTH, image(np.full((H, W), 2.0, np.float32), SECOND + k))
    found = run(made.write(tmp_path / "in"), tmp_path / "out")
    sizes = [shadow(message) for message in found["/shadow_tracer/mask"]]
    assert sizes[0] == 0 and sizes[1] > 100 and sizes[2] == 0 and sizes[3] == sizes[1]
    assert 0 < sizes[4] < sizes[1] and sizes[5] == 0
    assert (tmp_path / "out" / "metadata.yaml").exists()  # a folder was asked for


def test_a_static_transform_that_changes(tmp_path: Path) -> None:
    made = BagMaker()
    depth = np.full((H, W), 2.0, np.float32)
    made.add(DEPTH, image(depth, SECOND))
    made.add("/tf_static", transform("map", "camera", 0, (0.0, 0.0, 0.0)))
    made.add("/tf_static", transform("map", "camera", 0, (0.5, 0.0, 0.0)))
    made.add(DEPTH, image(depth, SECOND + 1))
    for k in range(2):
        made.add(INFO, info(W, H, SECOND + k, FOCAL))
    options = parameters(fixed_frame="map", mesh__files=f"[{tmp_path / 'plate.obj'}]")
    vertices, triangles = plate()
    pytest.importorskip("trimesh").Trimesh(vertices, triangles).export(tmp_path / "plate.obj")
    found = run(made.write(tmp_path / "in"), tmp_path / "out.mcap", *options)["/shadow_tracer/mask"]
    edges = [np.flatnonzero((pixels(message) == 0).any(axis=0)).max() for message in found]
    assert edges[0] - edges[1] == pytest.approx(0.5 * FOCAL / 2, abs=1.0)


def test_what_mesh_files_hold_besides_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plate.obj"
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nl 1 2\n")
    run(still_life().write(tmp_path / "in"), tmp_path / "out.mcap", *parameters(mesh__files=f"[{file}]"))
    assert f"warning: {file}: left out, as it casts no shadow: lines (1)\n" in capsys.readouterr().err


def test_poses_from_a_topic_and_the_latest_camera_info(tmp_path: Path) -> None:
    made = BagMaker()
    made.raw("/mesh", MESH, encode_mesh(*plate()))
    for k in range(3):
        made.add(DEPTH, image(np.full((H, W), 2.0, np.float32), (k + 1) * SECOND))
    made.add(INFO, info(W, H, 5, FOCAL))
    for k, x in ((2, 0.5), (0, 0.0), (1, 0.25)):
        made.add("/camera_pose", pose((k + 1) * SECOND + 10**7, "map", (x, 0.0, 0.0)))
    made.add("/camera_pose", pose(SECOND, "elsewhere", (9.0, 0.0, 0.0)))
    options = parameters(fixed_frame="map", pose_source="topic", camera_info_policy="latest")
    found = run(made.write(tmp_path / "in"), tmp_path / "out.mcap", *options)["/shadow_tracer/mask"]
    edges = [np.flatnonzero((pixels(message) == 0).any(axis=0)).max() for message in found]
    np.testing.assert_allclose(np.diff(edges), -0.25 * FOCAL / 2, atol=1.0)


def test_slashes_units_and_another_camera_frame(tmp_path: Path) -> None:
    """Frames with a leading slash are found in tf; steps of a fifth of a millimetre give the masks of metres."""
    metres = depth_image(1)
    steps = np.uint16(np.nan_to_num(metres) / 0.0002)
    options = parameters(fixed_frame="map", depth__unit=0.0002)
    masks = []
    for name, depth, slash, frame in (
        ("plain", np.float32(steps * 0.0002), "", "camera"),
        ("slash", steps, "/", "camera"),
        ("named", steps, "/", "x"),
    ):
        made = BagMaker()
        made.raw("/mesh", MESH, encode_mesh(*plate()))
        made.add("/tf_static", transform(f"{slash}map", f"{slash}camera", 0, (0.25, 0.0, 0.0)))
        made.add(INFO, info(W, H, SECOND, FOCAL))
        made.add(DEPTH, image(depth, SECOND, f"{slash}{frame}"))
        named = parameters(camera_frame="camera") if frame == "x" else []
        found = run(made.write(tmp_path / name), tmp_path / f"{name}.mcap", *options, *named)
        masks.append(pixels(found["/shadow_tracer/mask"][0]))
    assert (masks[0] == 0).sum() > 100 and (masks[0] == 255).sum() > 100
    for mask in masks[1:]:
        np.testing.assert_array_equal(mask, masks[0])


@pytest.mark.parametrize(
    ("topic", "distortion", "raw", "ros1"),
    [
        (DEPTH, "auto", False, False),
        ("/camera/image_raw", "auto", True, False),
        ("/camera/image_raw", "auto", True, True),
        (DEPTH, "apply", True, False),
        ("/camera/image_raw", "ignore", False, False),
    ],
)
def test_distortion(tmp_path: Path, topic: str, distortion: str, raw: bool, ros1: bool) -> None:
    """The library's masks along rays of K and D, or of P; the depth image itself casts shadow along the same."""
    model, d = "equidistant", [0.3, 0.1, -0.05, 0.02]
    message = info(W, H, SECOND, FOCAL)
    message.distortion_model, message.d, message.p[0] = model, np.array(d), 2 * FOCAL
    made = BagMaker()
    made.add(INFO, message)
    made.add(topic, image(depth_image(0), SECOND))
    centre = (W - 1) / 2, (H - 1) / 2
    options = parameters(distortion=distortion, occluders="depth", bias__constant=0.0, bias__quadratic=0.0)
    remap = ["--remap", f"depth/image_rect:={topic}"]
    bag = made.write_ros1(tmp_path / "in.bag") if ros1 else made.write(tmp_path / "in")
    found = run(bag, tmp_path / "out.mcap", *options, *remap)["/shadow_tracer/mask"]
    seen = Camera.distorted(W, H, FOCAL, FOCAL, *centre, model, d) if raw else Camera(W, H, 2 * FOCAL, FOCAL, *centre)
    tracer = ShadowTracer(device="cpu", bounds=BOUNDS)
    tracer.scene.put("depth", *depth_mesh(depth_image(0), seen, 2, 0.05))
    expected = tracer.trace(depth_image(0), seen, [PointLight("lamp", (0.5, -0.5, 0.0))], bias=0.0).mask()
    assert (expected == 0).sum() > 300 and (expected == 255).sum() > 100
    np.testing.assert_array_equal(pixels(found[0]), expected)


def test_one_camera_info_for_all_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Latched, it stands in the bag once, with a stamp of its own, and the images may start again after the last."""
    made = BagMaker()
    made.add(INFO, info(W, H, 5, FOCAL))
    made.raw("/mesh", MESH, encode_mesh(*plate()))
    for k in (1, 2, 3, 1, 2):
        made.add(DEPTH, image(np.full((H, W), 2.0, np.float32), 10 * k * SECOND))
    folder = made.write(tmp_path / "in")
    for policy, known in (("auto", True), ("latest", True), ("exact", False)):
        given, status = parameters(camera_info_policy=policy), 0 if known else 3
        found = run(folder, tmp_path / f"{policy}.mcap", *given, expect=status)
        masks = [pixels(message) for message in found["/shadow_tracer/mask"]]
        assert len(masks) == 5 and all(bool((mask == 255).any()) == known for mask in masks), policy
        err = capsys.readouterr().err
        assert ("no camera_info has the stamp of the image (the last one differs by -" in err) == (not known)
        assert "no camera_info has arrived" not in err


def test_what_is_missing_is_unknown_and_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = still_life()
    made.add(DEPTH, image(depth_image(1), 3 * SECOND))
    made.add("/tf", transform("map", "camera", SECOND, (0.0, 0.0, 0.0)))
    made.add("/tf", transform("map", "map", SECOND, (0.0, 0.0, 0.0)))
    made.raw("/mesh", MESH, b"\x00\x01")
    made.raw(DEPTH, "sensor_msgs/msg/Image", b"\x00\x01\x00\x00\xff")
    made.add(DEPTH, image(depth_image(1), 0))
    options = parameters(fixed_frame="map", mask__unknown_value=UNKNOWN, camera_info_policy="exact", bias__constnt=1.0)
    found = run(made.write(tmp_path / "in"), tmp_path / "out.mcap", *options)["/shadow_tracer/mask"]
    assert [bool((pixels(message) == UNKNOWN).all()) for message in found] == [False, True, True]
    out, err = capsys.readouterr()
    assert "3 frames" in out and "1 traced, 2 unknown" in out
    for text in (
        "bias.constnt has no effect: there is no such parameter; did you mean bias.constant?",
        "unknown, 2 times: no camera_info has the stamp of the image",
        "tf: 1 messages were refused, the last one because of child_frame_id",
        "mesh: 1 messages were refused, the last one because of header",
        "depth: 1 messages were refused, the last one because of message: not a sensor_msgs/msg/Image",
        "the images start again 1 times",
    ):
        assert text in err


def test_queries_overlay_and_copies(tmp_path: Path) -> None:
    made = still_life()
    points = np.array([(0.5, 0.5, 2.0), (-0.5, 0.5, 2.0), (0.0, 0.0, np.nan)])
    made.add("/query", cloud(points, SECOND, "camera"))
    made.raw("/shadow_tracer/mask", "sensor_msgs/msg/Image", b"an old one")
    folder = made.write(tmp_path / "in")
    found = run(folder, tmp_path / "out.mcap", "--overlay", "--copy")
    (reply,) = found["/shadow_tracer/query/visibility"]
    rows = reply.data.reshape(3, 20)
    assert rows[:, 16].tolist() == [1, 1, 0] and rows[:, 12].tolist() == [1, 0, 0]
    assert pixels(found["/shadow_tracer/overlay"][0]).shape == (H, W, 3)
    assert len(found["/shadow_tracer/mask"]) == 1
    np.testing.assert_array_equal(found[DEPTH][0].data, read_one(folder, DEPTH).data)
    assert found["/mesh"][0].vertices[2].x == 0.25
    # and what was written can be read by the program itself
    again = run(tmp_path / "out.mcap", tmp_path / "again.mcap")
    np.testing.assert_array_equal(pixels(again["/shadow_tracer/mask"][0]), pixels(found["/shadow_tracer/mask"][0]))
    assert "/shadow_tracer/overlay" not in again


def test_queries_about_cones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same bits as those of the node; a query with a wrong field is refused by its name."""
    made, points = still_life(), np.array([(0.5, 0.5, 2.0), (-0.5, 0.5, 2.0), (-0.5, 0.5, 0.1)])
    narrow, wrong = (
        cloud(np.insert(points, 3, radius, axis=1), SECOND, "camera", ["radius"]) for radius in (1e-3, -1.0)
    )
    made.add("/query", narrow)
    made.add("/query", wrong)
    found = run(made.write(tmp_path / "in"), tmp_path / "out.mcap")
    (reply,) = found["/shadow_tracer/query/visibility"]
    rows = np.frombuffer(reply.data.tobytes(), "<u4").reshape(3, 7)
    assert rows[:, 3:].tolist() == [[1, 1, 1, 0], [0, 1, 0, 1], [1, 1, 1, 0]]
    text = "query: 1 messages were refused, the last one because of data: expected radius from 0"
    assert text in capsys.readouterr().err


def test_a_light_that_ignores_no_part_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, warned in (("shade", True), ("mesh", False)):
        run(
            still_life().write(tmp_path / name),
            tmp_path / f"{name}.mcap",
            *parameters(lights__lamp__ignore=f"[{name}]"),
        )
        text = f"warning: lights.lamp.ignore names '{name}', but the parts are mesh, depth; correct the name"
        assert (text in capsys.readouterr().err) == warned


def test_the_part_of_a_light_that_is_seen(tmp_path: Path) -> None:
    """The library's numbers, NaN where nothing is known; the mesh casts nothing in a light that ignores it."""
    lights = parameters(
        light_names="[disc, bare]", lights__disc__type="disc", lights__disc__radius=0.2,
        lights__disc__position="[0.4, -0.3, 0.0]", lights__bare__ignore="[mesh]", bias__normal=0.0,
    )  # fmt: skip
    lights += parameters(lights__disc__power=4.0)
    found = run(still_life().write(tmp_path / "in"), tmp_path / "out.mcap", "--visibility", "--irradiance", *lights)
    (message,) = found["/shadow_tracer/visibility/disc"]
    assert (message.encoding, message.step) == ("32FC1", 4 * W)
    share = message.data.view(np.float32).reshape(H, W)
    tracer = ShadowTracer("brute_force", device="cpu", bounds=BOUNDS)
    tracer.scene.put("mesh", *plate())
    disc = DiscLight("disc", (0.4, -0.3, 0.0), (0, 0, 1), 0.2, strength=Strength(power=4.0))
    frame = tracer.trace(depth_image(0), camera(np.eye(4)), [disc], bias=Bias(0.02, 0.003))
    np.testing.assert_array_equal(share, frame.visibility("disc"))
    assert ((share > 0) & (share < 1)).sum() > 20
    for name in ("", "/disc"):
        watts = found[f"/shadow_tracer/irradiance{name}"][0].data.view(np.float32).reshape(H, W)
        np.testing.assert_array_equal(watts, frame.irradiance("disc"))
    bare = found["/shadow_tracer/visibility/bare"][0].data.view(np.float32).reshape(H, W)
    np.testing.assert_array_equal(bare, np.where(np.isnan(depth_image(0)), np.nan, 1.0))


def read_one(folder: Path, topic: str) -> Any:
    from rosbags.highlevel import AnyReader

    with AnyReader([folder]) as reader:
        connection = next(c for c in reader.connections if c.topic == topic)
        return reader.deserialize(next(reader.messages([connection]))[2], connection.msgtype)


def test_the_former_name_of_the_list_of_lights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = run(still_life().write(tmp_path / "in"), tmp_path / "out.mcap", "--param", "lights:=[one, two]")
    assert {"/shadow_tracer/mask/one", "/shadow_tracer/mask/two"} <= set(found)
    assert "write light_names: [one, two]" in capsys.readouterr().err


def test_names_are_those_of_the_node(tmp_path: Path) -> None:
    made = BagMaker()
    made.raw("/cam/room", MESH, encode_mesh(*plate()))
    made.add("/cam/depth/camera_info", info(W, H, SECOND, FOCAL))
    made.add("/front/depth", image(depth_image(0), SECOND))
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    light_names: [sun]\n    lights.sun: {type: directional, direction: [1, 0, 3]}\n"
    )
    names = ["--node", "/cam/shade", "--remap", "depth/image_rect:=/front/depth", "--remap", "mesh:=room"]
    options = [*names, "--remap", "~/mask:=/dark", "--params-file", str(file)]
    found = run(made.write(tmp_path / "in"), tmp_path / "out.mcap", *options)
    topics = {f"/cam/shade/{name}" for name in ("mask/sun", "light_bits", "camera_info", "timing")}
    assert set(found) == topics | {"/dark"}
    assert found["/cam/shade/timing"][0].status[0].name == "cam/shade: timing"
    assert shadow(found["/dark"][0]) > 100


@pytest.mark.parametrize("storage", ["sqlite3", "bare mcap"])
def test_other_bags_can_be_read(storage: str, tmp_path: Path) -> None:
    from rosbags.rosbag2 import StoragePlugin

    plugin = StoragePlugin.SQLITE3 if storage == "sqlite3" else StoragePlugin.MCAP
    folder = still_life().write(tmp_path / "in", plugin)
    found = run(folder if storage == "sqlite3" else folder / "in.mcap", tmp_path / "out.mcap")
    assert shadow(found["/shadow_tracer/mask"][0]) > 100


def spoil(folder: Path) -> None:
    file = folder / "in.mcap"
    data = file.read_bytes()
    file.write_bytes(data[:8] + b"\x0f" + data[9:])


def shorten(folder: Path) -> None:
    file = folder / "in.mcap"
    file.write_bytes(file.read_bytes()[:2000])


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ("no bag", [], "expected an mcap, db3 or ROS 1 bag file or the folder of a bag, found none"),
        ("spoilt", [], "the bag cannot be read"),
        ("shortened", [], "in.mcap: the recording is cut off; its 2 whole messages are read"),
        (
            "no depth",
            [],
            "no sensor_msgs/msg/Image on /depth/image_rect; use --remap depth/image_rect:=... with one of /other",
        ),
        ("no info", [], "no sensor_msgs/msg/CameraInfo on /depth/camera_info; it has no such topic"),
        ("wrong type", [], "/mesh: expected shape_msgs/msg/Mesh, the bag has sensor_msgs/msg/CameraInfo"),
        ("", ["--param", "bias.constant:=-1"], "bias.constant: expected"),
        (
            "",
            ["--param", "camera_names:=[front]"],
            "--camera: expected one of front, cameras of the parameters, got ''",
        ),
        ("", ["--param", "bias.constant"], "--param: expected name:=value, got 'bias.constant'"),
        ("", ["--param", "light_names:=[lamp"], "--param light_names: not YAML"),
        ("", ["--params-file", "none.yaml"], "--params-file: none.yaml cannot be read"),
        ("", ["--remap", "mesh"], "--remap: expected from:=to"),
        ("", ["--remap", "mesh:=depth/image_rect"], "--remap: two inputs have got the same topic"),
        ("", ["--node", "shadow_tracer"], "--node: expected a full name such as /robot/shadow_tracer"),
        ("", ["--param", "device:=cuda:77"], "cuda:77"),
        ("", ["--param", "mesh.files:=[none.stl]"], "mesh.files"),
    ],
)
def test_errors(
    change: str, options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "in"
    made = BagMaker() if change in ("no depth", "no info") else still_life()
    if change == "no depth":
        made.add("/other", image(depth_image(0), SECOND))
    elif change == "no info":
        made.add(DEPTH, image(depth_image(0), SECOND))
    elif change == "wrong type":
        made = BagMaker()
        made.add("/mesh", info(W, H, 1, FOCAL))
    if change != "no bag":
        made.write(folder)
    if change == "spoilt":
        spoil(folder)
    if change == "shortened":
        shorten(folder)
    output = tmp_path / "deep" / "out.mcap"
    run(folder, output, *options, expect=1)
    assert message in capsys.readouterr().err
    assert not output.parent.exists() or not list(output.parent.iterdir())


@pytest.mark.parametrize(
    ("wrong", "code", "strict_code"),
    [
        ("nothing", 0, 0),
        ("one image without transform", 0, 3),
        ("all images without transform", 3, 3),
        ("one image refused", 0, 3),
        ("all images refused", 3, 3),
        ("query refused", 0, 3),
        ("query without transform", 0, 3),
        ("mesh refused", 0, 0),  # the last good one stays
    ],
)
@pytest.mark.slow
def test_exit_codes(wrong: str, code: int, strict_code: int, tmp_path: Path) -> None:
    """0 only where something is known, with --strict only where all is; the output is written nevertheless."""
    made = BagMaker()
    made.raw("/mesh", MESH, encode_mesh(*plate()))
    for k in (1, 2):
        if not (wrong.startswith("all images without") or (k == 2 and wrong == "one image without transform")):
            made.add("/tf", transform("map", "camera", k * SECOND, (0.0, 0.0, 0.0)))
        made.add(INFO, info(W, H, k * SECOND, FOCAL))
        good = image(depth_image(0), k * SECOND)
        if wrong == "all images refused" or (k == 2 and wrong == "one image refused"):
            good.encoding = "rgb8"
        made.add(DEPTH, good)
    made.add("/query", cloud(np.array([(0.5, 0.5, 2.0)]), SECOND, "nowhere" if wrong.startswith("query w") else "map"))
    if wrong == "query refused":
        made.raw("/query", "sensor_msgs/msg/PointCloud2", b"\x00\x01\x00\x00")
    if wrong == "mesh refused":
        made.raw("/mesh", MESH, b"\x00\x01")
    folder = made.write(tmp_path / "in")
    for options, expect in (([], code), (["--strict"], strict_code)):
        found = run(
            folder, tmp_path / "out.mcap", "--overwrite", *parameters(fixed_frame="map"), *options, expect=expect
        )
        refused = {"all images refused": 2, "one image refused": 1}.get(wrong, 0)
        assert len(found.get("/shadow_tracer/mask", [])) == 2 - refused


def test_help_explains_exit_codes(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["bag", "--help"])
    text = capsys.readouterr().out
    assert all(f"\n  {code}  " in text for code in (0, 1, 2, 3, 130))


def test_nothing_is_replaced_by_accident(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, output = still_life().write(tmp_path / "in"), tmp_path / "out.mcap"
    output.write_text("precious")
    run(folder, output, expect=1)
    assert "exists already" in capsys.readouterr().err and output.read_text() == "precious"
    run(folder, folder, "--overwrite", expect=1)
    assert "is the bag that is read" in capsys.readouterr().err
    assert run(folder, output, "--overwrite")["/shadow_tracer/mask"]


def test_an_interrupted_run_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from shadow_tracer.apps.bag.player import Player

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Player, "play", stop)
    folder = still_life().write(tmp_path / "in")
    run(folder, tmp_path / "out.mcap", expect=130)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in"]


def test_what_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "rosbags" else find(name, *a))
    assert cli.main(["bag", "in", "out"]) == 2
    assert "to read bags rosbags is needed: pip install 'shadow_tracer[bag]'" in capsys.readouterr().err


def test_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0 and "bag " in capsys.readouterr().out
    assert cli.main([]) == 2 and cli.main(["bog"]) == 2
    assert "no command 'bog'" in capsys.readouterr().err
    for name, (module, _) in cli.COMMANDS.items():
        with pytest.raises(SystemExit) as done:
            cli.main([name, "--help"])
        assert done.value.code == 0 and importlib.util.find_spec(module)


def test_options_of_the_readme_example_exist() -> None:
    epilog = bag._options().epilog or ""
    words = epilog.split("shadow_tracer bag")[1].replace("\\", "").split()
    chosen = bag._options().parse_args(words)
    assert chosen.bag == Path("drive.mcap") and len(chosen.remap) == 2


def test_dose_of_a_recording(tmp_path: Path) -> None:
    """By the time of the log; a pause of two seconds counts nothing; a file holds all of it in the end."""
    made = BagMaker()
    made.raw("/mesh", MESH, encode_mesh(*plate()))
    for half_seconds in (0, 1, 2, 3, 7, 8, 9):
        stamp = SECOND + half_seconds * SECOND // 2
        made.now = 10**12 + half_seconds * SECOND // 2
        made.add(INFO, info(W, H, stamp, FOCAL))
        made.add(DEPTH, image(depth_image(0), stamp))
    dose = parameters(
        lights__lamp__power=10.0, dose__parts="[mesh, wall]", dose__side="both", dose__max_edge=0.2,
        dose__folder=str(tmp_path), dose__target=0.01,
    )  # fmt: skip
    found = run(made.write(tmp_path / "in"), tmp_path / "out.mcap", *dose)
    loaded = DoseMap.load(tmp_path / "mesh.dose.npz")
    assert loaded.seconds == pytest.approx(2.0)
    tracer = ShadowTracer("brute_force", device="cpu", bounds=BOUNDS)
    tracer.scene.put("mesh", *plate())
    expected = DoseMap(tracer, "mesh", 0.2, side="both")
    expected.add([PointLight("lamp", (0.5, -0.5, 0.0), strength=Strength(power=10.0))], 2.0)
    np.testing.assert_allclose(loaded.dose, expected.dose, rtol=1e-12)
    coverage, done, clouds, markers = (
        found[f"/shadow_tracer/dose/{name}"] for name in ("coverage", "done", "cloud", "markers")
    )
    assert len(coverage) == len(clouds) == 2 and coverage[1].data == pytest.approx(expected.coverage(0.01))
    assert not done[1].data, "the part wall is not there"
    rows = clouds[1].data.view(np.float32).reshape(-1, 6)
    np.testing.assert_array_equal(rows[:, 4], loaded.dose.astype(np.float32))
    assert clouds[1].header.frame_id == "camera" and [each.ns for each in markers[0].markers] == ["", "dose/mesh"]


def test_a_dose_that_could_not_be_kept_is_refused_before(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dose = parameters(dose__parts="[mesh]", dose__folder=str(tmp_path / "none"))
    run(still_life().write(tmp_path / "in"), tmp_path / "out.mcap", *dose, expect=1)
    assert "dose.folder: expected a folder" in capsys.readouterr().err


@pytest.mark.parametrize("ros1", [False, True])
def test_ground_of_a_recording(tmp_path: Path, ros1: bool) -> None:
    """Maps without an image before them, with one, and one that cannot be used: grids and hours by the log's time."""
    pytest.importorskip("ephem")
    rows, columns = 9, 7
    values = np.zeros((rows, columns), np.float32)
    values[4, 2:5], values[0, 0] = 2.0, np.nan
    stamp = 1_782_014_400 * SECOND  # 2026-06-21 04:00 UTC
    ground = GridMap("map", stamp, 0.5, (0.0, 0.0), values)
    made = BagMaker()
    made.raw("/grid_map", GRID_MAP, encode_grid_map(ground, {"elevation": values}, starts=(4, 1)))
    made.add(INFO, info(W, H, stamp, FOCAL))
    made.add(DEPTH, image(depth_image(0), stamp))
    made.raw("/grid_map", GRID_MAP, encode_grid_map(ground, {"height": values}))
    folder = made.write_ros1(tmp_path / "drive.bag") if ros1 else made.write(tmp_path / "drive")
    sun = parameters(
        fixed_frame="map", pose_source="parameter", lights__lamp__type="sun", lights__lamp__sun__latitude="48.0",
        lights__lamp__sun__longitude="11.5", sun_map__hours="2.0", sun_map__step="60.0",
    )  # fmt: skip
    found = run(folder, tmp_path / "out.mcap", *sun, "--sun-map")
    (grid,) = found["/shadow_tracer/shadow_grid"]
    assert run(folder, tmp_path / "plain.mcap", *sun).keys() == found.keys() - {"/shadow_tracer/sun_map"}
    tracer, known = ShadowTracer("brute_force", device="cpu", bounds=BOUNDS), ~np.isnan(values)
    tracer.scene.put_surface("ground", ground.height_field())
    points = ground.height_field().positions()[known] + (0.0, 0.0, 0.05)
    dark = [
        tracer.occluded(points, DirectionalLight("sun", sun_direction(stamp + k * 1800 * SECOND, 48.0, 11.5)[0]))
        for k in (0, 1, 3)
    ]
    wanted = np.full(known.shape, -1)
    wanted[known] = 100 * dark[0]
    assert set(np.unique(wanted)) == {-1, 0, 100}
    np.testing.assert_array_equal(grid_of(grid), wanted)
    assert (grid.header.frame_id, grid.header.stamp.sec) == ("map", 1_782_014_400)
    (sun_map,) = found["/shadow_tracer/sun_map"]
    assert sun_map.layers == ["elevation", "sunlit", "hours"] and sun_map.basic_layers == ["elevation"]
    hours = sun_map.data[2].data.reshape(columns, rows).T
    np.testing.assert_array_equal(hours[known], 2.0 - dark[1] - dark[2])
    assert np.isnan(hours[~known]).all()
