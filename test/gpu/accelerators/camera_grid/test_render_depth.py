# SPDX-License-Identifier: Apache-2.0
"""Depth images: against float64 closest hits, both forms bit for bit, at any capacity and in any order."""

from __future__ import annotations

import closest_hit
import data
import geometry
import numpy as np
import pytest
from depth_views import BOUNDS, VIEWS, check, generator, look, same, scene_of

from shadow_tracer import Bounds, Camera, Scene

ODD = ((1, 1), (1, 7), (9, 1), (8, 8), (17, 33), (130, 3))


@pytest.mark.slow
@pytest.mark.parametrize("name", VIEWS)
def test_closest_hit(depth_camera, plain_forms, name):
    mesh, camera = VIEWS[name]
    scene = scene_of(mesh)
    depth, triangle = depth_camera.render(scene, camera)
    assert depth.shape == triangle.shape == (camera.height, camera.width)
    assert depth.dtype == np.float32 and triangle.dtype == np.int32
    assert 0.02 < (triangle >= 0).mean() and len(np.unique(triangle)) > 1, "there is something to see"
    check(camera, mesh, depth, triangle)
    same(plain_forms, scene, camera, depth, triangle)


@pytest.mark.parametrize(
    ("name", "eye", "target"),
    [
        ("bart_robots_t10", (-7, 6, -140), (0, 3, -165)),
        ("sponza_dabrovic", (-12, 3, 0), (5, 4, 0)),
        ("sibenik", (-16, -13, 0), (0, -12, 0)),
        ("conference", (1000, 450, 400), (200, 100, -300)),
    ],
)
@pytest.mark.slow
def test_real_meshes(depth_camera, plain_forms, name, eye, target):
    mesh = data.mesh(name)
    camera = look(96, 72, eye, target, 0.9, (0, 1, 0))
    scene = scene_of(mesh)
    depth, triangle = depth_camera.render(scene, camera)
    assert (triangle >= 0).mean() > 0.9
    check(camera, mesh, depth, triangle)
    same(plain_forms[:1], scene, camera, depth, triangle)


def test_every_pixel_of_a_large_image_in_both_forms(depth_camera, plain_forms):
    """Many tiles and coarse tiles, cut by the border of the image."""
    mesh, camera = VIEWS["museum, inside"]
    camera = Camera(283, 219, 200.0, 220.0, 130.0, 100.0, camera.camera_to_world)
    scene = scene_of(mesh)
    same(plain_forms, scene, camera, *depth_camera.render(scene, camera))


@pytest.mark.parametrize("size", ODD)
def test_odd_sizes(depth_camera, plain_forms, size):
    """A pixel sees the same in every image that it is a part of."""
    mesh, whole = VIEWS["museum, inside"]
    pose = whole.camera_to_world
    scene = scene_of(mesh)
    camera = Camera(*size, 20.0, 20.0, 4.0, 3.0, pose)
    depth, triangle = depth_camera.render(scene, camera)
    same(plain_forms, scene, camera, depth, triangle)
    large = depth_camera.render(scene, Camera(140, 40, 20.0, 20.0, 4.0, 3.0, pose))
    rows, columns = slice(0, size[1]), slice(0, size[0])
    assert large[0][rows, columns].tobytes() == depth.tobytes()
    assert np.array_equal(large[1][rows, columns], triangle)


@pytest.mark.parametrize("wide", [True, False])
@pytest.mark.parametrize("name", ["street", "around", "ground"])
def test_few_entries_cost_passes_and_nothing_else(any_device, depth_camera, name, wide):
    from shadow_tracer.gpu.accelerators.camera_grid.primary import PrimaryRays
    from shadow_tracer.gpu.device.devices import pick_device

    device = pick_device(any_device)
    if wide and not device.is_cpu:
        pytest.skip("the wide form is the CPU's")
    mesh, camera = VIEWS[name]
    camera = Camera(24, 18, 20.0, 20.0, 12.0, 9.0, camera.camera_to_world)
    scene = scene_of(mesh)
    depth, triangle = depth_camera.render(scene, camera)
    total = depth_camera.counters["entries"]
    assert total > 10
    for capacity, passes in ((1, total), (7, -(-total // 7)), (total - 1, 2), (total, 1)):
        bounds = Bounds(max_triangles=3000, max_rays=1000, grid_entries=capacity)
        seen = PrimaryRays(device, bounds, wide=wide).render(scene, camera)
        assert seen.counters["passes"] == passes and seen.counters["entries"] == total
        assert seen.depth.tobytes() == depth.tobytes()
        assert np.array_equal(seen.triangle, triangle.ravel())


@pytest.mark.parametrize("name", ["museum, inside", "around", "slivers"])
def test_order_and_winding_do_not_matter(depth_camera, name):
    (vertices, triangles), camera = VIEWS[name]
    depth, triangle = depth_camera.render(scene_of((vertices, triangles)), camera)
    order = generator().permutation(len(triangles))
    turned = triangles[order]
    turned[::2] = turned[::2, ::-1]
    turned[1::3] = np.roll(turned[1::3], 1, axis=1)
    again, number = depth_camera.render(scene_of(geometry.split(vertices, turned)), camera)
    assert again.tobytes() == depth.tobytes()
    # Triangles at the same depth are told apart by their number, and only by that.
    tied = depth_camera.counters["compared"]
    assert (np.where(number >= 0, order[number], -1) != triangle).sum() <= tied


def test_of_equal_triangles_the_first_is_seen(depth_camera, plain_forms):
    mesh, camera = VIEWS["street"]
    depth, triangle = depth_camera.render(scene_of(mesh), camera)
    # However its corners are turned, a triangle has the same depth to the last bit.
    copies = [(mesh[0], mesh[1][:, order]) for order in ([0, 1, 2], [1, 2, 0], [2, 1, 0], [0, 2, 1])]
    scene = scene_of(geometry.join(copies))
    again, number = depth_camera.render(scene, camera)
    assert again.tobytes() == depth.tobytes() and np.array_equal(number, triangle)
    assert depth_camera.counters["compared"] >= (triangle >= 0).sum()
    same(plain_forms, scene, camera, again, number)


def test_numbers_run_through_the_meshes(depth_camera):
    mesh, camera = VIEWS["street"]
    whole = depth_camera.render(scene_of(mesh), camera)
    scene = Scene(BOUNDS)
    for k in range(0, len(mesh[1]), 900):
        scene.put(f"part {k}", mesh[0], mesh[1][k : k + 900])
    parts = depth_camera.render(scene, camera)
    assert parts[0].tobytes() == whole[0].tobytes() and np.array_equal(parts[1], whole[1])


def _adversarial(seed: int) -> tuple[tuple[np.ndarray, np.ndarray], Camera]:
    """Meshes of all sizes, eyes on corners and in planes, rays through corners, map coordinates."""
    rng = generator(seed)
    kinds = (
        lambda: geometry.soup(rng, int(rng.integers(1, 400)), 10.0 ** rng.uniform(-2, 1), 1.5),
        lambda: geometry.slivers(rng, 100, 5.0, 10.0 ** rng.uniform(1, 6)),
        lambda: geometry.integer_soup(rng, 100, int(rng.integers(1, 4))),
        lambda: geometry.spiky_sphere(12, seed),
        lambda: geometry.join([geometry.square(axis, float(rng.normal() * 1e-3), 100.0) for axis in range(3)]),
        lambda: geometry.join([geometry.box((-1, -1, -1), (1, 1, 1))] * 3 + [geometry.soup(rng, 50, 0.3, 1.0)]),
    )
    vertices, triangles = kinds[seed % len(kinds)]()
    scale = 10.0 ** rng.integers(-4, 6)
    vertices = vertices * scale
    eye = rng.normal(size=3) * rng.choice([0.0, 0.3, 2.0, 20.0]) * scale
    if rng.random() < 0.3:
        eye = vertices[rng.integers(len(vertices))] if rng.random() < 0.5 else np.round(eye)
    turn = np.eye(3) if rng.random() < 0.4 else geometry.rotation(rng)
    if rng.random() < 0.2:
        vertices, eye = vertices + [5e5, 4e6, 100.0], eye + [5e5, 4e6, 100.0]
    width, height, focal = int(rng.integers(1, 60)), int(rng.integers(1, 40)), float(rng.choice([1.0, 8.0, 64.0]))
    camera = Camera(
        width, height, focal, 1.25 * focal, width // 2, height // 2 + rng.random(), geometry.pose_of(turn, eye)
    )
    if rng.random() < 0.4:
        ways = closest_hit.directions(camera).reshape(-1, 3)
        some = rng.integers(len(vertices), size=len(vertices) // 2)
        vertices[some] = (
            eye + ways[rng.integers(len(ways), size=len(some))] * rng.integers(1, 9, (len(some), 1)) * scale
        )
    return (vertices, triangles), camera


@pytest.mark.slow
def test_adversarial(any_device, depth_camera, plain_forms):
    """Many small images; of each, both plain_forms and any capacity give the same, in any order of the triangles."""
    from shadow_tracer.gpu.accelerators.camera_grid.primary import PrimaryRays
    from shadow_tracer.gpu.device.devices import pick_device

    cramped = PrimaryRays(pick_device(any_device), Bounds(max_triangles=3000, max_rays=3000, grid_entries=97))
    sure = seen = 0
    for seed in range(60):
        mesh, camera = _adversarial(seed)
        scene = scene_of(mesh)
        depth, triangle = depth_camera.render(scene, camera)
        same([*plain_forms[:1], cramped], scene, camera, depth, triangle)
        order = generator(seed).permutation(len(mesh[1]))
        again, _ = depth_camera.render(scene_of((mesh[0], mesh[1][order][:, [2, 1, 0]])), camera)
        assert again.tobytes() == depth.tobytes()
        truth = closest_hit.closest(camera, *mesh)
        hit = np.isfinite(truth.depth)
        assert np.array_equal((triangle >= 0)[truth.sure], hit[truth.sure]), seed
        both = truth.sure & hit
        assert (np.abs(depth[both] - truth.depth[both]) <= 1e-6 * truth.depth[both]).all(), seed
        both &= truth.alone
        assert np.array_equal(triangle[both], truth.triangle[both]), seed
        sure += int(truth.sure.sum())
        seen += int(both.sum())
    assert sure > 20_000 and seen > 5_000
