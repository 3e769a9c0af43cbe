# SPDX-License-Identifier: Apache-2.0
"""Trees that cut space: their leaves and what is in them, rays along planes and corners of cells, and short lists."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest
from trees import Tree, clusters, equal, hidden, mesh_of, tracer_of, unlike_scenes

from shadow_tracer import DirectionalLight, PointLight, ShadowTracer
from shadow_tracer.gpu.accelerators.bsp.bsp import BinarySpacePartition
from shadow_tracer.gpu.accelerators.kd_tree.kd_tree import KdTree
from shadow_tracer.gpu.accelerators.octree.octree import Octree

pytestmark = probe.in_both_forms

_along_axes = pytest.mark.parametrize("pipeline", ["kd_tree", "octree"])
_BUILDS = {"kd_tree": KdTree, "octree": Octree, "bsp": BinarySpacePartition}
_all_trees = pytest.mark.parametrize("pipeline", _BUILDS)

_LAMP = PointLight("lamp", (0.013, -0.027, 3.1))
_PADDING = 2.0**-19


@_along_axes
def test_triangles_are_members_of_the_leaves_that_they_touch(any_device: str, pipeline: str) -> None:
    tracer, corners = tracer_of(any_device, pipeline), clusters(np.random.default_rng(1))
    hidden(tracer, mesh_of(corners), np.zeros((1, 3)), _LAMP)
    tree = Tree(tracer)
    assert tree.depth > 8 and len(tree.leaves) > 300
    assert len(set(tree.leaves)) == len(tree.leaves), "no two cells share a node"
    members = [np.array(tree.triangles(leaf), int) for leaf in tree.leaves]
    assert all(len(set(some)) == len(some) for some in members)
    low, high = corners.min(axis=1), corners.max(axis=1)
    for some, box in zip(members, tree.boxes, strict=True):
        inside = ((low < box[1]) & (high > box[0])).all(axis=1)
        assert set(np.flatnonzero(inside)) <= set(some.tolist())
        # And no others, padding aside.
        beside = ((low > box[1] + 1e-5) | (high < box[0] - 1e-5)).any(axis=1)
        assert not beside[some].any()
    sizes = np.array([len(some) for some in members])
    assert np.median(sizes) <= 8 and sizes.max() < 60


@_all_trees
@pytest.mark.parametrize("room", [1000, 1300, 2500, 100_000])
def test_a_short_list_makes_larger_leaves(any_device: str, pipeline: str, room: int) -> None:
    corners, rng = clusters(np.random.default_rng(2), 1000), np.random.default_rng(3)
    aims = corners.mean(axis=1)
    points = aims + (aims - _LAMP.position) * rng.uniform(0.0, 0.5, (len(aims), 1))
    expected = hidden(tracer_of(any_device, "brute_force"), mesh_of(corners), points, _LAMP)
    tracer = tracer_of(any_device, pipeline, max_triangles=1000, grid_entries=room)
    for _ in range(2):
        assert np.array_equal(hidden(tracer, mesh_of(corners), points, _LAMP), expected)
    assert expected.sum() > 900
    held = Tree(tracer).held()
    assert 1000 <= len(held) <= room and len(set(held.tolist())) == 1000


@_all_trees
@pytest.mark.parametrize("name", ["nodes_per_triangle", "triangles_per_cell"])
@pytest.mark.parametrize("few", [1, 40])
def test_room_for_few(any_device: str, pipeline: str, monkeypatch: pytest.MonkeyPatch, name: str, few: int) -> None:
    monkeypatch.setattr(_BUILDS[pipeline], name, 10**9 if name == "triangles_per_cell" else 0)
    monkeypatch.setattr(_BUILDS[pipeline], "fewest", few)
    corners, rng = clusters(np.random.default_rng(2), 600), np.random.default_rng(3)
    points = corners.mean(axis=1) - (0.0, 0.0, 1.0) * rng.uniform(0.0, 0.5, (len(corners), 1))
    light = DirectionalLight("sun", (0.0, 0.0, -1.0))
    expected = hidden(tracer_of(any_device, "brute_force"), mesh_of(corners), points, light)
    tracer = tracer_of(any_device, pipeline)
    assert np.array_equal(hidden(tracer, mesh_of(corners), points, light), expected)
    tree = Tree(tracer)
    if name == "nodes_per_triangle":
        assert len(tree.leaves) + tree.inner <= few
    if few == 40:
        assert tree.inner > 3


@_along_axes
@pytest.mark.parametrize("spread", [1e-8, 1e-7, 1e-6, 0.0])
@pytest.mark.parametrize("kind", ["point", "directional", "along an axis", "nearly along an axis"])
def test_tiny_triangles_at_the_corners_of_cells(any_device: str, pipeline: str, kind: str, spread: float) -> None:
    """Rays that cut a corner of a cell by less than a rounding, and triangles that lie in that corner alone, or across
    it: each ray is aimed at its triangle's middle, and none is missed. New triangles make other cells, so that some
    lie as far apart as boxes are padded."""
    tracer, rng, number = tracer_of(any_device, pipeline), np.random.default_rng(4), 700
    core = clusters(rng, 1200)
    more = core[rng.integers(2, len(core), number)]
    reach = np.maximum(spread, 1e-9)
    for _ in range(3):
        hidden(tracer, mesh_of(np.concatenate([core, more])), np.zeros((1, 3)), _LAMP)
        corners = rng.choice(Tree(tracer).corners(), number)
        offset = spread * rng.uniform(-1, 1, (number, 3)) + _PADDING * rng.integers(-1, 2, (number, 3))
        more = (corners + offset)[:, None] + reach * rng.uniform(-1, 1, (number, 3, 3))
        more = more.clip(-1.0, 1.0)
    middle = more.mean(axis=1)
    ways = {"along an axis": (0.0, 0.0, -1.0), "nearly along an axis": (1e-7, -1.0, 2e-8)}
    way = np.array(ways.get(kind, (0.31, -0.17, -0.9)))
    light: Any = _LAMP if kind == "point" else DirectionalLight("sun", way)
    away = middle - light.position if kind == "point" else np.broadcast_to(way, middle.shape)
    points = middle + away / np.linalg.norm(away, axis=1, keepdims=True) * rng.uniform(0.3, 3.0, (number, 1))
    assert equal(tracer_of(any_device, pipeline), mesh_of(np.concatenate([core, more])), points, light).mean() > 0.5


@_along_axes
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rays_within_the_planes_between_cells(any_device: str, pipeline: str, axis: int) -> None:
    """They start on planes and edges of cells and go along them."""
    tracer, rng, number = tracer_of(any_device, pipeline), np.random.default_rng(5), 700
    core = clusters(rng)
    hidden(tracer, mesh_of(core), np.zeros((1, 3)), _LAMP)
    corners = rng.choice(Tree(tracer).corners(), number)
    way = np.zeros(3)
    way[axis] = 1.0
    beside = rng.choice([0.0, 2e-8, -2e-8, 3e-7, -3e-7], (number, 3)) * (1.0 - way)
    ends = core[rng.integers(0, len(core), number), rng.integers(0, 3, number)]
    points = np.concatenate([corners - 0.3 * way, corners + beside - 0.01 * way, ends - 0.2 * way, ends + beside])
    for sign in (1.0, -1.0):
        light = DirectionalLight("sun", sign * way + 1e-8 * (1.0 - way))
        assert 20 < equal(tracer_of(any_device, pipeline), mesh_of(core), points, light).sum() < len(points) - 20


def _counted(tracer: ShadowTracer, points: np.ndarray, light: Any) -> dict[str, int]:
    counters: dict[str, int] = probe.trace_points(tracer, points, [light]).counters
    return counters


@_all_trees
def test_mailboxes_test_a_triangle_once(any_device: str, pipeline: str) -> None:
    """A slanted plate lies in many cells of a ray's way, and is tested once by each ray."""
    rng = np.random.default_rng(6)
    dots = mesh_of(clusters(rng))
    plate = (np.array([(-1, -1, -1), (1, -1, -1), (0, 1, 1.0)]), np.array([(0, 1, 2)]))
    points = np.column_stack([rng.uniform(-0.9, 0.9, (300, 2)), np.full(300, -1.5)])
    tracer = tracer_of(any_device, pipeline)
    hidden(tracer, geometry.join([dots, plate]), points, _LAMP)
    tree = Tree(tracer)
    assert (tree.held() == len(dots[1])).sum() > 100, "it is a member of many leaves"
    counters = _counted(tracer, points, PointLight("lamp", (0.9, 0.9, 1.5)))
    # Each other triangle is small: what is tested again is the plate.
    hidden(tracer, dots, points, _LAMP)
    without = _counted(tracer, points, PointLight("lamp", (0.9, 0.9, 1.5)))
    assert counters["leaf_tests"] <= 1.3 * without["leaf_tests"] + 300
    assert counters["nodes_visited"] > 4 * 300


@_all_trees
def test_mailboxes_are_not_shared_between_rays(any_device: str, pipeline: str) -> None:
    """What a ray tests depends on no other: rays together test what they test one by one."""
    rng = np.random.default_rng(12)
    tracer = tracer_of(any_device, pipeline)
    points = rng.uniform(-1.2, 1.2, (40, 3))
    hidden(tracer, geometry.soup(rng, 400, 0.6, 1.0), points, _LAMP)
    together = _counted(tracer, points, _LAMP)
    alone = [_counted(tracer, point[None], _LAMP) for point in points]
    for name in ("leaf_tests", "nodes_visited"):
        assert together[name] == sum(each[name] for each in alone) > 0


@_along_axes
def test_empty_space_is_cut_off(any_device: str, pipeline: str) -> None:
    """Rays between two heaps of triangles cross a few cells, whatever is in the heaps, and test nothing."""
    rng = np.random.default_rng(13)
    heaps = geometry.join([geometry.icosphere(3, 0.05, (x, x, x)) for x in (-1.0, 1.0)])
    points = np.column_stack([rng.uniform(-0.1, 0.1, (200, 2)), np.full(200, -1.0)])
    tracer = tracer_of(any_device, pipeline)
    assert not hidden(tracer, heaps, points, PointLight("lamp", (0.0, 0.0, 2.0))).any()
    counters = _counted(tracer, points, PointLight("lamp", (0.0, 0.0, 2.0)))
    assert counters["leaf_tests"] == 0 and counters["nodes_visited"] <= 10 * 200


@_along_axes
def test_nearer_children_come_first(any_device: str, pipeline: str) -> None:
    """A camera before many walls, one behind the other, tests those of the first cells alone."""
    from shadow_tracer import Camera

    walls = geometry.join(
        [
            geometry.square(2, z, 0.3, (0.6 * x - 2.7, 0.6 * y - 2.7))
            for z in range(1, 21)
            for x in range(10)
            for y in range(10)
        ]
    )
    tracer = tracer_of(any_device, pipeline)
    for pose in (np.eye(4), geometry.pose_of(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 21.0))):
        hidden(tracer, walls, np.zeros((1, 3)), PointLight("lamp", (0.0, 0.0, 0.5)))
        camera = Camera(20, 20, 20.0, 20.0, 9.3, 9.4, camera_to_world=pose)
        seen = probe.closest_hits(tracer, camera)
        assert seen.depth.max() <= 1.0 and 0 < seen.counters["tests"] < 30 * 400


@_all_trees
@pytest.mark.parametrize("size", [1e-3, 3.0])
def test_triangles_that_no_plane_tells_apart(any_device: str, pipeline: str, size: float) -> None:
    """Many in one place, small and large: the depth of splits ends, and the members stay few."""
    rng = np.random.default_rng(14)
    one = size * rng.uniform(-1, 1, (1, 3, 3))
    corners = np.concatenate([np.repeat(one, 60, axis=0), clusters(rng, 100)])
    points = rng.uniform(-1, 1, (500, 3)) * (size, size, 1.0) - (0.0, 0.0, 1.0)
    equal(tracer_of(any_device, pipeline), mesh_of(corners), points, _LAMP)
    tracer = tracer_of(any_device, pipeline)
    hidden(tracer, mesh_of(corners), points, _LAMP)
    tree = Tree(tracer)
    assert len(tree.held()) <= 8 * len(corners) + 64
    assert tree.depth <= {"octree": 16, "kd_tree": 17, "bsp": 30}[pipeline]


@_all_trees
def test_samples_far_away_and_beside_the_box(any_device: str, pipeline: str) -> None:
    rng = np.random.default_rng(7)
    mesh, ways = geometry.icosphere(2, 1.0), geometry.directions(rng, 300)
    points = np.concatenate([ways * far for far in (1.0, 1.5, 1e3, 6.7e7, 6.8e7, 1e15)])
    for light in (PointLight("inside", (0.1, 0.0, 0.2)), PointLight("outside", (3.0, 1.0, 0.5))):
        assert equal(tracer_of(any_device, pipeline), mesh, points, light).any()


@_all_trees
@pytest.mark.parametrize("half", [(1, 1, 1e-7), (1, 1e-7, 1e-7), (1, 0.3, 0.01), (1e-7, 1, 0.5), (0, 0, 0)])
def test_flat_scenes(any_device: str, pipeline: str, half: tuple[float, float, float]) -> None:
    corners, rng = clusters(np.random.default_rng(8), 800) * half, np.random.default_rng(9)
    points = corners.mean(axis=1) + rng.uniform(-1.5, 0.0, (len(corners), 1)) * (0.3, 0.2, 1.0)
    light = DirectionalLight("sun", (-0.3, -0.2, -1.0))
    assert equal(tracer_of(any_device, pipeline), mesh_of(corners), points, light).any() == (half != (0, 0, 0))


@_all_trees
def test_unlike_frames(any_device: str, pipeline: str) -> None:
    """Nothing of a frame before is read."""
    rng = np.random.default_rng(10)
    tracer, oracle = tracer_of(any_device, pipeline), tracer_of(any_device, "brute_force")
    points, gaps = rng.uniform(-1.2, 1.2, (800, 3)), False
    for _, triangles in unlike_scenes(rng, (tracer, oracle)):
        assert np.array_equal(tracer.occluded(points, _LAMP), oracle.occluded(points, _LAMP))
        if triangles:
            held = set(Tree(tracer).held().tolist())
            assert len(held) == triangles, "those of gaps are in no leaf"
            gaps |= max(held) >= len(held)
    assert gaps, "no scene has one"


def _on_planes(seed: int) -> tuple[geometry.Geometry, np.ndarray, np.ndarray]:
    """Triangles with integer corners, several in each plane; points in these planes, and what they aim at there."""
    rng = np.random.default_rng([15, seed])
    soup = mesh_of(rng.integers(-6, 7, (150, 1, 3)) + rng.integers(-1, 2, (150, 3, 3)).astype(float))
    flat = [geometry.square(axis, at, 1.0, (2.0 * at, 1.0)) for axis in range(3) for at in (-2, 0, 1)]
    mesh = geometry.join([soup, *flat])
    corners = mesh[0][mesh[1]][rng.integers(0, len(mesh[1]), 800)]
    weights = rng.integers(0, 4, (800, 2, 3)).astype(float)
    weights[..., 0] += 1e-9 * (weights.sum(axis=-1) == 0.0)
    ends = np.einsum("nkc,ncx->nkx", weights / weights.sum(axis=-1, keepdims=True), corners)
    return mesh, ends[:, 0] + 3.0 * (ends[:, 0] - ends[:, 1]), ends[:, 1]


@pytest.mark.parametrize("pipeline", ["bsp"])
def test_bsp_planes_that_meet_in_a_point(any_device: str, pipeline: str) -> None:
    """Triangles that a ray touches in a corner alone, and planes across all axes through that corner: the ray is in the
    cell of the triangle for no length, and where it meets the planes is lost in roundings. Sample, corner and light
    are in a line exactly, but their distances have more than 53 bits."""
    rng, number = np.random.default_rng(16), 40
    fine = np.array([3.0, -5.0, 7.0]) / 2.0**32
    whole, lamp = (
        rng.integers(-(2**19), 2**19, (number, 3)).astype(float),
        np.array([2.0**18, -(2.0**19), 2.0**20 - 1.0]),
    )
    tips, light = whole + 3.0 * fine, PointLight("lamp", lamp + 4.0 * fine)
    points = 4.0 * whole - 3.0 * lamp
    turn = np.sign(lamp - whole) * rng.permuted(np.tile([1.0, 1.0, -1.0], (number, 1)), axis=1)
    wings = rng.uniform(10.0, 500.0, (number, 2, 3)) * turn[:, None]
    touched = np.concatenate([tips[:, None], tips[:, None] + wings], axis=1)
    # These begin on the lines through the corners along the axes.
    starts = tips[:, None] + np.eye(3)[rng.integers(0, 3, (number, 30))] * rng.uniform(-2e4, 2e4, (number, 30, 1))
    others = np.concatenate(
        [starts[:, :, None], starts[:, :, None] + rng.uniform(-100, 100, (number, 30, 2, 3))], axis=2
    )
    mesh = mesh_of(np.concatenate([touched, others.reshape(-1, 3, 3)]))
    assert equal(tracer_of(any_device, pipeline), mesh_of(touched), points, light).all()
    assert equal(tracer_of(any_device, pipeline), mesh, points, light).all()


@pytest.mark.parametrize("pipeline", ["bsp"])
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (1e6, -3e5, 7e4), (1e11, 0.0, 0.0)])
@pytest.mark.parametrize("seed", [0, 1])
def test_bsp_planes_that_hold_rays(any_device: str, pipeline: str, seed: int, shift: tuple[float, ...]) -> None:
    """Rays within the planes of triangles, aimed at their corners, edges and insides; far origins, where the planes'
    values are mostly roundings; and the light in such a plane."""
    (vertices, triangles), points, aims = _on_planes(seed)
    vertices, points, aims = (array + shift for array in (vertices, points, aims))
    tracer, oracle = tracer_of(any_device, pipeline), tracer_of(any_device, "brute_force")
    hits = 0
    for lamp in aims[:6]:
        for light in (PointLight("lamp", lamp), DirectionalLight("sun", lamp - points[0])):
            found = [hidden(each, (vertices, triangles), points, light) for each in (tracer, oracle)]
            assert np.array_equal(*found), (found[0] != found[1]).sum()
            hits += int(found[0].sum())
    assert hits > 100
    tree = Tree(tracer)
    assert len(set(tree.held().tolist())) == len(triangles) and tree.inner > 5
