# SPDX-License-Identifier: Apache-2.0
"""Meshes whose triangles and vertices stand in another order on the device: who gets one, and that nobody sees it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import geometry
import numpy as np
import probe_occluders
import pytest
import sequences
import warp as wp
from interrupts import Ring, Steps

from shadow_tracer import Bounds, Camera, HeightField, PointLight, Scene, ShadowTracer, render_depth
from shadow_tracer.gpu.occluders import order
from shadow_tracer.gpu.occluders.world import _finite_box
from shadow_tracer.scene.parts import Mesh

pytestmark = pytest.mark.wide

_LAMP = PointLight("lamp", (0.3, -0.2, 4.0))


def _shuffled(seed: int, mesh: geometry.Geometry) -> geometry.Geometry:
    """The same triangles in any order, of vertices in any order."""
    vertices, triangles = mesh
    rng = np.random.default_rng(seed)
    to = rng.permutation(len(vertices))
    moved = np.empty_like(vertices)
    moved[to] = vertices
    return moved, to[triangles][rng.permutation(len(triangles))].astype(np.int32)


def _mesh(vertices: np.ndarray, triangles: np.ndarray) -> Mesh:
    scene = Scene(Bounds(max_triangles=10_000))
    scene.put("mesh", vertices, triangles, nonfinite="skip")
    return scene["mesh"]


def _order(mesh: Mesh) -> order.MeshOrder | None:
    return order.find_order(mesh, lambda: _finite_box(mesh.vertices), wp.get_device("cpu"))


@pytest.fixture
def _always(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every mesh gets an order, however small, and however it stands."""
    monkeypatch.setattr(order, "LEAST", 1)
    monkeypatch.setattr(order, "WORTH", 1e9)


def _looseness(corners: np.ndarray) -> float:
    """Of (T, 3, 3) corners of triangles that follow each other."""
    sixteens = [corners[k : k + 16].reshape(-1, 3) for k in range(0, len(corners), 16)]
    sides = [np.nanmax(each, axis=0) - np.nanmin(each, axis=0) for each in sixteens]
    return float(sum((x * y + y * z + z * x) ** 0.5 for x, y, z in sides))


@pytest.mark.parametrize("lost", [0, 40])
def test_neighbours_come_together(lost: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same triangles, corner by corner, in boxes a quarter as large; also if some have a corner that is nowhere."""
    monkeypatch.setattr(order, "LEAST", 1000)
    vertices, triangles = _shuffled(1, geometry.icosphere(4, 2.0, (5.0, -3.0, 1.0)))
    vertices[:lost] = np.nan
    vertices = np.vstack([vertices, [[7.0, 8.0, 9.0]]])  # a corner of none
    mesh = _mesh(vertices, triangles)
    found = _order(mesh)
    assert found is not None
    numbers, vertex_numbers = found.numbers, found.vertices.numpy()
    np.testing.assert_array_equal(np.sort(numbers), np.arange(len(triangles)))
    np.testing.assert_array_equal(np.sort(vertex_numbers), np.arange(len(vertices)))
    np.testing.assert_array_equal(vertex_numbers[found.triangles], triangles[numbers])
    first = np.unique(found.triangles, return_index=True)[1]
    assert (np.diff(first) > 0).all(), "vertices are numbered as triangles come to them"
    before, now = _looseness(vertices[triangles]), _looseness(vertices[triangles[numbers]])
    assert now < 0.25 * before


def test_small_things_among_large_ones_come_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ball of a millimetre in a hall of a hundred metres: a thousand cells along the hall would hold it in one."""
    monkeypatch.setattr(order, "LEAST", 1000)
    ball, hall = geometry.icosphere(4, 1e-3, (20.0, 30.0, 1.0)), geometry.icosphere(2, 100.0)
    vertices, triangles = _shuffled(2, geometry.join([ball, hall]))
    found = _order(_mesh(vertices, triangles))
    assert found is not None
    corners = vertices[triangles[found.numbers]]
    balls = corners[np.abs(corners - (20.0, 30.0, 1.0)).max(axis=(1, 2)) < 0.01]
    assert len(balls) == len(ball[1])
    loose, shuffled = _looseness(balls), _shuffled(3, ball)
    assert loose < 0.2 * _looseness(shuffled[0][shuffled[1]])


def test_who_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    ball = _shuffled(4, geometry.icosphere(4))
    assert len(ball[1]) >= order.LEAST and _order(_mesh(*ball)) is not None
    assert _order(_mesh(ball[0], ball[1][: order.LEAST - 1])) is None, "small"
    along = _order(_mesh(*ball))
    assert along is not None
    vertices, triangles = ball[0][along.vertices.numpy()], along.triangles
    assert _order(_mesh(vertices, np.array(triangles))) is None, "in order"
    monkeypatch.setattr(order, "LEAST", 1)
    assert _order(_mesh(np.zeros((3, 3)), np.array([[0, 1, 2]] * 40))) is None, "a point"
    assert _order(_mesh(np.full((3, 3), np.nan), np.array([[0, 1, 2]] * 40))) is None, "nowhere"
    scene = Scene(Bounds(max_triangles=10_000))
    scene.put_surface("ground", HeightField(np.arange(64.0).reshape(8, 8) % 5.0, 1.0))
    monkeypatch.setattr(order, "WORTH", 1e9)
    assert _order(scene["ground"]) is None, "a surface"


def test_from_the_second_frame_on_and_for_clusters_alone() -> None:
    """Kept while the triangles stay, through poses and positions; looked for once more for other triangles."""
    bounds = Bounds(max_triangles=20_000, max_rays=400, max_lights=1)
    tracer, points = ShadowTracer("light_grid", device="cpu", bounds=bounds, threads=1), np.zeros((4, 3))
    ball = _shuffled(5, geometry.icosphere(4))
    in_order = []
    turned = geometry.pose_of(geometry.rotation(np.random.default_rng(6)), (0.1, 0.0, 0.0))
    changes: list[Any] = [
        lambda scene: scene.put("ball", *ball),
        lambda scene: None,
        lambda scene: scene.move("ball", turned),
        lambda scene: scene.deform("ball", ball[0] * 1.5),
        lambda scene: scene.put("tetrahedron", *geometry.icosphere(0)),
        lambda scene: scene.remove("tetrahedron"),
        lambda scene: scene.put("ball", ball[0], ball[1][:-1]),
        lambda scene: scene.deform("ball", ball[0] * 0.5),
    ]
    for change in changes:
        change(tracer.scene)
        tracer.occluded(points, _LAMP)
        in_order.append("ball" in probe_occluders.in_another_order(tracer))
    assert in_order == [False, True, True, True, True, True, False, True]
    other = ShadowTracer("mesh_bvh", device="cpu", bounds=bounds, threads=1)
    other.scene.put("ball", *ball)
    for _ in range(3):
        other.occluded(points, _LAMP)
    assert probe_occluders.in_another_order(other) == set(), "nobody there looks at sixteen triangles"


@pytest.mark.parametrize(
    "seed", [1, 2, pytest.param(3, marks=pytest.mark.slow), pytest.param(4, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.usefixtures("_always")
def test_unlike_frames(threads: int, seed: int) -> None:
    """Each frame twice, so that all that stays gets an order in the middle of things."""
    tracer, met = ShadowTracer("light_grid", device="cpu", bounds=sequences.ROOMY, threads=threads), 0
    for number, step in enumerate(sequences.sequence(seed, 16)):
        assert sequences.differing(tracer, step) == 0, number
        assert sequences.differing(tracer, replace(step, changes=())) == 0, number
        met += bool(probe_occluders.in_another_order(tracer))
    assert met > 8


@pytest.mark.usefixtures("_always")
def test_pipelines_that_take_turns() -> None:
    """One that looks at sixteen triangles and one that does not."""
    tracer = ShadowTracer("light_grid", device="cpu", bounds=sequences.ROOMY, threads=1)
    names = ["light_grid", "mesh_bvh", "bvh", "cone_hierarchy", "uniform_grid", "brute_force"]
    for number, step in enumerate(sequences.sequence(5, 18)):
        tracer.select(names[number % 6])
        assert sequences.differing(tracer, step) == 0, (number, tracer.pipeline)


@pytest.mark.usefixtures("_always")
def test_who_was_left_out_comes_back_as_it_stood() -> None:
    tracer = ShadowTracer("light_grid", device="cpu", bounds=sequences.ROOMY, threads=1)
    oracle = ShadowTracer("brute_force", device="cpu", bounds=sequences.ROOMY, threads=1)
    lamps = [_LAMP, PointLight("under", (0.1, 0.2, -4.0), ignore=["ball"])]
    points = np.random.default_rng(8).uniform(-2.0, 2.0, (300, 3))
    for each in (tracer, oracle):
        each.scene.put("ball", *_shuffled(9, geometry.icosphere(2)))
        each.scene.put("other", *_shuffled(10, geometry.icosphere(1, 0.7, (1.0, 1.0, 0.5))))
    for number in range(4):
        for lamp in (lamps[number % 2], lamps[0]):
            found = [each.occluded(points, lamp) for each in (tracer, oracle)]
            np.testing.assert_array_equal(*found)
            assert 5 < found[0].sum() < 280
    assert probe_occluders.in_another_order(tracer) == {"ball", "other"}


@pytest.mark.usefixtures("_always")
def test_an_exception_while_a_mesh_is_put_into_its_order() -> None:
    """At steps all over the second frame, in which the order is found: the frames after it are right."""
    points = np.random.default_rng(14).uniform(-2.0, 2.0, (300, 3))
    ball, oracle = _shuffled(15, geometry.icosphere(2)), ShadowTracer("brute_force", device="cpu", threads=1)
    oracle.scene.put("ball", *ball)
    expected, met, rung = oracle.occluded(points, _LAMP), 0, 0
    for share in np.linspace(0.02, 0.98, 24):
        tracer, steps = ShadowTracer("light_grid", device="cpu", bounds=sequences.ROOMY, threads=1), Steps()
        tracer.scene.put("ball", *ball)
        tracer.occluded(points, _LAMP)
        again = ShadowTracer("light_grid", device="cpu", bounds=sequences.ROOMY, threads=1)
        again.scene.put("ball", *ball)
        again.occluded(points, _LAMP)
        total = steps.count(partial(again.occluded, points, _LAMP))
        try:
            steps.run(partial(tracer.occluded, points, _LAMP), int(share * total) + 1)
        except Ring:
            rung += 1
        for _ in range(3):
            np.testing.assert_array_equal(tracer.occluded(points, _LAMP), expected)
        met += probe_occluders.in_another_order(tracer) == {"ball"}
    assert met == 24 and rung > 12


@pytest.mark.usefixtures("_always")
def test_numbers_are_those_of_the_scene() -> None:
    """Of what cones meet, and of which triangles go on across an edge."""
    bounds = Bounds(max_triangles=2000, max_rays=4096, max_lights=1)
    tracer = ShadowTracer("light_grid", device="cpu", bounds=bounds, threads=1)
    tracer.scene.put("ball", *_shuffled(11, geometry.icosphere(2)))
    tracer.scene.put("other", *_shuffled(12, geometry.icosphere(2, 0.5, (0.0, 0.0, 3.0))))
    camera = Camera(32, 24, 40.0, 40.0, 15.5, 11.5, camera_to_world=geometry.pose_of(np.eye(3), (0.1, 0.2, -3.0)))
    _, seen = render_depth(tracer.scene, camera)
    row, column = np.nonzero(seen >= 0)
    way = np.stack([(column - 15.5) / 40.0, (row - 11.5) / 40.0, np.ones(len(row))], axis=1)
    apex = (0.1, 0.2, -3.0)
    for number in range(3):
        tracer.occluded(np.zeros((4, 3)), _LAMP)
        numbers, _ = tracer.cone_hits(apex, way, 0.0, 1)
        np.testing.assert_array_equal(numbers[:, 0], seen[row, column], str(number))
    assert len(row) > 100 and probe_occluders.in_another_order(tracer) == {"ball", "other"}
    fresh = ShadowTracer("mesh_bvh", device="cpu", bounds=bounds, threads=1)  # where nothing stands otherwise
    for mesh in tracer.scene:
        fresh.scene.put(mesh.name, mesh.vertices, mesh.triangles)
    rng = np.random.default_rng(13)
    apices, axes = rng.uniform(-2.0, 2.0, (60, 3)), geometry.directions(rng, 60)
    for mine, others in zip(*(each.cone_hits(apices, axes, 0.3, 400) for each in (tracer, fresh)), strict=True):
        np.testing.assert_array_equal(mine, others)
    # Cones that two triangles block together, across their edge.
    ends = rng.uniform(-0.6, 0.6, (200, 3))
    starts = 2.0 * geometry.directions(rng, 200)
    states = [each.cones(starts, ends, half_angle=0.02) for each in (tracer, fresh)]
    np.testing.assert_array_equal(*states)
    assert np.bincount(states[0])[2] > 50
