# SPDX-License-Identifier: Apache-2.0
"""Meshes from all topics and files, in frames of their own: the masks are those of the library, and only what changed
is copied."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from harness import Rig, plate, wall
from node_world import BIAS, UNKNOWN, all_unknown, camera, cloud_msg, library, shadow_size, shift, soup
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from tf_double import Buffer, module, transform
from visualization_msgs.msg import Marker, MarkerArray

from shadow_tracer import PointLight, ShadowTracer
from shadow_tracer.ros.diagnostics import ERROR, MESH, OK, PROCESSING, TRANSFORMS, WARN
from shadow_tracer.ros.wire.cdr_markers import DELETE, DELETEALL, MarkerMessage, encode_marker, encode_markers
from shadow_tracer.ros.wire.messages import rigid
from shadow_tracer.scene.depth_mesh import depth_mesh

LAMP = PointLight("lamp", (0.5, -0.5, 0.0))
SECOND = 1_000_000_000


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig({"mask.unknown_value": UNKNOWN}) as made:
        yield made


@pytest.fixture(scope="module")
def tracer() -> ShadowTracer:
    return library()


def expected(tracer: ShadowTracer, meshes: dict[str, tuple[Any, ...]], depth: np.ndarray | None = None) -> np.ndarray:
    """The library's mask of the lamp with these meshes: vertices, triangles and perhaps a pose."""
    tracer.scene.clear()
    for name, mesh in meshes.items():
        tracer.scene.put(name, *mesh)
    return tracer.trace(wall() if depth is None else depth, camera(), [LAMP], bias=BIAS).mask(unknown=UNKNOWN)


def marker(x: float, **values: Any) -> MarkerMessage:
    """A plate as a marker in the frame of the camera."""
    return MarkerMessage(**{"ns": "n", "id": 1, "frame": "camera", "points": soup(*plate(x=x)), **values})


def send_markers(rig: Rig, *markers: MarkerMessage) -> None:
    rig.send_part("mesh_markers", MarkerArray, encode_markers(markers))


def send_marker(rig: Rig, message: MarkerMessage) -> None:
    rig.send_part("mesh_marker", Marker, encode_marker(message))


def updates(rig: Rig) -> tuple[int, int, int]:
    """How often the node's scene got a mesh, positions and a pose."""
    counts = rig.core.inputs.meshes.store.updates
    return counts["put"], counts["deform"], counts["move"]


def test_markers_come_change_and_go(rig: Rig, tracer: ShadowTracer) -> None:
    send_markers(rig, marker(-0.2), marker(0.3, id=2))
    both = {"a": plate(x=-0.2), "b": plate(x=0.3)}
    np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, both))
    assert updates(rig) == (2, 0, 0)
    send_marker(rig, marker(-0.2, position=(0.0, 0.1, 0.0), scale=(2.0, 1.0, 0.5), orientation=(0.0, 0.0, 0.6, 0.8)))
    vertices, triangles = plate(x=-0.2)
    turned = {**both, "a": (vertices * (2.0, 1.0, 0.5), triangles, rigid((0, 0.1, 0), (0, 0, 0.6, 0.8), "pose"))}
    np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, turned))
    assert updates(rig) == (2, 1, 1)
    send_markers(rig, marker(-0.2, id=2, action=DELETE))
    np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, {"a": turned["a"]}))
    send_markers(rig, marker(0.1, type=1))  # now a cube, which casts nothing and is counted
    assert shadow_size(rig.trace(wall())) == 0
    rig.until(lambda: rig.value(MESH, "ignored markers") == "1")
    send_markers(rig, marker(0.0), marker(0.2, ns="other"), marker(0.0, action=DELETEALL), marker(0.1, id=5))
    np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, {"a": plate(x=0.1), "b": plate(x=0.2)}))
    assert set(rig.core.inputs.meshes.store.parts) == {"markers/n/5", "markers/other/1"}
    rig.wait_status(MESH, OK)


def test_the_classes_of_ros_are_understood_too(rig: Rig, tracer: ShadowTracer) -> None:
    """Markers as most publishers make them: message objects."""
    from geometry_msgs.msg import Point, Pose, Quaternion, Vector3

    msg = Marker(ns="n", id=1, type=Marker.TRIANGLE_LIST, action=Marker.ADD)
    msg.header.frame_id = "camera"
    msg.pose = Pose(orientation=Quaternion(w=1.0))
    msg.scale = Vector3(x=1.0, y=1.0, z=1.0)
    msg.points = [Point(x=x, y=y, z=z) for x, y, z in soup(*plate()).tolist()]
    rig.send_part("mesh_marker", Marker, msg)
    np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, {"a": plate()}))
    msg.points = [Point(x=x, y=y, z=z) for x, y, z in soup(*plate(x=0.2)).tolist()]
    rig.send_part("mesh_markers", MarkerArray, MarkerArray(markers=[msg]))
    np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, {"a": plate(x=0.2)}))


def test_a_cloud_is_a_soup_of_triangles(rig: Rig, tracer: ShadowTracer) -> None:
    for number, kind in enumerate(("f4", "f8", "f8")):
        vertices, triangles = plate(x=0.1 * number)
        corners = soup(vertices, triangles).astype(kind).astype(np.float64)
        rig.send_part("mesh_cloud", PointCloud2, cloud_msg(corners, kind=kind, height=2))
        mesh = (corners, np.arange(6).reshape(2, 3))
        np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, {"cloud": mesh}))
    assert updates(rig) == (1, 2, 0)
    rig.send_part("mesh_cloud", PointCloud2, cloud_msg(corners[:5]))
    rig.wait_status(MESH, ERROR, "mesh_cloud refused, width, height: expected a multiple of 3 points")
    np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, {"cloud": mesh}))
    rig.send_part("mesh_cloud", PointCloud2, cloud_msg(np.empty((0, 3))))
    assert shadow_size(rig.trace(wall())) == 0


def write_stl(path: Path, mesh: tuple[np.ndarray, np.ndarray]) -> str:
    trimesh = pytest.importorskip("trimesh")
    trimesh.Trimesh(*mesh, process=False).export(path)
    return str(path)


def test_files_that_cannot_be_used_at_the_start(tmp_path: Path, tracer: ShadowTracer) -> None:
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    vertices, triangles = plate()
    rows = [f"v {x} {y} {z}" for x, y, z in vertices.tolist()] + [
        f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()
    ]
    (tmp_path / "good.obj").write_text("\n".join([*rows, "l 1 2"]))
    with Rig({"mask.unknown_value": UNKNOWN, "mesh.files": [str(tmp_path / "flat.obj")]}) as rig:
        text = "zero area (1 of them), so that nothing casts a shadow; export it again, and look at mesh.files_scale"
        assert text in rig.wait_status(MESH, ERROR, "none is loaded and masks are unknown").message
        assert rig.set(mesh__files=[str(tmp_path / "good.obj")]) == ""
        np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, {"a": plate()}))
        rig.until(lambda: rig.value(MESH, "left out of files").endswith("casts no shadow: lines (1)"))


def test_files_are_loaded_at_start_and_when_they_change(tmp_path: Path, tracer: ShadowTracer) -> None:
    first = write_stl(tmp_path / "a.ply", plate())
    with Rig({"mask.unknown_value": UNKNOWN, "mesh.files": [first]}) as rig:
        np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, {"a": plate()}))
        second = write_stl(tmp_path / "b.ply", (plate(x=300.0, half=200.0, distance=1000.0)))
        assert rig.set(mesh__files=[first, second]) == ""
        assert updates(rig)[0] == 1
        far = rig.trace(wall())
        np.testing.assert_array_equal(far, expected(tracer, {"a": plate()}))  # a kilometre away it casts nothing
        assert updates(rig)[0] == 2  # the first was not loaded again
        assert rig.set(mesh__files_scale=0.001) == ""
        vertices, triangles = plate(x=300.0, half=200.0, distance=1000.0)
        scaled = {"a": (plate()[0] * 0.001, triangles), "b": (vertices * 0.001, triangles)}
        np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, scaled))
        assert rig.set(mesh__files=[str(tmp_path / "nowhere.ply")]) == ""
        rig.wait_status(MESH, ERROR, "correct mesh.files, the others stay")
        assert "nowhere.ply" in rig.status(MESH).message  # type: ignore[union-attr]
        np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, scaled))
        assert rig.set(mesh__files=[""]) == ""
        assert shadow_size(rig.trace(wall())) == 0
        rig.wait_status(MESH, WARN, "no mesh")


def test_parts_in_different_frames_at_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, tracer: ShadowTracer
) -> None:
    """A robot: everything in a frame of its own, most of them moving. Equal bits, and nothing copied twice."""
    double, made = module()
    monkeypatch.setitem(sys.modules, "tf2_ros", double)
    wall_file = write_stl(tmp_path / "part.ply", plate(x=-0.4, half=0.05))
    parameters = {
        "mask.unknown_value": UNKNOWN, "fixed_frame": "map", "mesh.frame": "odom", "mesh.files": [wall_file],
        "lights.lamp.frame": "camera", "tf_timeout": 1.0,
    }  # fmt: skip
    with Rig(parameters) as rig:
        buffer: Buffer = made[0]
        start, turn = rig.stamp, (0.0, 0.0, 0.1, np.sqrt(0.99))
        frames = {"camera": 5.0, "odom": 5.0, "arm": 4.9, "lidar": 5.2, "door": 5.0}
        for number, (name, x) in enumerate(frames.items()):
            for stamp, more in ((start, 0.0), (start + SECOND, 0.02 * (number + 1))):
                buffer.set_transform(transform("map", name, stamp, (x + more, 1.0, 0.0), turn), "test")

        def pose(frame: str, stamp: int) -> np.ndarray:
            found = buffer.lookup_transform("map", frame, Stamp(stamp)).transform
            t, q = found.translation, found.rotation
            return rigid((t.x, t.y, t.z), (q.x, q.y, q.z, q.w), frame)

        small = plate(half=0.08)
        corners = (soup(*small), np.arange(6).reshape(2, 3))
        messages = [
            marker(0.0, frame="arm", frame_locked=True, points=corners[0], position=(0.0, 0.2, 0.0)),
            marker(0.0, id=2, frame="door", stamp=start + SECOND // 4, points=corners[0], position=(0.2, 0.1, 0.0)),
        ]
        rig.send_mesh(*small)
        send_markers(rig, *messages)
        rig.send_part("mesh_cloud", PointCloud2, cloud_msg(corners[0], start + SECOND // 2, "lidar", "f8"))
        masks = []
        for stamp in (start + SECOND // 2, start + SECOND * 3 // 4, start + SECOND):
            at = pose("camera", stamp)
            meshes = {
                "mesh": (*small, pose("odom", stamp)),
                "arm": (*corners, pose("arm", stamp) @ shift(0.0, 0.2)),
                "door": (*corners, pose("door", start + SECOND // 4) @ shift(0.2, 0.1)),
                "cloud": (*corners, pose("lidar", start + SECOND // 2)),
                "file": (*plate(x=-0.4, half=0.05), pose("odom", stamp)),
            }
            tracer.scene.clear()
            for name, mesh in meshes.items():
                tracer.scene.put(name, *mesh)
            lamp = PointLight("lamp", at[:3, :3] @ LAMP.position + at[:3, 3])
            frame = tracer.trace(wall(), camera(at), [lamp], bias=BIAS)
            masks.append(rig.trace(wall(), stamp=stamp))
            np.testing.assert_array_equal(masks[-1], frame.mask(unknown=UNKNOWN))
        assert not np.array_equal(masks[0], masks[1]) and not np.array_equal(masks[1], masks[2])
        # All five once; then only those whose frames move at the image's stamp: mesh, file, and the locked marker.
        assert updates(rig) == (5, 0, 2 * 3)
        before = rig.core.inputs.meshes.store.updates.copy()
        send_markers(rig, replace(messages[1], points=corners[0] + (0.1, 0.0, 0.0)))
        rig.trace(wall(), stamp=start + SECOND - 2)
        after = rig.core.inputs.meshes.store.updates
        assert {name: after[name] - before[name] for name in after} == {"put": 0, "deform": 1, "move": 3}
        rig.until(lambda: rig.value(MESH, "parts") == "5")
        send_markers(rig, marker(0.0, frame="nowhere", frame_locked=True))
        assert rig.set(tf_timeout=0.0) == ""
        assert all_unknown(rig.trace(wall(), stamp=start + SECOND - 1))
        status = rig.wait_status(TRANSFORMS, WARN, "nowhere")
        assert "header.frame_id of mesh_markers 'n' 1" in status.message and "tf2_echo" in status.message


class Stamp:
    """Of tf's time only the nanoseconds are looked at."""

    def __init__(self, nanoseconds: int) -> None:
        self.nanoseconds = nanoseconds


def test_a_marker_lives_as_long_as_it_says() -> None:
    with Rig({"mask.unknown_value": UNKNOWN, "use_sim_time": True}) as rig:
        rig.publish_clock(100.0)
        rig.until(lambda: rig.core.now_ns() == 100 * SECOND)
        send_marker(rig, marker(0.0, lifetime=2 * SECOND))
        assert shadow_size(rig.trace(wall()))
        rig.publish_clock(101.9)
        rig.until(lambda: rig.core.now_ns() > 101 * SECOND)
        assert shadow_size(rig.trace(wall()))
        rig.publish_clock(102.0)
        rig.until(lambda: rig.core.now_ns() == 102 * SECOND)
        assert shadow_size(rig.trace(wall())) == 0
        rig.wait_status(MESH, WARN, "the meshes have no triangles")


def test_clear_meshes_leaves_those_of_files(tmp_path: Path, tracer: ShadowTracer) -> None:
    file = write_stl(tmp_path / "a.ply", plate(x=-0.3, half=0.1))
    with Rig({"mask.unknown_value": UNKNOWN, "mesh.files": [file]}) as rig:
        rig.send_mesh(*plate())
        send_markers(rig, marker(0.3))
        rig.send_part("mesh_cloud", PointCloud2, cloud_msg(soup(*plate(x=0.1))))
        everything = rig.trace(wall())
        response = rig.call(Trigger, "shadow_tracer/clear_meshes")
        assert response.success and response.message == "3 parts cleared; those of mesh.files stay"
        only_file = expected(tracer, {"a": plate(x=-0.3, half=0.1)})
        np.testing.assert_array_equal(rig.trace(wall()), only_file)
        assert not np.array_equal(everything, only_file)
        assert rig.call(Trigger, "shadow_tracer/clear_meshes").message.startswith("0 parts")
        rig.send_mesh(*plate())  # the same again is taken again
        both = {"a": plate(x=-0.3, half=0.1), "mesh": plate()}
        np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, both))


def grid(count: int, x: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A plate of ``count`` triangles, most of them far away."""
    vertices, triangles = plate(x=x)
    more = np.repeat(triangles[:1], count - 2, axis=0) + 4
    return np.vstack([vertices, vertices + (0.0, 0.0, 500.0)]), np.vstack([triangles, more])


def test_bounds_hold_for_all_parts_together(rig: Rig, tracer: ShadowTracer) -> None:
    rig.send_mesh(*grid(4000))
    send_marker(rig, marker(0.3))
    good = rig.trace(wall())
    np.testing.assert_array_equal(good, expected(tracer, {"a": plate(), "b": plate(x=0.3)}))
    rig.send_part("mesh_cloud", PointCloud2, cloud_msg(np.tile(soup(*plate(x=-0.3)), (50, 1))))
    text = "mesh_cloud refused, bounds.max_triangles: all meshes together would have 4102 triangles"
    assert "there is no earlier one and it casts no shadow" in rig.wait_status(MESH, ERROR, text).message
    np.testing.assert_array_equal(rig.trace(wall()), good)
    # The shares change in one frame, neither of them fits beside what the other had.
    rig.send_mesh(*grid(10))
    send_marker(rig, marker(0.3, points=np.tile(soup(*plate(x=0.3)), (2000, 1))))
    np.testing.assert_array_equal(rig.trace(wall()), good)
    assert rig.value(PROCESSING, "faults") == "0"


def test_mesh_max_age_holds_for_each_part() -> None:
    with Rig({"mask.unknown_value": UNKNOWN, "use_sim_time": True, "mesh.max_age": 5.0}) as rig:

        def clock(seconds: float) -> None:
            rig.publish_clock(seconds)
            rig.until(lambda: rig.core.now_ns() == int(seconds * 1e9))

        clock(100.0)
        rig.send_mesh(*plate())
        clock(103.0)
        send_marker(rig, marker(0.3))
        clock(105.0)
        assert shadow_size(rig.trace(wall()))
        rig.until(lambda: (rig.value(MESH, "oldest part"), rig.value(MESH, "age [s]")) == ("mesh", "5.00"))
        clock(106.0)
        assert all_unknown(rig.trace(wall()))
        rig.wait_status(MESH, WARN, "the mesh is 6.0 s old and mesh.max_age is 5 s")
        rig.send_mesh(*plate())
        assert shadow_size(rig.trace(wall()))
        clock(110.0)
        assert all_unknown(rig.trace(wall()))
        rig.wait_status(MESH, WARN, "mesh part 'markers/n/1' is 7.0 s old")
        send_marker(rig, marker(0.3, action=DELETE))
        assert shadow_size(rig.trace(wall()))
        assert rig.set(occluders="depth") == ""
        clock(120.0)
        assert not all_unknown(rig.trace(wall()))  # meshes are not looked at


def step_image() -> np.ndarray:
    """A box in front of a wall, which casts a shadow on it."""
    depth = wall()
    depth[10:30, 30:45] = 1.2
    return depth


@pytest.mark.parametrize(
    ("occluders", "step", "jump"), [("depth", 2, 0.05), ("mesh+depth", 2, 0.05), ("mesh+depth", 3, 0.8)]
)
def test_the_depth_image_casts_shadow(rig: Rig, tracer: ShadowTracer, occluders: str, step: int, jump: float) -> None:
    rig.send_mesh(*plate(x=-0.4, half=0.1))
    assert rig.set(occluders=occluders, depth_occluder__step=step, depth_occluder__max_jump=jump) == ""
    for depth in (step_image(), step_image()[:, ::-1].copy(), wall()):
        meshes: dict[str, Any] = {"depth": depth_mesh(depth, camera(), step, jump)}
        if occluders != "depth":
            meshes["mesh"] = plate(x=-0.4, half=0.1)
        mask = rig.trace(depth)
        np.testing.assert_array_equal(mask, expected(tracer, meshes, depth))
        assert bool(shadow_size(mask[:, 20:])) == (not np.array_equal(depth, wall(), equal_nan=True))
    rig.wait_status(MESH, OK)
    assert rig.set(occluders="mesh") == ""
    mesh_only = expected(tracer, {"mesh": plate(x=-0.4, half=0.1)}, step_image())
    np.testing.assert_array_equal(rig.trace(step_image()), mesh_only)


def test_the_surface_of_the_last_image_is_not_in_the_way(rig: Rig, tracer: ShadowTracer) -> None:
    """It makes room for meshes that fit only without it, or beside the surface of a coarser step."""
    assert rig.set(occluders="mesh+depth", depth_occluder__step=2) == ""
    rig.trace(wall())
    rig.send_mesh(*grid(4000))
    assert all_unknown(rig.trace(wall()))
    rig.wait_status(PROCESSING, ERROR, "bounds.max_triangles")
    assert rig.set(depth_occluder__step=16) == ""
    np.testing.assert_array_equal(
        rig.trace(wall()), expected(tracer, {"a": plate(), "d": depth_mesh(wall(), camera(), 16, 0.05)})
    )
    rig.send_mesh(*grid(100))
    assert rig.set(depth_occluder__step=2) == ""
    assert not all_unknown(rig.trace(wall()))
    rig.send_mesh(*grid(4096))
    assert rig.set(occluders="mesh") == ""
    np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, {"a": plate()}))


def test_a_layout_that_ros_does_not_share_is_read_as_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    from shadow_tracer.ros.wire import layouts

    monkeypatch.setattr(layouts, "_markers_differ", lambda: "points came out as colors")
    with Rig({"mask.unknown_value": UNKNOWN}) as rig:
        send_markers(rig, marker(0.0))
        assert shadow_size(rig.trace(wall()))
        status = rig.wait_status(MESH, WARN, "visualization_msgs/msg/MarkerArray is laid out differently")
        assert "slow" in status.message and "report" in status.message
