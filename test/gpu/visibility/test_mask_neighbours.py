# SPDX-License-Identifier: Apache-2.0
"""Samples that are looked at together: what is between them and a light is found to be empty only where it is; and
images, whose pixels ask in tiles."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, Camera, DiscLight, RectangleLight, ShadowTracer, SphereLight, SunDisc, TubeLight

_LIGHTS = ("panel", "sphere", "tube", "point", "sun")


def _lamp(light: str, origin: float) -> Any:
    if light == "panel":
        return RectangleLight("s", (origin,) * 3, (0.5, 0.0, 0.0), (0.0, 0.25, 0.25), two_sided=True)
    if light == "sphere":
        return SphereLight("s", (origin,) * 3, 0.3, samples=64)
    if light == "tube":
        return TubeLight("s", (origin - 0.5, origin, origin), (origin + 0.5, origin + 0.25, origin), 0.02, samples=16)
    if light == "point":
        return DiscLight("s", (origin,) * 3, (0.0, 0.0, 1.0), 1e-3, two_sided=True)
    return SunDisc("s", (0.25, -0.125, -0.75), 0.25)


# Far apart, so that the scene is large: beside and behind what is between samples and light.
_CORNERS = np.array([(x, y, z) for x in (-4.0, 4.0) for y in (-4.0, 4.0) for z in (-4.0, 4.0)])


def _tracer(names: str, device: str, mesh: geometry.Geometry, count: int) -> ShadowTracer:
    bounds = Bounds(max_triangles=len(mesh[1]), max_rays=max(count, 8), max_lights=8)
    tracer = ShadowTracer(*names.split("/"), device=device, bounds=bounds)
    tracer.scene.put("mesh", *mesh)
    return tracer


def _bits(names: str, device: str, mesh: geometry.Geometry, points: np.ndarray, lamp: Any) -> np.ndarray:
    return _tracer(names, device, mesh, len(points)).light_bits(points, [lamp])[0]


def _specks(tips: np.ndarray, way: np.ndarray, size: float, beside: float) -> geometry.Geometry:
    """Triangles with a corner just before each tip, which lie across a way and to the side of the tip that is away from
    the scene's middle; and specks at the corners of the scene. Each sixteen times, so that it fills a block."""
    across = np.cross(way, (0.3, 0.5, -0.7))
    across /= np.sqrt((across * across).sum())
    other = np.cross(across, way) / np.sqrt((way * way).sum())
    sign = np.where(((tips - beside) * across).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    tips = tips - 0.02 * size * sign * across  # what touches, touches surely
    made = np.stack([tips, tips + size * (sign * across + other), tips + size * (sign * across - other)], axis=1)
    corners = beside + np.stack([_CORNERS, _CORNERS * 1.001, _CORNERS * (1.0, 1.001, 1.0)], axis=1)
    return _sixteen(np.concatenate([made, corners]))


def _sixteen(triangles: np.ndarray) -> geometry.Geometry:
    """A mesh of (K, 3, 3) triangles, each of them sixteen times."""
    return np.repeat(triangles, 16, axis=0).reshape(-1, 3), np.arange(48 * len(triangles)).reshape(-1, 3)


@pytest.mark.parametrize("origin", [0.0, 1e5])
@pytest.mark.parametrize("light", _LIGHTS)
def test_specks_on_the_outermost_rays_of_neighbours(any_device: str, light: str, origin: float) -> None:
    """A speck touches the ray between one of sixteen samples and one point of the light, mostly one that lies at the
    border of what is between all of them. Whoever looks at less than that finds nothing."""
    rng, hidden = np.random.default_rng([28, int(origin)]), 0
    lamp = _lamp(light, origin)
    ends = lamp.homogeneous_points[:, :3]
    for case in range(24):
        size, place = 10.0 ** rng.uniform(-3.0, 0.0), rng.uniform(-2.0, 2.0, 3)
        place[2] = 2.0 + 0.5 * place[2]
        count = int(rng.choice([5, 16, 16, 30]))
        points = origin + place + size * rng.uniform(-1.0, 1.0, (count, 3))
        first = int(np.argmax(((points - origin - place) * rng.normal(size=3)).sum(axis=1)))
        point = int(np.argmax((ends * rng.normal(size=3)).sum(axis=1)))
        way = 3.0 * ends[point] if light == "sun" else ends[point] - points[first]
        tips = points[first] + rng.choice([0.05, 0.3, 0.7, 0.95], (1, 1)) * way
        mesh = _specks(tips, way, 1e-4, origin)
        found = [_bits(names, any_device, mesh, points, lamp) for names in ("bvh/sah", "light_grid/packed")]
        np.testing.assert_array_equal(*found, err_msg=f"case {case}")
        hidden += int(found[0].min() != found[0].max())
    assert hidden > 8


@pytest.mark.parametrize("away", [1.0, 1.9, 2.5, 1e3, 1e6, 1e12])
def test_neighbours_far_from_the_scene(any_device: str, away: float) -> None:
    """A speck in the middle of a small scene on the ray of one of sixteen samples, which are so many extents away."""
    rng = np.random.default_rng(29)
    for _ in range(8):
        turn = rng.normal(size=3)
        turn /= np.sqrt((turn * turn).sum())
        lamp = SphereLight("s", 16.0 * turn, 0.25, samples=64)
        points = -4.0 * away * turn + 0.1 * rng.uniform(-1.0, 1.0, (16, 3))
        way = lamp.points[7] - points[3]
        tips = points[3] - (points[3] * way).sum() / (way * way).sum() * way[None]
        mesh = _specks(tips, way, 1e-3, 0.0)
        found = [_bits(names, any_device, mesh, points, lamp) for names in ("bvh/sah", "light_grid/packed")]
        np.testing.assert_array_equal(*found)


def test_lists_of_many_groups(any_device: str) -> None:
    """Samples along a line past things that stand apart, in any order, some of which do not ask; and frame after frame
    of one tracer."""
    rng = np.random.default_rng(30)
    mesh = geometry.soup(rng, 80, 0.1, 2.0)
    line = np.linspace(-6.0, 6.0, 900)[:, None] * (1.0, 0.25, -0.125) + (0.0, 1.0, 2.0)
    tracers = [_tracer(names, any_device, mesh, 1000) for names in ("bvh/sah", "light_grid/packed")]
    for lamp in (_lamp("tube", 0.0), RectangleLight("s", (0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, 0.5, 0.0), range=4.0)):
        for points in (line, line[::-1], rng.permutation(line), line[::7], line[:3]):
            found = [tracer.light_bits(points, [lamp])[0] for tracer in tracers]
            np.testing.assert_array_equal(*found)
            assert len(np.unique(found[0])) > 3 or len(points) < 900


def test_neighbours_in_the_open_visit_no_node_each(any_device: str) -> None:
    rng = np.random.default_rng(31)
    tracer = _tracer("bvh/sah", any_device, geometry.soup(rng, 3000, 0.05, 1.0), 1600)
    points = np.linspace(-0.5, 0.5, 1600)[:, None] * (1.0, 0.5, 0.0) + (0.0, 0.0, 3.0)
    lamp = RectangleLight("s", (0.0, 0.0, 5.0), (0.25, 0.0, 0.0), (0.0, 0.25, 0.0), two_sided=True)
    counters = probe.trace_points(tracer, points, [lamp]).counters
    if probe.wide(any_device):
        assert counters["nodes_visited"] < len(points)


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("width", [1, 2, 3, 4, 5, 7, 8, 33])
def test_images_of_any_width(any_device: str, width: int, flat: bool) -> None:
    """Every pixel asks, and for itself, in images of any width and height; of a flat wall behind a few things that
    stand apart as well, most of which sees all of the light."""
    rng = np.random.default_rng([32, width])
    mesh = geometry.soup(rng, 80, 0.15, 1.0)
    if flat:
        mesh = _sixteen(rng.uniform(-1.0, 1.0, (6, 1, 3)) * (0.7, 0.9, 0.1) + rng.normal(size=(6, 3, 3)) * 0.05)
    lamp = RectangleLight("s", (0.0, 0.0, -2.0), (0.25, 0.0, 0.0), (0.0, 0.125, 0.0), two_sided=True)
    names = ("bvh/sah", "mesh_bvh/refit", "light_grid/packed")
    tracers = [_tracer(each, any_device, mesh, 33 * 41) for each in names]
    for height in (1, 3, 4, 6, 9, 41):
        pose, focal = geometry.pose_of(np.eye(3), (0, 0, -3)), 60.0 if flat else 12.0
        camera = Camera(width, height, focal, focal, 0.5 * width, 0.5 * height, pose)
        depth = np.full((height, width), 4.0) if flat else rng.uniform(2.0, 6.0, (height, width))
        depth[rng.random((height, width)) < (0.01 if flat else 0.1)] = 0.0
        found = [tracer.trace(depth.astype(np.float32), camera, [lamp]).light_bits("s") for tracer in tracers]
        np.testing.assert_array_equal(found[0], found[2])
        np.testing.assert_array_equal(found[1], found[2])
