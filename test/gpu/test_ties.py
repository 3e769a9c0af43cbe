# SPDX-License-Identifier: Apache-2.0
"""Exact ties: rays through vertices and along edges, lights and samples in planes, on an integer grid where no
rounding excuses anything.

Edges and vertices belong to a triangle; its plane, seen from sample or light, does not.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import geometry
import numpy as np
import oracle
import pytest
from scenario import Scenario

from shadow_tracer import DirectionalLight, PointLight


def _through(rng: np.random.Generator, vertices: np.ndarray, triangles: np.ndarray, away: Any) -> np.ndarray:
    """Samples exactly behind vertices, edge midpoints (of even edges: integers) and interior points, `away` from
    the light."""
    corners = 2.0 * vertices[triangles]
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1))
    targets = np.concatenate(
        [corners.reshape(-1, 3), middles.reshape(-1, 3), corners.sum(axis=1) / 4.0 + corners[:, 0] / 4.0]
    )
    return away(targets[rng.integers(0, len(targets), 400)])


@cache
def _point_ties(seed: int) -> Scenario:
    rng = np.random.default_rng([5, seed])
    vertices, triangles = geometry.integer_soup(rng, 14)
    light = rng.integers(-4, 5, 3).astype(float)
    points = _through(
        rng, vertices, triangles, lambda q: light + (q - light) * rng.choice([0.5, 1.0, 1.5, 2.0, 3.0], (len(q), 1))
    )
    return Scenario(points, PointLight("lamp", light), 2.0 * vertices, triangles)


@cache
def _sun_ties(seed: int) -> Scenario:
    rng = np.random.default_rng([6, seed])
    vertices, triangles = geometry.integer_soup(rng, 12)
    direction = np.array([(1, 2, -4), (3, 1, -2), (0, 0, -1), (1, 1, 1), (-5, 7, 3), (0, 3, -1)][seed % 6], float)
    points = _through(
        rng, vertices, triangles, lambda q: q + direction * rng.choice([-1.0, 0.0, 0.5, 1.0, 4.0], (len(q), 1))
    )
    return Scenario(points, DirectionalLight("sun", direction), 2.0 * vertices, triangles)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("make", [_point_ties, _sun_ties], ids=["point", "sun"])
def test_integer_grid(tracer: Any, make: Any, seed: int) -> None:
    scenario = make(seed)
    unsure = oracle.occluded_float64(scenario.points, scenario.light, scenario.vertices, scenario.triangles).unsure
    assert len(unsure) > 20, "no ties: a bad test scene"
    scenario.check(tracer)


def test_integer_grid_equals_the_literal_definition(tracer: Any) -> None:
    scenario = _point_ties(0)
    some, few = scenario.points[:60], scenario.triangles[:20]
    tracer.scene.put("mesh", scenario.vertices, few)
    literal = oracle.occluded_exact(some, scenario.light, scenario.vertices, few)
    np.testing.assert_array_equal(tracer.occluded(some, scenario.light), literal)


@pytest.mark.parametrize("height", [0.0, 1e-50, 1e-30, 1e-16, 1e-6])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_light_in_or_almost_in_a_plane(tracer: Any, height: float, side: float) -> None:
    """However little the light is above the plane, everything strictly below it is in shadow; exactly in the plane,
    nothing is."""
    tracer.scene.put("mesh", *geometry.square(2, 0.0, 1000.0))
    points = np.array(
        [(0.25, 0.5, -1.0), (0.25, 0.5, -1e-20), (0.25, 0.5, 0.0), (0.25, 0.5, 1.0), (300.0, -20.0, -1e-9)]
    ) * [1, 1, side]
    hidden = tracer.occluded(points, PointLight("lamp", (0.0, 0.0, side * height)))
    np.testing.assert_array_equal(hidden, [height > 0, height > 0, False, False, height > 0])


def test_samples_on_the_mesh_are_not_in_its_shadow(tracer: Any) -> None:
    """On a convex solid with the light outside, a sample exactly on the lit side is lit with no bias at all."""
    vertices, triangles = geometry.box((-1, -1, -1), (1, 1, 1))
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)), axis=-1).reshape(-1, 2)
    top = np.column_stack([grid, np.ones(len(grid))])
    tracer.scene.put("mesh", vertices, triangles)
    for light in (
        PointLight("lamp", (0.3, 0.1, 5.0)),
        PointLight("lamp", (8.0, 0.0, 1.5)),
        DirectionalLight("sun", (0.1, 0.7, -0.2)),
    ):
        assert not tracer.occluded(top, light).any()
    bottom = top * [1, 1, -1]
    assert tracer.occluded(bottom, PointLight("lamp", (0.3, 0.1, 5.0))).all()
    # the plane of the top, light in it: the top and the bottom see nothing of it, the side it looks at hides what is
    # behind
    side = PointLight("lamp", (5.0, 0.0, 1.0))
    np.testing.assert_array_equal(tracer.occluded(top, side), oracle.occluded(top, side, vertices, triangles).hidden)


def test_both_sides_cast(tracer: Any) -> None:
    for winding in ([[0, 1, 2]], [[2, 1, 0]]):
        tracer.scene.put("mesh", [(0, 0, 0), (4, 0, 0), (0, 4, 0)], winding)
        assert tracer.occluded((1.0, 1.0, -1.0), PointLight("lamp", (1, 1, 2)))
        assert tracer.occluded((1.0, 1.0, 1.0), PointLight("lamp", (1, 1, -2)))


@pytest.mark.parametrize(
    "bias,hidden",
    [(0.0, True), (0.5, True), (np.nextafter(1.0, 0), True), (1.0, False), (2.0, False), (3.0, False), (1e40, False)],
)
def test_bias_is_metres_along_the_ray(tracer: Any, bias: float, hidden: bool) -> None:
    """A plane 1 m from the sample counts while the bias is less than that; a bias beyond the light (3 m) leaves
    nothing."""
    tracer.scene.put("mesh", *geometry.square(2, 0.0, 10.0))
    assert tracer.occluded((0.25, 0.5, -1.0), PointLight("lamp", (0.25, 0.5, 2.0)), bias) == hidden
    assert tracer.occluded((0.25, 0.5, -1.0), DirectionalLight("sun", (0.0, 0.0, -7.0)), bias) == hidden
    # along a slope of 3-4-5 the same plane is 5/3 m away
    slope = tracer.occluded(
        (0.0, 0.0, -1.0),
        DirectionalLight("sun", (-4.0, 0.0, -3.0)),
        bias * 5.0 / 3.0 * (1.0 - 1e-9 if hidden else 1.0 + 1e-9),
    )
    assert slope == hidden


def test_light_at_the_sample(tracer: Any) -> None:
    tracer.scene.put("mesh", *geometry.icosphere(1, 0.5))
    lamp = PointLight("lamp", (0.0, 0.0, 0.0))
    points = np.array([(0, 0, 0), (0, 0, 1), (0, 0, 1e-200), (0, 0, -1e-20)], float)
    np.testing.assert_array_equal(tracer.occluded(points, lamp), [False, True, False, False])
    np.testing.assert_array_equal(tracer.occluded(points, lamp, 0.01), [False, True, False, False])


def test_axis_squares(tracer: Any) -> None:
    """Squares at 0, +-1e-7, 1e-6 and +-1 on each axis; rays exactly along axes, face diagonals and cube corners."""
    _axis_squares().check(tracer)


@cache
def _axis_squares() -> Scenario:
    parts = [geometry.square(axis, at, 1.0) for axis in range(3) for at in (0.0, 1e-7, -1e-7, 1e-6, 1.0, -1.0)]
    vertices, triangles = geometry.join(parts)
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    return Scenario(
        np.concatenate([grid * s for s in (1e-7, 5e-7, 0.5, 1.0, 2.0)]),
        PointLight("lamp", (0, 0, 0)),
        vertices,
        triangles,
    )


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.0, 0.0, 1e-6), (1e-6, -1e-6, 1e-6), (0.5, 0.25, -0.125)])
def test_kilometre_planes_crossing_at_the_light(tracer: Any, offset: tuple[float, float, float]) -> None:
    _planes(offset).check(tracer)


@cache
def _planes(offset: tuple[float, float, float]) -> Scenario:
    rng = np.random.default_rng(7)
    vertices, triangles = geometry.join([geometry.square(axis, 0.0, 500.0) for axis in range(3)])
    points = np.concatenate(
        [rng.uniform(-3, 3, (300, 3)), rng.uniform(-600, 600, (300, 3)), rng.integers(-2, 3, (100, 3)).astype(float)]
    )
    return Scenario(points, PointLight("lamp", offset), vertices, triangles)
