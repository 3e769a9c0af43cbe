# SPDX-License-Identifier: Apache-2.0
"""Lights of few points, which are judged one by one against sixteen triangles; and samples on triangles that follow
each other, each mostly hidden by its own."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, RectangleLight, ShadowTracer, SphereLight, SunDisc, TubeLight

pytestmark = probe.in_both_forms

_LIGHTS: dict[str, Any] = {
    "line": TubeLight("s", (-0.5, -0.2, 0.3), (0.6, 0.2, 0.2), samples=8),
    "tube": TubeLight("s", (-0.5, -0.2, 0.3), (0.6, 0.2, 0.2), 0.02, samples=16),
    "one more": TubeLight("s", (-0.5, -0.2, 0.3), (0.6, 0.2, 0.2), 0.02, samples=17),
    "panel": RectangleLight("s", (0.1, -0.2, 0.3), (0.3, 0.1, 0.0), (-0.1, 0.3, 0.0), two_sided=True, samples=5),
    "sphere": SphereLight("s", (0.1, -0.2, 0.3), 0.2, samples=9),
    "small": SphereLight("s", (0.1, -0.2, 0.3), 1e-4, samples=32),
    "sun": SunDisc("s", (0.25, -0.125, -0.75), 0.125, samples=7),
}


def _tracer(names: str, device: str, triangles: int, **more: Any) -> ShadowTracer:
    bounds = Bounds(max_triangles=triangles, max_rays=4000, max_lights=8)
    return ShadowTracer(*names.split("/"), device=device, bounds=bounds, **more)


def _same(mesh: geometry.Geometry, points: np.ndarray, light: Any, device: str, bias: float, **more: Any) -> np.ndarray:
    """The bits, which are those of the points as hard lights."""
    found = []
    for names in ("bvh/sah", "light_grid/packed"):
        tracer = _tracer(names, device, len(mesh[1]), **more)
        tracer.scene.put("mesh", *mesh)
        found.append(tracer.light_bits(points, [light], bias)[0])
    np.testing.assert_array_equal(*found)
    return found[0]


@pytest.mark.parametrize("cull", [False, True])
@pytest.mark.parametrize("light", _LIGHTS)
def test_edges_and_planes_within_roundings(any_device: str, light: str, cull: bool) -> None:
    """Edges past a ray by 1e-9 to 1e-4 of the scene, sixteen triangles at a place, so that they are in a block; planes
    that go by the sample, the biased start, or the point; triangles of both sides, front faces culled or not."""
    rng, lamp = np.random.default_rng(40), _LIGHTS[light]
    points = rng.uniform(-1.0, 1.0, (300, 3)) * (3.0, 3.0, 0.5) + (0.0, 0.0, 3.0)
    ends = lamp.homogeneous_points[rng.integers(0, lamp.samples, 300)]
    ways = ends[:, :3] - ends[:, 3:] * points
    shares = rng.choice([1e-3, 0.03, 0.5, 0.97, 1.0], (300, 1), p=[0.4, 0.3, 0.26, 0.02, 0.02])
    middles = np.repeat(points + shares * ways, 16, axis=0)
    size = np.repeat(shares * 10.0 ** rng.uniform(-3.0, -0.4, (300, 1)), 16, axis=0)
    along, aside = rng.normal(size=(2, 4800, 3)) * size
    off = rng.normal(size=(4800, 3)) * 10.0 ** rng.uniform(-9.0, -3.0, (4800, 1))
    corners = np.stack([middles + along, middles - along, middles + aside], axis=1) + off[:, None]
    kept = corners[rng.random(4800) < 0.1]  # so that not all is hidden
    mesh = kept.reshape(-1, 3), np.arange(3 * len(kept)).reshape(-1, 3)
    for bias in (0.0, 0.01):
        bits = _same(mesh, points, lamp, any_device, bias, front_face_culling=cull)
        assert len(np.unique(bits)) > 5


def _sheet(rng: np.random.Generator, cells: int, bumps: float) -> geometry.Geometry:
    """Squares of 0.1 m around the origin, in two triangles each, one after the other."""
    across = 0.1 * (np.arange(cells + 1) - 0.5 * cells)
    x, y = np.meshgrid(across, across)
    vertices = np.stack([x, y, bumps * rng.uniform(-1.0, 1.0, x.shape)], axis=-1).reshape(-1, 3)
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1, 1)
    squares = first + np.array([0, 1, cells + 1, cells + 1, 1, cells + 2])
    return vertices, squares.reshape(-1, 3).astype(np.int32)


def _in_front(mesh: geometry.Geometry, lift: float) -> np.ndarray:
    """A point in front of the middle of each triangle."""
    a, b, c = (mesh[0][mesh[1][:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.sqrt((normals * normals).sum(axis=1))[:, None]
    return (a + b + c) / 3.0 + lift * normals


@pytest.mark.parametrize(("bumps", "samples"), [(0.0, 3), (0.02, 16), (0.2, 16), (0.02, 64)])
def test_samples_on_triangles_that_follow_each_other(any_device: str, bumps: float, samples: int) -> None:
    """A sheet seen by lamps behind and before it, from far off and from near its plane, where triangles hide some
    points of the light from their samples; it moves from frame to frame, another mesh comes before it, a lamp ignores
    it, some of it is no number, and samples come in another order."""
    rng = np.random.default_rng([41, samples])
    mesh, names = _sheet(rng, 24, bumps), ("bvh/sah", "light_grid/packed")
    tracers = [_tracer(each, any_device, 1400) for each in names]
    points = _in_front(mesh, 1e-3)
    partly = 0
    for number, (height, radius) in enumerate([(-1.0, 0.02), (-0.02, 0.01), (0.02, 0.01), (2.0, 0.1), (-0.3, 0.01)]):
        lamps = [TubeLight("s", (-0.5, 1.3, height), (0.7, 1.3, height + 0.1), radius, samples=samples)]
        lamps += [TubeLight("t", (-0.5, 1.3, height), (0.7, 1.3, height), radius, samples=samples, ignore=("sheet",))]
        vertices = mesh[0] + (0.0, 0.0, 1e-6 * number)
        if number == 3:
            vertices[200:300] = np.nan
        for tracer in tracers:
            if number in (0, 2):
                if number:
                    tracer.scene.put("before", *geometry.square(2, 0.2, -0.5))
                tracer.scene.put("sheet", vertices, mesh[1])
            else:
                tracer.scene.deform("sheet", vertices, nonfinite="skip")
        for some in (points, points[::-1], points[::3], rng.permutation(points)):
            found = [tracer.light_bits(some, lamps) for tracer in tracers]
            np.testing.assert_array_equal(*found)
            open_points = np.array([int(bits).bit_count() for bits in found[0][0]])
            partly += int(((open_points > 0) & (open_points < samples)).sum())
    assert partly > 100


def test_samples_turned_away_visit_no_node_each(any_device: str) -> None:
    mesh = _sheet(np.random.default_rng(42), 24, 0.0)
    tracer = _tracer("bvh/sah", any_device, len(mesh[1]))
    tracer.scene.put("sheet", *mesh)
    lamp = TubeLight("s", (-0.5, 0.2, -2.0), (0.7, 0.2, -2.0), 0.01, samples=64)
    traced = probe.trace_points(tracer, _in_front(mesh, 1e-3), [lamp])
    assert traced.counters["rays"] == 64 * len(mesh[1])
    if probe.wide(any_device):
        assert traced.counters["nodes_visited"] < len(mesh[1])
