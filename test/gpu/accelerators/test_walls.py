# SPDX-License-Identifier: Apache-2.0
"""Triangles that cover everything, crowd in one direction or are seen edge-on, and spots ever narrower. On every
pipeline, against the oracle."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import bundles
import crowds
import geometry
import numpy as np
import pytest
import views
from scenario import Scenario

from shadow_tracer import Camera, DirectionalLight, PointLight, SpotLight, State

_LAMP = PointLight("lamp", (0.0, 0.0, 0.0))
_LIGHTS = {
    "lamp": PointLight("lamp", (0.25, -0.5, 3.0)),
    "50 km": PointLight("50 km", (1.2e4, -3.6e4, 3.2e4)),
    "1e8 m": PointLight("1e8 m", (2.4e7, -7.2e7, 6.4e7)),
    "sun": DirectionalLight("sun", (-0.24, 0.72, -0.64)),
}


# --- one triangle over everything ---

# where the wall is, seen from the camera: depth in the middle and slope; samples are between 3 and 5 m
_WALLS = {
    "nearer": (2.0, 0.0),
    "farther": (7.0, 0.0),
    "through": (4.0, 0.0),
    "tilted through": (4.0, 0.4),
    "tilted nearer": (1.5, 0.2),
}


@cache
def _walled(wall: str, alone: bool) -> tuple[views.View, np.ndarray]:
    rng = np.random.default_rng(427)
    pose = geometry.look_at((1.0, -2.0, 1.5), (0.0, 4.0, 0.5), (0, 0, 1))
    camera = Camera(32, 32, 30.0, 30.0, 15.5, 15.5, pose)
    depth = rng.uniform(3.0, 5.0, (32, 32)).astype(np.float32)
    at, slope = _WALLS[wall]
    corners = np.array([(x, y, at + slope * x) for x, y in ((-90.0, -60.0), (90.0, -60.0), (1.0, 120.0))])
    soup, triangles = geometry.soup(rng, 60, 0.1, 1.0)
    parts = [(corners, np.array([[0, 1, 2]]))] + ([] if alone else [(soup + [0.0, 0.0, 3.0], triangles)])
    local, triangles = geometry.join(parts)
    axes = pose[:3, :3]
    eye = pose[:3, 3]
    lights = (
        PointLight("at the camera", eye + axes @ [0.3, 0.2, 0.0]),
        PointLight("behind the samples", eye + axes @ [0.3, 0.2, 9.0]),
        PointLight("among the samples", eye + axes @ [0.1, 0.2, 3.7]),
        SpotLight("spot", eye + axes @ [0.3, 0.2, -1.0], axes @ [0.1, 0.0, 1.0], 0.35),
        PointLight("far", eye + axes @ [3e3, -2e3, -5e4]),
        DirectionalLight("sun", axes @ [0.2, -0.1, 1.0]),
        DirectionalLight("from behind", axes @ [0.2, -0.1, -1.0]),
    )
    view = views.View(local @ axes.T + eye, triangles, depth, camera, lights, 0.01)
    return view, views.expected_states(view)


@pytest.mark.parametrize("alone", [True, False], ids=["alone", "in company"])
@pytest.mark.parametrize("wall", _WALLS)
def test_one_triangle_over_everything(tracer: Any, wall: str, alone: bool) -> None:
    view, expected = _walled(wall, alone)
    view.check(tracer, expected)
    if alone:
        hidden = [(states[states != State.OUTSIDE] == State.SHADOWED).mean() for states in expected]
        before, behind = [hidden[k] for k in (0, 3, 4, 5)], [hidden[k] for k in (1, 6)]
        if "nearer" in wall:
            assert min(before) == 1.0 and max(behind) == 0.0
        elif wall == "farther":
            assert max(before) == 0.0 and min(behind) == 1.0
        else:
            assert all(0.2 < part < 0.8 for part in before + behind)


@cache
def _layers() -> Scenario:
    """Three hundred triangles that each cover most directions, most of them behind the samples."""
    rng = np.random.default_rng(428)
    ways = geometry.directions(rng, 300)
    corners = []
    for way, distance in zip(ways, rng.uniform(1.5, 8.0, 300), strict=True):
        right, down, forward = bundles.frame_of(way)
        reach = rng.uniform(1.0, 60.0)
        corners.append([distance * forward + reach * (x * right + y * down) for x, y in ((-1, -1), (1, -1), (0, 1.5))])
    points = geometry.directions(rng, 900) * rng.uniform(0.5, 4.0, (900, 1))
    return Scenario(
        points, _LAMP, *geometry.split(np.reshape(corners, (-1, 3)), np.arange(900).reshape(-1, 3)), bias=0.01
    )


def test_hundreds_of_triangles_over_everything(tracer: Any) -> None:
    scenario = _layers()
    scenario.check(tracer)
    assert 0.2 < scenario.answer.hidden.mean() < 0.9


# --- narrow spots ---


@cache
def _spotted(half_angle: float) -> tuple[views.View, np.ndarray]:
    """The same view under a spot that is ever narrower: what is outside is neither lit nor shadowed nor traced."""
    rng = np.random.default_rng(429)
    camera = Camera(48, 48, 40.0, 40.0, 23.5, 23.5)
    depth = rng.uniform(3.0, 6.0, (48, 48)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.05] = 0.0
    soup, triangles = geometry.soup(rng, 150, 0.2, 1.5)
    place = (0.4, -0.3, 4.2)
    through = camera.unproject(np.where(depth > 0, depth, 4.0))[30, 20] - place  # one sample is in every cone
    lights = (
        SpotLight("spot", place, through, half_angle),
        SpotLight("near", place, through, half_angle, range=4.0),
        SpotLight("away", place, -through, half_angle),
        SpotLight("far", (400.0, -300.0, -5e3), (-400.0, 300.0, 5e3 + 4.0), half_angle * 1e-3),
    )
    view = views.View(soup + [0.0, 0.0, 3.0], triangles, depth, camera, lights, 0.01)
    return view, views.expected_states(view)


_ANGLES = [1e-7, 1e-3, 0.02, 0.1, 0.5, 1.2, 1.5707963, 2.0, 3.1]


@pytest.mark.parametrize("half_angle", _ANGLES)
def test_spots(tracer: Any, half_angle: float) -> None:
    view, expected = _spotted(half_angle)
    view.check(tracer, expected)
    frame = tracer.trace(view.depth, view.camera, view.lights[:1], view.bias)
    inside = np.isin(expected[0], [State.LIT, State.SHADOWED]).sum()
    assert frame.counters["rays"] == inside >= 1, "what is outside is not traced"


def test_spots_grow_with_their_angle() -> None:
    inside = [np.isin(_spotted(angle)[1][0], [State.LIT, State.SHADOWED]).sum() for angle in _ANGLES]
    assert inside[0] == 1 and inside == sorted(inside) and inside[-1] > 2000
    assert all((_spotted(angle)[1][2] == State.OUTSIDE).sum() > 2000 for angle in _ANGLES[:3])
    assert (_spotted(3.1)[1][2] == State.LIT).sum() > 100 and (_spotted(1.2)[1][0] == State.SHADOWED).sum() > 30


# --- triangles in one direction ---


@cache
def _terrain() -> tuple[views.View, np.ndarray]:
    """A rough height field of 1800 triangles under lights that see it edge-on: they are all behind each other."""
    rng = np.random.default_rng(430)
    vertices, triangles = crowds.terrain(rng, 30, 10.0, 6.0)
    camera = Camera(48, 48, 60.0, 60.0, 23.5, 23.5, geometry.look_at((290.0, 150.0, 30.0), (200, 150, 0), (0, 0, 1)))
    rows = np.linspace(0.0, 1.0, 48)[:, None]
    depth = (30.0 + 200.0 * (1.0 - rows) ** 2 + rng.normal(size=(48, 48)) * 3.0).astype(np.float32)
    lights = (
        PointLight("low", (-30.0, 150.0, 7.0)),
        PointLight("at the edge", (0.0, 155.0, 5.0)),
        PointLight("50 km", (-5e4, 150.0, 400.0)),
        PointLight("1e8 m", (-1e8, 150.0, 1e6)),
        DirectionalLight("sun", (1.0, 0.0, -0.01)),
        DirectionalLight("level", (1.0, 0.0, 0.0)),
    )
    view = views.View(vertices, triangles, depth, camera, lights, 0.05)
    return view, views.expected_states(view)


def test_terrain_edge_on(tracer: Any) -> None:
    view, expected = _terrain()
    view.check(tracer, expected)
    assert all(0.1 < part < 0.95 for part in (expected == State.SHADOWED).mean(axis=(1, 2)))


@cache
def _edge_on(light: str) -> Scenario:
    """A stack of squares in whose planes the light is, or nearly: each is a line, seen from there."""
    rng = np.random.default_rng(431)
    lamp = _LIGHTS[light].homogeneous
    toward = lamp[:3] / np.linalg.norm(lamp[:3])
    right, down, forward = bundles.frame_of(toward)
    corners = []
    for offset, tilt in zip(rng.uniform(-1, 1, 200), rng.choice([0.0, 1e-9, 1e-6, 1e-3], 200), strict=True):
        along, across = forward + tilt * right, down
        place = offset * right + rng.uniform(-1, 1) * down
        corners.append([place - 0.5 * along - across, place + 0.5 * along, place - 0.5 * along + across])
    vertices = np.reshape(corners, (-1, 3))
    behind = vertices[rng.integers(0, 600, 500)] - forward * rng.uniform(0.0, 4.0, (500, 1))
    behind += rng.normal(size=behind.shape) * 10.0 ** rng.uniform(-9, -1, (500, 1))
    points = np.concatenate([behind, rng.uniform(-2, 2, (300, 3))])
    return Scenario(points, _LIGHTS[light], *geometry.split(vertices, np.arange(600).reshape(-1, 3)))


@pytest.mark.parametrize("light", _LIGHTS)
def test_triangles_edge_on(tracer: Any, light: str) -> None:
    scenario = _edge_on(light)
    scenario.check(tracer)
    assert 0.02 < scenario.answer.hidden.mean() < 0.9


# --- what is no triangle, and what is one several times, among all this ---


@cache
def _rubbish() -> tuple[views.View, np.ndarray]:
    """The view with a wall through the samples, its mesh riddled with NaN, zero areas and everything five times."""
    view, expected = _walled("tilted through", False)
    rng = np.random.default_rng(432)
    count = len(view.vertices)
    waste = np.full((3, 3), np.nan)
    waste[1], waste[2] = (np.inf, 0.0, 0.0), (0.0, 0.0, 0.0)
    bad = rng.integers(0, count, (300, 3))
    bad[:100, 1] = count + rng.integers(0, 2, 100)
    bad[100:200, 2] = bad[100:200, 0]
    bad[200:] = bad[200:, :1]
    several = np.concatenate([view.triangles] * 4 + [view.triangles[:, ::-1]])
    triangles = np.concatenate([several, bad])[rng.permutation(5 * len(view.triangles) + 300)]
    return replace(view, vertices=np.concatenate([view.vertices, waste]), triangles=triangles), expected


def test_rubbish_changes_nothing(tracer: Any) -> None:
    view, expected = _rubbish()
    tracer.scene.put("mesh", view.vertices, view.triangles, nonfinite="skip")
    view.check_again(tracer, expected)
