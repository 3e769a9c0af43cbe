# SPDX-License-Identifier: Apache-2.0
"""Rays in one tile, in one column, on one line; rays that crowd in one spot while a few are elsewhere; as many rays or
triangles as fit a tile or a list, and one more. On every pipeline, against the oracle."""

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


# --- all rays in one tile ---


def _blob(rng: np.random.Generator, axis: np.ndarray, width: float, count: int) -> np.ndarray:
    """(count, 3) samples between 1 and 3 m from the origin, within about ``width`` radians of each other."""
    ways = axis / np.linalg.norm(axis) + rng.normal(size=(count, 3)) * width
    points: np.ndarray = ways * rng.uniform(1.0, 3.0, (count, 1))
    return points


@cache
def _one_tile(way: int, width: float) -> Scenario:
    rng = np.random.default_rng([420, way])
    axis = bundles.AXES[way]
    near = geometry.soup(rng, 12, 0.5 * width, 2.0 * width)
    vertices, triangles = geometry.join(
        [
            bundles.edges_across(rng, axis, width, 1),
            (near[0] + 0.75 * axis / np.linalg.norm(axis), near[1]),
            geometry.soup(rng, 30, 0.1, 3.0),
        ]
    )
    return Scenario(_blob(rng, axis, width, 600), _LAMP, vertices, triangles)


@pytest.mark.parametrize("width", [1e-2, 1e-5, 1e-9, 1e-15])
@pytest.mark.parametrize("way", [0, 4, 6, 8], ids=["axis", "edge", "corner", "anywhere"])
def test_all_rays_in_one_tile(tracer: Any, way: int, width: float) -> None:
    scenario = _one_tile(way, width)
    scenario.check(tracer)
    if width > 1e-12:
        assert 0.1 < scenario.answer.hidden.mean() < 0.97


@cache
def _in_the_camera(width: int, height: int) -> tuple[views.View, np.ndarray]:
    """The light in the camera's own place, so that rays go through one pixel each; and a centimetre beside."""
    rng = np.random.default_rng([421, width, height])
    pose = geometry.pose_of(geometry.rotation(rng), (0.5, -1.0, 2.0))
    camera = Camera(width, height, 64.0, 64.0, 0.5 * width - 0.5, 0.5 * height - 0.5, pose)
    soup, triangles = geometry.soup(rng, 120, 0.05, 0.6)
    vertices = (soup + [0.0, 0.0, 2.0]) @ pose[:3, :3].T + pose[:3, 3]
    depth = rng.uniform(1.0, 4.0, (height, width)).astype(np.float32)
    lights = (
        PointLight("in the camera", pose[:3, 3]),
        PointLight("beside", pose[:3, 3] + 0.01 * pose[:3, 0]),
        SpotLight("torch", pose[:3, 3], pose[:3, 2], 0.3),
        DirectionalLight("along the axis", pose[:3, 2]),
    )
    view = views.View(vertices, triangles, depth, camera, lights, 0.001)
    return view, views.expected_states(view)


@pytest.mark.parametrize("size", [(48, 48), (8, 4), (1, 1), (33, 1), (1, 65)], ids=str)
def test_light_in_the_camera(tracer: Any, size: tuple[int, int]) -> None:
    view, expected = _in_the_camera(*size)
    view.check(tracer, expected)
    if size == (48, 48):
        hidden = (expected == State.SHADOWED).mean(axis=(1, 2))
        assert (hidden > 0.02).all() and (expected[2] == State.OUTSIDE).mean() > 0.1


@pytest.mark.parametrize("block", [1, 2, 8])
def test_one_block_of_pixels(tracer: Any, block: int) -> None:
    """All other pixels have no depth."""
    view, expected = _in_the_camera(48, 48)
    depth, states = np.full_like(view.depth, np.nan), np.full_like(expected, State.INVALID)
    there = np.s_[..., 20 : 20 + block, 25 : 25 + block]
    depth[there], states[there] = view.depth[there], expected[there]
    alone = replace(view, depth=depth)
    tracer.scene.put("mesh", alone.vertices, alone.triangles)
    np.testing.assert_array_equal(alone.trace(tracer), states)


def test_no_depth_at_all(tracer: Any) -> None:
    view, expected = _in_the_camera(48, 48)
    tracer.scene.put("mesh", view.vertices, view.triangles)
    for nothing in (np.nan, 0.0, -1.0, np.inf):
        states = replace(view, depth=np.full_like(view.depth, nothing)).trace(tracer)
        assert (states == State.INVALID).all()
        np.testing.assert_array_equal(view.trace(tracer)[:, :4], expected[:, :4])


# --- numbers about the sizes of tiles and chunks ---


@cache
def _sizes(triangles: int) -> Scenario:
    rng = np.random.default_rng([422, triangles])
    vertices, indices = geometry.soup(rng, 2100, 0.25, 1.5)
    points = np.concatenate([rng.uniform(-3, 3, (900, 3)), _blob(rng, bundles.AXES[8], 1e-3, 200)])
    return Scenario(points[rng.permutation(1100)], _LAMP, vertices, indices[:triangles])


@pytest.mark.parametrize("rays", [0, 1, 31, 32, 33, 63, 64, 65, 255, 257, 1023, 1024, 1025])
@pytest.mark.parametrize("triangles", [0, 1, 40])
def test_rays_by_the_tile(tracer: Any, triangles: int, rays: int) -> None:
    scenario = _sizes(triangles)
    tracer.scene.put("mesh", scenario.vertices, scenario.triangles)
    hidden = tracer.occluded(scenario.points[:rays], _LAMP)
    np.testing.assert_array_equal(hidden, scenario.answer.hidden[:rays])


@pytest.mark.parametrize("triangles", [15, 16, 17, 255, 256, 257, 511, 513, 2049])
def test_triangles_by_the_chunk(tracer: Any, triangles: int) -> None:
    scenario = _sizes(triangles)
    scenario.check(tracer)
    assert scenario.answer.hidden.any()


@cache
def _in_front(triangles: int, rays: int) -> Scenario:
    """Triangles all of which all rays of one tile come near, of which every one is met by at most a few."""
    rng = np.random.default_rng([423, triangles])
    points = bundles.grid(bundles.AXES[8], 1e-3, 16, 4.0)[:rays]
    aside = rng.normal(size=(triangles, 2)) * 5e-3
    right, down, forward = bundles.frame_of(bundles.AXES[8])
    centres = rng.uniform(0.5, 3.5, (triangles, 1)) * (forward + aside @ np.stack([right, down]))
    corners = centres[:, None] + rng.normal(size=(triangles, 3, 3)) * 4e-4
    return Scenario(points, _LAMP, *geometry.split(corners.reshape(-1, 3), np.arange(3 * triangles).reshape(-1, 3)))


@pytest.mark.parametrize("rays", [1, 32, 200])
@pytest.mark.parametrize("triangles", [255, 256, 257, 1500])
def test_long_lists_over_few_rays(tracer: Any, triangles: int, rays: int) -> None:
    _in_front(triangles, rays).check(tracer)


def test_long_lists_hide_some() -> None:
    hidden = _in_front(1500, 200).answer.hidden
    assert 0.1 < hidden.mean() < 0.9


# --- equal u ---


@cache
def _line(kind: str) -> Scenario:
    """Samples on one line through the light, on one that misses it, in one plane with it, or all at one place."""
    rng = np.random.default_rng(424)
    way = np.array([0.5, -0.25, 1.0])
    steps = np.concatenate([np.arange(1, 201) / 32.0, -np.arange(1, 101) / 32.0])[:, None]  # exactly on the line
    points = {
        "through the light": steps * way,
        "beside the light": steps * way + [0.0, 0.5, 0.0],
        "parallel to an axis": np.column_stack([np.full(300, 0.25), np.full(300, -0.5), steps]),
        "plane y = 0": np.column_stack([rng.uniform(-3, 3, 600), np.zeros(600), rng.uniform(-3, 3, 600)]),
        "plane x = z": rng.uniform(-3, 3, (600, 2))[:, [0, 1, 0]],
        "fan of columns": np.column_stack([rng.integers(-3, 4, 600), rng.uniform(-4, 4, 600), np.full(600, -4.0)]),
        "one place, hidden": np.tile([[1.5, -0.75, 3.0]], (700, 1)),
        "one place, lit": np.tile([[0.0625, -0.03125, 0.125]], (700, 1)),
        "two places": np.tile([[1.5, -0.75, 3.0], [0.0625, -0.03125, 0.125]], (350, 1)),
        "one direction and its opposite": np.repeat([1.0, -1.0], 300)[:, None] * rng.uniform(0.1, 4.0, (600, 1)) * way,
    }[kind]
    vertices, triangles = geometry.join(
        [
            geometry.soup(rng, 60, 0.4, 2.0),
            geometry.square(2, 1.0, 1.5),
            geometry.square(1, 0.0, 2.0),
            geometry.square(0, -1.0, 1.0),
        ]
    )
    return Scenario(points, _LAMP, vertices, triangles)


_LINES = (
    *("through the light", "beside the light", "parallel to an axis", "plane y = 0", "plane x = z", "fan of columns"),
    *("one place, hidden", "one place, lit", "two places", "one direction and its opposite"),
)


@pytest.mark.parametrize("kind", _LINES)
def test_samples_on_lines_and_planes(tracer: Any, kind: str) -> None:
    scenario = _line(kind)
    scenario.check(tracer)
    hidden = scenario.answer.hidden
    assert hidden.all() if kind.endswith("hidden") else not hidden.any() if kind.endswith("lit") else 0 < hidden.mean()


@cache
def _columns(turn: int) -> tuple[views.View, np.ndarray]:
    """Lights exactly in the planes of image columns and rows, where whole columns have one u; a wall at one depth, so
    that rows have one v."""
    rng = np.random.default_rng([425, turn])
    camera = Camera(33, 32, 16.0, 16.0, 16.0, 15.0, geometry.pose_of(crowds.TURNS[turn], (0.0, 0.0, 0.0)))
    depth = np.full((32, 33), 4.0, np.float32)
    depth[::5, ::3] = 3.0
    soup, triangles = geometry.soup(rng, 100, 0.2, 0.8)
    axes = crowds.TURNS[turn]
    vertices = (soup + [0.0, 0.0, 2.0]) @ axes.T
    lights = (
        PointLight("middle column", axes @ [0.0, -3.0, 0.0]),
        PointLight("middle row", axes @ [2.0, 0.0, 1.0]),
        PointLight("in front", axes @ [0.0, 0.0, 0.5]),
        PointLight("far in a column", axes @ [0.0, -3e5, -4e5]),
        DirectionalLight("sun in a column", axes @ [0.0, 0.5, 1.0]),
        DirectionalLight("sun along the axis", axes @ [0.0, 0.0, 1.0]),
    )
    view = views.View(vertices, triangles, depth, camera, lights, 0.001)
    return view, views.expected_states(view)


@pytest.mark.parametrize("turn", range(6))
def test_columns_through_the_light(tracer: Any, turn: int) -> None:
    view, expected = _columns(turn)
    view.check(tracer, expected)
    assert ((expected == State.SHADOWED).mean(axis=(1, 2)) > 0.02).all()


# --- most rays in one spot, and outliers ---


@cache
def _uneven(width: float, light: str) -> Scenario:
    """1200 samples within ``width`` metres of each other, 40 anywhere and 10 kilometres away; triangles in all three
    places."""
    rng = np.random.default_rng(426)
    spot = np.array([1.0, 2.0, -1.5])
    lamp = _LIGHTS[light].homogeneous
    toward = lamp[:3] - lamp[3] * spot
    toward = toward / np.linalg.norm(toward)
    crowd = spot + rng.normal(size=(1200, 3)) * width
    near = geometry.soup(rng, 100, 0.4 * width, 2.0 * width)
    far = rng.normal(size=(10, 3)) * 1e3
    vertices, triangles = geometry.join(
        [
            (near[0] + spot + 4.0 * width * toward, near[1]),
            geometry.soup(rng, 100, 0.3, 3.0),
            geometry.square(2, -200.0, 300.0, (20.0, 30.0)),
        ]
    )
    points = np.concatenate([crowd, rng.uniform(-4, 4, (40, 3)), far])
    return Scenario(points[rng.permutation(len(points))], _LIGHTS[light], vertices, triangles)


@pytest.mark.parametrize("light", _LIGHTS)
@pytest.mark.parametrize("width", [1e-1, 1e-3, 1e-6])
def test_crowds_and_outliers(tracer: Any, width: float, light: str) -> None:
    scenario = _uneven(width, light)
    scenario.check(tracer)
    assert 0.05 < scenario.answer.hidden.mean() < 0.99
