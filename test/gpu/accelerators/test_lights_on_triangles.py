# SPDX-License-Identifier: Apache-2.0
"""Lights exactly on vertices, on edges, in triangles and in their planes, and where planes of a kilometre cross: seen
from there, triangles fill half of all directions or none. On every pipeline, against the oracle."""

from __future__ import annotations

from functools import cache
from typing import Any

import crowds
import geometry
import numpy as np
import pytest
import views
from scenario import Scenario

from shadow_tracer import Camera, PointLight, SpotLight, State

# --- on a lattice of unit squares, each cut along its diagonal from (0, 0) to (1, 1) ---

_SIZE = 4

# Positions of the light, on and about the side z = 4 of the box from 0 to 4.
_PLACES = {
    "vertex": (1.0, 2.0, 4.0),
    "vertex on an edge of the box": (4.0, 2.0, 4.0),
    "corner of the box": (4.0, 4.0, 4.0),
    "edge": (1.0, 2.5, 4.0),
    "edge of the box": (4.0, 2.25, 4.0),
    "diagonal": (1.25, 2.25, 4.0),
    "inside a triangle": (1.75, 2.25, 4.0),
    "plane of a side, outside": (7.0, 2.25, 4.0),
    "line of an edge": (7.0, 2.0, 4.0),
    "line of a diagonal": (6.0, 6.0, 4.0),
    "planes of three sides": (0.0, 0.0, 4.0),
    "crossing of planes outside": (4.0, 7.0, 0.0),
}

# Off those places, by how much: the last is the smallest step there is at 4.
_OFF = {"on": 0.0, "above": 1e-6, "below": -1e-6, "an ulp above": 2.0**-50, "an ulp below": -(2.0**-51)}


@cache
def _mesh() -> geometry.Geometry:
    """The box without a few of its triangles, so that light gets in and out, and some triangles in it."""
    rng = np.random.default_rng(410)
    box, triangles = crowds.lattice_box(_SIZE)
    soup, small = geometry.integer_soup(rng, 12, 2)
    return geometry.join([(box, triangles[rng.random(len(triangles)) < 0.8]), (soup + 2.0, small)])


@cache
def _lattice_points() -> np.ndarray:
    """Integer and half-integer places in the box and around it: in planes of triangles, on edges, on vertices; and a
    few anywhere."""
    rng = np.random.default_rng(411)
    whole = rng.integers(-3, 8, (500, 3)).astype(float)
    halves = rng.integers(-4, 13, (300, 3)) * 0.5
    return np.concatenate([whole, halves, rng.uniform(-3, 7, (200, 3))])


@cache
def _on_lattice(place: str, off: str) -> Scenario:
    light = np.array(_PLACES[place]) + [0.0, 0.0, _OFF[off]]
    points = _lattice_points()
    vertices, triangles = _mesh()
    through = light + 2.0 * (vertices - light)  # exactly behind every vertex
    return Scenario(np.concatenate([points, through]), PointLight("lamp", light), vertices, triangles)


@pytest.mark.parametrize("place", _PLACES)
def test_light_on_a_lattice(tracer: Any, place: str) -> None:
    scenario = _on_lattice(place, "on")
    scenario.check(tracer)
    assert 0.2 < scenario.answer.hidden.mean() < 0.9


@pytest.mark.parametrize("off", [name for name, height in _OFF.items() if height])
@pytest.mark.parametrize("place", ["vertex", "edge", "inside a triangle", "plane of a side, outside"])
def test_light_a_hair_off_a_lattice(tracer: Any, place: str, off: str) -> None:
    scenario = _on_lattice(place, off)
    scenario.check(tracer)
    assert 0.2 < scenario.answer.hidden.mean() < 0.95


def test_a_hair_makes_a_difference() -> None:
    """Of the oracle: an ulp above a triangle all that is below it is in its shadow, exactly on it nothing is."""
    points = _on_lattice("inside a triangle", "on").points
    below = points[:, 2] < 4.0
    on, above = (_on_lattice("inside a triangle", off).answer.hidden for off in ("on", "an ulp above"))
    assert above[below].all() and on[below].mean() < 0.95


@pytest.mark.parametrize("place", ["vertex", "edge", "diagonal", "inside a triangle"])
def test_triangles_at_the_light_might_as_well_not_be_there(tracer: Any, place: str) -> None:
    """The light is in their planes, so they cast nothing: neither they nor their absence changes anything else."""
    light, (vertices, triangles) = np.array(_PLACES[place]), _mesh()
    in_plane = (vertices[triangles][:, :, 2] == light[2]).all(axis=1)
    assert 5 < in_plane.sum() < len(triangles) / 2
    points = _on_lattice(place, "on").points
    answers = []
    for chosen in (triangles, triangles[~in_plane], triangles[in_plane]):
        tracer.scene.put("mesh", vertices, chosen)
        answers.append(tracer.occluded(points, PointLight("lamp", light)))
    np.testing.assert_array_equal(answers[0], answers[1])
    assert answers[0].any() and not answers[2].any()


# --- on a round mesh, where nothing is exact but the vertex itself ---


@cache
def _on_sphere(kind: str, seed: int) -> Scenario:
    rng = np.random.default_rng([412, seed])
    vertices, triangles = geometry.icosphere(2, 1.0, rng.normal(size=3))
    a, b, c = vertices[triangles[rng.integers(len(triangles))]]
    light = {"vertex": a, "edge": 0.5 * (a + b), "triangle": (a + b + c) / 3.0, "line of an edge": b + 2.0 * (b - a)}[
        kind
    ]
    ways = np.concatenate([vertices - light, geometry.edge_points(vertices, triangles) - light])
    along = np.concatenate([ways * 0.5, ways, ways * 1.5])[rng.permutation(3 * len(ways))[:900]]
    points = np.concatenate([light + along, light + geometry.directions(rng, 300) * rng.uniform(0.0, 3.0, (300, 1))])
    return Scenario(points, PointLight("lamp", light), vertices, triangles)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["vertex", "edge", "triangle", "line of an edge"])
@pytest.mark.slow
def test_light_on_a_sphere(tracer: Any, kind: str, seed: int) -> None:
    scenario = _on_sphere(kind, seed)
    scenario.check(tracer)
    assert 0.1 < scenario.answer.hidden.mean() < 0.95


# --- three planes of one kilometre crossing ---

_CROSSING = {
    "at the crossing": (0.0, 0.0, 0.0),
    "on the line of two": (0.0, 0.0, 0.375),
    "in one": (0.25, 0.0, 0.375),
    "off all": (0.25, -0.5, 0.375),
    "a hair off one": (1e-12, 0.0, 0.0),
    "a hair off all": (1e-7, -1e-7, 1e-6),
    "at a far corner": (500.0, 500.0, 0.0),
}


@cache
def _planes(cells: int, place: str, turned: bool) -> Scenario:
    """Through the crossing goes an edge of each plane if ``cells`` is odd, a vertex if it is even. All have holes."""
    rng = np.random.default_rng([413, cells])
    vertices, triangles = geometry.join([crowds.lattice_plane(axis, cells, 500.0) for axis in range(3)])
    triangles = triangles[rng.random(len(triangles)) < (0.8 if cells > 2 else 1.0)]
    points = np.concatenate(
        [
            rng.uniform(-3, 3, (200, 3)),
            rng.uniform(-600, 600, (200, 3)),
            rng.integers(-2, 3, (150, 3)),  # in the planes, on the lines, at the crossing
            rng.integers(-6, 7, (150, 3)) * 100.0,
        ]
    )
    light = np.array(_CROSSING[place])
    if turned:  # the planes of a turned scene cross at the light only nearly
        turn = geometry.rotation(rng)
        points, vertices, light = points @ turn.T, vertices @ turn.T, turn @ light
    return Scenario(points, PointLight("lamp", light), vertices, triangles)


@pytest.mark.parametrize("cells", [1, 2, 5, 8])
@pytest.mark.parametrize("place", _CROSSING)
@pytest.mark.slow
def test_kilometre_planes(tracer: Any, place: str, cells: int) -> None:
    scenario = _planes(cells, place, False)
    scenario.check(tracer)
    if place != "at the crossing":
        assert scenario.answer.hidden.mean() > 0.1


@pytest.mark.parametrize("place", ["at the crossing", "off all"])
def test_kilometre_planes_turned(tracer: Any, place: str) -> None:
    _planes(5, place, True).check(tracer)


def test_nothing_is_hidden_from_the_crossing_of_whole_planes(tracer: Any) -> None:
    scenario = _planes(8, "at the crossing", False)
    assert not scenario.check(tracer).any()


# --- as images: the same, with a camera between the planes and all lights in one frame ---


@cache
def _room_corner() -> tuple[views.View, np.ndarray]:
    """Three planes of a kilometre, a box on them, and lights at the crossing, on a line, in a plane, on the box."""
    rng = np.random.default_rng(414)
    vertices, triangles = geometry.join(
        [
            *(crowds.lattice_plane(axis, 4, 500.0) for axis in range(3)),
            geometry.box((1.0, 1.0, 0.0), (2.0, 3.0, 1.5)),
            geometry.soup(rng, 60, 0.3, 2.0),
        ]
    )
    camera = Camera(48, 48, 40.0, 40.0, 23.5, 23.5, geometry.look_at((6.0, 5.0, 4.0), (0.5, 0.5, 0.5), (0, 0, 1)))
    depth = rng.uniform(3.0, 12.0, (48, 48)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = np.nan
    depth[:8, :8] = 400.0
    lights = (
        PointLight("crossing", (0.0, 0.0, 0.0)),
        PointLight("line", (0.0, 0.0, 2.0)),
        PointLight("plane", (3.0, 0.0, 2.0)),
        PointLight("corner of the box", (2.0, 3.0, 1.5)),
        PointLight("edge of the box", (2.0, 2.5, 1.5)),
        PointLight("side of the box", (1.25, 2.25, 1.5)),
        SpotLight("spot on the box", (2.0, 3.0, 1.5), (1.0, 0.0, -0.5), 1.4),
    )
    view = views.View(vertices, triangles, depth, camera, lights, 0.001)
    return view, views.expected_states(view)


def test_image_with_lights_on_triangles(tracer: Any) -> None:
    view, expected = _room_corner()
    view.check(tracer, expected)
    for k, light in enumerate(view.lights):
        assert (expected[k] == State.SHADOWED).any() and (expected[k] == State.LIT).any(), light.name
