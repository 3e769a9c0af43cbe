# SPDX-License-Identifier: Apache-2.0
"""Grids within cells of grids: their cells and members, rays along planes and corners of cells at each depth, short
lists, and what mailboxes save."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, DirectionalLight, PointLight, ShadowTracer
from shadow_tracer.gpu.accelerators.hierarchical_grid import hierarchical_grid

pytestmark = probe.in_both_forms

_BOUNDS = {"max_triangles": 5000, "max_rays": 20_000, "max_lights": 2}
_LAMP = PointLight("lamp", (0.013, -0.027, 3.1))


def _tracer(device: str, pipeline: str = "hierarchical_grid", **more: int) -> ShadowTracer:
    return ShadowTracer(pipeline, device=device, bounds=Bounds(**{**_BOUNDS, **more}), threads=1)


def _hidden(tracer: ShadowTracer, mesh: geometry.Geometry, points: np.ndarray, light: Any) -> np.ndarray:
    tracer.scene.put("mesh", *mesh)
    return tracer.occluded(points, light)


@dataclass(frozen=True)
class Grid:
    """Of a tree, in the scene's coordinates."""

    count: np.ndarray
    low: np.ndarray
    size: np.ndarray
    first: int

    @property
    def cells(self) -> range:
        return range(self.first, self.first + int(self.count.prod()))


class Tree:
    """The grids of a tracer, by depth."""

    def __init__(self, tracer: ShadowTracer) -> None:
        made = probe.structure(tracer)
        self.inside, self.start, self.members = made.inside.numpy(), made.start.numpy(), made.members.numpy()
        self._stored, self._extent = made.grids.numpy(), 1.0 / made.box.inverse_extent
        self._center = np.array(made.box.center)
        self.depths = [[self._grid(0)]]
        while True:
            deeper = [self.inside[k] for grid in self.depths[-1] for k in grid.cells if self.inside[k]]
            if not deeper:
                return
            self.depths.append([self._grid(number) for number in deeper])

    def _grid(self, number: int) -> Grid:
        shape = self._stored[number]["shape"]
        low = self._center + self._extent * np.asarray(shape["low"], float)
        count, size = np.asarray(shape["count"], int), self._extent * np.asarray(shape["size"], float)
        return Grid(count, low, size, int(self._stored[number]["first"]))

    def leaf(self, point: np.ndarray) -> int:
        """The cell without a grid that a point lies in."""
        grid = self.depths[0][0]
        while True:
            at = np.clip(((point - grid.low) / grid.size).astype(int), 0, grid.count - 1)
            cell = grid.first + int((at[2] * grid.count[1] + at[1]) * grid.count[0] + at[0])
            if not self.inside[cell]:
                return cell
            grid = self._grid(self.inside[cell])

    def triangles(self, cell: int) -> set[int]:
        """Those of a cell."""
        return set(self.members[self.start[cell] : self.start[cell + 1]].tolist())

    def corners(self, depth: int) -> np.ndarray:
        """(N, 3) of cells at a depth, also those that lie at the borders of the grids there."""
        found = []
        for grid in self.depths[depth]:
            planes = [grid.low[k] + grid.size[k] * np.arange(grid.count[k] + 1) for k in range(3)]
            found.append(np.stack(np.meshgrid(*planes, indexing="ij"), axis=-1).reshape(-1, 3))
        return np.concatenate(found)


def _clusters(rng: np.random.Generator, number: int = 3000) -> np.ndarray:
    """(number, 3, 3): small triangles, dense around some points and denser there around others; the first ones keep
    the box of the scene."""
    centres = rng.uniform(-0.8, 0.8, (6, 3))
    which = rng.integers(0, 6, number)
    reach = np.where(rng.random(number) < 0.5, 0.004, 0.08)
    middle = centres[which] + reach[:, None] * rng.uniform(-1, 1, (number, 3))
    made: np.ndarray = middle[:, None] + 0.1 * reach[:, None, None] * rng.uniform(-1, 1, (number, 3, 3))
    made[0] = [(-1, -1, -1), (-1, -0.99, -1), (-0.99, -1, -1)]
    made[1] = [(1, 1, 1), (1, 0.99, 1), (0.99, 1, 1)]
    return made


def _mesh(corners: np.ndarray) -> geometry.Geometry:
    return corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3)


def _at_cells(device: str, depth: int, number: int, make: Any) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of clusters, and ``number`` others that ``make`` makes at corners of cells at a depth, which are such
    corners still when these are there; and the corners."""
    tracer, rng = _tracer(device), np.random.default_rng(11)
    core = _clusters(rng)
    more = core[rng.integers(2, len(core), number)]
    for _ in range(4):
        _hidden(tracer, _mesh(np.concatenate([core, more])), np.zeros((1, 3)), _LAMP)
        corners = rng.choice(Tree(tracer).corners(depth), number)
        more = make(corners)
    _hidden(tracer, _mesh(np.concatenate([core, more])), np.zeros((1, 3)), _LAMP)
    there = {tuple(corner) for corner in np.round(Tree(tracer).corners(depth), 9).tolist()}
    kept = np.mean([tuple(corner) in there for corner in np.round(corners, 9).tolist()])
    assert kept > 0.5, "the grids have changed"
    return np.concatenate([core, more]), corners


def test_triangles_are_members_of_the_cells_that_they_touch(any_device: str) -> None:
    tracer, corners = _tracer(any_device), _clusters(np.random.default_rng(1))
    _hidden(tracer, _mesh(corners), np.zeros((1, 3)), _LAMP)
    tree = Tree(tracer)
    assert [len(grids) > 5 for grids in tree.depths] == [False, True, True], "three depths"
    cells = [cell for grids in tree.depths for grid in grids for cell in grid.cells]
    assert len(set(cells)) == len(cells) == max(cells) + 1, "grids share no cells, and leave none between them"
    held = [tree.triangles(cell) for cell in cells]
    assert sum(map(len, held)) == tree.start[max(cells) + 1]
    assert not any(tree.triangles(cell) for cell in cells if tree.inside[cell])
    for weights in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0.3, 0.3, 0.4)):
        for triangle, point in enumerate(np.einsum("c,tcx->tx", np.array(weights), corners)):
            assert triangle in tree.triangles(tree.leaf(point))


def _fits(device: str, tracer: ShadowTracer) -> Tree:
    corners, rng = _clusters(np.random.default_rng(2), 1000), np.random.default_rng(3)
    aims = corners.mean(axis=1)
    points = aims + (aims - _LAMP.position) * rng.uniform(0.0, 0.5, (len(aims), 1))
    expected = _hidden(_tracer(device, "brute_force"), _mesh(corners), points, _LAMP)
    for _ in range(2):
        assert np.array_equal(_hidden(tracer, _mesh(corners), points, _LAMP), expected)
    assert expected.sum() > 900
    return Tree(tracer)


@pytest.mark.parametrize("room", [1000, 1300, 2000, 3500, 100_000])
def test_a_short_list_makes_larger_cells(any_device: str, room: int) -> None:
    tracer = _tracer(any_device, max_triangles=1000, grid_entries=room)
    tree = _fits(any_device, tracer)
    last = max(grid.cells[-1] for grids in tree.depths for grid in grids)
    assert 1000 <= tree.start[last + 1] <= room
    assert (len(tree.depths[0][0].cells) == 1) == (room == 1000)
    grids = sum(map(len, tree.depths))
    assert grids < 10 if room == 1000 else grids > 20


@pytest.mark.parametrize("few", [1, 9])
def test_few_grids(any_device: str, monkeypatch: pytest.MonkeyPatch, few: int) -> None:
    monkeypatch.setattr(hierarchical_grid, "_TRIANGLES_PER_GRID", 10**9)
    monkeypatch.setattr(hierarchical_grid, "_FEWEST", few)
    tree = _fits(any_device, _tracer(any_device))
    assert sum(map(len, tree.depths)) <= few and (len(tree.depths) > 1) == (few > 1)


@pytest.mark.parametrize("cells", [1, 2, 3])
def test_room_for_few_cells(any_device: str, monkeypatch: pytest.MonkeyPatch, cells: int) -> None:
    monkeypatch.setattr(hierarchical_grid, "_CELLS_PER_TRIANGLE", cells)
    monkeypatch.setattr(hierarchical_grid, "_FEWEST", 4)
    tree = _fits(any_device, _tracer(any_device))
    assert max(grid.cells[-1] for grids in tree.depths for grid in grids) < 1000 * cells + 4


@pytest.mark.parametrize("spread", [1e-8, 1e-7, 1e-6, 0.0])
@pytest.mark.parametrize("kind", ["point", "directional", "along an axis"])
@pytest.mark.parametrize("depth", [0, 1, 2])
def test_tiny_triangles_at_the_corners_of_cells(any_device: str, kind: str, depth: int, spread: float) -> None:
    """Rays that cut a corner of a cell by less than a rounding, and triangles that lie in that corner alone, or across
    it: each ray is aimed at its triangle's middle, and none is missed."""
    rng, number = np.random.default_rng(4), 600
    reach = np.maximum(spread, 1e-9)

    def tiny(corners: np.ndarray) -> np.ndarray:
        offset = spread * rng.uniform(-1, 1, (number, 3))
        made: np.ndarray = (corners + offset)[:, None] + reach * rng.uniform(-1, 1, (number, 3, 3))
        return made.clip(-1.0, 1.0)

    triangles, _ = _at_cells(any_device, depth, number, tiny)
    middle = triangles[-number:].mean(axis=1)
    ways = {"along an axis": (0.0, 0.0, -1.0), "directional": (0.31, -0.17, -0.9)}
    light: Any = _LAMP if kind == "point" else DirectionalLight("sun", ways[kind])
    away = middle - light.position if kind == "point" else np.broadcast_to(np.array(ways[kind]), middle.shape)
    points = middle + away / np.linalg.norm(away, axis=1, keepdims=True) * rng.uniform(0.3, 3.0, (number, 1))
    expected = _hidden(_tracer(any_device, "brute_force"), _mesh(triangles), points, light)
    assert np.array_equal(_hidden(_tracer(any_device), _mesh(triangles), points, light), expected)
    assert expected.mean() > 0.5


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("depth", [1, 2])
def test_rays_within_the_planes_between_cells(any_device: str, axis: int, depth: int) -> None:
    """They start on planes and edges of cells, borders of grids among them, and go along them, towards triangles that
    lie in them or cross them."""
    rng, number = np.random.default_rng(5), 400
    spans = 0.01 * rng.uniform(-1, 1, (number, 3, 3))
    spans[: number // 2, :, (axis + 1) % 3] = 0.0  # these lie in a plane
    triangles, corners = _at_cells(
        any_device, depth, number, lambda corners: (corners[:, None] + spans * 0.1**depth).clip(-1.0, 1.0)
    )
    way = np.zeros(3)
    way[axis] = 1.0
    # A rounding and a few beside the planes, too.
    beside = rng.choice([0.0, 2e-8, -2e-8, 3e-7, -3e-7], (number, 3)) * (1.0 - way)
    points = np.concatenate([corners - 0.3 * way, corners - 0.01 * way, corners + beside - 0.05 * way])
    for sign in (1.0, -1.0):
        light = DirectionalLight("sun", sign * way)
        hidden = _hidden(_tracer(any_device), _mesh(triangles), points, light)
        assert np.array_equal(hidden, _hidden(_tracer(any_device, "brute_force"), _mesh(triangles), points, light))
        assert 20 < hidden.sum() < len(points) - 20


def test_mailboxes_test_a_triangle_once(any_device: str) -> None:
    """A slanted plate lies in many cells of a ray's way, of several grids, and is tested once by each ray."""
    rng = np.random.default_rng(6)
    dots = _mesh(_clusters(rng))
    plate = (np.array([(-1, -1, -1), (1, -1, -1), (0, 1, 1.0)]), np.array([(0, 1, 2)]))
    tracer = _tracer(any_device)
    points = np.column_stack([rng.uniform(-0.9, 0.9, (500, 2)), np.full(500, -1.5)])
    tests = []
    for mesh in (dots, geometry.join([dots, plate])):
        tracer.scene.put("mesh", *mesh)
        traced = probe.trace_points(tracer, points, [PointLight("lamp", (0.9, 0.9, 1.5))])
        tests.append(traced.counters["leaf_tests"])
        assert traced.counters["nodes_visited"] > 4 * 500
    assert tests[0] < tests[1] <= tests[0] + 510  # a few cells have got other grids


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


@pytest.mark.parametrize("half", [(1, 1, 1e-7), (1, 1e-7, 1e-7), (1, 0.3, 0.01), (1e-7, 1, 0.5)])
def test_flat_scenes(any_device: str, half: tuple[float, float, float]) -> None:
    corners, rng = _clusters(np.random.default_rng(8)) * half, np.random.default_rng(9)
    points = corners.mean(axis=1) + rng.uniform(-1.5, 0.0, (len(corners), 1)) * (0.3, 0.2, 1.0)
    light = DirectionalLight("sun", (-0.3, -0.2, -1.0))
    expected = _hidden(_tracer(any_device, "brute_force"), _mesh(corners), points, light)
    assert np.array_equal(_hidden(_tracer(any_device), _mesh(corners), points, light), expected)
    assert expected.any()


def test_unlike_frames(any_device: str) -> None:
    """Large and small scenes, none, and such with gaps where parts have gone, on one tracer: nothing of a frame before
    is read."""
    rng = np.random.default_rng(10)
    tracer, oracle = _tracer(any_device), _tracer(any_device, "brute_force")
    clusters = _mesh(_clusters(rng, 2500))
    ball, soup = geometry.icosphere(3, 0.3, (0.2, 0.1, 0.0)), geometry.soup(rng, 300, 0.3, 2.0)
    points = rng.uniform(-1.2, 1.2, (800, 3))
    frames: list[dict[str, geometry.Geometry]] = [
        {"clusters": clusters, "ball": ball},
        {"ball": ball},
        {},
        {"soup": soup},
        {"soup": soup, "clusters": clusters, "ball": ball},
        {"clusters": clusters, "ball": ball},
        {"soup": soup, "ball": ball},
        {"soup": soup},
        {"clusters": clusters},
        {"dot": (ball[0] * 1e-3, ball[1])},
        {"soup": soup, "clusters": clusters},
    ]
    gaps = False
    for parts in frames:
        for each in (tracer, oracle):
            for name in ("clusters", "ball", "soup", "dot"):
                if name in parts:
                    each.scene.put(name, *parts[name])
                elif name in each.scene:
                    each.scene.remove(name)
        assert np.array_equal(tracer.occluded(points, _LAMP), oracle.occluded(points, _LAMP))
        if parts:
            tree = Tree(tracer)
            held = set().union(
                *(tree.triangles(cell) for grids in tree.depths for grid in grids for cell in grid.cells)
            )
            assert len(held) == sum(len(triangles) for _, triangles in parts.values()), "those of gaps are in no cell"
            gaps |= max(held) >= len(held)
    assert gaps, "no scene has one"
