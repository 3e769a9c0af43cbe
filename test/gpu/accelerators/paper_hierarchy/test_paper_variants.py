# SPDX-License-Identifier: Apache-2.0
"""The seven variants of the paper as pipelines: the bits of brute force for every number of rays, shape of image and
capacity of queues, and the counts that each idea promises."""

from __future__ import annotations

from functools import cache

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, ShadowTracer, SpotLight

VARIANTS = ("precise", "precise_sorted", "spheres", "spheres_sorted", "precise_sea", "precise_eatp", "precise_seatp")
ACCEPTING = VARIANTS[4:]
BOUNDS = {"max_triangles": 6000, "max_rays": 20000, "max_lights": 8, "grid_entries": 1}
LIGHTS = [
    PointLight("near", (0.4, 0.3, 1.4)),
    PointLight("among", (0.05, -0.02, 2.1)),
    SpotLight("spot", (1.0, -2.0, -1.0), (-0.2, 0.5, 0.9), 0.7),
    PointLight("far", (3e3, -6e3, -8e3)),
    DirectionalLight("sun", (-0.2, 0.4, 0.9)),
]


def _tracer(device: str, pipeline: str, variant: str, capacity: int = 100_000) -> ShadowTracer:
    return probe.reset(_shared(device, pipeline, variant, capacity))


@cache
def _shared(device: str, pipeline: str, variant: str, capacity: int) -> ShadowTracer:
    return ShadowTracer(
        pipeline=pipeline, variant=variant, device=device, bounds=Bounds(**BOUNDS, queue_capacity=capacity)
    )


def _clutter(seed: int, count: int = 300) -> geometry.Geometry:
    rng = np.random.default_rng(seed)
    near = geometry.soup(rng, count, 0.15, 1.2)
    return geometry.join(
        [(near[0] + [0.0, 0.0, 1.6], near[1]), geometry.soup(rng, 5, 3.0, 4.0), geometry.slivers(rng, 40, spread=2.0)]
    )


def _depth(width: int, height: int, valid: float, seed: int = 5) -> np.ndarray:
    """A surface with steps; all but a share of its pixels invalid, in every way a pixel can be."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[0:height, 0:width]
    depth = 2.0 + 0.4 * np.sin(0.31 * u) + 0.7 * ((u // 5 + v // 7) % 3 == 0)
    bad = rng.uniform(size=depth.shape) >= valid
    depth[bad] = rng.choice([np.nan, np.inf, -np.inf, 0.0, -1.0], bad.sum())
    return depth.astype(np.float32)


def _camera(width: int, height: int) -> Camera:
    focal = 0.8 * max(width, height)
    return Camera(width, height, focal, focal, 0.5 * width - 0.5, 0.5 * height - 0.5)


def _states(tracer: ShadowTracer, mesh: geometry.Geometry, depth: np.ndarray, bias: float) -> tuple[np.ndarray, dict]:
    tracer.scene.clear()
    tracer.scene.put("mesh", *mesh)
    frame = tracer.trace(depth, _camera(depth.shape[1], depth.shape[0]), LIGHTS, bias)
    return np.stack([frame.state(name) for name in frame.names]), frame.counters


@cache
def _expected(device: str, width: int, height: int, valid: float, bias: float) -> np.ndarray:
    brute = _tracer(device, "brute_force", "filtered")
    return _states(brute, _clutter(1), _depth(width, height, valid), bias)[0]


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(
    ("width", "height", "valid"),
    [(64, 48, 1.0), (61, 37, 0.7), (61, 37, 0.05), (1, 200, 0.8), (203, 1, 0.8), (2, 101, 1.0), (5, 3, 1.0)],
)
def test_images_equal_brute_force(any_device: str, variant: str, width: int, height: int, valid: float) -> None:
    expected = _expected(any_device, width, height, valid, 0.01)
    states, counters = _states(
        _tracer(any_device, "cone_hierarchy", variant), _clutter(1), _depth(width, height, valid), 0.01
    )
    np.testing.assert_array_equal(states, expected)
    assert (expected == 1).any() and (expected == 0).any()
    assert counters["nodes_visited"] > 0 and counters["overflow_passes"] == 0
    assert counters["passes"] == len(LIGHTS) * (2 if variant.endswith("tp") else 1)


@pytest.mark.parametrize("capacity", [1, 64])
@pytest.mark.parametrize("variant", VARIANTS)
def test_small_queues_change_nothing(any_device: str, variant: str, capacity: int) -> None:
    """Queues of one and of eight pairs per level, and of 1 and 64 uncertain pairs; some samples lie on a triangle."""
    depth = _depth(23, 17, 0.8)
    depth[8:10, 6:9] = 2.0
    mesh = geometry.join([_clutter(1, 60), geometry.square(2, 2.0, 0.5)])
    expected, _ = _states(_tracer(any_device, "brute_force", "filtered"), mesh, depth, 0.0)
    states, counters = _states(_tracer(any_device, "cone_hierarchy", variant, capacity), mesh, depth, 0.0)
    np.testing.assert_array_equal(states, expected)
    assert counters["peak_queue"] == max(1, capacity // 8)
    assert capacity == 64 or probe.wide(any_device) or counters["overflow_passes"] > 0


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 17, 256])
@pytest.mark.parametrize("variant", VARIANTS)
def test_any_number_of_rays(any_device: str, variant: str, count: int) -> None:
    """As a list of points, and as valid pixels of an image of which the others are invalid."""
    tracer, brute = _tracer(any_device, "cone_hierarchy", variant), _tracer(any_device, "brute_force", "filtered")
    mesh, depth = _clutter(2), _depth(32, 31, 1.0)
    keep = np.random.default_rng(count).permutation(depth.size)[:count]
    sparse = np.full(depth.size, np.nan, np.float32)
    sparse[keep] = depth.reshape(-1)[keep]
    states, counters = _states(tracer, mesh, sparse.reshape(depth.shape), 0.01)
    np.testing.assert_array_equal(states, _states(brute, mesh, sparse.reshape(depth.shape), 0.01)[0])
    assert (states != 3).sum() == count * len(LIGHTS)
    assert (counters["nodes_visited"] > 0) == (count > 0)
    points = _camera(32, 31).unproject(depth).reshape(-1, 3)[keep]
    for light in LIGHTS:
        np.testing.assert_array_equal(tracer.occluded(points, light, 0.01), brute.occluded(points, light, 0.01))


@pytest.mark.parametrize("variant", VARIANTS)
def test_rays_in_all_directions(any_device: str, variant: str) -> None:
    """A light in the middle of its samples: opposite and equal rays, nodes wider than a half-space, all in one list."""
    rng = np.random.default_rng(8)
    ways = geometry.directions(rng, 700)
    points = np.concatenate([ways, -ways, np.repeat(ways[:5], 30, axis=0), 3.0 * ways]) + LIGHTS[0].position
    mesh = geometry.join([geometry.soup(rng, 200, 0.4, 2.0), geometry.soup(rng, 4, 5.0, 3.0)])
    mesh = mesh[0] + LIGHTS[0].position, mesh[1]
    tracer, brute = _tracer(any_device, "cone_hierarchy", variant), _tracer(any_device, "brute_force", "filtered")
    hidden = []
    for one in (tracer, brute):
        one.scene.clear()
        one.scene.put("mesh", *mesh)
        hidden.append(one.occluded(points, LIGHTS[0], 0.0))
    np.testing.assert_array_equal(hidden[0], hidden[1])
    assert 0.1 < hidden[0].mean() < 0.9


def _wall_counters(device: str, variant: str, size: int, aside: float) -> dict[str, int]:
    """A wall of two triangles between the light and everything seen; ``aside`` moves its diagonal."""
    tracer = _tracer(device, "cone_hierarchy", variant)
    depth = np.full((size, size), 3.0, np.float32)
    tracer.scene.clear()
    tracer.scene.put("wall", *geometry.square(2, 1.0, 40.0, (aside, -aside)))
    frame = tracer.trace(depth, _camera(size, size), [PointLight("lamp", (0.1, 0.2, -1.0))])
    assert (frame.state("lamp") == 1).all()
    return frame.counters


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_wall_costs_little_with_early_accept(any_device: str, variant: str) -> None:
    """16 times the rays: with early accept 4 times the nodes, those along the diagonal of the wall, and no more nodes
    at all where the diagonal is not seen; 16 times the nodes without it."""
    small, large = (_wall_counters(any_device, variant, size, 0.0) for size in (32, 128))
    near, far = (_wall_counters(any_device, variant, size, 20.0) for size in (32, 128))
    if variant in ACCEPTING:
        assert small["accepted"] > 0 and large["accepted"] > 0
        assert large["nodes_visited"] < 6 * small["nodes_visited"]
        assert max(near["nodes_visited"], far["nodes_visited"]) <= 2
        # Elsewhere it depends on which of the wall's two triangles comes first.
        assert near["nodes_visited"] == far["nodes_visited"] or not probe.wide(any_device)
    else:
        assert small["accepted"] == large["accepted"] == 0
        assert large["nodes_visited"] > 12 * small["nodes_visited"]
        assert far["nodes_visited"] > 12 * near["nodes_visited"]
