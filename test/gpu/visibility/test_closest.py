# SPDX-License-Identifier: Apache-2.0
"""The query *closest hit*: through every walker and by the camera's own grid, over one scene on the device, the same
triangles and the same bits of depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import data
import geometry
import numpy as np
import probe
import probe_occluders
import pytest
import sequences
from depth_views import VIEWS, generator, lens, look
from one_world import WALKERS, OneWorld

from shadow_tracer import Bounds, Camera, DepthCamera, PointLight, Scene, ShadowTracer

pytestmark = probe.in_both_forms

_BOUNDS = Bounds(max_triangles=9000, max_rays=30_000, grid_entries=60_000)
_worlds: dict[tuple[str, str], OneWorld] = {}


@pytest.fixture
def world(any_device: str, kernel_form: str) -> OneWorld:
    """One for each device and form, which many scenes follow each other in."""
    if (any_device, kernel_form) not in _worlds:
        _worlds[any_device, kernel_form] = OneWorld(any_device, _BOUNDS)
    return _worlds[any_device, kernel_form]


def _scene(mesh: geometry.Geometry, **options: Any) -> Scene:
    scene = Scene(_BOUNDS)
    scene.put("all", *mesh, **options)
    return scene


@pytest.mark.parametrize("name", VIEWS)
def test_views(world: OneWorld, name: str) -> None:
    mesh, camera = VIEWS[name]
    assert (world.check(_scene(mesh), camera) >= 0).mean() > 0.02


@pytest.mark.parametrize("kind", ["rational", "fisheye", "wild", "narrow"])
@pytest.mark.parametrize("name", ["street", "museum, inside", "around", "ground"])
def test_tables_of_rays(world: OneWorld, name: str, kind: str) -> None:
    mesh, camera = VIEWS[name]
    camera = lens(kind, camera)
    triangle = world.check(_scene(mesh), camera)
    assert (triangle >= 0).mean() > 0.02 and (triangle[~camera.rays.known.reshape(-1)] == -1).all()


@pytest.mark.parametrize(
    "rays", [np.full((3, 5, 2), np.nan), np.full((3, 5, 2), 3e38), np.full((3, 5, 2), -7.0), np.zeros((3, 5, 2))]
)
def test_tables_at_the_end_of_numbers(world: OneWorld, rays: np.ndarray) -> None:
    wall = geometry.square(2, 2.0, 9.0)
    assert (world.check(_scene(wall), Camera(5, 3, 4.0, 4.0, 2.0, 1.0, rays=rays)) >= 0).all() == (rays == 0.0).all()


def _sheet() -> geometry.Geometry:
    """A rough surface with a corner exactly on every pixel's ray of :data:`_ON_CORNERS`."""
    z = generator(9).integers(32, 160, (23, 31)) / 16.0
    v, u = np.mgrid[:23, :31]
    number = np.arange(23 * 31).reshape(23, 31)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return np.stack([(u - 15) / 64.0 * z, (v - 11) / 64.0 * z, z], axis=-1).reshape(-1, 3), triangles


_ON_CORNERS = Camera(31, 23, 64.0, 64.0, 15.0, 11.0)


def _doubled() -> geometry.Geometry:
    """Integer corners, every triangle twice, in the other order and winding."""
    vertices, triangles = geometry.integer_soup(generator(2), 60, 3)
    return vertices, np.concatenate([triangles, triangles[::-1, ::-1]])


def _coplanar(large_first: bool) -> geometry.Geometry:
    small = [geometry.square(2, 4.0, 0.2, (0.5 * i, 0.5 * j)) for i in range(-6, 7) for j in range(-6, 7)]
    large = [geometry.square(2, 4.0, 5.0)]
    return geometry.join(large + small if large_first else small + large)


_SQUARE = Camera(33, 33, 16.0, 16.0, 16.0, 16.0)
_TIES: dict[str, tuple[Callable[[], geometry.Geometry], Camera]] = {
    "corners": (_sheet, _ON_CORNERS),
    "edges": (
        lambda: geometry.join(
            [geometry.square(2, 4.0, 2.0, (4.0 * i, 4.0 * j)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        ),
        _SQUARE,
    ),
    "large before small": (lambda: _coplanar(True), _SQUARE),
    "small before large": (lambda: _coplanar(False), _SQUARE),
    "integers": (_doubled, Camera(17, 17, 8.0, 8.0, 8.0, 8.0, geometry.pose_of(np.eye(3), (0, 0, -4)))),
    "integers, inside": (_doubled, Camera(17, 17, 8.0, 8.0, 8.0, 8.0, geometry.pose_of(np.eye(3), (0, 0, -1)))),
    "closed": (lambda: geometry.icosphere(3, 1.0), look(60, 45, (0.01, 0.02, 0.0), (1, 0, 0), 0.3)),
    "spikes": (lambda: geometry.spiky_sphere(24, 1), look(60, 45, (3, 0.5, 0.2), (0, 0, 0))),
    "a corner at the eye": (lambda: geometry.square(2, 0.0, 1.0, (1.0, 1.0)), look(20, 20, (0, 0, 0), (1, 1, 0.3))),
    "near and far": (
        lambda: geometry.join([geometry.square(2, z, 0.3 * z) for z in (1e-9, 1e-3, 1.0, 1e6, 1e12)]),
        _SQUARE,
    ),
}


@pytest.mark.parametrize("name", _TIES)
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (4096.0, -512.0, 77.0)])
def test_ties(world: OneWorld, name: str, shift: tuple[float, float, float]) -> None:
    make, camera = _TIES[name]
    vertices, triangles = make()
    pose = np.array(camera.camera_to_world)
    pose[:3, 3] += shift
    camera = replace(camera, camera_to_world=pose)
    seen = world.check(_scene((vertices + shift, triangles)), camera)
    assert (seen >= 0).any() or name == "a corner at the eye"


def test_triangles_that_nobody_sees(world: OneWorld) -> None:
    """Without area, seen edge-on, with corners that are not finite: among others that are seen, before and behind."""
    vertices, triangles = VIEWS["street"][0]
    camera = VIEWS["street"][1]
    vertices, triangles = np.array(vertices, float), np.array(triangles)
    vertices[generator(3).integers(0, len(vertices), 40)] = np.nan
    triangles[::7, 1] = triangles[::7, 0]
    seen = world.check(_scene((vertices, triangles), nonfinite="skip"), camera)
    bad = ~np.isfinite(vertices[triangles]).all(axis=(1, 2))
    bad[::7] = True
    assert (seen >= 0).mean() > 0.3 and not bad[seen[seen >= 0]].any()
    flat = np.array([(0, 0, 3), (1, 1, 3), (2, 2, 3.0), (np.nan, 0, 3), (np.inf, 5, 9), (0, -5, 9)])
    triangles = np.array([(0, 1, 2), (0, 3, 1), (4, 1, 2), (0, 0, 0), (5, 5, 1)])
    assert (world.check(_scene((flat, triangles), nonfinite="skip"), Camera(9, 7, 3.0, 3.0, 4.0, 3.0)) == -1).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 37), (37, 1), (2, 3), (150, 150)])
def test_sizes(world: OneWorld, size: tuple[int, int]) -> None:
    mesh, camera = VIEWS["museum, inside"]
    width, height = size
    assert (
        world.check(_scene(mesh), Camera(*size, 50.0, 50.0, width / 2, height / 2, camera.camera_to_world)) >= 0
    ).all()


def test_scenes_of_no_triangle_and_of_one(world: OneWorld) -> None:
    camera = Camera(12, 9, 6.0, 6.0, 5.5, 4.0)
    assert (world.check(Scene(_BOUNDS), camera) == -1).all()
    scene = _scene((np.zeros((3, 3)), np.zeros((0, 3), int)))
    assert (world.check(scene, camera) == -1).all()
    scene.put("one", *geometry.split(*geometry.square(2, 3.0, 9.0)))
    assert (world.check(scene, camera) >= 0).all()
    scene.put("one", np.array([(-1, -1, 3), (1, -1, 3), (0, 1, 3.0)]), np.array([(0, 1, 2)]))
    assert 0 < (world.check(scene, camera) == 0).sum() < 12 * 9
    scene.remove("one")
    assert (world.check(scene, camera) == -1).all()


@pytest.mark.parametrize("away", [1e3, 1e7, 6.6e7, 6.8e7, 1e9, 1e15])
def test_far_away(world: OneWorld, away: float) -> None:
    """Beyond 2^26 times the size of the scene rays are shown every triangle."""
    scene = _scene(geometry.soup(generator(1), 300, 0.06, 1.0))
    camera = look(16, 16, (0.36 * away, 0.48 * away, 0.8 * away), (0, 0, 0), 0.4 * away)
    assert 0.05 < (world.check(scene, camera) >= 0).mean() < 0.95


@pytest.mark.slow
def test_edge_on_but_for_rounding(world: OneWorld) -> None:
    """A triangle that the eye is in the plane of, but for the last bits of its coordinates, reaches from before a wall
    to behind it; its depth is computed anywhere between those of its corners."""
    closer = 0
    for seed in range(300):
        scene, camera = _edge_on(seed)
        closer += int((world.check(scene, camera) == 1).sum())
    assert closer > 50


def _edge_on(seed: int) -> tuple[Scene, Camera]:
    rng = generator(seed)
    turn, eye = geometry.rotation(rng), rng.normal(size=3)
    wall = np.array([(-9.0, -9.0, 3.0), (9.0, -9.0, 3.0), (0.0, 9.0, 3.0)])
    through = np.array([(3.0, 0.0, 2.0), (5.0, 0.0, 7.0), (6.5, 0.0, 7.0)])
    # Beside what is looked at, so that trees and grids have something to leave out.
    others = geometry.soup(rng, 60, 0.3, 1.0)[0] + (-6.0, 0.0, 8.0)
    vertices = eye + np.concatenate([wall, through, others]) @ turn.T
    camera = Camera(41, 3, 40.0, 40.0, 0.0, 1.0, geometry.pose_of(turn, eye))
    return _scene((vertices, np.arange(len(vertices)).reshape(-1, 3))), camera


def test_what_lies_behind_is_not_looked_at(world: OneWorld) -> None:
    """A wall before a crowd: rays end there."""
    wall, crowd = geometry.square(2, 1.0, 2.0), geometry.soup(generator(), 4000, 0.3, 1.0)
    scene = _scene(geometry.join([wall, (crowd[0] + (0.0, 0.0, 5.0), crowd[1])]))
    camera = Camera(40, 30, 40.0, 40.0, 19.5, 14.5)
    assert (world.check(scene, camera) <= 1).all()
    for name in WALKERS:
        counters = world.walk(name, camera).counters
        if name == "brute_force":
            assert counters["tests"] == 40 * 30 * 4002
        else:
            most = 20 if name.startswith("bvh/") else 10  # the wall shares a block of sixteen with a part of the crowd
            assert counters["tests"] < 40 * 30 * most, name


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_sequences(any_device: str, seed: int) -> None:
    """Unlike scenes, images and lenses one after the other, meshes that come, move, deform and go."""
    world, scene, hits = OneWorld(any_device, sequences.ROOMY), Scene(sequences.ROOMY), 0
    rng = np.random.default_rng(seed)
    for step in sequences.sequence(20 + seed, 24):
        for change in step.changes:
            change(scene)
        width, height = (int(size) for size in rng.choice((1, 2, 7, 8, 9, 63, 64, 65, 100), 2))
        pose = geometry.pose_of(np.eye(3), rng.normal(0.0, 0.3, 3))
        camera = Camera(width, height, max(width, 2), max(width, 2), width / 2, height / 2, pose)
        camera = replace(camera, rays=sequences.any_rays(rng.spawn(1)[0], camera))
        hits += bool((world.check(scene, camera) >= 0).any())
    assert hits > 5


@pytest.mark.parametrize("names", [("mesh_bvh", "refit"), ("uniform_grid", None)])
def test_the_scene_of_a_tracer(any_device: str, names: tuple[str, str | None]) -> None:
    """Between frames, with a gap where a mesh has been: the depths of a depth camera, and what it sees as the tracer
    numbers it. Frames after that are what they were."""
    bounds = Bounds(max_triangles=4000, max_rays=4000, max_lights=2)
    tracer, camera = ShadowTracer(*names, device=any_device, bounds=bounds, threads=1), _SQUARE
    for k in range(4):
        tracer.scene.put(
            f"{k}", *geometry.soup(generator(k), 100 + k, 0.5, 2.0), pose=geometry.pose_of(np.eye(3), (0, 0, 4))
        )
    lamp = PointLight("lamp", (0.5, -3.0, 1.0))
    depth = np.full((33, 33), 3.0, np.float32)
    tracer.trace(depth, camera, [lamp])
    tracer.scene.remove("1")
    before = tracer.trace(depth, camera, [lamp]).state("lamp")
    seen = probe.closest_hits(tracer, camera)
    expected, number = DepthCamera(any_device, bounds).render(tracer.scene, camera)
    assert seen.depth.tobytes() == expected.tobytes()
    parts = probe_occluders.layout(tracer).first
    first = np.concatenate([np.arange(len(mesh.triangles)) + parts[mesh.name][1] for mesh in tracer.scene])
    assert (number >= 0).any() and np.array_equal(seen.triangle, np.where(number < 0, -1, first[number]).reshape(-1))
    assert np.array_equal(tracer.trace(depth, camera, [lamp]).state("lamp"), before)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stanford_bunny", "cornell_box", "sibenik", "utah_teapot"])
def test_real_meshes(any_device: str, name: str) -> None:
    vertices, triangles = data.mesh(name)
    bounds = Bounds(max_triangles=max(len(triangles), len(vertices)), max_rays=5000, grid_entries=400_000)
    world, scene = OneWorld(any_device, bounds, WALKERS[:4]), Scene(bounds)
    scene.put("mesh", vertices.astype(np.float64), triangles)
    middle = np.median(vertices, axis=0).astype(float)
    size = float(np.ptp(vertices, axis=0).max())
    for k in range(4):  # inside, and from around
        eye = middle + (0.01 + 0.5 * k) * size * geometry.unit((1.0, 0.3 * k - 0.4, 0.2))
        seen = world.check(scene, look(80, 60, eye, middle + (0.0, 0.02 * size, 0.0)))
        assert (seen >= 0).mean() > 0.02
