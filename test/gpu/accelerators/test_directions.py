# SPDX-License-Identifier: Apache-2.0
"""Rays exactly where a grid of directions has its seams: along axes, face diagonals and corners of a cube, on
|x| = |y|, at poles; with triangles whose corners and edges are exactly there. On every pipeline, against the oracle."""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import Any

import crowds
import geometry
import numpy as np
import oracle
import pytest
import views
from scenario import Scenario

from shadow_tracer import Camera, DirectionalLight, PointLight, SpotLight, State

_ORIGIN = np.zeros(3)
_ELSEWHERE = np.array([0.5, -0.25, 0.125])


def _rays(rng: np.random.Generator, distances: tuple[float, ...]) -> np.ndarray:
    """Samples in the 26 directions of a cube at all distances, on seams and hairs beside them at some."""
    ways = np.concatenate([crowds.seam_directions(4), crowds.hairs_beside(rng, crowds.cube_directions(), 300)])
    some = ways * rng.choice(distances, (len(ways), 1))
    return np.concatenate([*(crowds.cube_directions() * d for d in distances), some])


# --- corners that are on seams, at the light, and hairs beside both ---


@cache
def _hairs(seed: int, light: tuple[float, ...]) -> Scenario:
    """Triangles between any three points with coordinates 0, +-1e-7, 1e-6 and +-1 from the light, some of them twice as
    large."""
    rng = np.random.default_rng([400, seed])
    places = np.array(list(product(crowds.HAIRS, repeat=3)))
    corners = places[rng.integers(0, len(places), (14, 3))] * rng.choice([1.0, 2.0], (14, 1, 1))
    vertices, triangles = geometry.split(corners.reshape(-1, 3), np.arange(42).reshape(-1, 3))
    points = np.concatenate([_rays(rng, (0.5, 1.0, 1.5, 4.0)), places])
    return Scenario(points + light, PointLight("lamp", light), vertices + light, triangles)


@pytest.mark.parametrize("light", [_ORIGIN, _ELSEWHERE], ids=["origin", "elsewhere"])
@pytest.mark.parametrize("seed", range(3))
def test_corners_on_seams_and_at_the_light(tracer: Any, seed: int, light: np.ndarray) -> None:
    scenario = _hairs(seed, tuple(light))
    scenario.check(tracer)
    assert 0.15 < scenario.answer.hidden.mean() < 0.98


@cache
def _thin(seed: int) -> Scenario:
    """Triangles of 1e-7 and 1e-6 exactly on seams and axes a metre away, in front of rays through their corners."""
    rng = np.random.default_rng([401, seed])
    ways = np.concatenate([crowds.cube_directions(), crowds.seam_directions(2)])
    centres = ways[rng.integers(0, len(ways), 150)]
    corners = centres[:, None] + rng.choice([0.0, 1e-7, -1e-7, 1e-6, -1e-6], (150, 3, 3))
    vertices, triangles = geometry.split(corners.reshape(-1, 3), np.arange(450).reshape(-1, 3))
    points = np.concatenate([2.0 * corners.reshape(-1, 3), 2.0 * corners.mean(axis=1), 2.0 * ways])
    return Scenario(points, PointLight("lamp", _ORIGIN), vertices, triangles)


@pytest.mark.parametrize("seed", range(2))
def test_hair_thin_triangles_on_seams(tracer: Any, seed: int) -> None:
    scenario = _thin(seed)
    scenario.check(tracer)
    assert 0.3 < scenario.answer.hidden.mean() < 0.98


# --- nothing gets through seams ---


@cache
def _around(name: str) -> geometry.Geometry:
    if name == "cube":
        return geometry.box((-1, -1, -1), (1, 1, 1))
    if name == "lattice":
        vertices, triangles = crowds.lattice_box(4)
        return vertices - 2.0, triangles
    if name == "octahedron":
        return crowds.octahedron(0)
    return crowds.octahedron(3, 8.0)


@pytest.mark.parametrize("split", [False, True], ids=["welded", "split"])
@pytest.mark.parametrize("name", ["cube", "lattice", "octahedron", "fine octahedron"])
def test_no_leak_at_seams(tracer: Any, name: str, split: bool) -> None:
    """Vertices on axes, diagonals and corners, edges on |x| = |y| or in the planes between the axes; the light inside,
    rays exactly at all of them."""
    vertices, triangles = _around(name)
    targets = np.concatenate([vertices, geometry.edge_points(vertices, triangles, (0.5, 0.25))])
    reach = np.abs(vertices).max()
    rng = np.random.default_rng(402)
    ways = _rays(rng, (3.0 * reach, 5.0 * reach))  # a corner of the octahedron is three times nearer than the cube's
    samples = np.concatenate([2.0 * targets, 1.5 * targets, ways])
    tracer.scene.put("closed", *(geometry.split(vertices, triangles) if split else (vertices, triangles)))
    samples = samples[:: 1 if tracer.variant != "float64" else 7]
    assert tracer.occluded(samples, PointLight("lamp", _ORIGIN)).all()
    assert not tracer.occluded(0.15 * samples / np.abs(samples).max(axis=1, keepdims=True) * reach, _LAMP).any()


_LAMP = PointLight("lamp", _ORIGIN)


# --- poles ---


@cache
def _poles(spokes: int) -> Scenario:
    """Fans around all six axes, rays exactly through their middles, a hair beside, and through every spoke."""
    rng = np.random.default_rng([403, spokes])
    parts = [crowds.fan(axis, side, spokes, 0.125) for axis in range(3) for side in (-1.0, 1.0)]
    vertices, triangles = geometry.join(parts)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    near = np.repeat(axes, 60, axis=0)
    near = near + rng.normal(size=near.shape) * 10.0 ** rng.uniform(-14, -0.7, (len(near), 1))
    points = np.concatenate([2.0 * axes, 2.0 * near, 2.0 * vertices, 2.0 * geometry.edge_points(vertices, triangles)])
    return Scenario(points, _LAMP, vertices, triangles)


@pytest.mark.parametrize("spokes", [3, 4, 48])
def test_fans_around_poles(tracer: Any, spokes: int) -> None:
    scenario = _poles(spokes)
    scenario.check(tracer)
    assert 0.3 < scenario.answer.hidden.mean() < 0.98


# --- lights along seams ---


@cache
def _lattice(light: Any) -> Scenario:
    """Integer triangles and samples, so that rays run exactly through corners and along edges."""
    rng = np.random.default_rng(404)
    vertices, triangles = geometry.join([geometry.integer_soup(rng, 40), crowds.lattice_plane(2, 4, 4.0, -3.0)])
    points = np.concatenate([rng.integers(-6, 7, (500, 3)), rng.integers(-12, 13, (300, 3)) * 0.5])
    return Scenario(points, light, vertices, triangles)


_ALONG = {"axis": (0.0, 0.0, -1.0), "edge": (-1.0, 0.0, -1.0), "corner": (1.0, -1.0, -1.0), "pole": (0.0, 1.0, 0.0)}
_KINDS = {
    "sun": {name: DirectionalLight("sun", way) for name, way in _ALONG.items()},
    "star": {name: PointLight("star", -np.array(way) * 2.0**26) for name, way in _ALONG.items()},
    "lamp": {name: PointLight("lamp", -np.array(way) * 8.0) for name, way in _ALONG.items()},
}


@pytest.mark.parametrize("way", _ALONG)
@pytest.mark.parametrize("kind", _KINDS)
def test_lights_along_axes_and_diagonals(tracer: Any, kind: str, way: str) -> None:
    scenario = _lattice(_KINDS[kind][way])
    scenario.check(tracer)
    assert 0.1 < scenario.answer.hidden.mean() < 0.95


# --- depth images whose columns and rows are exactly on seams ---


@cache
def _seam_image(turn: int, at_light: bool) -> tuple[views.View, np.ndarray]:
    """Looks along an axis, more than 90 degrees wide: eight pixels from the middle are rows and columns of rays with
    |x| = |z|, |y| = |z| exactly; the middle ones are on the axis. Or the light is a unit beside the camera."""
    rng = np.random.default_rng([405, turn])
    camera = Camera(21, 21, 8.0, 8.0, 10.0, 10.0, geometry.pose_of(crowds.TURNS[turn], (0.0, 0.0, 0.0)))
    depth = rng.choice([1.0, 1.5, 2.0, 3.0, 4.5], (21, 21)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.05] = np.nan
    vertices, triangles = geometry.join(
        [
            geometry.soup(rng, 40, 0.3, 1.5),
            *(geometry.square(axis, (-0.5, 0.5)[(axis + turn) % 2], 0.5) for axis in range(3)),
        ]
    )
    place = crowds.TURNS[turn] @ [0.0 if at_light else 1.0, 0.0, 0.0]
    lights = (
        PointLight("lamp", place),
        SpotLight("spot", place, crowds.TURNS[turn][:, 2], 0.9),
        SpotLight("half space", place, crowds.TURNS[turn][:, 2] + crowds.TURNS[turn][:, 0], 1.9),
        DirectionalLight("sun", crowds.TURNS[turn][:, 2] + crowds.TURNS[turn][:, 1]),
    )
    view = views.View(vertices, triangles, depth, camera, lights, 0.001)
    return view, views.expected_states(view)


@pytest.mark.parametrize("at_light", [True, False], ids=["light in the camera", "light beside it"])
@pytest.mark.parametrize("turn", range(6))
def test_images_with_columns_on_seams(tracer: Any, turn: int, at_light: bool) -> None:
    view, expected = _seam_image(turn, at_light)
    view.check(tracer, expected)
    hidden, outside = ((expected == state).mean(axis=(1, 2)) for state in (State.SHADOWED, State.OUTSIDE))
    assert (hidden > 0.05).sum() >= 2 and hidden.max() < 0.95 and outside[1] > 0.05


def test_the_seams_are_exact() -> None:
    """What this file promises about its directions."""
    ways = crowds.seam_directions()
    largest = np.sort(np.abs(ways), axis=1)
    assert (largest[:, 2] == 1.0).all() and (np.diff(largest[:, 1:], axis=1) <= 2e-16).all()
    assert 0.3 < (largest[:, 1] == 1.0).mean() < 0.9
    points = _seam_image(2, True)[0].camera.unproject(np.full((21, 21), 1.5, np.float32))
    assert (np.abs(points[:, 18]).max(axis=1) >= 1.5).all() and (np.abs(points[4:17, 18, [0, 2]]) == 1.5).all()
    for turn in crowds.TURNS:
        assert np.linalg.det(turn) == 1.0 and set(np.abs(turn).reshape(-1)) == {0.0, 1.0}
    for name in ("cube", "lattice", "octahedron", "fine octahedron"):
        vertices, triangles = _around(name)
        ways = 10.0 * vertices[:3] / np.abs(vertices[:3]).max()
        assert oracle.occluded(ways, _LAMP, vertices, triangles).hidden.all()
