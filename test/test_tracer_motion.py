# SPDX-License-Identifier: Apache-2.0
"""Scenes that change between frames: poses, deformations, meshes that come and go. The answer is always that of the
scene as it is now."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import oracle
import pytest

from shadow_tracer import Camera, DirectionalLight, PointLight

_LAMP = PointLight("lamp", (0.3, 0.4, 4.0))
_SUN = DirectionalLight("sun", (0.25, 0.5, -1.0))


def _points(seed: int, count: int = 200) -> np.ndarray:
    return np.random.default_rng([100, seed]).uniform((-4, -4, -2), (4, 4, 3), (count, 3))


def _check(tracer: Any, points: np.ndarray) -> float:
    """Against the oracle on the world as the scene tells it, and on poses applied here."""
    vertices: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    for name in tracer.scene.names:
        mesh, count = tracer.scene[name], sum(len(v) for v in vertices)
        r = mesh.pose
        x, y, z = mesh.vertices.T
        world = np.stack([((r[k, 0] * x + r[k, 1] * y) + r[k, 2] * z) + r[k, 3] for k in range(3)], axis=-1)
        np.testing.assert_array_equal(mesh.world_vertices(), world)
        vertices.append(world)
        triangles.append(mesh.triangles + count)
    for light in (_LAMP, _SUN):
        answer = oracle.occluded(points, light, np.concatenate(vertices), np.concatenate(triangles), 0.01)
        np.testing.assert_array_equal(tracer.occluded(points, light, 0.01), answer.hidden)
    return float(answer.hidden.mean())


def test_twenty_frames_of_everything(tracer: Any) -> None:
    """Twenty frames: a body moves every frame, a cloth deforms, a third mesh changes its topology, a fourth comes
    and goes."""
    rng = np.random.default_rng(101)
    grid = np.stack(np.meshgrid(np.linspace(-2, 2, 9), np.linspace(-2, 2, 9)), axis=-1).reshape(-1, 2)
    cells = (np.arange(8)[:, None] * 9 + np.arange(8)).reshape(-1)
    cloth = np.concatenate([np.stack([cells, cells + 1, cells + 10], 1), np.stack([cells, cells + 10, cells + 9], 1)])
    tracer.scene.put("ground", *geometry.square(2, -1.5, 6.0))
    tracer.scene.put("body", *geometry.icosphere(1, 0.7))
    tracer.scene.put("cloth", np.column_stack([grid, np.zeros(81)]), cloth)
    shadows = []
    for frame in range(20):
        tracer.scene.move(
            "body", geometry.pose_of(geometry.rotation(rng), (3.0 * np.cos(frame), 2.0 * np.sin(frame), 1.0))
        )
        tracer.scene.deform(
            "cloth", np.column_stack([grid, 0.4 * np.sin(grid[:, 0] * 2.0 + frame) + rng.normal(size=81) * 0.05])
        )
        if frame % 3 == 1:
            tracer.scene.put("rubble", *geometry.soup(rng, 20 + 7 * (frame % 4), 0.4, 2.0))
        if frame % 4 == 2:
            tracer.scene.put("guest", *geometry.box((-0.3, -0.3, 2.0), (0.6, 0.5, 2.5)))
        elif frame % 4 == 0 and frame:
            tracer.scene.remove("guest")
        if frame == 12:
            tracer.scene.remove("ground")
        shadows.append(_check(tracer, _points(frame)))
    assert len(set(shadows)) > 10, "the shadows hardly change: nothing moves"


def test_far_flight_and_back(tracer: Any) -> None:
    """A refitted tree must survive its boxes being stretched over kilometres and folded back."""
    vertices, triangles = geometry.soup(np.random.default_rng(102), 120, 0.5, 2.0)
    tracer.scene.put("swarm", vertices, triangles)
    rng = np.random.default_rng(103)
    for spread in (1.0, 10.0, 1e4, 1e7, 1.0, 0.01, 1.0):
        moved = vertices + np.repeat(rng.normal(size=(120, 3)) * (spread - 1.0), 3, axis=0)
        tracer.scene.deform("swarm", moved)
        _check(tracer, np.concatenate([_points(1, 100), moved[::6] * [1, 1, 0.5]]))


def test_move_equals_putting_transformed_vertices(tracer: Any) -> None:
    rng = np.random.default_rng(104)
    vertices, triangles = geometry.join([geometry.icosphere(2, 0.8), geometry.slivers(rng, 60)])
    points = _points(2, 150)
    for _ in range(5):
        pose = geometry.pose_of(geometry.rotation(rng), rng.normal(size=3))
        tracer.scene.put("mesh", vertices, triangles)
        tracer.scene.move("mesh", pose)
        world = tracer.scene["mesh"].world_vertices()
        on_vertices = np.concatenate([points, _LAMP.position + 1.5 * (world[::4] - _LAMP.position)])
        moved = [tracer.occluded(on_vertices, light) for light in (_LAMP, _SUN)]
        tracer.scene.put("mesh", world, triangles)
        for light, want in zip((_LAMP, _SUN), moved, strict=True):
            np.testing.assert_array_equal(tracer.occluded(on_vertices, light), want)
        tracer.scene.put("mesh", vertices, triangles, pose=pose)
        np.testing.assert_array_equal(tracer.occluded(on_vertices, _LAMP), moved[0])


@pytest.mark.parametrize("refused", ["pose", "vertices", "unknown"])
def test_refused_changes_do_not_reach_the_device(tracer: Any, refused: str) -> None:
    vertices, triangles = geometry.icosphere(1, 1.0)
    tracer.scene.put("mesh", vertices, triangles)
    points = _points(3)
    before = tracer.occluded(points, _LAMP)
    with pytest.raises(ValueError):
        if refused == "pose":
            tracer.scene.move("mesh", np.diag([1.0, 1.0, 1.1, 1.0]))
        elif refused == "vertices":
            tracer.scene.deform("mesh", vertices * np.nan)
        else:
            tracer.scene.deform("other", vertices)
    np.testing.assert_array_equal(tracer.occluded(points, _LAMP), before)


def test_the_callers_arrays_are_free_after_put(tracer: Any) -> None:
    vertices, triangles = geometry.icosphere(1, 1.0)
    tracer.scene.put("mesh", vertices, triangles)
    before = tracer.occluded(_points(4), _LAMP)
    vertices[:] = 0.0
    triangles[:] = 0
    np.testing.assert_array_equal(tracer.occluded(_points(4), _LAMP), before)
    tracer.scene.put("other", *geometry.square(2, -1.9, 0.1))
    tracer.scene.remove("other")
    np.testing.assert_array_equal(tracer.occluded(_points(4), _LAMP), before)


def test_meshes_of_equal_size_swap_places(tracer: Any) -> None:
    """Same counts, same triangles, other names and order: what lies in the buffers must follow."""
    a, b = geometry.icosphere(1, 0.9, (1.5, 0, 0)), geometry.icosphere(1, 0.9, (-1.5, 0, 0))
    for first, second in ((a, b), (b, a), (a, a)):
        tracer.scene.clear()
        tracer.scene.put("first", *first)
        tracer.scene.put("second", *second)
        _check(tracer, _points(5))
        tracer.scene.remove("first")
        _check(tracer, _points(5))
        tracer.scene.put("first", *b)
        _check(tracer, _points(5))
        tracer.scene.put("second", *b, pose=geometry.pose_of(np.eye(3), (0, 0, 1.0)))
        _check(tracer, _points(5))


def test_deforming_to_nothing_and_back(tracer: Any) -> None:
    vertices, triangles = geometry.icosphere(2, 1.0)
    tracer.scene.put("mesh", vertices, triangles)
    before = tracer.occluded(_points(6), _LAMP)
    tracer.scene.deform("mesh", vertices * 0.0)
    assert not tracer.occluded(_points(6), _LAMP).any()
    tracer.scene.deform("mesh", np.full_like(vertices, np.nan), nonfinite="skip")
    assert not tracer.occluded(_points(6), _LAMP).any()
    tracer.scene.deform("mesh", vertices)
    np.testing.assert_array_equal(tracer.occluded(_points(6), _LAMP), before)
    assert before.any()


def test_lights_and_camera_move_over_a_scene_at_rest(tracer: Any) -> None:
    """What is kept for a light at rest must be made again when it moves, also by one ulp, also when only its kind
    changes."""
    vertices, triangles = geometry.join([geometry.icosphere(2, 1.0), geometry.square(2, -1.5, 6.0)])
    tracer.scene.put("mesh", vertices, triangles)
    rng = np.random.default_rng(105)
    position = np.array([0.0, 0.0, 4.0])
    edge = np.array([(0.0, 0.0, -1.4), (1.0, 1.0, -1.4)])
    for k in range(12):
        light: Any = PointLight("lamp", position)
        if k % 3 == 2:
            light = DirectionalLight("lamp", -position)
        points = np.concatenate([edge, _points(k, 60) + 1e3 * (k % 2)])
        answer = oracle.occluded(points, light, vertices, triangles, 0.01)
        np.testing.assert_array_equal(tracer.occluded(points, light, 0.01), answer.hidden)
        position = np.nextafter(position, 9.0) if k % 2 else position + rng.normal(size=3)


def test_image_size_changes_between_frames(tracer: Any) -> None:
    tracer.scene.put("sphere", *geometry.icosphere(2, 0.5, (0.0, 0.0, 1.5)))
    rng = np.random.default_rng(106)
    for height, width in ((12, 16), (30, 40), (1, 1), (40, 30), (12, 16)):
        camera = Camera(width, height, 0.8 * width + 1, 0.8 * width + 1, (width - 1) / 2, (height - 1) / 2)
        depth = rng.uniform(0.3, 4.0, (height, width)).astype(np.float32)
        lamp = PointLight("lamp", (1.0, -1.0, 0.5))
        state = tracer.trace(depth, camera, [lamp], 0.0).state("lamp")
        expected = oracle.occluded(camera.unproject(depth), lamp, *geometry.icosphere(2, 0.5, (0.0, 0.0, 1.5)))
        np.testing.assert_array_equal(state.reshape(-1) == 1, expected.hidden)
