# SPDX-License-Identifier: Apache-2.0
"""Random scenes: every pipeline against the oracle, and against brute force where the oracle would be slow."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import geometry
import numpy as np
import oracle
import pytest
from scenario import Scenario

from shadow_tracer import DirectionalLight, PointLight

_SOUPS: dict[str, Callable[[np.random.Generator], geometry.Geometry]] = {
    "small": lambda rng: geometry.soup(rng, 400, 0.15, 2.5),
    "huge": lambda rng: geometry.soup(rng, 14, 8.0, 4.0),
    "slivers": lambda rng: geometry.slivers(rng, 150),
    "mixed": lambda rng: geometry.join(
        [geometry.soup(rng, 200, 0.1, 2.0), geometry.soup(rng, 6, 30.0, 10.0), geometry.slivers(rng, 60)]
    ),
}
_LIGHTS = {
    "inside": PointLight("lamp", (0.13, -0.21, 0.34)),
    "corner": PointLight("lamp", (6.1, 5.2, 7.3)),
    "far": PointLight("lamp", (3.0e4, -1.0e4, 5.0e4)),
    "sun": DirectionalLight("sun", (0.31, -0.42, -0.87)),
}


@cache
def _scenario(soup: str, light: str) -> Scenario:
    rng = np.random.default_rng(3)
    vertices, triangles = _SOUPS[soup](rng)
    around = geometry.directions(rng, 600) * rng.uniform(0.5, 9.0, (600, 1))
    chosen = triangles[rng.integers(0, len(triangles), 500)]
    on_mesh = (vertices[chosen] * rng.dirichlet([1, 1, 1], 500)[:, :, None]).sum(axis=1)
    lamp, w = oracle.homogeneous_light(_LIGHTS[light])
    away = w * on_mesh - lamp  # half of the samples on triangles move away from the light: needles have shadows as well
    on_mesh[::2] += (away * rng.uniform(0.1, 2.0, (500, 1)) / np.linalg.norm(away, axis=1, keepdims=True))[::2]
    return Scenario(np.concatenate([around, on_mesh]), _LIGHTS[light], vertices, triangles, 0.01)


@pytest.mark.parametrize("light", _LIGHTS)
@pytest.mark.parametrize("soup", _SOUPS)
def test_soups_equal_the_oracle(tracer: Any, soup: str, light: str) -> None:
    scenario = _scenario(soup, light)
    hidden = scenario.check(tracer)
    assert 0.1 < scenario.answer.hidden.mean() < 0.95 and len(hidden) > 100


@cache
def _scene(name: str) -> tuple[geometry.Geometry, np.ndarray]:
    rng = np.random.default_rng(4)
    vertices, triangles = geometry.street(rng) if name == "street" else geometry.museum(rng)
    chosen = triangles[rng.integers(0, len(triangles), 3000)]
    points = (vertices[chosen] * rng.dirichlet([1, 1, 1], 3000)[:, :, None]).sum(axis=1)
    return (vertices, triangles), points


_SCENE_LIGHTS = [
    PointLight("lamp", (0.4, 0.2, 1.5)),
    PointLight("star", (2e6, 1e6, 3e6)),
    DirectionalLight("sun", (0.2, 0.3, -0.9)),
]


@pytest.mark.parametrize("light", _SCENE_LIGHTS, ids=lambda light: light.name)
@pytest.mark.parametrize("name", ["street", "museum"])
@pytest.mark.parametrize("bias", [0.0, 0.02])
def test_pipelines_equal_brute_force(tracer: Any, tracers: Any, name: str, light: Any, bias: float) -> None:
    (vertices, triangles), points = _scene(name)
    points = points[:250] if tracer.variant == "float64" else points
    brute = tracers(tracer.device, "brute_force", "filtered")
    brute.scene.put("mesh", vertices, triangles)
    expected = brute.occluded(points, light, bias)
    assert 0.01 < expected.mean()
    tracer.scene.put("mesh", vertices, triangles)
    np.testing.assert_array_equal(tracer.occluded(points, light, bias), expected)


@pytest.mark.parametrize("name", ["street", "museum"])
def test_mesh_samples_equal_the_oracle(tracer: Any, name: str) -> None:
    (vertices, triangles), points = _scene(name)
    _mesh_scenario(name).check(tracer)


@cache
def _mesh_scenario(name: str) -> Scenario:
    (vertices, triangles), points = _scene(name)
    return Scenario(points[:1500], PointLight("lamp", (0.4, 0.2, 1.5)), vertices, triangles, 0.0, cull=True)
