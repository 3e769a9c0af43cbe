# SPDX-License-Identifier: Apache-2.0
"""Cells of directions around a light: rays on their borders, the order of what is in them, short lists, and the
triangle that is tried first."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest
from trees import clusters, equal, hidden, mesh_of, tracer_of, unlike_scenes

from shadow_tracer import DirectionalLight, PointLight, ShadowTracer

pytestmark = probe.in_both_forms

_LAMP = PointLight("lamp", (0.013, -0.027, 3.1))
_LIGHTS: dict[str, Any] = {
    "above": _LAMP,
    "among": PointLight("lamp", (0.1, 0.05, -0.02)),
    "far": PointLight("lamp", (300.0, -200.0, 900.0)),
    "sun": DirectionalLight("sun", (0.31, -0.17, -0.9)),
}


def _buffer(device: str, **more: int) -> ShadowTracer:
    return tracer_of(device, "light_buffer", **more)


def _lists(tracer: ShadowTracer) -> tuple[int, list[np.ndarray], list[np.ndarray]]:
    """Columns of a face; members and depths of each list."""
    made = probe.structure(tracer)
    columns = int(made.columns.numpy()[0])
    start = made.start.numpy()[: 6 * columns**2 + 7]
    ends = list(zip(start[:-1], start[1:], strict=True))
    return columns, *([array.numpy()[a:b] for a, b in ends] for array in (made.members, made.depths))


@pytest.mark.parametrize("name", _LIGHTS)
def test_lists_go_from_the_light_outwards(any_device: str, name: str) -> None:
    tracer, rng = _buffer(any_device), np.random.default_rng(1)
    mesh = geometry.join([mesh_of(clusters(rng, 1500)), geometry.square(2, -1.0, 4.0)])
    light, points = _LIGHTS[name], rng.uniform(-2, 2, (1500, 3))
    assert 300 < equal(tracer, mesh, points, light).sum() < 1200
    columns, members, depths = _lists(tracer)
    assert 30 <= columns <= 60 and max(map(len, members[:-6])) > 3
    held = np.concatenate(members)
    assert len(set(held.tolist())) == 1502 and len(held) < 10 * 1502
    for some, far in zip(members, depths, strict=True):
        assert len(set(some.tolist())) == len(some)
        assert (np.diff(far) <= 0.0).all()


@pytest.mark.parametrize("room", [1, 700, 1500, 4000, 100_000])
def test_short_lists_make_larger_cells(any_device: str, room: int) -> None:
    """And where one cell a face is too many, there is none."""
    tracer, rng = _buffer(any_device, grid_entries=room), np.random.default_rng(2)
    mesh, found = geometry.soup(rng, 600, 0.2, 2.0), []
    for name in ("above", "among", "sun", "above"):
        assert equal(tracer, mesh, rng.uniform(-2, 2, (800, 3)), _LIGHTS[name]).any()
        columns = int(probe.structure(tracer).columns.numpy()[0])
        found.append(columns)
        if columns:
            assert sum(map(len, _lists(tracer)[1])) <= room
    assert (max(found) == 0) == (room == 1) and (min(found) > 20) == (room == 100_000)


def _on_borders(tracer: ShadowTracer, light: Any, rng: np.random.Generator, number: int) -> tuple[Any, np.ndarray]:
    """Points of the world whose directions are on borders of cells and of faces, and unit vectors away from the light
    there."""
    frame = probe.light_frame(tracer, light)
    columns, _, _ = _lists(tracer)
    axes = np.array([frame.r, frame.s, frame.f])
    scale, c, s = 1.0 / frame.inverse_scale, float(frame.w_constant), float(frame.w_slope)
    least, most = (columns // 3 + 1, columns - columns // 3) if s < 0.5 else (0, columns + 1)  # what samples reach
    on = 2.0 * rng.integers(least, most, (number, 2)) / columns - 1.0
    beside = np.where(rng.random((number, 2)) < 0.5, on, np.roll(on, 1, axis=0) * 0.97)
    size = rng.uniform(0.05, 0.35, number)
    face = rng.integers(0, 6 if s > 0.5 else 1, number)
    h = np.empty((number, 3))
    for k in range(3):
        mine = (face // 2 + 2) % 3 == k  # forward first
        h[mine, k] = np.where(face[mine] % 2, -size[mine], size[mine])
        h[mine, (k + 1) % 3], h[mine, (k + 2) % 3] = (size[:, None] * beside)[mine].T
    if s == 0.0:
        h /= h[:, 2:]
        z = rng.uniform(-0.5, 0.5, number)
    elif s < 0.5:
        z = rng.uniform(-0.3, 0.3, number)
        h *= ((c - s * z) / h[:, 2])[:, None]
    else:
        z = (c - h[:, 2]) / s
    places = np.array(frame.center) + scale * (np.column_stack([h[:, :2], z]) @ axes)
    away = np.broadcast_to(-axes[2], places.shape) if s == 0.0 else places - np.array(frame.light)[:3]
    return places, away / np.linalg.norm(away, axis=1, keepdims=True)


@pytest.mark.parametrize("spread", [1e-8, 1e-7, 1e-6])
@pytest.mark.parametrize("name", _LIGHTS)
def test_tiny_triangles_on_the_borders_of_cells(any_device: str, name: str, spread: float) -> None:
    """Each ray is aimed at its triangle, which lies in the corner or beside the border of a cell, or across it."""
    tracer, rng, number = _buffer(any_device), np.random.default_rng(3), 900
    # These keep the frame of the light where it is.
    light, around = _LIGHTS[name], np.array([[x, y, z] for x in (-3, 3) for y in (-3, 3) for z in (-3, 3)], float)
    points = around
    mesh = mesh_of(0.01 * rng.uniform(-1, 1, (number, 3, 3)))
    for _ in range(3):
        hidden(tracer, mesh, points, light)
        places, away = _on_borders(tracer, light, rng, number)
        offset = spread * rng.uniform(-1, 1, (number, 3))
        tiny = (places + offset)[:, None] + spread * rng.uniform(-1, 1, (number, 3, 3))
        mesh, points = mesh_of(tiny), tiny.mean(axis=1) + away * rng.uniform(0.05, 0.3, (number, 1))
        points = np.concatenate([points, around])
    before = probe.light_frame(tracer, light)
    assert equal(tracer, mesh, points, light).mean() > 0.5
    after = probe.light_frame(tracer, light)
    assert tuple(before.center) == tuple(after.center) and before.inverse_scale == after.inverse_scale, "other cells"


def test_triangles_behind_the_sample_are_not_tested(any_device: str) -> None:
    """A thousand triangles in the cells of the rays, farther from the light than the samples."""
    rng = np.random.default_rng(6)
    tracer, points = _buffer(any_device), np.column_stack([rng.uniform(-0.2, 0.2, (300, 2)), np.full(300, 2.0)])
    sheets = geometry.join([geometry.square(2, z, 1.0) for z in np.linspace(-1.0, 1.9, 1000)])
    for light in (_LAMP, DirectionalLight("sun", (0.0, 0.1, -1.0))):
        assert not equal(tracer, sheets, points, light).any()
        counters = probe.trace_points(tracer, points, [light]).counters
        assert counters["leaf_tests"] <= 20 * 300


def test_the_last_occluder_comes_first(any_device: str) -> None:
    """A frame of the same rays tests little more than what hid each; whatever is noted changes no answer."""
    rng = np.random.default_rng(7)
    tracer, points = _buffer(any_device), rng.uniform(-1, 1, (3000, 3)) * (1, 1, 0.1) - (0, 0, 1.5)
    mesh = geometry.soup(rng, 2000, 0.15, 1.0)
    expected = equal(tracer, mesh, points, _LAMP)
    last = probe.structure(tracer).last
    last.fill_(-1)
    tests = [probe.trace_points(tracer, points, [_LAMP]).counters["leaf_tests"] for _ in range(2)]
    assert tests[1] < 0.95 * tests[0] and expected.mean() > 0.3
    for numbers in (rng.integers(-5, 2000, last.shape), np.full(last.shape, 2**31 - 1), np.full(last.shape, 1999)):
        last.assign(numbers.astype(np.int32))
        assert np.array_equal(tracer.occluded(points, _LAMP), expected)


def test_the_order_of_rays_changes_no_answer(any_device: str) -> None:
    rng = np.random.default_rng(8)
    tracer, points = _buffer(any_device), rng.uniform(-1.5, 1.5, (2000, 3))
    mesh = geometry.join([geometry.soup(rng, 1500, 0.15, 2.0), geometry.icosphere(3, 0.4)])
    expected = equal(tracer, mesh, points, _LAMP)
    for _ in range(4):
        order = rng.permutation(len(points))
        assert np.array_equal(tracer.occluded(points[order], _LAMP), expected[order])


def test_wild_rays_are_shown_every_triangle(any_device: str) -> None:
    """Samples so near to the light, or at it, that their direction is lost in float32."""
    rng = np.random.default_rng(9)
    lamp = PointLight("lamp", (0.3, 0.2, 0.1))
    ways = geometry.directions(rng, 200)
    points = np.concatenate([lamp.position + ways * far for far in (0.0, 1e-12, 1e-9, 1e-8, 1e-7, 1e-3, 2.0)])
    cage = mesh_of(lamp.position + 0.3 * ways[:, None] + 0.2 * rng.uniform(-1, 1, (200, 3, 3)))
    near = mesh_of((lamp.position + 5e-9 * ways)[:, None] + 2e-8 * rng.uniform(-1, 1, (200, 3, 3)))
    tracer = _buffer(any_device)
    assert equal(tracer, geometry.join([cage, near]), points, lamp).any()


def test_unlike_frames(any_device: str) -> None:
    """Scenes, lights and samples in turn on one tracer: nothing of a frame before is read."""
    rng = np.random.default_rng(10)
    tracer, oracle = _buffer(any_device), tracer_of(any_device, "brute_force")
    for number, _ in unlike_scenes(rng, (tracer, oracle)):
        for each in (tracer, oracle):
            each.front_face_culling = number % 3 == 2
        points = rng.uniform(-1.2, 1.2, (500, 3)) * (10.0 if number % 4 == 3 else 1.0)
        pair = [_LIGHTS["above"], _LIGHTS["sun"]][:: 1 - 2 * (number % 2)]
        assert np.array_equal(tracer.states_at(points, pair), oracle.states_at(points, pair))
        light = list(_LIGHTS.values())[number % 4]
        assert np.array_equal(tracer.occluded(points, light), oracle.occluded(points, light))
