# SPDX-License-Identifier: Apache-2.0
"""The bias where a triangle is nearly in the ray's way: distances from its plane are all rounding in float64, and the
comparison has to be about what they are."""

from __future__ import annotations

import numpy as np
import oracle
import probe
import pytest

from shadow_tracer import Bounds, DirectionalLight, HeightField, ShadowTracer, available_pipelines
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


@pytest.mark.parametrize("pipeline", available_pipelines())
def test_a_ray_along_a_triangle_that_ends_before_the_bias(any_device: str, pipeline: str) -> None:
    field = HeightField(np.array(_QUARTERS) / 4.0, 1.25, origin=(12.25, -17.0, 0.1))
    light, surface = DirectionalLight("sun", (3, 3, -3)), organised(field, None)
    points = field.positions().reshape(-1, 3)
    tracer = ShadowTracer(pipeline, device=any_device, bounds=Bounds(max_triangles=200, max_rays=100), threads=1)
    tracer.scene.put_surface("ground", field)
    for bias in (0.5, 2.0, 3.0):
        expected = oracle.occluded_exact(points, light, surface.vertices, surface.triangles(), bias)
        assert np.array_equal(tracer.occluded(points, light, bias), expected), bias
