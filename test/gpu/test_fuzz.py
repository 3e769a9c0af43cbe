# SPDX-License-Identifier: Apache-2.0
"""Sixteen adversarial kinds of scene, each with several seeds, on every pipeline: no sample may differ from the
exact oracle."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import geometry
import numpy as np
import pytest
from scenario import Scenario

from shadow_tracer import DirectionalLight, PointLight

Rng = np.random.Generator


def _around(rng: Rng, count: int = 120, reach: float = 6.0) -> np.ndarray:
    return rng.uniform(-reach, reach, (count, 3))


def _lamp(position: Any) -> PointLight:
    return PointLight("lamp", position)


def _light_in_plane(rng: Rng) -> Scenario:
    vertices, triangles = geometry.join(
        [geometry.soup(rng, 20, 1.0, 2.0), geometry.square(2, 0.25, 3.0), geometry.square(0, -0.5, 3.0)]
    )
    return Scenario(_around(rng), _lamp((-0.5, rng.uniform(-5, 5), 0.25)), vertices, triangles)


def _light_on_vertex(rng: Rng) -> Scenario:
    vertices, triangles = geometry.icosphere(1, 1.0, rng.normal(size=3))
    return Scenario(
        np.concatenate([_around(rng), vertices]), _lamp(vertices[rng.integers(len(vertices))]), vertices, triangles
    )


def _light_on_edge(rng: Rng) -> Scenario:
    vertices, triangles = geometry.box((-1, -2, -1), (1, 2, 1))
    a, b = vertices[triangles[rng.integers(12), :2]]
    return Scenario(np.concatenate([_around(rng), vertices]), _lamp(a + 0.25 * (b - a)), vertices, triangles)


def _light_near_triangle(rng: Rng) -> Scenario:
    vertices, triangles = geometry.soup(rng, 30, 1.5, 2.0)
    a, b, c = vertices[triangles[0]]
    normal = np.cross(b - a, c - a)
    return Scenario(_around(rng), _lamp((a + b + c) / 3 + 1e-6 * normal / np.linalg.norm(normal)), vertices, triangles)


def _degenerate(rng: Rng) -> Scenario:
    vertices, triangles = geometry.soup(rng, 40, 1.0, 2.0)
    vertices[1:30:3] = vertices[0:30:3]  # two equal corners
    vertices[32:60:3] = 0.5 * (vertices[30:60:3] + vertices[31:60:3])  # collinear, up to rounding
    vertices[60:75] = vertices[60]  # all equal
    return Scenario(_around(rng), _lamp(rng.normal(size=3)), vertices, triangles)


def _nonfinite(rng: Rng) -> Scenario:
    vertices, triangles = geometry.icosphere(2, 2.0)
    vertices[rng.integers(0, len(vertices), 12), rng.integers(0, 3, 12)] = rng.choice([np.nan, np.inf, -np.inf], 12)
    return Scenario(_around(rng), _lamp(rng.normal(size=3) * 0.5), vertices, triangles)


def _duplicates(rng: Rng) -> Scenario:
    vertices, triangles = geometry.soup(rng, 30, 1.0, 2.0)
    return Scenario(
        _around(rng),
        _lamp(rng.normal(size=3)),
        vertices,
        np.concatenate([triangles, triangles, triangles[:, [2, 1, 0]]]),
    )


def _integers(rng: Rng) -> Scenario:
    vertices, triangles = geometry.integer_soup(rng, 60)
    return Scenario(
        rng.integers(-5, 6, (200, 3)).astype(float),
        _lamp(rng.integers(-3, 4, 3)),
        vertices,
        triangles,
        float(rng.choice([0.0, 0.3])),
    )


def _integers_sun(rng: Rng) -> Scenario:
    vertices, triangles = geometry.integer_soup(rng, 60)
    direction = rng.choice([-3.0, -2.0, 1.0, 2.0], 3)
    return Scenario(
        rng.integers(-5, 6, (200, 3)).astype(float), DirectionalLight("sun", direction), vertices, triangles
    )


def _on_mesh(rng: Rng) -> Scenario:
    vertices, triangles = geometry.icosphere(2, 1.0, rng.normal(size=3))
    chosen = triangles[rng.integers(0, len(triangles), 150)]
    points = (vertices[chosen] * rng.dirichlet([1, 1, 1], 150)[:, :, None]).sum(axis=1)
    return Scenario(np.concatenate([points, vertices]), _lamp(rng.normal(size=3) * 3), vertices, triangles)


def _far_light(rng: Rng) -> Scenario:
    vertices, triangles = geometry.soup(rng, 120, 0.3, 3.0)
    return Scenario(
        _around(rng, 300), _lamp(geometry.directions(rng, 1)[0] * 10.0 ** rng.uniform(4, 9)), vertices, triangles, 0.01
    )


def _huge_coordinates(rng: Rng) -> Scenario:
    vertices, triangles = geometry.join(
        [geometry.soup(rng, 40, 1.0, 2.0), geometry.soup(rng, 5, 1e15, 1e15), geometry.soup(rng, 5, 1e25, 1e25)]
    )
    return Scenario(
        np.concatenate([_around(rng), _around(rng, 40, 1e16)]), _lamp(rng.normal(size=3)), vertices, triangles
    )


def _straddling(rng: Rng) -> Scenario:
    light = rng.normal(size=3)
    planes = [geometry.square(axis, light[axis] + offset, 500.0) for axis in range(3) for offset in (0.0, 0.5)]
    vertices, triangles = geometry.join([*planes, geometry.soup(rng, 30, 0.5, 2.0)])
    return Scenario(_around(rng), _lamp(light), vertices, triangles)


def _clustered(rng: Rng) -> Scenario:
    """Rays within a millionth of each other, equal ones and exactly antipodal ones, on needles."""
    vertices, triangles = geometry.slivers(rng, 80, ratio=1e4)
    base = 2.0 * vertices[triangles[:8]].mean(axis=1)
    beam = np.repeat(base, 12, axis=0) + rng.normal(size=(96, 3)) * 1e-6
    return Scenario(
        np.concatenate([beam, base, -base, np.repeat(base[:1], 5, axis=0)]), _lamp((0, 0, 0)), vertices, triangles
    )


def _near_light(rng: Rng) -> Scenario:
    """Samples at the light, and a hair away from it; a bias that is often longer than the ray."""
    light = rng.normal(size=3)
    vertices, triangles = geometry.soup(rng, 60, 0.5, 1.0)
    tiny = light + geometry.directions(rng, 60) * 10.0 ** rng.uniform(-300, 0.5, (60, 1))
    return Scenario(
        np.concatenate([light[None], tiny, _around(rng, 60, 2.0)]),
        _lamp(light),
        vertices,
        triangles,
        float(rng.choice([0.0, 0.2, 1.5])),
    )


def _axis_rays(rng: Rng) -> Scenario:
    """Axis-parallel squares, some through or almost through the light; rays along axes, face diagonals and cube
    corners."""
    squares = [
        geometry.square(axis, at, half)
        for axis in range(3)
        for at, half in [(0.0, 2.0), (1e-7, 1.0), (-1e-6, 1.0), (1.0, 1.0), (-1.0, 1.0)]
    ]
    vertices, triangles = geometry.join([squares[k] for k in rng.choice(len(squares), 6, replace=False)])
    grid = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 3)
    return Scenario(np.concatenate([grid * s for s in (0.5, 1.0, 3.0)]), _lamp((0, 0, 0)), vertices, triangles)


_KINDS: dict[str, Callable[[Rng], Scenario]] = {
    kind.__name__[1:]: kind
    for kind in (
        *(
            _light_in_plane,
            _light_on_vertex,
            _light_on_edge,
            _light_near_triangle,
            _degenerate,
            _nonfinite,
            _duplicates,
        ),
        *(_integers, _integers_sun, _on_mesh, _far_light, _huge_coordinates, _straddling, _clustered, _near_light),
        _axis_rays,
    )
}


@cache
def _scenario(kind: str, seed: int) -> Scenario:
    return _KINDS[kind](np.random.default_rng([seed, *kind.encode()]))


def test_sixteen_kinds_that_cast_shadows() -> None:
    assert len(_KINDS) == 16
    for kind in _KINDS:
        assert any(_scenario(kind, seed).answer.hidden.any() for seed in range(4)), (
            f"{kind} casts no shadow: it tests nothing"
        )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", _KINDS)
def test_fuzz(tracer: Any, kind: str, seed: int) -> None:
    _scenario(kind, seed).check(tracer)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 17, 256])
@pytest.mark.parametrize("kind", ["integers", "on_mesh", "clustered"])
def test_any_number_of_samples(tracer: Any, kind: str, count: int) -> None:
    scenario = _scenario(kind, 0)
    some = np.arange(count) % len(scenario.points)
    tracer.scene.put("mesh", scenario.vertices, scenario.triangles)
    hidden = tracer.occluded(scenario.points[some], scenario.light, scenario.bias)
    np.testing.assert_array_equal(hidden, scenario.answer.hidden[some])
