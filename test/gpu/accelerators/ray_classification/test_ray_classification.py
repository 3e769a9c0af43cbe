# SPDX-License-Identifier: Apache-2.0
"""Cells of origins and directions: lists that are made when rays ask for them, rays on the borders of cells, and little
memory."""

from __future__ import annotations

import geometry
import numpy as np
import probe
import pytest
from trees import clusters, equal, mesh_of, tracer_of, unlike_scenes

from shadow_tracer import DirectionalLight, PointLight, ShadowTracer
from shadow_tracer.gpu.accelerators.ray_classification import ray_classification

pytestmark = probe.in_both_forms

_LAMP = PointLight("lamp", (0.013, -0.027, 3.1))
_SUN = DirectionalLight("sun", (0.31, -0.17, -0.9))


def _tracer(device: str, **more: int) -> ShadowTracer:
    return tracer_of(device, "ray_classification", **more)


def _made(tracer: ShadowTracer) -> int:
    """Cells that have lists, the six of all origins among them."""
    return int(probe.structure(tracer).made.numpy()[1])


def test_lists_are_made_when_they_are_asked_for(any_device: str) -> None:
    rng = np.random.default_rng(1)
    tracer, mesh = _tracer(any_device), mesh_of(clusters(rng, 1500))
    points = np.array([[0.9, 0.9, -0.9], [0.9001, 0.9, -0.9]])
    equal(tracer, mesh, points[:1], _LAMP)
    assert 6 < _made(tracer) <= 6 + 6, "one for each level"
    first = _made(tracer)
    tracer.occluded(points, _LAMP)
    assert _made(tracer) == first, "of the same cell"
    tracer.occluded(-points, _LAMP)
    second = _made(tracer)
    assert first < second <= first + 6
    tracer.occluded(points, _LAMP)
    assert _made(tracer) == second, "they are kept"
    tracer.occluded(points, PointLight("other", (-3.0, 0.0, 0.0)))
    assert _made(tracer) > second
    tracer.scene.put("more", *geometry.square(2, 0.5, 0.1))
    tracer.occluded(np.repeat(points, 50, axis=0), _LAMP)
    assert 6 < _made(tracer) <= 6 + 6, "of another scene, once for all that ask"


def test_a_ray_tests_few_triangles(any_device: str) -> None:
    rng = np.random.default_rng(2)
    tracer, points = _tracer(any_device), rng.uniform(-1, 1, (1000, 3))
    for mesh in (mesh_of(clusters(rng, 4000)), geometry.icosphere(3, 0.7)):
        assert equal(tracer, mesh, points, _LAMP).any()
        counters = probe.trace_points(tracer, points, [_LAMP]).counters
        assert 0 < counters["leaf_tests"] < 0.02 * 1000 * len(mesh[1])
        assert counters["nodes_visited"] <= 7 * 1000


def test_lists_hold_what_smaller_ones_hold(any_device: str) -> None:
    rng = np.random.default_rng(3)
    tracer = _tracer(any_device)
    equal(tracer, mesh_of(clusters(rng, 1500)), rng.uniform(-1, 1, (600, 3)), _SUN)
    made = probe.structure(tracer)
    first, count, level, asked, members = (
        getattr(made, name).numpy() for name in ("first", "count", "level", "asked", "members")
    )
    lists = [set(members[first[k] : first[k] + count[k]].tolist()) for k in range(_made(tracer))]
    assert lists[0] == set(range(1500)) and min(map(len, lists)) < 20
    for node in range(6, len(lists)):
        parent = asked[node] // 32
        assert lists[node] <= lists[parent] and count[parent] > 8 and level[node] == level[parent] + 1
        assert made.children.numpy()[asked[node]] == node


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("spread", [1e-8, 3e-7])
def test_rays_on_the_borders_of_cells(any_device: str, axis: int, spread: float) -> None:
    """Origins and directions on borders of cells or beside them by less than a rounding, towards tiny triangles at the
    ends of the beams."""
    rng, number = np.random.default_rng([4, axis]), 120
    keep = np.array([[(-1, -1, -1), (-1, -0.99, -1), (-0.99, -1, -1)], [(1, 1, 1), (1, 0.99, 1), (0.99, 1, 1)]])
    for sign in (1.0, -1.0, 1.0, -1.0):
        # Borders of all levels, those of the first ones among them.
        fine = rng.choice([4, 8, 16, 32], (number, 3))
        way = np.roll([sign, *(rng.integers(-4, 5, 2) / 4.0)], axis)
        origins = 129 / 128 * np.floor(rng.uniform(-0.97, 0.97, (number, 3)) * fine) / fine
        far = rng.uniform(0.1, 1.0, (number, 1))
        middle = origins + far * way + spread * rng.uniform(-1, 1, (number, 3))
        tiny = middle[:, None] + 1e-9 * rng.uniform(-1, 1, (number, 3, 3))
        some = (np.abs(tiny) < 1.0).all(axis=(1, 2))
        others = geometry.soup(rng, 2500, 0.02, 0.9)
        mesh = geometry.join([mesh_of(np.concatenate([keep, tiny[some]])), others])
        light = DirectionalLight("sun", -way)
        # Aimed exactly along the way at the triangles' middles.
        points = tiny[some].mean(axis=1) - far[some] * way
        assert some.sum() > 30
        assert equal(_tracer(any_device), mesh, points, light).mean() > 0.9


@pytest.mark.parametrize("nodes", [6, 7, 60])
@pytest.mark.parametrize("room", [1, 900, 1500])
def test_little_memory(any_device: str, monkeypatch: pytest.MonkeyPatch, nodes: int, room: int) -> None:
    """What does not fit takes the list of the cell around, and everything is forgotten before the next light."""
    monkeypatch.setattr(ray_classification, "_MOST_NODES", nodes)
    rng = np.random.default_rng(5)
    mesh, tracer = geometry.soup(rng, 700, 0.2, 2.0), _tracer(any_device, max_triangles=700, grid_entries=room)
    for light in (_LAMP, _SUN, _LAMP, PointLight("inside", (0.1, 0.2, 0.3)), _SUN):
        assert equal(tracer, mesh, rng.uniform(-2, 2, (300, 3)), light).any()
        structure = probe.structure(tracer)
        assert _made(tracer) <= nodes and structure.used.numpy()[0] <= max(room, 700)


def test_what_does_not_fit_is_forgotten(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the next light, unless that one light asks for more than fits: then its lists are kept."""
    monkeypatch.setattr(ray_classification, "_FEWEST_NODES", 40)
    rng = np.random.default_rng(6)
    mesh, points = geometry.soup(rng, 150, 0.3, 2.0), rng.uniform(-2, 2, (200, 3))
    tracer, oracle = _tracer(any_device, max_triangles=160), tracer_of(any_device, "brute_force")
    for each in (tracer, oracle):
        each.scene.put("mesh", *mesh)
    made = []
    for light in (_SUN, _SUN, _SUN, _LAMP, _LAMP):
        some = points[:1] if light is _LAMP else points
        assert np.array_equal(tracer.occluded(some, light), oracle.occluded(some, light))
        made.append(probe.structure(tracer).asked.numpy()[: _made(tracer)].tolist())
    assert len(made[0]) == 40 and made[0] == made[1] == made[2], "kept"
    assert made[3] == made[2], "nothing fits"
    assert 6 < len(made[4]) <= 12, "made again"


def test_samples_far_away_and_beside_the_box(any_device: str) -> None:
    rng = np.random.default_rng(7)
    mesh, ways = geometry.icosphere(2, 1.0), geometry.directions(rng, 200)
    points = np.concatenate([ways * far for far in (1.0, 1.5, 1e3, 6.7e7, 6.8e7, 1e15)])
    tracer = _tracer(any_device)
    for light in (PointLight("inside", (0.1, 0.0, 0.2)), PointLight("outside", (3.0, 1.0, 0.5))):
        assert equal(tracer, mesh, points, light).any()


def test_unlike_frames(any_device: str) -> None:
    """Scenes, lights and samples in turn on one tracer: nothing of a frame before is read."""
    rng = np.random.default_rng(10)
    tracer, oracle = _tracer(any_device), tracer_of(any_device, "brute_force")
    for number, _ in unlike_scenes(rng, (tracer, oracle), 1500):
        points = rng.uniform(-1.2, 1.2, (300, 3)) * (10.0 if number % 4 == 3 else 1.0)
        pair = [_LAMP, _SUN][:: 1 - 2 * (number % 2)]
        assert np.array_equal(tracer.states_at(points, pair), oracle.states_at(points, pair))
