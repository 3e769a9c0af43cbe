# SPDX-License-Identifier: Apache-2.0
"""Lights of 64 points on real meshes: all together, or one by one, every bit is that of ``brute_force``."""

from __future__ import annotations

from functools import cache
from typing import Any

import data
import numpy as np
import pytest

from shadow_tracer import Bounds, DiscLight, RectangleLight, ShadowTracer, SunDisc, TubeLight
from shadow_tracer.gpu.engine import area_lights

_MESHES = (
    "bart_robots_t10",
    "sponza_dabrovic",
    "sibenik",
    "conference",
    "rgbd_livingroom1_fused",
    "rgbd_redkitchen_fused",
    "cornell_box",
    "aws_hospital",
)


def _tracer(names: str, name: str, rays: int) -> ShadowTracer:
    vertices, triangles = data.mesh(name)
    bounds = Bounds(max_triangles=len(triangles), max_rays=rays, max_lights=8)
    made = ShadowTracer(*names.split("/"), device="cpu", bounds=bounds, threads=1)
    made.scene.put("mesh", vertices, triangles)
    return made


@cache
def _samples(name: str, count: int) -> np.ndarray:
    """On triangles, and in the middle of the mesh."""
    vertices, triangles = data.mesh(name)
    rng = np.random.default_rng(410)
    low, high = vertices.min(axis=0).astype(float), vertices.max(axis=0).astype(float)
    chosen = vertices[triangles[rng.integers(0, len(triangles), count // 2)]].astype(float)
    weights = rng.uniform(0.1, 1.0, (len(chosen), 3, 1))
    on = (chosen * weights).sum(axis=1) / weights.sum(axis=1)
    return np.concatenate([on, low + rng.uniform(0.3, 0.7, (count - len(on), 3)) * (high - low)])


def _lights(name: str) -> list[Any]:
    """In the middle of a mesh, of 2 % of its size."""
    vertices, _ = data.mesh(name)
    low, high = vertices.min(axis=0).astype(float), vertices.max(axis=0).astype(float)
    middle, size = 0.5 * low + 0.5 * high, 0.02 * float((high - low).max())
    way = np.array((0.6, 0.0, 0.8))
    return [
        RectangleLight("panel", middle, size * np.array((1.0, 0.0, 0.0)), (0.0, 0.0, size), two_sided=True),
        DiscLight("disc", middle, way, size, two_sided=True, samples=16),
        TubeLight("tube", middle - 2.0 * size * way, middle + 2.0 * size * way, 0.1 * size, samples=16),
        SunDisc("sun", (0.3, -1.0, 0.2), samples=16),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", _MESHES)
def test_bits_of_brute_force(name: str) -> None:
    points, lights = _samples(name, 8), _lights(name)
    bias = 1e-4 * float(np.ptp(data.mesh(name)[0], axis=0).max())
    true = _tracer("brute_force/filtered", name, len(points)).light_bits(points, lights, bias)
    assert len(np.unique(true)) > 1
    for names in ("bvh/sah", "mesh_bvh/refit"):
        np.testing.assert_array_equal(_tracer(names, name, len(points)).light_bits(points, lights, bias), true, names)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sponza_dabrovic", "rgbd_livingroom1_fused"])
def test_the_same_bits_by_both_ways(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """All points together, and one by one."""
    monkeypatch.setattr(area_lights, "PILOT", 32)
    points, panel = _samples(name, 300), _lights(name)[0]
    tracer, found = _tracer("bvh/sah", name, len(points)), []
    for cost in (1e9, 0.0):
        monkeypatch.setattr(area_lights, "ray_cost", lambda *_, cost=cost: cost)
        found.append(tracer.light_bits(points, [panel]))
    np.testing.assert_array_equal(*found)
    assert len(np.unique(found[0])) > 5
