# SPDX-License-Identifier: Apache-2.0
"""What comes, goes, changes its size or moves is copied and made; nothing of what rests is, wherever it lies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import geometry
import numpy as np
import probe
import probe_occluders
import pytest

from shadow_tracer import Bounds, BoundsError, DirectionalLight, PointLight, ShadowTracer

_SIDE = 48  # of the terrain
_TERRAIN = 2 * _SIDE * _SIDE  # 36 blocks of 128 triangles
_CORNERS = (_SIDE + 1) ** 2
_BOUNDS = Bounds(3 * _TERRAIN, 2000, 2, queue_capacity=4096, grid_entries=16384)
_LIGHTS = [PointLight("lamp", (0.5, -0.3, 2.5)), DirectionalLight("sun", (0.3, 0.2, -1.0))]
_POINTS = np.random.default_rng(3).uniform((-2.0, -2.0, -0.6), (2.0, 2.0, 0.2), (1500, 3))
_NAMES = [
    "light_grid/packed",
    "light_grid/spherical",
    "cone_hierarchy/linear",
    "cone_hierarchy/precise_seatp",
    "mesh_bvh/refit",
    "brute_force/filtered",
]


def _terrain(seed: int = 1) -> geometry.Geometry:
    x, y = np.meshgrid(np.linspace(-2.0, 2.0, _SIDE + 1), np.linspace(-2.0, 2.0, _SIDE + 1))
    z = 0.2 * np.random.default_rng(seed).random(x.shape)
    k = np.arange(_CORNERS).reshape(_SIDE + 1, -1)
    a, b, c, d = (part.ravel() for part in (k[:-1, :-1], k[:-1, 1:], k[1:, 1:], k[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x.ravel(), y.ravel(), z.ravel()], 1), triangles


def _marker(count: int = 2, at: float = 0.0) -> geometry.Geometry:
    """So many triangles in a row, not sharing corners."""
    vertices = np.zeros((count, 3, 3))
    vertices[:, :, :2] = np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]]) + at
    vertices[:, :, 2] = 0.5 + 0.01 * np.arange(count)[:, None]
    return vertices.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


class _World:
    """A tracer whose frames are compared with those of one that is made for each."""

    def __init__(self, names: str, device: str, monkeypatch: pytest.MonkeyPatch, **more: Any) -> None:
        self.tracer = ShadowTracer(*names.split("/"), device=device, **{"bounds": _BOUNDS, "threads": 1, **more})
        self.scene = self.tracer.scene
        self._copied = probe_occluders.scene_uploads(self.tracer, monkeypatch)
        self._device = device

    def states(self) -> np.ndarray:
        found: np.ndarray = self.tracer.states_at(_POINTS, _LIGHTS)
        return found

    def copied(self) -> dict[str, int]:
        """What is copied or placed for a frame, which is right."""
        self._copied.clear()
        found = self.states()
        copied: dict[str, int] = {}
        for name, count in self._copied:
            copied[name] = copied.get(name, 0) + count
        fresh = ShadowTracer("brute_force", device=self._device, bounds=self.tracer.bounds)
        for mesh in self.scene:
            fresh.scene.put(mesh.name, mesh.vertices, mesh.triangles, mesh.pose, nonfinite="skip")
        assert np.array_equal(found, fresh.states_at(_POINTS, _LIGHTS))
        assert probe_occluders.layout(self.tracer).live == self.scene.triangle_count
        return copied

    def settle(self) -> None:
        """Two frames: in the second one meshes that stay may be put into another order, once (``order.py``)."""
        self.copied()
        self.copied()

    def expected(self, triangles: int, local: int, placed: int) -> dict[str, int]:
        """The CPU reads vertices where meshes have them."""
        local = 0 if probe.wide(self._device) else local
        return {k: v for k, v in {"triangles": triangles, "local": local, "placed": placed}.items() if v}


def _keeps_records(tracer: ShadowTracer) -> bool:
    """The grid of the CPU makes them for rays outside of its tiles alone."""
    return not probe.wide(tracer.device) or tracer.variant != "packed"


Make = Callable[..., _World]


_each = probe.in_forms("names", _NAMES, ["light_grid/packed", "cone_hierarchy/linear"])


@pytest.fixture
def make(names: str, kernel_form: str, any_device: str, monkeypatch: pytest.MonkeyPatch) -> Make:
    return partial(_World, names, any_device, monkeypatch)


@pytest.fixture
def world(make: Make) -> _World:
    return make()


@pytest.mark.parametrize("first", ["marker", "terrain"])
@_each
def test_a_marker_that_comes_and_goes_copies_nothing_of_a_terrain(world: _World, first: str) -> None:
    """Before the terrain or behind it; and where it has been another one finds its place."""
    scene = world.scene
    meshes = {"marker": _marker(), "terrain": _terrain()}
    for name in (first, *(set(meshes) - {first})):
        scene.put(name, *meshes[name])
    world.settle()
    begin = probe_occluders.layout(world.tracer).first["terrain"]
    assert begin == ((7, 2) if first == "marker" else (1, 0))
    scene.remove("marker")
    assert world.copied() == {}
    scene.put("marker", *_marker(at=0.3))
    assert world.copied() == world.expected(2, 6, 6)
    scene.put("marker", *_marker(150))  # does not fit where it was
    assert world.copied() == world.expected(150, 450, 450)
    scene.put("marker", *_marker(1))
    assert world.copied() == world.expected(1, 3, 3)
    scene.put("second", *_marker(1, 0.5))
    assert world.copied() == world.expected(1, 3, 3)
    assert probe_occluders.layout(world.tracer).looked_at == _TERRAIN + 2
    scene.move("terrain", geometry.pose_of(np.eye(3), (0.0, 0.0, -0.1)))
    assert world.copied() == world.expected(0, 0, _CORNERS)
    assert probe_occluders.layout(world.tracer).first["terrain"] == begin


@pytest.mark.parametrize("first", ["marker", "terrain"])
@_each
@pytest.mark.slow
def test_only_what_a_marker_touches_is_made_again(world: _World, first: str) -> None:
    """Records, corners and boxes of both lights; the marker's, and those of the terrain that share a block with it."""
    meshes = {"marker": _marker(), "terrain": _terrain()}
    scene, tracer = world.scene, world.tracer
    for name in (first, *(set(meshes) - {first})):
        scene.put(name, *meshes[name])
    block, corner = (0, 1) if first == "marker" else (_TERRAIN // 128, _CORNERS + 1)
    corners = set(range(corner, corner + 6))
    world.settle()
    assert probe_occluders.layout(tracer).places == 2
    steps: list[tuple[Any, set[int], set[int]]] = [
        (lambda: scene.move("marker", geometry.pose_of(np.eye(3), (0.1, 0.0, 0.1))), {block}, corners),
        (lambda: scene.deform("marker", _marker(at=0.2)[0]), {block}, corners),
        (lambda: scene.remove("marker"), {block} if first == "marker" else set(), set()),
        (lambda: scene.put("marker", *_marker(at=-0.2)), {block}, corners),
        (lambda: None, set(), set()),
    ]
    for number, (step, blocks, vertices) in enumerate(steps):
        step()
        found = probe_occluders.remade(tracer, world.states)
        # Which the grid of the CPU needs for rays outside of its tiles alone.
        assert found["records"] == (set() if probe.wide(tracer.device) and tracer.variant == "packed" else blocks), (
            number
        )
        assert found.get("vertices", vertices) == vertices, number
        assert found.get("boxes", set()) <= {each // 2 for each in blocks}, number
    scene.move("terrain", geometry.pose_of(np.eye(3), (0.0, 0.0, -0.1)))
    rests = _TERRAIN // 128 if first == "terrain" else None
    assert rests not in probe_occluders.remade(tracer, world.states)["records"]


@probe.in_forms("names", ["light_grid/packed"], ["light_grid/packed", "cone_hierarchy/linear"])
def test_recorded_frames_make_what_a_marker_touches(make: Make) -> None:
    """A marker that moves is made before the recording, of which there is one for all its places."""
    world = make(graphs=True)
    world.scene.put("terrain", *_terrain())
    world.scene.put("marker", *_marker())
    for step in range(6):
        world.scene.move("marker", geometry.pose_of(np.eye(3), (0.1 * step, 0.0, 0.0)))
        world.copied()
    assert probe.recordings(world.tracer) == 1
    world.scene.move("marker", np.eye(4))
    made = {_TERRAIN // 128} if _keeps_records(world.tracer) else set()
    assert probe_occluders.remade(world.tracer, world.states)["records"] == made
    for at in (0.4, -0.3, 0.1):
        world.scene.deform("terrain", _terrain(2)[0])
        world.scene.move("marker", geometry.pose_of(np.eye(3), (at, 0.0, 0.0)))
        world.copied()


@_each
def test_gaps_of_many_parts_are_filled_or_closed(make: Make) -> None:
    """Every other part goes; parts that fit lie in the gaps, one that does not closes them all."""
    world = make(bounds=replace(_BOUNDS, max_triangles=1000))
    for number in range(10):
        world.scene.put(f"part {number}", *_marker(100, 0.1 * number))
    world.copied()
    for number in range(0, 6, 2):
        world.scene.remove(f"part {number}")
    assert world.copied() == {}
    now = probe_occluders.layout(world.tracer)
    assert (now.live, now.looked_at) == (700, 1000)
    world.scene.put("fits", *_marker(60, -0.2))
    assert world.copied() == world.expected(60, 180, 180)
    assert probe_occluders.layout(world.tracer).first["fits"] == (1, 0)
    world.scene.put("does not", *_marker(240, -0.4))
    assert world.copied()["triangles"] >= 240 + 600
    now = probe_occluders.layout(world.tracer)
    assert (now.live, now.looked_at) == (1000, 1000)
    with pytest.raises(BoundsError):
        world.scene.put("more", *_marker(1))
    for number in (1, 3, 5, 7):
        world.scene.remove(f"part {number}")
    world.copied()
    now = probe_occluders.layout(world.tracer)
    assert now.live == now.looked_at == 600, "gaps of more than half of what there is are closed"


@probe.in_forms("names", ["mesh_bvh/refit", "mesh_bvh/binary"], ["mesh_bvh/refit"])
@pytest.mark.slow
def test_a_tree_is_refitted_for_markers(world: _World, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is built for the terrain, once more when there is a first marker, and when much has been replaced."""
    rng = np.random.default_rng(8)
    builds = probe.tree_builds(world.tracer, monkeypatch)
    world.scene.put("terrain", *_terrain())
    world.copied()
    world.scene.put("marker 0", *_marker(20))
    world.copied()
    assert builds == [True, True]
    for step in range(30):
        name = f"marker {rng.integers(3)}"
        if name in world.scene and rng.random() < 0.4:
            world.scene.remove(name)
        else:
            world.scene.put(name, *_marker(int(rng.integers(1, 25)), float(rng.uniform(-1.0, 1.0))))
        if step % 7 == 0:
            world.scene.move("terrain", geometry.pose_of(np.eye(3), (0.0, 0.0, float(rng.uniform(-0.2, 0.1)))))
        world.copied()
    assert sum(builds[2:]) <= 5 < len(builds) - 7, builds
    builds.clear()
    for name in [name for name in world.scene.names if name != "terrain"]:
        world.scene.remove(name)
    world.copied()
    world.scene.put("terrain", *_terrain(2))
    world.scene.deform("terrain", _terrain(3)[0])
    world.copied()
    world.scene.put("terrain", _terrain()[0], _terrain()[1][::-1])
    world.copied()
    assert builds == [False, False, True]
