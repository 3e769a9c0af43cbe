# SPDX-License-Identifier: Apache-2.0
"""The bias where a triangle is nearly in the ray's way: distances from its plane are all rounding in float64, and the
comparison has to be about what they are."""

from __future__ import annotations

from functools import cache

import numpy as np
import oracle
import probe
import pytest

from shadow_tracer import Bounds, DirectionalLight, HeightField, PointLight, ShadowTracer, available_pipelines
from shadow_tracer.scene.surface import organised

pytestmark = probe.in_both_forms

_QUARTERS = [
    (-2, -2, -1, 2, -1, 4, 1, -2),
    (4, 4, 3, -2, 3, 2, 3, 2),
    (1, -1, 4, 4, 2, -1, 1, 1),
    (-3, -3, 0, 1, -2, -1, -2, 4),
    (1, -1, 3, 4, -1, 4, 3, 3),
    (1, 4, -2, -3, 4, 0, 0, 2),
    (-1, 2, 3, 3, -3, 4, 2, 2),
    (-2, 4, 0, 4, -2, -3, 3, 1),
]


_FIELD = HeightField(np.array(_QUARTERS) / 4.0, 1.25, origin=(12.25, -17.0, 0.1))
_SUN = DirectionalLight("sun", (3, 3, -3))


@cache
def _exactly(bias: float) -> np.ndarray:
    """By fractions, once for all pipelines."""
    surface = organised(_FIELD, None)
    points = _FIELD.positions().reshape(-1, 3)
    return oracle.occluded_exact(points, _SUN, surface.vertices, surface.triangles(), bias)


@pytest.mark.slow
@pytest.mark.parametrize("pipeline", available_pipelines())
def test_a_ray_along_a_triangle_that_ends_before_the_bias(any_device: str, pipeline: str) -> None:
    points = _FIELD.positions().reshape(-1, 3)
    tracer = ShadowTracer(pipeline, device=any_device, bounds=Bounds(max_triangles=200, max_rays=100), threads=1)
    tracer.scene.put_surface("ground", _FIELD)
    for bias in (0.5, 2.0, 3.0):
        assert np.array_equal(tracer.occluded(points, _SUN, bias), _exactly(bias)), bias


@pytest.mark.parametrize("height", [3e-15, 4e-14, 6e-14, 3e-12])
@pytest.mark.parametrize("pipeline", available_pipelines())
def test_lights_and_samples_all_but_in_the_plane(any_device: str, pipeline: str, height: float) -> None:
    """A light and samples on the two sides of a triangle, by so little: what of the ray is behind the plane is about
    as long as the bias, and float64 alone says it to no digit, to two, or to four."""
    rng = np.random.default_rng(521)
    plane = np.array([[2.0, 3.0, 6.0], [3.0, -6.0, 2.0], [6.0, 2.0, -3.0]]) / 7.0  # two ways in it, and its normal
    middle = np.array([3.7, -2.9, 5.3])
    corners = np.array([u * plane[0] + v * plane[1] for u, v in ((-4.0, -3.0), (5.0, -3.0), (0.0, 6.0))]) + middle
    u, v = rng.uniform(-1.2, 1.2, (2, 150, 1))
    points = (u * plane[0] + v * plane[1]) + rng.uniform(0.2, 3.0, (150, 1)) * height * plane[2] + middle
    light = PointLight("lamp", tuple(middle - height * plane[2]))
    tracer = ShadowTracer(pipeline, device=any_device, bounds=Bounds(max_triangles=10, max_rays=200), threads=1)
    tracer.scene.put("sheet", corners, np.array([[0, 1, 2]]))
    for bias in (0.2, 0.4):
        expected = oracle.occluded_exact(points, light, corners, np.array([[0, 1, 2]]), bias)
        assert 0.05 < expected.mean() < 0.95
        assert np.array_equal(tracer.occluded(points, light, bias), expected), bias
