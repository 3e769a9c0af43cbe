# SPDX-License-Identifier: Apache-2.0
"""The tree over blocks of triangles: what is in it, refits and builds, packets, and what roundings could lose."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, ShadowTracer, SpotLight
from shadow_tracer.gpu.accelerators.bvh.tree import FEWEST, LANES, LEVELS, NONE, most_blocks
from shadow_tracer.gpu.accelerators.segment import OUTSIDE, PADDING
from shadow_tracer.gpu.engine import bands, frame

pytestmark = probe.in_both_forms

_VARIANTS = ("sah", "median", "lbvh", "threaded")
_BOUNDS = {"max_triangles": 3000, "max_rays": 6000, "max_lights": 2}
_LAMP = PointLight("lamp", (0.1, 0.2, 2.5))


def _tracer(device: str, names: str = "bvh/sah", **more: Any) -> ShadowTracer:
    bounds = {name: more.pop(name) for name in list(more) if name in _BOUNDS}
    return ShadowTracer(
        *names.split("/"), device=device, bounds=Bounds(**{**_BOUNDS, **bounds}), **{"threads": 1, **more}
    )


def _hidden(tracer: ShadowTracer, mesh: geometry.Geometry, points: np.ndarray, light: Any = _LAMP) -> np.ndarray:
    tracer.scene.put("mesh", *mesh)
    return tracer.occluded(points, light)


def _expected(device: str, mesh: geometry.Geometry, points: np.ndarray, light: Any = _LAMP) -> np.ndarray:
    return _hidden(_tracer(device, "brute_force"), mesh, points, light)


def _shelves(count: int) -> geometry.Geometry:
    """Triangles at places that halve towards the origin: a bin holds all but one of them."""
    small = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
    sizes = 0.5 ** (np.arange(count) / 8.0)
    vertices = (small[None] * 0.1 * sizes[:, None, None]) + sizes[:, None, None]
    return geometry.split(vertices.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


_MESHES: dict[str, geometry.Geometry] = {
    "one": geometry.soup(np.random.default_rng(1), 1, 0.5, 1.0),
    "full block": geometry.soup(np.random.default_rng(2), 16, 0.5, 1.0),
    "two blocks": geometry.soup(np.random.default_rng(3), 17, 0.5, 1.0),
    "soup": geometry.soup(np.random.default_rng(4), 900, 0.2, 1.5),
    "same place": geometry.join([geometry.soup(np.random.default_rng(5), 1, 0.5, 0.5)] * 300),
    "shelves": _shelves(700),
    "flat": (np.random.default_rng(6).uniform(-1, 1, (900, 3)) * (1, 1, 0), np.arange(900).reshape(-1, 3)),
}


def _depths(children: np.ndarray, nodes: int) -> np.ndarray:
    depth = np.zeros(nodes, int)
    for node in range(nodes):
        if children[node, 0] >= 0:
            assert (children[node] > node).all() and (children[node] < nodes).all()
            depth[children[node]] = depth[node] + 1
    return depth


@pytest.mark.parametrize("variant", _VARIANTS)
@pytest.mark.parametrize("name", _MESHES)
def test_every_triangle_is_in_one_block_and_in_all_boxes_above(any_device: str, variant: str, name: str) -> None:
    vertices, triangles = _MESHES[name]
    tracer = _tracer(any_device, f"bvh/{variant}", max_triangles=len(triangles))
    _hidden(tracer, (vertices, triangles), np.zeros((1, 3)))
    tree = probe.structure(tracer)
    nodes, blocks, _, _ = tree.counts.numpy()
    assert nodes == 2 * blocks - 1 and blocks <= most_blocks(len(triangles))
    members = tree.members.numpy()[: blocks * LANES].reshape(blocks, LANES)
    assert np.array_equal(np.sort(members[members >= 0]), np.arange(len(triangles)))
    filled = (members >= 0).sum(axis=1)
    assert filled.min() >= min(FEWEST, len(triangles))
    assert variant != "median" or (filled == LANES).sum() >= blocks - 2
    children = tree.children.numpy()[: 2 * nodes].reshape(nodes, 2)
    assert _depths(children, nodes).max() < LEVELS
    boxes = tree.corners.numpy()[: 8 * nodes].reshape(nodes, 2, 4)[:, :, :3].astype(float)
    inner = children[:, 0] >= 0
    for side in children[inner].T:
        assert (boxes[inner, 0] <= boxes[side, 0]).all() and (boxes[inner, 1] >= boxes[side, 1]).all()
    leaves = tree.leaves.numpy()[:blocks]
    assert np.array_equal(~children[leaves, 0], np.arange(blocks)) and np.array_equal(
        np.sort(leaves), np.nonzero(~inner)[0]
    )
    corners = (vertices[triangles] - np.array(tree.box.center)) * tree.box.inverse_extent
    for block, node in enumerate(leaves):
        mine = corners[members[block][members[block] >= 0]].reshape(-1, 3)
        assert (boxes[node, 0] <= mine.min(axis=0) - 0.95 * PADDING).all()
        assert (boxes[node, 1] >= mine.max(axis=0) + 0.95 * PADDING).all()


@pytest.mark.wide
@pytest.mark.parametrize("variant", ["sah", "median", "lbvh"])
@pytest.mark.parametrize("name", _MESHES)
def test_wide_nodes_reach_every_block_once(any_device: str, variant: str, name: str) -> None:
    if not probe.wide(any_device):
        pytest.skip("a form without them")
    mesh = _MESHES[name]
    tracer = _tracer(any_device, f"bvh/{variant}", max_triangles=len(mesh[1]))
    _hidden(tracer, mesh, np.zeros((1, 3)))
    tree = probe.structure(tracer)
    nodes, blocks, wide, _ = tree.counts.numpy()
    links = tree.links.numpy()[: wide * LANES].reshape(wide, LANES)
    assert np.array_equal(np.sort(~links[(links < 0) & (links != NONE)]), np.arange(blocks))
    assert np.array_equal(np.sort(links[links >= 0]), np.arange(1, wide))
    full = (links >= 0).any(axis=1)
    assert (links[full] != NONE).all(), "a node with inner children has all sixteen"
    assert wide * LANES <= len(tree.links)
    bounds = tree.bounds.numpy()[: wide * 6 * LANES].reshape(wide, 6, LANES)
    boxes = tree.corners.numpy()[: 8 * nodes].reshape(nodes, 8)[:, [0, 1, 2, 4, 5, 6]]
    sources = tree.sources.numpy()[: wide * LANES].reshape(wide, LANES)
    for k in range(wide):
        for lane in range(LANES):
            there = links[k, lane] != NONE
            assert np.array_equal(
                bounds[k, :, lane], boxes[sources[k, lane]] if there else np.full(6, OUTSIDE, np.float32)
            )


@pytest.mark.parametrize("variant", _VARIANTS)
@pytest.mark.parametrize("name", _MESHES)
def test_answers(any_device: str, variant: str, name: str) -> None:
    mesh, rng = _MESHES[name], np.random.default_rng(7)
    number = 100 if name == "shelves" else 600  # most of those small triangles must be decided exactly
    targets = mesh[0][mesh[1]].mean(axis=1)[rng.integers(0, len(mesh[1]), number)]
    behind = targets + (targets - _LAMP.position) * rng.uniform(0.01, 1, (number, 1))
    points = np.concatenate([behind, rng.uniform(-2, 2, (number, 3))])
    tracer = _tracer(any_device, f"bvh/{variant}")
    for light in (_LAMP, DirectionalLight("sun", (0.3, -0.2, -1.0))):
        expected = _expected(any_device, mesh, points, light)
        assert np.array_equal(_hidden(tracer, mesh, points, light), expected)
    assert name == "flat" or number / 4 < _expected(any_device, mesh, points).sum() < 2 * number


def _bent(vertices: np.ndarray, by: float) -> np.ndarray:
    x, y, z = vertices.T
    return np.stack([x + by * y * z, y - by * x * z, z + by * x * y], axis=1)


@pytest.mark.parametrize("variant", _VARIANTS)
def test_a_refitted_tree_answers_like_a_new_one(any_device: str, variant: str) -> None:
    """Small motions refit, another topology builds, and so does what has torn blocks apart: always the same bits."""
    rng = np.random.default_rng(8)
    vertices, triangles = geometry.soup(rng, 500, 0.15, 1.5)
    points = rng.uniform(-2, 2, (800, 3))
    tracer = _tracer(any_device, f"bvh/{variant}")

    def check(now: np.ndarray, builds: int) -> None:
        fresh = _hidden(_tracer(any_device, f"bvh/{variant}"), (now, triangles), points)
        assert np.array_equal(tracer.occluded(points, _LAMP), fresh)
        assert np.array_equal(fresh, _expected(any_device, (now, triangles), points))
        assert probe.builds(tracer) == builds

    tracer.scene.put("mesh", vertices, triangles)
    check(vertices, 1)
    for by in (0.01, 0.02, -0.03):
        tracer.scene.deform("mesh", _bent(vertices, by))
        check(_bent(vertices, by), 1)
    torn = vertices.reshape(-1, 3, 3)[rng.permutation(500)].reshape(-1, 3)
    tracer.scene.deform("mesh", torn)
    check(torn, 1)  # it is seen to be bad only now
    tracer.scene.deform("mesh", _bent(torn, 0.01))
    check(_bent(torn, 0.01), 2)
    tracer.scene.deform("mesh", _bent(torn, 0.02))
    check(_bent(torn, 0.02), 2)
    triangles = triangles[:400]
    tracer.scene.put("mesh", vertices, triangles)
    check(vertices, 3)


@pytest.mark.parametrize("variant", _VARIANTS)
def test_triangles_that_stop_being_numbers_and_come_back(any_device: str, variant: str) -> None:
    rng = np.random.default_rng(9)
    vertices, triangles = geometry.soup(rng, 200, 0.4, 1.5)
    points = rng.uniform(-2, 2, (600, 3))
    tracer, oracle = _tracer(any_device, f"bvh/{variant}"), _tracer(any_device, "brute_force")
    for each in (tracer, oracle):
        each.scene.put("mesh", vertices, triangles)
    for gone in (slice(0, 0), slice(30, 90), slice(0, 600), slice(0, 0)):
        now = vertices.copy()
        now[gone] = np.nan
        for each in (tracer, oracle):
            each.scene.deform("mesh", now, nonfinite="skip")
        expected = oracle.occluded(points, _LAMP)
        assert np.array_equal(tracer.occluded(points, _LAMP), expected), gone
        assert expected.any() == (gone != slice(0, 600))
    assert probe.builds(tracer) == 1


@pytest.mark.parametrize("variant", _VARIANTS)
def test_parts_that_come_and_go_leave_gaps(any_device: str, variant: str) -> None:
    rng = np.random.default_rng(10)
    parts = {name: geometry.soup(rng, count, 0.3, 1.5) for name, count in (("a", 150), ("b", 90), ("c", 70))}
    points = rng.uniform(-2, 2, (700, 3))
    tracer, oracle = _tracer(any_device, f"bvh/{variant}"), _tracer(any_device, "brute_force")
    for step in ("+a", "+b", "+c", "-b", "-a", "+b", "-c", "-b", "+a"):
        for each in (tracer, oracle):
            if step[0] == "+":
                each.scene.put(step[1], *parts[step[1]])
            else:
                each.scene.remove(step[1])
        assert np.array_equal(tracer.occluded(points, _LAMP), oracle.occluded(points, _LAMP)), step


@pytest.mark.parametrize("size", [1e-9, 1e-7, 1e-6, 1e-4])
@pytest.mark.parametrize("far", [0.0, 1e7])
@pytest.mark.parametrize("variant", ["sah", "threaded"])
def test_tiny_triangles(any_device: str, variant: str, far: float, size: float) -> None:
    """Each ray is aimed at the middle of a triangle as large as a rounding of float32, or smaller or larger."""
    rng, number = np.random.default_rng(11), 1200
    frame = np.array([(-1, -1, -1), (-1, -0.9, -1), (-0.9, -1, -1), (1, 1, 1), (1, 0.9, 1), (0.9, 1, 1)])
    small = rng.uniform(-1, 1, (number, 1, 3)) + size * rng.uniform(-1, 1, (number, 3, 3))
    vertices = np.concatenate([frame, small.reshape(-1, 3)]) + far
    light = PointLight("lamp", np.array((0.013, -0.027, 3.1)) + far)
    middle = vertices[6:].reshape(-1, 3, 3).mean(axis=1)
    points = middle + (middle - light.position) * rng.uniform(0.05, 1.0, (number, 1))
    mesh = (vertices, np.arange(len(vertices)).reshape(-1, 3))
    expected = _expected(any_device, mesh, points, light)
    assert np.array_equal(_hidden(_tracer(any_device, f"bvh/{variant}"), mesh, points, light), expected)
    assert far or expected.mean() > 0.6


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rays_along_edges_and_within_planes(any_device: str, axis: int) -> None:
    """Of a lattice of squares: rays along edges, through vertices, and within the planes of other squares."""
    squares = [geometry.square(k, at, 2.0) for k in range(3) for at in (-1.0, 0.0, 1.0)]
    mesh = geometry.join(squares)
    steps = np.arange(-3, 4) / 2.0
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    way = np.roll((1.0, 0.0, 0.0), axis)
    tracer = _tracer(any_device)
    for direction in (way, -way, way + np.roll(way, 1), way - np.roll(way, 1), (1.0, 1.0, 1.0)):
        light = DirectionalLight("sun", direction)
        assert np.array_equal(_hidden(tracer, mesh, grid, light), _expected(any_device, mesh, grid, light))
    lamp = PointLight("lamp", 0.5 * way + 1.0)
    expected = _expected(any_device, mesh, grid, lamp)
    assert np.array_equal(_hidden(tracer, mesh, grid, lamp), expected) and 0 < expected.sum() < len(grid)


@pytest.mark.parametrize("wide", [0.0, 1e-7, 1e-3, 0.01, 0.1])
@pytest.mark.parametrize("kind", ["beginnings", "ends", "sun"])
def test_packets_of_rays_at_the_border_of_their_bundle(any_device: str, kind: str, wide: float) -> None:
    """Sixteen rays each that are apart where they begin, where they end, or all along; and a triangle on the way of one
    of them, the one that is farthest from their middle."""
    rng, packets = np.random.default_rng(12), 60
    offsets = rng.uniform(-1, 1, (packets, 16, 3))
    offsets[:, 5] = (-2.0, 1.0, 0.0)
    light: Any = PointLight("lamp", (0.0, 0.0, 3.0))
    centres, share = rng.uniform(-1, 1, (packets, 1, 3)) * (1, 1, 0.2) - (0, 0, 1), rng.uniform(0.2, 0.8, (packets, 1))
    if kind == "sun":
        light = DirectionalLight("sun", (0.0, 0.0, -1.0))
    if kind == "ends":  # of rays that leave the scene's box at an angle of a hundredth, the farther the later
        light, share = DirectionalLight("sun", (-0.01, 0.0, -1.0)), rng.uniform(0.99, 0.999, (packets, 1))
        centres, offsets = centres * (0, 0.5, 0) + (0.99, 0, -1), 0.02 * offsets * (1, 1, 0)
    points = centres + wide * offsets
    aimed = points[:, 5]
    way = np.broadcast_to(-light.direction, aimed.shape) if kind != "beginnings" else light.position - aimed
    if kind == "ends":
        way = way / way[:, :1] * (1.0 - aimed[:, :1])
    middle = aimed + way * share
    spans = rng.uniform(-1, 1, (packets, 3, 3))
    small = middle[:, None] + 1e-4 * (spans - spans.mean(axis=1, keepdims=True))
    frame = np.array([(-1, -1, -2), (-1, -0.9, -2), (-0.9, -1, -2), (1, 1, 2), (1, 0.9, 2), (0.9, 1, 2)])
    vertices = np.concatenate([frame, small.reshape(-1, 3)])
    mesh = (vertices, np.arange(len(vertices)).reshape(-1, 3))
    flat = points.reshape(-1, 3)
    expected = _expected(any_device, mesh, flat, light)
    assert np.array_equal(_hidden(_tracer(any_device), mesh, flat, light), expected)
    assert expected.reshape(packets, 16)[:, 5].mean() > 0.7


def test_bundles_through_many_blocks(any_device: str) -> None:
    """Sixteen rays close together, along a rod of triangles that one of them may meet at its very end."""
    rng, packets = np.random.default_rng(17), 30
    rod = rng.uniform(-0.02, 0.02, (2800, 1, 3)) + rng.uniform(-0.004, 0.004, (2800, 3, 3))
    rod[:, :, 2] = rod[:, :, 2] + rng.uniform(-2, 2, (2800, 1))
    mesh = (rod.reshape(-1, 3), np.arange(8400).reshape(-1, 3))
    points = rng.uniform(-0.02, 0.02, (packets, 1, 3)) + rng.uniform(-1e-3, 1e-3, (packets, 16, 3)) - (0, 0, 2.1)
    sun, points = DirectionalLight("sun", (1e-4, 2e-4, -1.0)), points.reshape(-1, 3)
    expected = _expected(any_device, mesh, points, sun)
    assert np.array_equal(_hidden(_tracer(any_device), mesh, points, sun), expected)
    assert 0.05 < expected.mean() < 1.0


@pytest.mark.parametrize("holes", [0.0, 0.03])
def test_images_of_any_size_are_traced_whole(any_device: str, holes: float) -> None:
    """Sixteen pixels of a packet are a tile where the image has room for it and all of them ask, which those without
    depth do not, or those that a spot does not shine on. By ``brute_force/float64``, which takes pixels in their
    order."""
    mesh = geometry.soup(np.random.default_rng(13), 60, 0.5, 1.0)
    tracers = [_tracer(any_device, names) for names in ("bvh/sah", "brute_force/filtered", "brute_force/float64")]
    lights: list[Any] = [PointLight("lamp", (0.3, 0.2, -2.0)), SpotLight("spot", (0.3, 0.2, -2.0), (0, 0, 1), 0.1)]
    hidden = np.zeros(2, int)
    for tracer in tracers:
        tracer.scene.put("mesh", *mesh)
    for width in (1, 2, 3, 4, 5, 7, 8, 33):
        for height in (1, 3, 4, 5, 9, 33):
            camera = Camera(width, height, 30.0, 30.0, width / 2, height / 2)
            rng = np.random.default_rng(width * height)
            depth = rng.uniform(0.5, 3.0, (height, width)).astype(np.float32)
            depth[rng.random(depth.shape) < holes] = 0.0
            first, *others = (tracer.trace(depth, camera, lights) for tracer in tracers)
            assert all(first.differing(other) == 0 for other in others), (width, height)
            hidden += [(first.state(light.name) == 1).sum() for light in lights]
    assert hidden[0] > 500 and hidden[1] > 50


def test_samples_far_away_and_beside_the_box(any_device: str) -> None:
    rng = np.random.default_rng(14)
    mesh, ways = geometry.icosphere(2, 1.0), geometry.directions(rng, 300)
    points = np.concatenate([ways * far for far in (1.0, 1.5, 1e3, 6.7e7, 6.8e7, 1e15)])
    points = points[rng.permutation(len(points))]
    tracer = _tracer(any_device)
    for light in (
        PointLight("inside", (0.1, 0.0, 0.2)),
        PointLight("far", (3e9, 1e9, 5e8)),
        PointLight("top", (0, 0, 1e49)),
    ):
        expected = _expected(any_device, mesh, points, light)
        assert np.array_equal(_hidden(tracer, mesh, points, light), expected) and expected.any()


def test_a_ray_tests_few_triangles(any_device: str) -> None:
    """Blocks show only what may be met; in the form of a thread they show all they have."""
    rng = np.random.default_rng(15)
    tracer = _tracer(any_device)
    tracer.scene.put("mesh", *geometry.soup(rng, 2500, 0.02, 1.0))
    counters = probe.trace_points(tracer, rng.uniform(-1, 1, (2000, 3)), [_LAMP]).counters
    per_ray = counters["leaf_tests"] / 2000
    assert per_ray < (16 if probe.wide(any_device) else 120)
    assert counters["nodes_visited"] > 2000


def test_bands_of_the_rays_have_one_tree(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if not probe.wide(any_device):
        pytest.skip("one band")
    for module in (bands, frame):
        monkeypatch.setattr(module, "LEAST", 64)
    rng = np.random.default_rng(16)
    mesh, points = geometry.soup(rng, 300, 0.3, 1.5), rng.uniform(-2, 2, (5000, 3))
    tracer = _tracer(any_device, threads=2)
    for _ in range(2):  # the second time side by side
        assert np.array_equal(_hidden(tracer, mesh, points), _expected(any_device, mesh, points))
    assert len(probe.bands(tracer)) == 2 and probe.builds(tracer) == 1
