# SPDX-License-Identifier: Apache-2.0
"""The same surface told in another way gives the same bits: order, winding, sharing of vertices, number of meshes,
names of the axes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import geometry
import numpy as np
import pytest

from shadow_tracer import DirectionalLight, PointLight

Retelling = Callable[[np.random.Generator, np.ndarray, np.ndarray], geometry.Geometry]


def _shuffled_vertices(rng: np.random.Generator, vertices: np.ndarray, triangles: np.ndarray) -> geometry.Geometry:
    order = rng.permutation(len(vertices))
    back = np.empty(len(order), np.int32)
    back[order] = np.arange(len(order))
    return vertices[order], back[triangles]


_RETELLINGS: dict[str, Retelling] = {
    "triangles_shuffled": lambda rng, v, t: (v, t[rng.permutation(len(t))]),
    "vertices_shuffled": _shuffled_vertices,
    "windings_flipped": lambda rng, v, t: (v, t[:, ::-1]),
    "some_windings_flipped": lambda rng, v, t: (v, np.where(rng.random((len(t), 1)) < 0.5, t, t[:, [0, 2, 1]])),
    "corners_rotated": lambda rng, v, t: (
        v,
        np.stack([np.roll(row, k) for row, k in zip(t, rng.integers(0, 3, len(t)), strict=True)]),
    ),
    "vertices_split": lambda rng, v, t: geometry.split(v, t),
    "triangles_twice": lambda rng, v, t: (v, np.concatenate([t, t[::-1]])),
    "unused_vertices": lambda rng, v, t: (np.concatenate([v, rng.normal(size=(50, 3)) * 1e3]), t),
}


@cache
def _scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Closed and open surfaces, slivers, degenerates and integer ties; samples at random, on the mesh, and behind
    vertices of it."""
    rng = np.random.default_rng(30)
    vertices, triangles = geometry.join(
        [
            geometry.icosphere(2, 1.0, (1.0, 0.0, 0.5)),
            geometry.integer_soup(rng, 30),
            geometry.slivers(rng, 40),
            geometry.soup(rng, 150, 0.3, 2.5),
        ]
    )
    light = np.array([0.0, 0.5, 2.0])
    points = np.concatenate(
        [
            rng.uniform(-5, 5, (300, 3)),
            rng.integers(-5, 6, (150, 3)),
            light + 2.0 * (vertices[::2] - light),
            vertices[::5],
        ]
    )
    return vertices, triangles, points[::2]


_LIGHTS: list[Any] = [
    PointLight("lamp", (0.0, 0.5, 2.0)),
    PointLight("star", (2.0e6, -1.0e6, 3.0e6)),
    DirectionalLight("sun", (1.0, 2.0, -4.0)),
]


def _answers(tracer: Any, vertices: np.ndarray, triangles: np.ndarray, points: np.ndarray) -> list[np.ndarray]:
    tracer.scene.put("mesh", vertices, triangles)
    return [tracer.occluded(points, light, bias) for light in _LIGHTS for bias in (0.0, 0.01)]


@pytest.mark.parametrize("retelling", _RETELLINGS)
def test_retold_meshes(tracer: Any, retelling: str) -> None:
    vertices, triangles, points = _scene()
    expected = _answers(tracer, vertices, triangles, points)
    retold = _RETELLINGS[retelling](np.random.default_rng(31), vertices, triangles)
    for got, want in zip(_answers(tracer, *retold, points), expected, strict=True):
        np.testing.assert_array_equal(got, want)
    assert any(0.05 < want.mean() < 0.95 for want in expected)


def test_split_into_several_meshes(tracer: Any) -> None:
    vertices, triangles, points = _scene()
    expected = _answers(tracer, vertices, triangles, points)
    tracer.scene.clear()
    for k in (3, 0, 4, 1, 2):
        tracer.scene.put(f"part {k}", vertices, triangles[k::5])
    got = [tracer.occluded(points, light, bias) for light in _LIGHTS for bias in (0.0, 0.01)]
    for part, whole in zip(got, expected, strict=True):
        np.testing.assert_array_equal(part, whole)


@pytest.mark.parametrize("axes", [(1, 2, 0), (2, 0, 1), (0, 2, 1), (1, 0, 2)])
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, 1, -1), (1, 1, -1)])
def test_swapped_and_mirrored_axes(tracer: Any, axes: tuple[int, ...], signs: tuple[int, ...]) -> None:
    vertices, triangles, points = _scene()
    vertices, points = vertices[:, list(axes)] * signs, points[::3][:, list(axes)] * signs
    lights: list[PointLight | DirectionalLight] = []
    for light in _LIGHTS:
        if isinstance(light, PointLight):
            lights.append(PointLight(light.name, light.position[list(axes)] * signs))
        else:
            lights.append(DirectionalLight(light.name, light.direction[list(axes)] * signs))
    tracer.scene.put("mesh", *_scene()[:2])
    expected = [tracer.occluded(_scene()[2][::3], light) for light in _LIGHTS]
    tracer.scene.put("mesh", vertices, triangles)
    for light, want in zip(lights, expected, strict=True):
        np.testing.assert_array_equal(tracer.occluded(points, light), want)


def test_samples_in_any_order_and_company(tracer: Any) -> None:
    vertices, triangles, points = _scene()
    tracer.scene.put("mesh", vertices, triangles)
    points = points[:240]
    whole = tracer.occluded(points, _LIGHTS[0])
    order = np.random.default_rng(32).permutation(len(points))
    np.testing.assert_array_equal(tracer.occluded(points[order], _LIGHTS[0]), whole[order])
    alone = [bool(tracer.occluded(point, _LIGHTS[0])) for point in points[::6]]
    np.testing.assert_array_equal(alone, whole[::6])
    crowd = np.concatenate([points, np.random.default_rng(33).normal(size=(500, 3)) * 1e7])
    np.testing.assert_array_equal(tracer.occluded(crowd, _LIGHTS[0])[: len(points)], whole)


def test_length_of_a_direction_does_not_matter(tracer: Any) -> None:
    vertices, triangles, points = _scene()
    tracer.scene.put("mesh", vertices, triangles)
    expected = tracer.occluded(points, DirectionalLight("sun", (1.0, 2.0, -4.0)), 0.01)
    for scale in (2.0**-90, 2.0**-30, 0.5, 3.0, 2.0**90):  # (3, 6, -12) is the same direction exactly
        np.testing.assert_array_equal(
            tracer.occluded(points, DirectionalLight("sun", np.array([1.0, 2.0, -4.0]) * scale), 0.01), expected
        )
