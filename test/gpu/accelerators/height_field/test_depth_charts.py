# SPDX-License-Identifier: Apache-2.0
"""Charts of depth images whose surface is made on the device: steps in depth, holes, poses and scales of all sizes,
images one after the other; against brute_force over the same surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import probe
import pytest
import surfaces
from surfaces import agree, moved, turned

from shadow_tracer import Camera, DirectionalLight, PointLight
from shadow_tracer.gpu.accelerators.height_field import charts
from shadow_tracer.scene.chart import depth_chart

pytestmark = probe.in_both_forms


@pytest.fixture(autouse=True)
def _small_surfaces_have_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(charts, "_FEWEST_QUADS", 1)


def _image(rng: np.random.Generator, rows: int, columns: int, scale: float = 1.0) -> np.ndarray:
    """Depths with steps and holes [m]."""
    depth = surfaces.depth_surface(rng, rows, columns)[..., 2] * scale
    depth[rng.random(depth.shape) < 0.05] = rng.choice([0.0, np.nan, -1.0, np.inf])
    return depth.astype(np.float32)


def _points(rng: np.random.Generator, scene_points: np.ndarray) -> np.ndarray:
    """Corners, next to them, and anywhere among them."""
    low, high = scene_points.min(axis=0), scene_points.max(axis=0)
    near = scene_points + 0.01 * (high - low).max() * rng.normal(size=scene_points.shape)
    return np.concatenate([scene_points, near, rng.uniform(low, high, (200, 3))])


def _lights(middle: np.ndarray, size: float) -> list[Any]:
    ways = [(0, 0, 1), (0, 0, -1), (1, 0.1, 0), (1, 1, 0.2), (-0.2, 0.1, -1)]
    places = [(0.3, 0.1, -2.0), (1.0, 0.2, 0.0), (0.1, 0.0, 0.5), (0.0, 0.0, 9.0)]
    lights: list[Any] = [DirectionalLight(f"sun {k}", way) for k, way in enumerate(ways)]
    return lights + [PointLight(f"lamp {k}", middle + size * np.array(each)) for k, each in enumerate(places)]


@pytest.mark.parametrize("cull", [False, True])
@pytest.mark.parametrize(("step", "jump"), [(1, 0.05), (1, 1e6), (2, 0.2), (3, 0.3)])
@pytest.mark.parametrize("pose", [np.eye(4), turned(2.0, (1, 2, -0.5), (4e5, 5e6, 2.0))], ids=["here", "far"])
def test_steps_and_holes(any_device: str, pose: np.ndarray, step: int, jump: float, cull: bool) -> None:
    rng = np.random.default_rng(step)
    depth = _image(rng, 31, 43)
    camera = Camera(43, 31, 43.0, 40.0, 20.5, 16.0, pose)

    def show(scene: Any) -> None:
        scene.put_depth("depth", depth, camera, step, jump)

    known = surfaces.tracer(any_device, "brute_force")
    show(known.scene)
    corners = known.scene["depth"].vertices
    points = _points(rng, moved(pose, corners[corners[:, 2] > 0.0]))
    states, counters, tracer = agree(any_device, show, points, _lights(points.mean(axis=0), 2.0), 0.01, cull)
    assert probe.charts(tracer)[0] == ["depth"] and (cull or 0.05 < (states == 1).mean() < 0.9)
    assert counters["leaf_tests"] < 60 * counters["rays"], "all quads are shown"


@pytest.mark.parametrize("scale", [1e-30, 1e-10, 3e-10, 1e-8, 1e-3, 1e20])
def test_depths_that_are_nothing_beside_the_place_of_the_camera(any_device: str, scale: float) -> None:
    """Corners with a depth lie where those without lie: their triangles are thin or have no area, and count."""
    rng = np.random.default_rng(7)
    pose = turned(1.0, (1, 2, 3), (4e5, 5e6, 30.0))
    depth, camera = _image(rng, 14, 16, scale), Camera(16, 14, 16.0, 16.0, 7.5, 6.5, pose)
    middle = pose[:3, 3]
    points = middle + max(4.0 * scale, 2e-9) * rng.normal(size=(300, 3))
    lights = [PointLight("lamp", middle + max(9.0 * scale, 3e-9) * np.array((0.3, 0.2, 1.0)))]
    lights += _lights(middle, 1.0)[:3]
    agree(any_device, lambda scene: scene.put_depth("depth", depth, camera, 1, 1e6), points, lights)


def test_something_very_near(any_device: str) -> None:
    """A speck before the lens, of a depth that is next to nothing beside all others: rays to lamps in the camera,
    behind it, and from behind it to lamps in front; samples on the surfaces and behind them."""
    rng = np.random.default_rng(71)
    depth = np.full((33, 40), 20.0, np.float32)
    for number, z in enumerate(rng.choice([0.3, 0.5, 1.0, 2.0], 30)):
        row, column = rng.integers(0, 28, 2)
        depth[row : row + 5, column : column + 2 + number % 3] = z
    depth[10:13, 20:24] = 0.003
    camera = Camera(40, 33, 40.0, 40.0, 19.5, 16.0)

    def show(scene: Any) -> None:
        scene.put_depth("depth", depth, camera, 1, 0.1)

    known = surfaces.tracer(any_device, "brute_force")
    show(known.scene)
    corners = known.scene["depth"].vertices
    corners = corners[corners[:, 2] > 0.1]
    points = np.concatenate([corners, 1.3 * corners, 15.0 * corners, rng.normal(size=(100, 3)) * (1.0, 1.0, 3.0)])
    places = [
        (0.0, 0.0, 0.0),
        (1e-4, 0.0, 0.0),
        (0.0, 0.0, -0.1),
        (0.1, 0.0, -2.0),
        (-3.0, 1.0, -0.5),
        (0.5, -0.2, 0.0),
        (0.3, 0.2, 7.0),
        (0.0, 0.0, 60.0),
    ]
    lights: list[Any] = [PointLight(f"lamp {k}", each) for k, each in enumerate(places)]
    lights += [DirectionalLight("sun", (0.1, 0.2, 1.0)), DirectionalLight("from the front", (0.1, 0.2, -1.0))]
    states, _, tracer = agree(any_device, show, points, lights, 0.02)
    assert probe.charts(tracer)[0] == ["depth"] and 0.05 < (states == 1).mean() < 0.9


@pytest.mark.parametrize("scale", [1e-36, 1e-18, 1e18, 1e34])
def test_sizes_of_all_kinds(any_device: str, scale: float) -> None:
    rng = np.random.default_rng(72)
    depth, camera = _image(rng, 14, 16, scale), Camera(16, 14, 16.0, 16.0, 7.5, 6.5)
    points = scale * np.array([0.0, 0.0, 2.0]) + scale * rng.normal(size=(300, 3))
    lights = _lights(scale * np.array([0.0, 0.0, 2.0]), 2.0 * scale)
    for bias in (0.0, 0.02 * scale):
        states, _, _ = agree(
            any_device, lambda scene: scene.put_depth("depth", depth, camera, 1, 0.2), points, lights, bias
        )
        assert 0.02 < (states == 1).mean() < 0.9


def test_a_triangle_whose_corner_lies_at_the_camera(any_device: str) -> None:
    """A depth that is lost beside the place of the camera, among others that are not: rays through what the triangle
    has there, where its other corners are not."""
    rng, place = np.random.default_rng(10), np.full(3, 5e6)
    depth = np.full((9, 9), 1e-5, np.float32)
    depth[4, 4] = 1e-10
    camera = Camera(9, 9, 9.0, 9.0, 4.0, 4.0, turned(0.0, (0, 0, 1), tuple(place)))
    known = surfaces.tracer(any_device, "brute_force")
    known.scene.put_depth("depth", depth, camera, 1, 1e6)
    mesh = known.scene["depth"]
    (at_camera,) = np.flatnonzero((mesh.world_vertices() == place).all(axis=1))
    spanned = mesh.vertices[mesh.triangles[(mesh.triangles == at_camera).any(axis=1)]]
    inside = (spanned * rng.dirichlet((1, 1, 1), (40, len(spanned)))[..., None]).sum(axis=2).reshape(-1, 3)
    light = DirectionalLight("sun", (0.5, -0.75, 0.25))
    points = place + inside * rng.choice([0.02, 0.1], (len(inside), 1)) + 2e-8 * np.array(light.direction)
    states, _, tracer = agree(
        any_device, lambda scene: scene.put_depth("depth", depth, camera, 1, 1e6), points, [light]
    )
    assert probe.charts(tracer)[0] == ["depth"] and (states == 1).mean() > 0.5


@pytest.mark.parametrize("kind", ["image", "surface"])
@pytest.mark.parametrize("pose", [np.eye(4), turned(2.0, (1, 2, -0.5), (3.0, 5.0, 2.0))], ids=["straight", "turned"])
def test_triangles_that_a_light_sees_edge_on(any_device: str, pose: np.ndarray, kind: str) -> None:
    """Walls and slopes with a lamp in their plane, or beside it by next to nothing, and suns along them: counted as
    brute_force counts them."""
    depth = np.full((24, 33), 2.0, np.float32)
    depth[:, 11:22] = 4.0
    depth[:, 22:] = 1.0 / (0.25 + np.arange(11, dtype=np.float32) / 64)  # a plane, all but rounded
    depth[3:5, 5:9] = 0.0
    camera = Camera(33, 24, 32.0, 32.0, 16.0, 12.0, pose)

    def show(scene: Any) -> None:
        if kind == "image":
            scene.put_depth("depth", depth, camera, 1, 0.05)
        else:
            positions = (camera.unproject(depth.astype(np.float64)) - pose[:3, 3]) @ pose[:3, :3]
            scene.put_surface("depth", positions, depth > 0, pose)

    places = [(0.3, 0.2, 2.0), (0.3, 0.2, 2.0 + 1e-12), (0.3, 0.2, 2.0 - 1e-5), (0, 0, 4.0), (0, 0.5, 0), (0, 0.5, -1)]
    ways = [(1.0, 0.5, 0.0), (1.0, 0.5, 1e-13), (0.0, 1.0, 0.0), (1e-9, 1.0, 1e-6)]
    lights: list[Any] = [PointLight(f"lamp {k}", moved(pose, np.array(each))) for k, each in enumerate(places)]
    lights += [DirectionalLight(f"sun {k}", pose[:3, :3] @ np.array(each)) for k, each in enumerate(ways)]
    points = moved(pose, np.random.default_rng(11).uniform((-2, -2, 0), (2, 2, 5), (60, 3)))
    silent = []
    for light in lights:
        _, counters, tracer = agree(any_device, show, points, [light])
        silent.append(counters["degenerate"])
    assert probe.charts(tracer)[0] == ["depth"] and (max(silent) > 400 or not np.array_equal(pose, np.eye(4)))


def test_single_triangles_that_a_light_sees_edge_on(any_device: str) -> None:
    """Of a rough image, cut along both diagonals: lamps in the plane of one triangle each, and suns."""
    rng = np.random.default_rng(12)
    depth = (2.0 + rng.integers(-8, 9, (9, 9)) / 64.0).astype(np.float32)
    camera = Camera(9, 9, 32.0, 32.0, 4.0, 4.0)
    known = surfaces.tracer(any_device, "brute_force")
    known.scene.put_depth("depth", depth, camera, 1, 1e6)
    mesh, lights = known.scene["depth"], []
    rising = [k for k, each in enumerate(mesh.triangles) if each.max() - each.min() == 9 and len(set(each)) == 3]
    for number, k in enumerate(rng.choice(rising, 8, replace=False)):
        a, b, c = mesh.vertices[mesh.triangles[k]]
        lights.append(PointLight(f"lamp {number}", a + 5.0 * (b - a) - 3.0 * (c - a)))
        lights.append(DirectionalLight(f"sun {number}", 5.0 * (b - a) - 3.0 * (c - a)))
    points = rng.uniform((-0.3, -0.3, 1.0), (0.3, 0.3, 3.0), (100, 3))
    for light in lights:
        _, counters, _ = agree(
            any_device, lambda scene: scene.put_depth("depth", depth, camera, 1, 1e6), points, [light]
        )
        assert counters["degenerate"] >= 1


def test_images_one_after_the_other(any_device: str) -> None:
    """Of other sizes and poses, beside a mesh, moved, in place of a surface and the other way round."""
    rng = np.random.default_rng(8)
    ours, theirs = (surfaces.tracer(any_device, name, threads=1) for name in ("height_field", "brute_force"))
    seen = set()
    for number in range(16):
        rows, columns = (int(rng.integers(2, 24)) for _ in range(2))
        pose = turned(float(rng.uniform(0, 3)), (0, 1, 0.3), tuple(rng.normal(size=3)))
        camera = Camera(columns, rows, 20.0, 20.0, columns / 2, rows / 2, pose)
        depth = _image(rng, rows, columns) if rng.random() < 0.9 else np.zeros((rows, columns), np.float32)
        if rng.random() < 0.3:
            depth = np.nan_to_num(1000.0 * depth, posinf=0.0).clip(0, 65535).astype(np.uint16)
        soup = rng.normal(size=(9, 3))
        for scene in (ours.scene, theirs.scene):
            if number % 4 == 1:
                scene.put_surface("depth", surfaces.depth_surface(np.random.default_rng(number), rows, columns))
            elif number % 4 == 2 and "depth" in scene:
                scene.move("depth", pose)
            else:
                scene.put_depth("depth", depth, camera)
            if number % 5 == 0:
                scene.put("soup", soup, np.arange(9).reshape(-1, 3))
            elif "soup" in scene and number % 5 == 3:
                scene.remove("soup")
        points = 3.0 * rng.normal(size=(400, 3))
        lights = [PointLight("lamp", rng.normal(size=3)), DirectionalLight("sun", rng.normal(size=3))]
        found, expected = (probe.trace_points(each, points, lights, 0.01) for each in (ours, theirs))
        assert np.array_equal(found.states, expected.states), number
        for name in ("triangles", "degenerate", "culled"):
            assert found.counters[name] == expected.counters[name], name
        seen |= {type(ours.scene[name]).__name__ for name in probe.charts(ours)[0]}
    assert seen == {"DepthSurface", "Mesh"}


def test_what_has_no_chart(any_device: str) -> None:
    """A camera with a table of rays, an image without a depth, one row: these go with the meshes."""
    rng = np.random.default_rng(9)
    camera = Camera(16, 12, 16.0, 16.0, 7.5, 5.5)
    bent = camera.pixel_rays()[..., :2] * 1.1
    depth = _image(rng, 12, 16)
    for image, each in (
        (depth, Camera(16, 12, 16.0, 16.0, 7.5, 5.5, rays=bent)),
        (np.zeros_like(depth), camera),
        (depth[:1], Camera(16, 1, 16.0, 16.0, 7.5, 0.5)),
    ):
        points = 3.0 * rng.normal(size=(100, 3))
        _, _, tracer = agree(
            any_device,
            lambda scene, image=image, each=each: scene.put_depth("depth", image, each),
            points,
            _lights(np.zeros(3), 1.0),
        )
        assert depth_chart(tracer.scene["depth"]) is None and probe.charts(tracer)[0] == []
