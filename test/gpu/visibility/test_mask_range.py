# SPDX-License-Identifier: Apache-2.0
"""Which points of a flat light a triangle may touch at all: ranges leave out no point that is hidden."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, DiscLight, RectangleLight, ShadowTracer, SphereLight, SunDisc, TubeLight
from shadow_tracer.gpu.exact import mask_range

_ORIGINS = {"near": 0.0, "far": 1e5}


def _bits(names: str, device: str, mesh: geometry.Geometry, points: np.ndarray, light: Any) -> np.ndarray:
    bounds = Bounds(max_triangles=len(mesh[1]), max_rays=max(len(points), 8), max_lights=8)
    tracer = ShadowTracer(*names.split("/"), device=device, bounds=bounds)
    tracer.scene.put("mesh", *mesh)
    return tracer.light_bits(points, [light])[0]


def _same(mesh: geometry.Geometry, points: np.ndarray, light: Any, device: str) -> np.ndarray:
    """The bits, which are those of the points as hard lights."""
    found = [_bits(names, device, mesh, points, light) for names in ("bvh/sah", "light_grid/packed")]
    np.testing.assert_array_equal(*found)
    return found[0]


def _panel(rng: np.random.Generator, half: float, sine: float, origin: float) -> RectangleLight:
    """Ten metres in front of a sample at the origin, seen at so small a sine to its plane."""
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    across = np.cross(way, rng.normal(size=3))
    across /= np.linalg.norm(across)
    slope = np.sqrt(1.0 - sine**2) * way + sine * np.cross(way, across)
    one, two = (across, slope) if rng.random() < 0.5 else (slope, -across)
    return RectangleLight("s", origin + 10.0 * way, half * one, half * two, two_sided=True)


@pytest.mark.parametrize("origin", _ORIGINS)
@pytest.mark.parametrize("half", [1e-3, 1e-2, 0.1, 1.0])
@pytest.mark.parametrize("sine", [2e-3, 0.01, 0.1, 1.0])
def test_corners_on_rays_to_small_panels_at_grazing_angles(
    any_device: str, half: float, sine: float, origin: str
) -> None:
    """Triangles smaller than what is between points, each with a corner on a ray, near the sample, half way and near
    the light: pads that are constants lose some of them."""
    rng, sample = np.random.default_rng([18, int(1e4 * half), int(1e4 * sine)]), np.full((1, 3), _ORIGINS[origin])
    bits = []
    for _ in range(3):
        lamp, count = _panel(rng, half, sine, _ORIGINS[origin]), 150
        ways = lamp.points[rng.integers(0, 64, count)] - sample
        shares = rng.choice([0.02, 0.1, 0.5, 0.9], (count, 1)) * rng.uniform(0.9, 1.1, (count, 1))
        sizes = 0.1 * half * sine * shares
        first, second = rng.normal(size=(2, count, 3)) * sizes[None]
        # A corner on the ray, of which the others lie to one side.
        tips = sample + shares * ways
        corners = np.stack([tips, tips + np.abs(first), tips + np.abs(first) + 0.5 * second], axis=1)
        mesh = corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
        bits.append(int(_same(mesh, sample, lamp, any_device)[0]))
    assert any(0 < each.bit_count() < 64 for each in bits)


def test_corners_beside_and_behind_the_sample(any_device: str) -> None:
    """Triangles around samples, whose corners are on either side of them: those have no ranges."""
    rng = np.random.default_rng(19)
    lamp = RectangleLight("s", (0.0, 0.0, 3.0), (0.5, 0.0, 0.0), (0.0, 0.5, 0.0), two_sided=True)
    points = rng.uniform(-1.0, 1.0, (60, 3)) * (1.0, 1.0, 0.2)
    places = points + rng.normal(size=(60, 3)) * (0.1, 0.1, 0.0) + (0.0, 0.0, 0.05)
    one, two = rng.normal(size=(2, 60, 3)) * (0.05, 0.05, 0.3)
    flat = rng.random(60) < 0.3  # a corner as high as the sample, across the way to the light
    corners = np.stack([places + one, places + two, places - one - two], axis=1)
    corners[flat, 0, 2] = points[flat, 2]
    bits = _same((corners.reshape(-1, 3), np.arange(180).reshape(-1, 3)), points, lamp, any_device)
    assert len(np.unique(bits)) > 20


@pytest.mark.parametrize("away", [0.0, 1e-9, 1e-4, 1e-3, 0.01])
def test_samples_in_the_plane_of_the_light(any_device: str, away: float) -> None:
    rng = np.random.default_rng(20)
    lamp = RectangleLight("s", (0.0, 0.0, 0.0), (0.5, 0.0, 0.25), (-0.125, 0.5, 0.25), two_sided=True)
    normal = np.cross(lamp.u, lamp.v)
    aside = rng.uniform(-3.0, 3.0, (150, 2))
    points = aside[:, :1] * lamp.u + aside[:, 1:] * lamp.v + away * normal / np.linalg.norm(normal)
    mesh = geometry.soup(rng, 200, 0.3, 1.5)
    assert len(np.unique(_same(mesh, points, lamp, any_device))) > 20


_LAMPS: dict[str, Any] = {
    "panel": RectangleLight("s", (0.1, -0.2, 0.3), (0.3, 0.1, 0.0), (-0.1, 0.3, 0.0), two_sided=True),
    "strip": RectangleLight("s", (0.1, -0.2, 0.3), (1.5, 0.0, 0.1), (0.0, 0.01, 0.0), two_sided=True, samples=33),
    "disc": DiscLight("s", (0.1, -0.2, 0.3), (0.2, 0.1, 1.0), 0.5, two_sided=True, samples=50),
    "sun": SunDisc("s", (0.25, -0.125, -0.75), 0.125),
}


@pytest.mark.parametrize("light", _LAMPS)
def test_small_triangles_in_any_order_of_samples(any_device: str, light: str) -> None:
    rng, lamp = np.random.default_rng(21), _LAMPS[light]
    vertices, triangles = geometry.soup(rng, 600, 0.06, 1.5)
    points = rng.uniform(-2.0, 3.0, (300, 3))
    bits = _same((vertices, triangles), points, lamp, any_device)
    assert len(np.unique(bits)) > 20
    order = rng.permutation(len(points))
    np.testing.assert_array_equal(_bits("bvh/sah", any_device, (vertices, triangles), points[order], lamp), bits[order])


def test_ranges_spare_most_pairs(any_device: str) -> None:
    """Of a mesh of triangles smaller than what is between points few are asked about any point."""
    rng = np.random.default_rng(22)
    shown = []
    for lamp in (_LAMPS["panel"], SphereLight("s", (0.1, -0.2, 0.3), 0.3, samples=64)):
        tracer = ShadowTracer("bvh", "sah", any_device, Bounds(max_triangles=2000, max_rays=400))
        tracer.scene.put("mesh", *geometry.soup(rng, 2000, 0.02, 1.5))
        shown.append(probe.trace_points(tracer, rng.uniform(-2.0, 3.0, (400, 3)), [lamp]).counters["leaf_tests"])
    if probe.wide(any_device):
        assert 5 * shown[0] < shown[1]


def test_sides_of_lights() -> None:
    for lamp in (_LAMPS["panel"], _LAMPS["strip"], _LAMPS["disc"]):
        offsets = lamp.points - lamp.position
        found = mask_range.sides_of(offsets)
        assert found is not None
        (one, two), beyond = found
        assert abs(one @ two) <= 1e-12
        places = [offsets @ side / (side @ side) for side in (one, two)]
        assert all(np.abs(place).max() <= 1.0 + 1e-12 for place in places)
        for place, row in zip(places, beyond, strict=True):
            for number, bits in enumerate(row):
                edge = 2.0 * number / mask_range.BINS - 1.0
                mine = {k for k in range(lamp.samples) if int(bits) >> k & 1}
                assert mine >= set(np.flatnonzero(place > edge + 1e-9)) - {
                    k for k in range(64) if number == len(row) - 1
                }
                assert not mine & set(np.flatnonzero(place < edge - 1e-9))
    for lamp in (SphereLight("s", (0, 0, 1), 0.5, samples=64), TubeLight("s", (0, 0, 0), (1, 0, 0), 0.1)):
        assert mask_range.sides_of(lamp.points - lamp.position) is None
    line = TubeLight("s", (0, 0, 0), (1, 0, 0))
    assert mask_range.sides_of(line.points - line.position) is None
