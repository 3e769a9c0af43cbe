# SPDX-License-Identifier: Apache-2.0
"""Masks of light points by the float32 filter: where it must not be sure, and where it must be."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, DiscLight, RectangleLight, ShadowTracer, SphereLight, SunDisc, TubeLight

pytestmark = probe.in_both_forms

_WALKERS = ["bvh/sah", "bvh/median"]
_LIGHTS: dict[str, Any] = {
    "rectangle": RectangleLight("s", (0.1, -0.2, 0.3), (0.3, 0.1, 0.0), (-0.1, 0.3, 0.0), two_sided=True),
    "disc": DiscLight("s", (0.1, -0.2, 0.3), (0.2, 0.1, 1.0), 0.01, two_sided=True, samples=50),
    "sphere": SphereLight("s", (0.1, -0.2, 0.3), 0.2, samples=64),
    "line": TubeLight("s", (-0.5, -0.2, 0.3), (0.6, 0.2, 0.2)),
    "sun": SunDisc("s", (0.25, -0.125, -0.75), 0.125),
    "small": SphereLight("s", (0.1, -0.2, 0.3), 1e-7, samples=64),
}


def _same(mesh: geometry.Geometry, points: np.ndarray, light: Any, bias: float, names: str, device: str) -> np.ndarray:
    """The bits, which are those of the points as hard lights."""
    found = []
    for each in (names, "light_grid/packed"):
        bounds = Bounds(max_triangles=len(mesh[1]), max_rays=len(points), max_lights=8)
        tracer = ShadowTracer(*each.split("/"), device=device, bounds=bounds)
        tracer.scene.put("mesh", *mesh)
        found.append(tracer.light_bits(points, [light], bias))
    np.testing.assert_array_equal(*found)
    return found[0]


def _some_reach(bits: np.ndarray, light: Any) -> bool:
    share = np.mean([int(each).bit_count() for each in bits.ravel()]) / light.samples
    return bool(0.02 < share < 0.98)


def _rays(rng: np.random.Generator, count: int, light: Any) -> tuple[np.ndarray, np.ndarray]:
    """Samples, and the ways to one point each."""
    points = rng.uniform(-1.0, 1.0, (count, 3)) * (3.0, 3.0, 0.5) + (0.0, 0.0, 3.0)
    places = light.homogeneous_points[rng.integers(0, light.samples, count)]
    return points, places[:, :3] - places[:, 3:] * points


@pytest.mark.parametrize("names", _WALKERS)
@pytest.mark.parametrize("light", _LIGHTS)
@pytest.mark.parametrize("far", [0.0, 3e4])
def test_edges_within_roundings_of_float32(any_device: str, names: str, light: str, far: float) -> None:
    """Edges past a ray by 1e-9 to 1e-4 of the scene, near the sample, half way and near the light; large triangles and
    small ones; also of a sample far outside of the scene."""
    rng, lamp = np.random.default_rng(8), _LIGHTS[light]
    count = 300
    points, ways = _rays(rng, count, lamp)
    shares = 10.0 ** rng.uniform(-3.0, -0.01, (count, 1))
    middles = points + shares * ways
    sizes = 10.0 ** rng.uniform(-4.0, -0.5, (count, 1))
    along, aside = rng.normal(size=(2, count, 3)) * sizes
    off = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-9.0, -4.0, (count, 1))
    corners = np.stack([middles + along, middles - along, middles + aside], axis=1) + off[:, None]
    if far:
        # Rays of far samples through the same places.
        points = middles - ways * (far / np.linalg.norm(ways, axis=1)[:, None])
    mesh = corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
    for bias in (0.0, 0.01):
        bits = _same(mesh, points, lamp, bias, names, any_device)
    assert far or _some_reach(bits, lamp)


@pytest.mark.parametrize("names", _WALKERS)
@pytest.mark.parametrize("light", _LIGHTS)
def test_planes_within_roundings_of_samples_starts_and_points(any_device: str, names: str, light: str) -> None:
    """Large triangles whose plane goes by the sample, the biased start or the point of the light, or has the ray in it,
    but for 1e-9 to 1e-4 of the scene."""
    rng, lamp = np.random.default_rng(9), _LIGHTS[light]
    count, bias = 300, 0.125
    points, ways = _rays(rng, count, lamp)
    lengths = np.linalg.norm(ways, axis=1)[:, None]
    starts = points + ways * (bias / lengths)
    ends = starts + ways if light == "sun" else points + ways
    # A few at the light, which hide it from many.
    places = np.stack([points, starts, ends])[rng.choice(3, count, p=(0.49, 0.49, 0.02)), np.arange(count)]
    places += rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-9.0, -4.0, (count, 1))
    one, two = rng.normal(size=(2, count, 3))
    grazing = rng.random(count) < 0.3
    one[grazing] = (ways + rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-8.0, -2.0, (count, 1)))[grazing]
    size = 10.0 ** rng.uniform(-3.0, -1.5, (count, 1))
    corners = np.stack([places + size * one, places + size * two, places - size * (one + two)], axis=1)
    mesh = corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
    for many in (0.0, bias):
        bits = _same(mesh, points, lamp, many, names, any_device)
        assert len(np.unique(bits)) > 5 or light in ("small", "disc")


@pytest.mark.parametrize("names", _WALKERS)
@pytest.mark.parametrize("light", ["rectangle", "sphere", "line"])
def test_points_of_the_light_within_roundings_of_triangles(any_device: str, names: str, light: str) -> None:
    """A small triangle at each point of the light, whose plane goes by it but for 1e-9 to 1e-6 of the scene: whether
    the point is beyond the plane is all that matters."""
    rng, lamp = np.random.default_rng(16), _LIGHTS[light]
    points, _ = _rays(rng, 200, lamp)
    places = lamp.points + rng.normal(size=(64, 3)) * 10.0 ** rng.uniform(-9.0, -6.0, (64, 1))
    along, aside = rng.normal(size=(2, 64, 3)) * (0.02, 0.02, 0.002)
    corners = np.stack([places + along, places - along + aside, places - along - aside], axis=1)
    mesh = corners.reshape(-1, 3), np.arange(192).reshape(-1, 3)
    assert _some_reach(_same(mesh, points, lamp, 0.0, names, any_device), lamp)


@pytest.mark.parametrize("names", _WALKERS)
def test_triangles_far_off_and_steep_before_the_sun(any_device: str, names: str) -> None:
    """Farther from samples than the scene is large, times the cosine between their normals and the rays: at infinity
    only the cosine's sign matters."""
    rng = np.random.default_rng(15)
    points = rng.uniform(-1.0, 1.0, (200, 3)) * (1.0, 1.0, 0.01)
    middles = rng.uniform(-1.0, 1.0, (80, 3)) * (1.0, 1.0, 0.1) + (0.0, 0.0, 4.0)
    along, aside = rng.normal(size=(2, 80, 3)) * (0.2, 0.2, 0.6)
    mesh = (
        np.stack([middles + along, middles - along, middles + aside], axis=1).reshape(-1, 3),
        np.arange(240).reshape(-1, 3),
    )
    lamp = SunDisc("s", (0.0, 0.0, -1.0), 0.125)
    assert _some_reach(_same(mesh, points, lamp, 0.0, names, any_device), lamp)


@pytest.mark.parametrize("names", _WALKERS)
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_sheets_with_corners_on_all_rays(any_device: str, names: str, offset: float) -> None:
    """Triangles whose corners lie on the rays from a sample to the points of a light, in planes of any direction."""
    rng = np.random.default_rng(10)
    origin = np.array((offset, -offset, 0.5 * offset))
    lamp = RectangleLight("s", (0.25, 1.0, 2.0) + origin, (0.5, 0.0, 0.25), (0.0, 0.5, 0.0), two_sided=True)
    sample = np.array((0.1, 0.2, -1.0)) + origin
    triples = np.stack([np.arange(62), np.arange(1, 63), np.arange(2, 64)], axis=1)
    vertices = []
    for _ in range(4):
        normal, place = rng.normal(size=3) + (0.0, 0.0, 3.0), rng.uniform(0.2, 0.8)
        ways = lamp.points - sample
        shares = place * (normal @ (lamp.position - sample)) / (ways @ normal)
        vertices.append(sample + shares[:, None] * ways)
    for sheet in vertices:
        some = triples[rng.random(len(triples)) < 0.5]
        bits = _same((sheet, some), np.stack([sample, sample + 1e-7, sample - 0.01]), lamp, 0.0, names, any_device)
        assert int(bits[0, 0]) != 2**64 - 1


@pytest.mark.parametrize("names", _WALKERS)
def test_integers_full_of_ties(any_device: str, names: str) -> None:
    """Samples, points of the light and corners on a small lattice: rays through corners, along edges and in planes."""
    rng = np.random.default_rng(11)
    mesh = geometry.integer_soup(rng, 300)
    span = np.abs(mesh[0]).max()
    points = rng.integers(-span, span + 1, (400, 3)).astype(float)
    lamp = RectangleLight("s", (0.0, 0.0, 2.0 * span), (8.0, 0.0, 0.0), (0.0, 8.0, 0.0), two_sided=True, samples=4)
    for bias in (0.0, 1.0):
        _same(mesh, points, lamp, bias, names, any_device)
    _same(mesh, points, SunDisc("s", (0, 0, -1), samples=4), 0.0, names, any_device)


@pytest.mark.parametrize("names", _WALKERS)
def test_any_order_of_samples(any_device: str, names: str) -> None:
    """What hid points from the sample before is tried first: that changes no bit."""
    rng, lamp = np.random.default_rng(12), _LIGHTS["sphere"]
    mesh = geometry.soup(rng, 400, 0.6, 2.5)
    points = rng.uniform(-2.0, 4.0, (1500, 3))
    order = rng.permutation(len(points))
    bounds = Bounds(max_triangles=400, max_rays=1500)
    tracer = ShadowTracer(*names.split("/"), device=any_device, bounds=bounds)
    tracer.scene.put("mesh", *mesh)
    bits = tracer.light_bits(points, [lamp])[0]
    assert len(np.unique(bits)) > 50
    np.testing.assert_array_equal(tracer.light_bits(points[order], [lamp])[0], bits[order])
    np.testing.assert_array_equal(np.array([tracer.light_bits(p[None], [lamp])[0, 0] for p in points[:40]]), bits[:40])


@pytest.mark.parametrize("names", _WALKERS)
@pytest.mark.parametrize("metres", [1e-40, 1e-14, 1e-9, 1e12, 1e18, 1e36])
def test_lengths_beyond_those_of_the_filter(any_device: str, names: str, metres: float) -> None:
    """Scenes of a size that float32 products cannot hold, and next to that."""
    rng = np.random.default_rng(13)
    vertices, triangles = geometry.soup(rng, 200, 0.5, 2.5)
    points = rng.uniform(-2.0, 4.0, (300, 3)) * metres
    lamp = SphereLight("s", np.array((0.1, -0.2, 0.3)) * metres, 0.2 * metres, samples=64)
    assert _some_reach(_same((vertices * metres, triangles), points, lamp, 0.0, names, any_device), lamp)


@pytest.mark.parametrize("names", _WALKERS)
def test_few_pairs_are_left_for_the_exact_decision(any_device: str, names: str) -> None:
    """The filter is sure of nearly all: of 64 points of a light, fewer than one for each sample is decided again."""
    rng, lamp = np.random.default_rng(14), _LIGHTS["rectangle"]
    tracer = ShadowTracer(*names.split("/"), device=any_device, bounds=Bounds(max_triangles=400, max_rays=1500))
    tracer.scene.put("mesh", *geometry.soup(rng, 400, 0.6, 2.5))
    counters = probe.trace_points(tracer, rng.uniform(-2.0, 4.0, (1500, 3)), [lamp]).counters
    assert counters["rays"] == 64 * 1500 and counters["leaf_tests"] > 1500
    assert counters["retested"] < 1500
