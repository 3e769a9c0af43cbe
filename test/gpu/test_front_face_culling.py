# SPDX-License-Identifier: Apache-2.0
"""Front-face culling: triangles whose front faces the light cast nothing, in every pipeline, and only if asked for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import geometry
import numpy as np
import pytest
from scenario import stride_for

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, ShadowTracer

_LAMP = PointLight("lamp", (0.3, -0.2, 4.0))
_LIGHTS = [
    _LAMP,
    PointLight("inside", (0.1, 0.2, 0.3)),
    PointLight("far", (3.0e5, 2.0e5, 9.0e5)),
    DirectionalLight("sun", (0.3, 0.1, -1.0)),
]


@pytest.fixture
def culling(tracer: Any) -> Iterator[Any]:
    tracer.front_face_culling = True
    yield tracer
    tracer.front_face_culling = False


def _fronts(vertices: np.ndarray, triangles: np.ndarray, light: Any) -> np.ndarray:
    """Which triangles turn their front to the light; the scenes here stay clear of the edge-on case."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    to_light = light.homogeneous[:3] - light.homogeneous[3] * a
    side = (np.cross(b - a, c - a) * to_light).sum(axis=1)
    assert (
        np.abs(side) > 1e-9 * np.linalg.norm(to_light, axis=1) * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    ).all()
    return side > 0.0


def test_a_square_casts_by_its_winding(tracer: Any) -> None:
    square, triangles = geometry.square(2, 0.0, 1.0)
    up = np.cross(square[triangles[0, 1]] - square[triangles[0, 0]], square[triangles[0, 2]] - square[triangles[0, 0]])[
        2
    ]
    towards, away = (triangles, triangles[:, ::-1]) if up > 0 else (triangles[:, ::-1], triangles)
    below, above = np.array([[0.2, 0.1, -1.0]]), np.array([[0.2, 0.1, 1.0]])
    lamps = {"above": PointLight("lamp", (0.0, 0.0, 3.0)), "below": PointLight("lamp", (0.0, 0.0, -3.0))}
    assert tracer.front_face_culling is False
    for winding, casts_from_above in ((towards, False), (away, True)):
        tracer.scene.put("square", square, winding)
        for culled in (False, True, False):
            tracer.front_face_culling = culled
            assert tracer.occluded(below, lamps["above"])[0] == (casts_from_above or not culled)
            assert tracer.occluded(above, lamps["below"])[0] == (not casts_from_above or not culled)
            assert not tracer.occluded(above, lamps["above"])[0]


@pytest.mark.parametrize("light", _LIGHTS, ids=lambda light: light.name)
def test_equals_the_scene_without_the_fronts(culling: Any, light: Any) -> None:
    rng = np.random.default_rng(5)
    vertices, triangles = geometry.join(
        [geometry.soup(rng, 150, 0.4, 1.5), geometry.icosphere(2, 0.5, (0.1, 0.2, 0.3)), geometry.slivers(rng, 40)]
    )
    fronts = _fronts(vertices, triangles, light)
    points = rng.uniform(-3, 3, (1500, 3))
    points = points[:: stride_for(culling, len(points), len(triangles))]
    culling.scene.put("mesh", vertices, triangles)
    hidden = culling.occluded(points, light, 0.01)
    culling.front_face_culling = False
    all_of_it = culling.occluded(points, light, 0.01)
    culling.scene.put("mesh", vertices, triangles[~fronts])
    np.testing.assert_array_equal(hidden, culling.occluded(points, light, 0.01))
    assert hidden.any() and (all_of_it & ~hidden).any() and not (hidden & ~all_of_it).any()


def test_a_closed_surface_casts_the_same_shadow_on_everything_else(culling: Any) -> None:
    """A spiky sphere over a floor of samples."""
    vertices, triangles = geometry.spiky_sphere()
    x, y = np.meshgrid(np.linspace(-4, 4, 50), np.linspace(-4, 4, 50))
    floor = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -1.7)])
    floor = floor[:: stride_for(culling, len(floor), len(triangles))]
    culling.scene.put("mesh", vertices, triangles)
    hidden = culling.occluded(floor, _LAMP)
    culling.front_face_culling = False
    np.testing.assert_array_equal(hidden, culling.occluded(floor, _LAMP))
    assert 0.02 < hidden.mean() < 0.5


def test_a_convex_surface_does_not_shadow_its_lit_side(culling: Any) -> None:
    """Samples 2 cm below the lit side of a sphere are hidden by it, as noisy depth would be; not with culling. Just
    outside the surface nothing changes, behind it included."""
    vertices, triangles = geometry.icosphere(2, 1.0)
    middles = vertices[triangles].mean(axis=1)
    lit = _fronts(vertices, triangles, _LAMP)
    samples = 0.98 * middles[lit]
    culling.scene.put("mesh", vertices, triangles)
    assert not culling.occluded(samples, _LAMP).any()
    outside = culling.occluded(1.001 * middles, _LAMP)
    culling.front_face_culling = False
    assert culling.occluded(samples, _LAMP).all()
    np.testing.assert_array_equal(outside, culling.occluded(1.001 * middles, _LAMP))
    assert outside.any() and not outside.all()


def test_counters_and_every_light_of_a_frame(culling: Any) -> None:
    """Several lights share the records; each culls its own fronts. What casts nothing anyway is counted as before."""
    vertices, triangles = geometry.join([(np.zeros((3, 3)), np.array([[0, 1, 2]])), geometry.icosphere(1, 1.0)])
    camera = Camera(24, 18, 20.0, 20.0, 11.5, 8.5, geometry.look_at((0.5, -6.0, 1.0), (0.0, 0.0, 0.0), (0, 0, 1)))
    depth = np.full((18, 24), 7.2, np.float32)
    lights = [PointLight("first", (0.3, -4.0, 1.0)), PointLight("second", (0.2, 3.0, 0.4)), _LAMP]
    culling.scene.put("mesh", vertices, triangles)
    frame = culling.trace(depth, camera, lights, bias=0.0)
    fronts = _fronts(vertices, triangles[1:], _LAMP)
    assert frame.counters["culled"] == fronts.sum() and frame.counters["degenerate"] == 1
    for light in lights:
        np.testing.assert_array_equal(
            culling.trace(depth, camera, [light], bias=0.0).state(light.name), frame.state(light.name)
        )
    culling.front_face_culling = False
    assert culling.trace(depth, camera, lights, bias=0.0).counters["culled"] == 0


def test_given_to_the_constructor_and_refused_if_not_a_bool(any_device: str) -> None:
    bounds = Bounds(max_triangles=10, max_rays=10, queue_capacity=10)
    tracer = ShadowTracer("brute_force", device=any_device, bounds=bounds, front_face_culling=True)
    assert tracer.front_face_culling is True
    for bad in ("yes", 1, None):
        with pytest.raises(ValueError, match=r"^front_face_culling: expected True or False, got"):
            tracer.front_face_culling = bad
        with pytest.raises(ValueError, match=r"^front_face_culling: "):
            ShadowTracer("brute_force", device=any_device, bounds=bounds, front_face_culling=bad)
    assert tracer.front_face_culling is True
