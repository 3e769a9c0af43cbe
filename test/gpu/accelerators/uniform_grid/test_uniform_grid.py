# SPDX-License-Identifier: Apache-2.0
"""The uniform grid: its cells and their members, rays along planes, edges and corners of cells, short lists, and what
mailboxes save."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, DirectionalLight, PointLight, ShadowTracer
from shadow_tracer.gpu.accelerators.cells import cells_along

pytestmark = probe.in_both_forms

_BOUNDS = {"max_triangles": 5000, "max_rays": 20_000, "max_lights": 2}


def _tracer(device: str, pipeline: str = "uniform_grid", **more: int) -> ShadowTracer:
    return ShadowTracer(pipeline, device=device, bounds=Bounds(**{**_BOUNDS, **more}), threads=1)


def _shape(tracer: ShadowTracer) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells along each axis, and in the scene's coordinates the low corner of the first and their size."""
    structure = probe.structure(tracer)
    found: Any = structure.shape.numpy()[0]
    extent = 1.0 / structure.box.inverse_extent
    low = np.array(structure.box.center) + extent * np.asarray(found["low"], float)
    return np.asarray(found["count"], int), low, extent * np.asarray(found["size"], float)


def _hidden(tracer: ShadowTracer, mesh: geometry.Geometry, points: np.ndarray, light: Any) -> np.ndarray:
    tracer.scene.put("mesh", *mesh)
    return tracer.occluded(points, light)


@pytest.mark.parametrize("half", [(1, 1, 1), (1, 1, 1e-7), (1, 1e-7, 1e-7), (1, 0.3, 0.01), (1e-7, 1, 0.5)])
@pytest.mark.parametrize("most", [1, 2, 16, 1000, 100_000, 4_000_000])
def test_cells_are_as_near_to_cubes_as_may_be(half: tuple[float, float, float], most: int) -> None:
    along = np.array(cells_along(np.array(half, float), most))
    assert (along >= 1).all() and (along <= 256).all() and along.prod() <= most
    wide = along > 1
    size = np.array(half, float) / along
    free = wide & (along < 256)
    if free.sum() > 1:
        assert size[free].max() <= 2.1 * size[free].min()
    # Twice as many along each axis that can take them would be too many.
    assert along.prod() * 2 ** int((size > 0.4 * size[wide].max(initial=0)).sum() or 3) > most or along.max() == 256


def test_triangles_are_members_of_the_cells_that_they_touch(any_device: str) -> None:
    tracer, rng = _tracer(any_device), np.random.default_rng(1)
    vertices, triangles = geometry.soup(rng, 400, 0.3, 2.0)
    _hidden(tracer, (vertices, triangles), np.zeros((1, 3)), PointLight("lamp", (0, 0, 9)))
    count, low, size = _shape(tracer)
    structure = probe.structure(tracer)
    start, members = structure.start.numpy()[: count.prod() + 1], structure.members.numpy()
    assert 0.5 < count.prod() / 800 <= 1.0
    within = [set(members[start[k] : start[k + 1]]) for k in range(count.prod())]
    assert sum(map(len, within)) == start[-1]
    corners = vertices[triangles]
    for point, triangle in zip(corners.reshape(-1, 3), np.repeat(np.arange(len(triangles)), 3), strict=True):
        cell = np.clip(((point - low) / size).astype(int), 0, count - 1)
        assert triangle in within[(cell[2] * count[1] + cell[1]) * count[0] + cell[0]]


@pytest.mark.parametrize("room", [300, 700, 1500, 100_000])
def test_a_short_list_makes_larger_cells(any_device: str, room: int) -> None:
    rng = np.random.default_rng(2)
    mesh, points = geometry.soup(rng, 300, 0.5, 2.0), rng.uniform(-3, 3, (2000, 3))
    lamp = PointLight("lamp", (0.1, 0.2, 2.5))
    expected = _hidden(_tracer(any_device, "brute_force"), mesh, points, lamp)
    tracer = _tracer(any_device, max_triangles=300, grid_entries=room)
    for _ in range(2):
        assert np.array_equal(_hidden(tracer, mesh, points, lamp), expected)
    count, _, _ = _shape(tracer)
    used = probe.structure(tracer).start.numpy()[count.prod()]
    assert 300 <= used <= room
    assert (count.prod() == 1) == (room == 300)
    assert 100 < expected.sum() < 1900


def _lattice(
    tracer: ShadowTracer, number: int, half: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A scene of ``number`` small triangles in a box of this half size, which other triangles keep: the corners of
    these, some corners of inner cells, and the cells' size."""
    rng = np.random.default_rng(3)
    box = np.array([(-1, -1, -1), (-1, -0.99, -1), (-0.99, -1, -1), (1, 1, 1), (1, 0.99, 1), (0.99, 1, 1)]) * half
    vertices = np.concatenate([box, rng.uniform(-0.9, 0.9, (3 * number, 3)) * half])
    tracer.scene.put("mesh", vertices, np.arange(len(vertices)).reshape(-1, 3))
    tracer.occluded(np.zeros((1, 3)), PointLight("lamp", (0, 0, 9)))
    count, low, size = _shape(tracer)
    inner = [low[k] + size[k] * np.arange(1, count[k]) for k in range(3)]
    return box, np.stack([rng.choice(plane, number) for plane in inner], axis=-1), size


@pytest.mark.parametrize("spread", [1e-8, 1e-7, 1e-6, 0.0])
@pytest.mark.parametrize("kind", ["point", "directional", "along an axis", "through many cells"])
def test_tiny_triangles_at_the_corners_of_cells(any_device: str, kind: str, spread: float) -> None:
    """Rays that cut a corner of a cell by less than a rounding, and triangles that lie in that corner alone, or across
    it: each ray is aimed at its triangle's middle, and none is missed."""
    tracer, rng, number = _tracer(any_device), np.random.default_rng(4), 1500
    long = kind == "through many cells"
    box, corners, size = _lattice(tracer, number, (1.0, 0.05, 0.05) if long else (1.0, 1.0, 1.0))
    assert not long or _shape(tracer)[0][0] > 100
    reach = np.maximum(spread, 1e-9)
    offset = spread * rng.uniform(-1, 1, (number, 3))
    small = corners[:, None] + offset[:, None] + reach * rng.uniform(-1, 1, (number, 3, 3))
    vertices = np.concatenate([box, small.reshape(-1, 3)])
    triangles = np.arange(len(vertices)).reshape(-1, 3)
    middle = small.mean(axis=1)
    if kind == "point":
        light: Any = PointLight("lamp", (0.013, -0.027, 3.1))
        away = middle - light.position
    else:
        ways = {"along an axis": (0.0, 0.0, -1.0), "through many cells": (-1.0, 0.013, 0.021)}
        way = ways.get(kind, (0.31, -0.17, -0.9))
        light = DirectionalLight("sun", way)
        away = np.broadcast_to(np.array(way), middle.shape)
    points = middle + away / np.linalg.norm(away, axis=1, keepdims=True) * rng.uniform(0.3, 3.0, (number, 1))
    hidden = _hidden(tracer, (vertices, triangles), points, light)
    assert np.array_equal(_shape(tracer)[2], size), "the same cells"
    expected = _hidden(_tracer(any_device, "brute_force"), (vertices, triangles), points, light)
    assert np.array_equal(hidden, expected)
    assert expected.mean() > 0.5


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rays_within_the_planes_between_cells(any_device: str, axis: int) -> None:
    """They start on planes and edges of cells and go along them, towards triangles that lie in them or cross them."""
    tracer, rng, number = _tracer(any_device), np.random.default_rng(5), 600
    box, corners, size = _lattice(tracer, number)
    spans = rng.uniform(-1, 1, (number, 3, 3)) * size
    spans[: number // 2, :, (axis + 1) % 3] = 0.0  # these lie in a plane
    vertices = np.concatenate([box, (corners[:, None] + spans).reshape(-1, 3)])
    triangles = np.arange(len(vertices)).reshape(-1, 3)
    way = np.zeros(3)
    way[axis] = 1.0
    points = np.concatenate([corners - 0.7 * way, corners - size * way])
    for sign in (1.0, -1.0):
        light = DirectionalLight("sun", sign * way)
        hidden = _hidden(tracer, (vertices, triangles), points, light)
        assert np.array_equal(hidden, _hidden(_tracer(any_device, "brute_force"), (vertices, triangles), points, light))
        assert 20 < hidden.sum() < len(points) - 20


def test_mailboxes_test_a_triangle_once(any_device: str) -> None:
    """A slanted plate lies in many cells of a ray's way, and is tested once by each ray."""
    rng = np.random.default_rng(6)
    dots = geometry.soup(rng, 2000, 0.01, 1.0)
    plate = (np.array([(-1, -1, -1), (1, -1, -1), (0, 1, 1.0)]), np.array([(0, 1, 2)]))
    tracer = _tracer(any_device)
    points = np.column_stack([rng.uniform(-0.9, 0.9, (500, 2)), np.full(500, -1.5)])
    tests = []
    for mesh in (dots, geometry.join([dots, plate])):
        tracer.scene.put("mesh", *mesh)
        traced = probe.trace_points(tracer, points, [PointLight("lamp", (0.9, 0.9, 1.5))])
        tests.append(traced.counters["leaf_tests"])
        assert traced.counters["nodes_visited"] > 4 * 500
    assert tests[0] < tests[1] <= tests[0] + 500


def test_samples_far_away_and_beside_the_box(any_device: str) -> None:
    rng = np.random.default_rng(7)
    mesh = geometry.icosphere(2, 1.0)
    ways = rng.normal(size=(300, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    points = np.concatenate([ways * far for far in (1.0, 1.5, 1e3, 6.7e7, 6.8e7, 1e15)])
    for light in (PointLight("inside", (0.1, 0.0, 0.2)), PointLight("outside", (3.0, 1.0, 0.5))):
        hidden = _hidden(_tracer(any_device), mesh, points, light)
        assert np.array_equal(hidden, _hidden(_tracer(any_device, "brute_force"), mesh, points, light))
        assert hidden.any()
