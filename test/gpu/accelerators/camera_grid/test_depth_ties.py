# SPDX-License-Identifier: Apache-2.0
"""Depth images where floating point does not know: rays through corners and along edges, closed meshes, planes through
the eye, the ends of the world."""

from __future__ import annotations

import closest_hit
import geometry
import numpy as np
import pytest
from depth_views import BOUNDS, VIEWS, check, generator, look, same, scene_of

from shadow_tracer import Camera, Scene


def _sheet(columns: int, rows: int, fx: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A rough surface with a corner exactly on every pixel's ray of a camera at the origin: vertices, triangles and
    depths."""
    z = generator(9).integers(32, 160, (rows, columns)) / 16.0
    v, u = np.mgrid[:rows, :columns]
    x, y = (u - columns // 2) / fx, (v - rows // 2) / fx
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return np.stack([x * z, y * z, z], axis=-1).reshape(-1, 3), triangles.astype(np.int32), z


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (4096.0, -512.0, 77.0)])
def test_rays_through_corners(depth_camera, plain_forms, shift):
    """Six triangles meet at each pixel's ray, and at least one of them is hit; at the corner's depth, since all of
    them are there."""
    columns, rows, fx = 61, 43, 64.0
    vertices, triangles, z = _sheet(columns, rows, fx)
    camera = Camera(columns, rows, fx, fx, columns // 2, rows // 2, geometry.pose_of(np.eye(3), shift))
    scene = scene_of((vertices + shift, triangles))
    depth, triangle = depth_camera.render(scene, camera)
    assert (triangle >= 0).all()
    assert (depth <= z * (1.0 + 1e-7)).all(), "something may be in front of a corner, but nothing behind is seen"
    assert depth_camera.counters["retested"] > columns * rows
    assert (np.abs(depth - z) <= 1e-7 * z).mean() > 0.3
    same(plain_forms, scene, camera, depth, triangle)


def test_rays_along_edges(depth_camera, plain_forms):
    """The diagonals and the middle lines of squares in front of the camera run along rows, columns and diagonals of
    pixels."""
    parts = [geometry.square(2, 4.0, 2.0, (4.0 * i, 4.0 * j)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    camera = Camera(33, 33, 16.0, 16.0, 16.0, 16.0)
    scene = scene_of(geometry.join(parts))
    depth, triangle = depth_camera.render(scene, camera)
    assert (depth == 4.0).all()
    # The border of the outer squares is at 6 / 4 * 16 = 24 pixels: all of the image is inside.
    assert depth_camera.counters["retested"] > 33
    same(plain_forms, scene, camera, depth, triangle)


@pytest.mark.parametrize("side", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_rays_through_the_outermost_corner(depth_camera, plain_forms, side):
    """A triangle for each pixel, of which its ray meets the outermost corner and nothing else."""
    columns, rows, fx = 61, 43, 64.0
    v, u = np.mgrid[:rows, :columns]
    z = generator(3).integers(33, 160, (rows, columns)) / 16.0
    offsets = np.array([(0.0, 0.0), (0.5, 0.25), (0.5, -0.25)]) @ np.array([side, side[::-1]])
    corners = []
    for right, down in offsets:
        corners.append(np.stack([(u + right - columns // 2) / fx * z, (v + down - rows // 2) / fx * z, z], axis=-1))
    vertices = np.stack(corners, axis=2).reshape(-1, 3)
    triangles = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    camera = Camera(columns, rows, fx, fx, columns // 2, rows // 2)
    scene = scene_of((vertices, triangles))
    depth, triangle = depth_camera.render(scene, camera)
    assert np.array_equal(triangle, np.arange(rows * columns).reshape(rows, columns))
    assert np.array_equal(depth, z.astype(np.float32))
    same(plain_forms, scene, camera, depth, triangle)


def test_rounded_rotation(depth_camera, plain_forms):
    """A rotation may be off by 1e-6. Rays are what they are: within 1e-16 of a triangle's outermost corner each, and
    fractions say which meet it."""
    rng = generator(4)
    shear = np.array([[1.0, -1.0, 1.0], [-1.0, -1.0, 1.0], [1.0, 1.0, 1.0]])
    turn = (np.eye(3) + 4.9e-7 * shear) @ geometry.rotation(rng)
    eye = np.array([3.0, -7.0, 2.0])
    camera = Camera(31, 21, 5.0, 5.0, 14.6, 11.3, geometry.pose_of(turn, eye))
    ways = closest_hit.directions(camera)
    z = rng.uniform(2.0, 9.0, (21, 31, 1))
    right, down = 0.4 / 5.0 * turn[:, 0], 0.2 / 5.0 * turn[:, 1]
    corners = [eye + (ways + away) * z for away in (0.0 * right, right + down, right - down)]
    vertices = np.stack(corners, axis=2).reshape(-1, 3)
    triangles = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    scene = scene_of((vertices, triangles))
    depth, triangle = depth_camera.render(scene, camera)
    own = np.arange(len(triangles)).reshape(21, 31)
    met = [
        bool(closest_hit.exact_hits(camera, row, column, vertices, triangles[k : k + 1]))
        for (row, column), k in np.ndenumerate(own)
    ]
    assert 50 < sum(met) < 600
    assert np.array_equal(triangle, np.where(np.reshape(met, own.shape), own, -1))
    same(plain_forms, scene, camera, depth, triangle)


def test_edge_on_but_for_rounding(depth_camera, plain_forms):
    """Eye, ray and triangle in one plane but for the last bits of their coordinates: where fractions say that the ray
    meets it, the depth is one that the triangle has."""
    seen = 0
    for seed in range(40):
        rng = generator(seed)
        turn, eye = geometry.rotation(rng), rng.normal(size=3)
        camera = Camera(25, 3, 20.0, 20.0, 12.0, 1.0, geometry.pose_of(turn, eye))
        flat = np.array([(-2.0, 3.0), (2.0, 3.5), (0.3, 7.0)])
        vertices = eye + flat[:, :1] * turn[:, 0] + flat[:, 1:] * turn[:, 2]
        triangles = np.array([[0, 1, 2]], np.int32)
        scene = scene_of((vertices, triangles))
        depth, triangle = depth_camera.render(scene, camera)
        met = [bool(closest_hit.exact_hits(camera, 1, column, vertices, triangles)) for column in range(25)]
        assert np.array_equal(triangle[1] == 0, met)
        assert (triangle[::2] == -1).all()
        assert ((depth[1, met] >= 2.999999) & (depth[1, met] <= 7.00001)).all()
        same(plain_forms[:1], scene, camera, depth, triangle)
        seen += sum(met)
    assert seen > 30


@pytest.mark.parametrize("large_first", [True, False])
def test_large_and_small_in_one_plane(depth_camera, plain_forms, large_first):
    """They are in lists of tiles of different sizes, and the first one is seen all the same."""
    camera = Camera(200, 200, 100.0, 100.0, 100.25, 100.25)
    large = geometry.square(2, 4.0, 5.0)
    small = geometry.join(
        [geometry.square(2, 4.0, 0.2, (0.5 * i, 0.5 * j)) for i in range(-6, 7) for j in range(-6, 7)]
    )
    scene = scene_of(geometry.join([large, small] if large_first else [small, large]))
    depth, triangle = depth_camera.render(scene, camera)
    assert (depth == 4.0).all()
    if large_first:
        assert (triangle <= 1).all()
    else:
        at = 4.0 * camera.pixel_rays()[..., :2]
        inside = (np.abs(at - 0.5 * np.round(2.0 * at)) < 0.2) & (np.abs(at) < 3.2)
        assert np.array_equal(triangle < len(small[1]), inside.all(axis=-1))
    same(plain_forms, scene, camera, depth, triangle)


@pytest.mark.parametrize("seed", range(6))
def test_closed_meshes_have_no_holes(depth_camera, seed):
    rng = generator(seed)
    vertices, triangles = geometry.icosphere(3, 1.0) if seed % 2 else geometry.spiky_sphere(24, seed)
    eye = 0.2 * rng.normal(size=3) / 3.0
    # Corners of the mesh at pixel centres, as nearly as float64 can say: the camera looks at one of them.
    camera = look(120, 90, eye, vertices[int(rng.integers(len(vertices)))], 0.3)
    camera = Camera(120, 90, 40.0, 40.0, 60.0, 45.0, camera.camera_to_world)
    depth, _ = depth_camera.render(scene_of((vertices, triangles)), camera)
    assert np.isfinite(depth).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_rational_numbers(depth_camera, plain_forms, seed):
    """Integer corners, every triangle twice, and a camera on the lattice: ties everywhere, decided with fractions."""
    rng = generator(seed)
    vertices, triangles = geometry.integer_soup(rng, 60, 3)
    triangles = np.concatenate([triangles, triangles[::-1, ::-1]])
    camera = Camera(17, 17, 8.0, 8.0, 8.0, 8.0, geometry.pose_of(np.eye(3), (0, 0, -4 if seed < 2 else -1)))
    scene = scene_of((vertices, triangles))
    depth, triangle = depth_camera.render(scene, camera)
    same(plain_forms, scene, camera, depth, triangle)
    assert depth_camera.counters["retested"] > 20, "rays on edges and corners"
    for row, column in np.ndindex(17, 17):
        # Copies of a triangle have the same depth in any arithmetic: the first sixty say it all.
        hits = closest_hit.exact_hits(camera, row, column, vertices, triangles[:60])
        number = int(triangle[row, column])
        if not hits:
            assert number == -1
            continue
        nearest = min(hits.values())
        assert number in hits, "an exact hit, and not the copy of one"
        assert float(hits[number]) <= float(nearest) * (1.0 + 1e-12)
        assert abs(float(depth[row, column]) - float(nearest)) <= 1e-7 * float(nearest)


@pytest.mark.slow
def test_map_coordinates(depth_camera):
    """Half a million metres from the origin an image is the same to the last bit, where coordinates have room."""
    vertices, triangles = VIEWS["street"][0]
    vertices = np.round(vertices * 2.0**16) / 2.0**16
    camera = VIEWS["street"][1]
    pose = camera.camera_to_world.copy()
    depth, triangle = depth_camera.render(scene_of((vertices, triangles)), camera)
    shift = np.array([512_345.0, 5_403_210.0, 431.0])
    pose[:3, 3] = np.round(pose[:3, 3] * 2.0**16) / 2.0**16 + shift
    moved = Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, pose)
    again, number = depth_camera.render(scene_of((vertices + shift, triangles)), moved)
    assert again.tobytes() == depth.tobytes() and np.array_equal(number, triangle)
    check(moved, (vertices + shift, triangles), again, number)


def test_nothing_to_see(depth_camera):
    mesh, camera = VIEWS["street"]
    flat = np.array([[0, 0, 3], [1, 1, 3], [2, 2, 3.0]]), np.array([[0, 1, 2]])
    edge_on = np.array([[0, 0, 1], [0, 5, 9], [0, -5, 9.0]]), np.array([[0, 1, 2]])
    behind = np.array([[-9, -9, -1], [9, -9, -1], [0, 9, -1e-9]]), np.array([[0, 1, 2]])
    at_eye = np.array([[0, 0, 0], [9, 0, 9], [0, 9, 9.0]]), np.array([[0, 1, 2]])
    straight = Camera(21, 21, 10.0, 10.0, 10.0, 10.0)
    none = np.zeros((0, 3)), np.zeros((0, 3), int)
    for scene, seen_from in (
        (Scene(BOUNDS), camera),
        (scene_of(none), camera),
        (scene_of(flat), straight),
        (scene_of(edge_on), straight),
        (scene_of(behind), straight),
        (scene_of(at_eye), straight),
    ):
        depth, triangle = depth_camera.render(scene, seen_from)
        assert np.isnan(depth).all() and (triangle == -1).all()
    assert depth_camera.counters["degenerate"] == 1
    assert set(depth_camera.counters) >= {"rays", "triangles", "entries", "largest_tile", "passes", "tests", "retested"}
    depth_camera.render(Scene(BOUNDS), camera)
    assert depth_camera.counters["triangles"] == 0 and depth_camera.counters["tests"] == 0


def test_triangles_with_bad_corners_are_not_seen(depth_camera, plain_forms):
    vertices, triangles = VIEWS["street"][0]
    camera = VIEWS["street"][1]
    bad = vertices.copy()
    bad[::7, 1] = np.nan
    scene = scene_of((bad, triangles), nonfinite="skip")
    depth, triangle = depth_camera.render(scene, camera)
    good = np.isfinite(bad[triangles]).all(axis=(1, 2))
    fewer, number = depth_camera.render(scene_of((vertices, triangles[good])), camera)
    assert fewer.tobytes() == depth.tobytes()
    assert np.array_equal(np.where(number >= 0, np.flatnonzero(good)[number], -1), triangle)
    same(plain_forms, scene, camera, depth, triangle)


def test_no_near_plane(depth_camera, plain_forms):
    """A nanometre in front of the eye, at 1e12 m, and both."""
    for z in (1e-9, 1e12):
        near = geometry.square(2, z, 10.0 * z)
        camera = Camera(20, 20, 10.0, 10.0, 9.5, 9.5)
        scene = scene_of(geometry.join([near, geometry.square(2, 5.0, 0.5)]))
        depth, triangle = depth_camera.render(scene, camera)
        same(plain_forms, scene, camera, depth, triangle)
        small = np.isin(triangle, (2, 3))
        assert (depth[~small] == np.float32(z)).all() and (depth[small] == 5.0).all()
        assert small.sum() == (4 if z > 5.0 else 0)


def test_nearly_edge_on(depth_camera, plain_forms):
    """The eye a hair above a long triangle: every depth lies between the corners'."""
    for height in (1e-3, 1e-9, 1e-14, 1e-17):
        corners = np.array([[-50.0, height, -3.0], [50.0, height, -3.0], [0.0, height, 40.0]])
        camera = Camera(31, 31, 20.0, 20.0, 15.0, 15.0)
        scene = scene_of((corners, np.array([[0, 1, 2]])))
        depth, triangle = depth_camera.render(scene, camera)
        seen = triangle >= 0
        assert np.array_equal(np.isfinite(depth), seen)
        assert ((depth[seen] > 0.0) & (depth[seen] <= 40.0)).all()
        assert not seen[:15].any() and seen[16:].sum() > 100
        expected = np.broadcast_to(height * 20.0 / np.arange(1, 16)[:, None], (15, 31))
        assert np.allclose(depth[16:][seen[16:]], expected[seen[16:]])
        same(plain_forms, scene, camera, depth, triangle)
