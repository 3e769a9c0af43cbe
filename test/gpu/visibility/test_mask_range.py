# SPDX-License-Identifier: Apache-2.0
"""Which points of a flat light or a tube triangles and boxes may touch at all: ranges leave out no point that is
hidden."""

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
        mesh = _tips(rng, lamp, sample, 0.1 * half * sine, count, [0.02, 0.1, 0.5, 0.9])
        bits.append(int(_same(mesh, sample, lamp, any_device)[0]))
    assert any(0 < each.bit_count() < 64 for each in bits)


def _tube(rng: np.random.Generator, away: float, sine: float, radius: float, origin: float) -> TubeLight:
    """Of half length 1, whose axis passes the sample so far away, and whose middle is seen at such a sine."""
    axis, aside = rng.normal(size=(2, 3))
    axis /= np.sqrt((axis * axis).sum())
    aside = np.cross(axis, aside)
    aside /= np.sqrt((aside * aside).sum())
    middle = origin + away * aside + away * np.sqrt(1.0 - sine * sine) / sine * axis
    return TubeLight("s", middle - axis, middle + axis, radius)


def _tips(
    rng: np.random.Generator, lamp: Any, sample: np.ndarray, size: float, count: int, shares: list[float]
) -> geometry.Geometry:
    """So many triangles with a corner on a ray from the sample to a point of the light, of which the others lie to one
    side."""
    ways = lamp.points[rng.integers(0, lamp.samples, count)] - sample
    along = rng.choice(shares, (count, 1)) * rng.uniform(0.9, 1.1, (count, 1))
    first, second = rng.normal(size=(2, count, 3)) * (size * along)[None]
    tips = sample + along * ways
    corners = np.stack([tips, tips + np.abs(first), tips + np.abs(first) + 0.5 * second], axis=1)
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


@pytest.mark.parametrize("origin", _ORIGINS)
@pytest.mark.parametrize("radius", [0.0, 1e-3, 0.05, 0.2])
@pytest.mark.parametrize("away", [0.02, 0.3, 1.0, 10.0])
@pytest.mark.parametrize("sine", [2e-3, 0.1, 0.4, 1.0])
def test_corners_on_rays_to_tubes(any_device: str, sine: float, away: float, radius: float, origin: str) -> None:
    """Seen from the side and nearly from an end, from near by and from within as well."""
    rng = np.random.default_rng([24, int(1e4 * sine), int(1e4 * away), int(1e4 * radius)])
    sample = np.full((1, 3), _ORIGINS[origin])
    for _ in range(2):
        lamp = _tube(rng, away, sine, radius, _ORIGINS[origin])
        mesh = _tips(rng, lamp, sample, 0.01 * min(away, 1.0), 150, [0.02, 0.1, 0.5, 0.9])
        # No point is seen but where the exact test says that its triangle just misses.
        _same(mesh, np.concatenate([sample, sample + 0.01 * away]), lamp, any_device)


@pytest.mark.parametrize("light", ["panel", "tube"])
def test_boxes_around_and_behind_samples(any_device: str, light: str) -> None:
    """Samples in and around many boxes of different sizes, some of which reach behind them."""
    rng, lamp = np.random.default_rng(25), _LAMPS[light]
    points = rng.uniform(-1.0, 1.5, (100, 3))
    meshes = [_tips(rng, lamp, point, 0.02, 8, [0.01, 0.1, 0.6]) for point in points]
    vertices = np.concatenate([mesh[0] for mesh in meshes])
    vertices = np.concatenate([vertices, geometry.soup(rng, 12, 0.6, 1.5)[0]])
    bits = _same((vertices, np.arange(len(vertices)).reshape(-1, 3)), points, lamp, any_device)
    assert len(np.unique(bits)) > 20


def test_columns_of_triangles(any_device: str) -> None:
    """Boxes that are long along the way to the light, of which what is nearest reaches farthest to a side."""
    rng, sample = np.random.default_rng(26), np.zeros((1, 3))
    for _ in range(10):
        lamp = RectangleLight("s", (0.0, 0.0, 10.0), (6.0, 0.0, 0.0), (0.0, 6.0, 0.0), two_sided=True)
        vertices, _ = _tips(rng, lamp, sample, 0.02, 14, [0.1, 0.2])
        depths = np.linspace(0.0, 1.5, 9)[:, None, None, None] * (0.0, 0.0, 1.0)
        column = (vertices.reshape(-1, 3, 3) + depths * vertices.reshape(-1, 3, 3)[:, :1, 2:]).reshape(-1, 3)
        _same((column, np.arange(len(column)).reshape(-1, 3)), sample, lamp, any_device)


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
    "tube": TubeLight("s", (-0.9, -0.3, 0.1), (1.0, 0.1, 0.5), 0.06),
    "line": TubeLight("s", (-0.9, -0.3, 0.1), (1.0, 0.1, 0.5), samples=20),
    "two": TubeLight("s", (-0.9, -0.3, 0.1), (1.0, 0.1, 0.5), samples=2),
}


@pytest.mark.parametrize("light", _LAMPS)
def test_small_triangles_in_any_order_of_samples(any_device: str, light: str) -> None:
    rng, lamp = np.random.default_rng(21), _LAMPS[light]
    vertices, triangles = geometry.soup(rng, 600, 0.06, 1.5)
    points = rng.uniform(-2.0, 3.0, (300, 3))
    bits = _same((vertices, triangles), points, lamp, any_device)
    assert len(np.unique(bits)) > min(20, 2**lamp.samples - 1)
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
    for name, lamp in _LAMPS.items():
        if name == "sun":
            continue
        offsets = lamp.points - lamp.position
        sides = mask_range.sides_of(offsets)
        assert sides is not None
        round_ = name in ("tube", "line", "two")
        assert (sides.radius > 0.0) == round_
        assert abs((sides.u * sides.v).sum()) <= 1e-12
        for number, side in enumerate([sides.u] if round_ else [sides.u, sides.v]):
            place = (offsets * side).sum(axis=1) / (side * side).sum()
            assert np.abs(place).max() <= 1.0 + 1e-12
            _check_table(place, sides.beyond[number])
        if round_:
            everything = np.uint64((1 << lamp.samples) - 1)
            assert sides.beyond[1, 0] == everything and sides.beyond[1, -1] == 0
            along = (offsets * sides.u).sum(axis=1, keepdims=True) / (sides.u * sides.u).sum()
            assert np.sqrt(((offsets - along * sides.u) ** 2).sum(axis=1)).max() <= sides.radius


def _check_table(place: np.ndarray, row: np.ndarray) -> None:
    """Points at ``place``, from -1 to 1."""
    for number, bits in enumerate(row):
        edge = 2.0 * number / mask_range.BINS - 1.0
        mine = {k for k in range(len(place)) if int(bits) >> k & 1}
        last = set(range(64)) if number == len(row) - 1 else set()
        assert mine >= set(np.flatnonzero(place > edge + 1e-9)) - last
        assert not mine & set(np.flatnonzero(place < edge - 1e-9))


def test_lights_without_ranges() -> None:
    for lamp in (SphereLight("s", (0, 0, 1), 0.5, samples=64), TubeLight("s", (0, 0, 0), (1, 0, 0), 0.3)):
        assert mask_range.sides_of(lamp.points - lamp.position) is None
