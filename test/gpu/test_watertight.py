# SPDX-License-Identifier: Apache-2.0
"""Closed meshes leak nothing: every sample outside a closed mesh around the light is in shadow, whatever vertex or
edge its ray meets."""

from __future__ import annotations

from functools import cache
from typing import Any

import geometry
import numpy as np
import pytest
from scenario import Scenario, stride_for

from shadow_tracer import DirectionalLight, PointLight

_ORIGINS = {"origin": (0.0, 0.0, 0.0), "far": (148376.0, 1234.0, -223423.0), "utm": (5e5, 5.2e6, 112.0)}


@cache
def _aimed(subdivisions: int, radius: float, origin: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sphere, and samples outside it aimed at all vertices, at points of edges, and at 1e-7 jitters of both."""
    vertices, triangles = geometry.icosphere(subdivisions, radius, _ORIGINS[origin])
    rng = np.random.default_rng(8)
    centre = np.asarray(_ORIGINS[origin])
    targets = np.concatenate([vertices, geometry.edge_points(vertices, triangles, (0.5, 0.3))]) - centre
    targets = targets[rng.permutation(len(targets))[:6000]]
    jittered = targets + rng.normal(size=targets.shape) * 1e-7 * radius
    samples = np.concatenate(
        [centre + 2.0 * targets, centre + 1.01 * targets, centre + 8.0 * jittered, centre + 1.5 * jittered]
    )
    return vertices, triangles, samples[rng.permutation(len(samples))]


def _leaks(tracer: Any, vertices: np.ndarray, triangles: np.ndarray, samples: np.ndarray, light: Any) -> int:
    tracer.scene.put("mesh", vertices, triangles)
    step = stride_for(tracer, len(samples), len(triangles))
    return int((~tracer.occluded(samples[::step], light)).sum())


@pytest.mark.parametrize("origin", _ORIGINS)
@pytest.mark.parametrize("radius", [1.0, 50.0])
@pytest.mark.parametrize("subdivisions", [2, 3, pytest.param(4, marks=pytest.mark.slow)])
def test_closed_sphere(tracer: Any, subdivisions: int, radius: float, origin: str) -> None:
    vertices, triangles, samples = _aimed(subdivisions, radius, origin)
    centre = np.asarray(_ORIGINS[origin])
    assert _leaks(tracer, vertices, triangles, samples, PointLight("lamp", centre)) == 0
    off_centre = centre + radius * np.array([0.3, -0.2, 0.5])
    assert _leaks(tracer, vertices, triangles, samples, PointLight("lamp", off_centre)) == 0
    if radius == 1.0:
        split = geometry.split(vertices, triangles)
        assert _leaks(tracer, *split, samples, PointLight("lamp", centre)) == 0, "not welded"


def test_rays_exactly_through_vertices(tracer: Any) -> None:
    """With a power-of-two radius and the light at the origin, 2 v is exactly behind vertex v: ties of five or six
    triangles at once."""
    vertices, triangles = geometry.icosphere(3, 4.0)
    assert (
        _leaks(
            tracer, vertices, triangles, np.concatenate([2.0 * vertices, 1.5 * vertices]), PointLight("lamp", (0, 0, 0))
        )
        == 0
    )


@pytest.mark.parametrize("seed", range(3))
def test_spiky_sphere(tracer: Any, seed: int) -> None:
    """The closed latitude/longitude sphere with random radii: long needles, poles of 16 triangles, folded views."""
    vertices, triangles = geometry.spiky_sphere(16, seed)
    rng = np.random.default_rng([9, seed])
    targets = np.concatenate(
        [vertices, vertices, geometry.edge_points(vertices, triangles, (0.5, 0.25)), geometry.directions(rng, 2000)]
    )
    samples = targets / np.linalg.norm(targets, axis=1, keepdims=True) * rng.uniform(1.6, 30.0, (len(targets), 1))
    for light in ((0.0, 0.0, 0.0), (0.1, -0.05, 0.02)):
        assert (
            _leaks(tracer, vertices, triangles, samples[rng.permutation(len(samples))], PointLight("lamp", light)) == 0
        )


def test_terrain_under_the_sun(tracer: Any) -> None:
    """No ray gets through a height field from below, aimed at its vertices and edges."""
    rng = np.random.default_rng(10)
    x, y = (g.reshape(-1).astype(float) for g in np.meshgrid(np.arange(25), np.arange(25)))
    vertices = np.stack([x, y, rng.random(625)], axis=1)
    cells = (np.arange(24)[:, None] * 25 + np.arange(24)).reshape(-1)
    triangles = np.concatenate(
        [np.stack([cells, cells + 1, cells + 26], 1), np.stack([cells, cells + 26, cells + 25], 1)]
    ).astype(np.int32)
    inner = (vertices[:, :2].min(axis=1) > 4) & (vertices[:, :2].max(axis=1) < 20)
    edges = geometry.edge_points(vertices, triangles)
    targets = np.concatenate([vertices[inner], edges[(edges[:, :2].min(axis=1) > 4) & (edges[:, :2].max(axis=1) < 20)]])
    for direction in ((0.0, 0.0, -1.0), (0.5, 0.25, -1.0), (-0.3, 0.7, -1.5)):
        samples = targets + np.asarray(direction) * 2.0
        assert _leaks(tracer, vertices, triangles, samples, DirectionalLight("sun", direction)) == 0
        assert not tracer.occluded(
            targets[::5] - np.asarray(direction) * 4.0, DirectionalLight("sun", direction)
        ).any(), "above it is day"


@cache
def _sphere_between() -> Scenario:
    vertices, triangles = geometry.icosphere(3, 1.0)
    light = np.array([0.5, -0.25, 6.0])
    targets = np.concatenate([vertices, geometry.edge_points(vertices, triangles)])
    floor = light + (targets - light) * ((-4.0 - light[2]) / (targets[:, 2:] - light[2]))
    return Scenario(np.concatenate([floor, vertices, 1.5 * vertices]), PointLight("lamp", light), vertices, triangles)


def test_sphere_between_light_and_floor(tracer: Any) -> None:
    """Rays past every vertex and edge of a sphere, the silhouette included: the oracle knows which side each one
    passes."""
    scenario = _sphere_between()
    scenario.check(tracer)
    assert 0.3 < scenario.answer.hidden.mean() < 0.999
