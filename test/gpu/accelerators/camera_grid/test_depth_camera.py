# SPDX-License-Identifier: Apache-2.0
"""``DepthCamera`` and ``render_depth``: what they upload, keep and refuse, and that a light at the eye agrees."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest
from depth_views import BOUNDS, VIEWS, generator, scene_of

from shadow_tracer import (
    Bias,
    Bounds,
    BoundsError,
    Camera,
    DepthCamera,
    PointLight,
    Scene,
    ShadowTracer,
    State,
    render_depth,
)


def test_only_changes_are_uploaded(any_device, monkeypatch):
    from shadow_tracer.gpu.device.transfers import Uploads
    from shadow_tracer.gpu.occluders.world import SceneBuffers

    uploaded: list[int] = []
    placed: list[int] = []
    original, place = Uploads.__call__, SceneBuffers._place

    def count(uploads: Uploads, to: Any, what: np.ndarray, offset: int = 0) -> None:
        if to.ptr in scene_arrays:
            uploaded.append(len(what))
        original(uploads, to, what, offset)

    mesh, camera = VIEWS["street"]
    ball = geometry.icosphere(2, 0.4)
    made = DepthCamera(any_device, Bounds(max_triangles=20_000, max_rays=10_000, grid_entries=50_000))
    # Not the columns and rows of the image.
    scene_on_device = probe.depth_camera_scene(made)
    scene_arrays = [array.ptr for array in (scene_on_device.local, scene_on_device.triangles)]
    monkeypatch.setattr(Uploads, "__call__", count)
    monkeypatch.setattr(
        SceneBuffers,
        "_place",
        lambda self, mesh, *first: (placed.append(len(mesh.vertices)), place(self, mesh, *first)),
    )
    # The CPU reads vertices where the mesh has them.
    vertices = [] if probe.wide(any_device) else [len(mesh[0]), len(ball[0])]
    scene = scene_of(mesh)
    scene.put("ball", *ball, pose=geometry.pose_of(np.eye(3), (4, 1, 1.6)))
    first = made.render(scene, camera)
    assert sorted(uploaded) == sorted([*vertices, len(mesh[1]), len(ball[1])])
    assert placed == [len(mesh[0]), len(ball[0])]
    for step in range(3):
        uploaded.clear()
        placed.clear()
        scene.move("ball", geometry.pose_of(np.eye(3), (4, 0.5 - 0.5 * step, 1.7)))
        depth, triangle = made.render(scene, camera)
        assert uploaded == [] and placed == [len(ball[0])]
        fresh = DepthCamera(any_device, made.bounds).render(scene, camera)
        assert fresh[0].tobytes() == depth.tobytes() and np.array_equal(fresh[1], triangle)
        assert (depth != first[0]).any()
    uploaded.clear()
    placed.clear()
    scene.deform("ball", 1.5 * ball[0])
    made.render(scene, camera)
    assert uploaded == vertices[1:] and placed == [len(ball[0])]


@pytest.mark.parametrize("name", ["street", "museum, inside", "ground"])
def test_what_is_seen_is_lit_from_the_eye(any_device, depth_camera, name):
    """A light at the optical centre reaches exactly what the camera sees: float32 rounding of the depth is all that a
    bias has to cover."""
    mesh, camera = VIEWS[name]
    scene = scene_of(mesh)
    depth, triangle = depth_camera.render(scene, camera)
    tracer = ShadowTracer(device=any_device, bounds=Bounds(max_triangles=4000, max_rays=10_000))
    tracer.scene.put("all", *mesh)
    light = PointLight("eye", camera.position)
    slack = 4e-7 * float(np.nanmax(depth))
    states = tracer.trace(depth, camera, [light], Bias(constant=slack)).state("eye")
    assert np.array_equal(states == State.LIT, triangle >= 0)
    assert np.array_equal(states == State.INVALID, triangle < 0)
    # And nothing nearer is missing: a little farther on, all but silhouettes is in the shadow of what is seen.
    hidden = tracer.trace(depth * np.float32(1.001), camera, [light], Bias(constant=0.0)).state("eye")
    assert (hidden[triangle >= 0] == State.SHADOWED).all()


def test_errors(depth_camera, any_device):
    mesh, camera = VIEWS["street"]
    scene = scene_of(mesh)
    before = depth_camera.render(scene, camera)
    for arguments, message in (
        ((mesh, camera), "^scene: expected a Scene, got tuple"),
        ((scene, np.eye(4)), "^camera: expected a Camera, got ndarray"),
    ):
        with pytest.raises(ValueError, match=message):
            depth_camera.render(*arguments)
        with pytest.raises(ValueError, match=message):
            render_depth(*arguments)
    with pytest.raises(ValueError, match="^device: expected one of .*, got 'tpu'"):
        render_depth(scene, camera, "tpu")
    small = DepthCamera(any_device, Bounds(max_triangles=100, max_rays=100, grid_entries=10))
    with pytest.raises(BoundsError, match=r"^bounds\.max_triangles: .* 100 triangles .* got 2290"):
        small.render(scene, camera)
    few = Scene(BOUNDS)
    few.put("few", np.zeros((301, 3)), [(0, 1, 2)])
    with pytest.raises(BoundsError, match=r"^bounds\.max_triangles: .* 300 vertices .* got 301"):
        small.render(few, camera)
    with pytest.raises(BoundsError, match=r"^bounds\.max_rays: .* 100 pixels .* got 3055"):
        small.render(Scene(), camera)
    after = depth_camera.render(scene, camera)
    assert after[0].tobytes() == before[0].tobytes()


def test_render_depth_grows(monkeypatch, any_device, depth_camera):
    probe.forget_depth_cameras(monkeypatch)
    mesh, camera = VIEWS["street"]
    scene = scene_of(mesh)
    expected = depth_camera.render(scene, camera)
    depth, triangle = render_depth(scene, camera, any_device)
    assert depth.tobytes() == expected[0].tobytes() and np.array_equal(triangle, expected[1])
    first = probe.kept_depth_camera(any_device)
    render_depth(scene_of(VIEWS["around"][0]), VIEWS["around"][1], any_device)
    assert probe.kept_depth_camera(any_device) is first
    crowd = geometry.soup(generator(), 20_000, 0.1, 5.0)
    render_depth(scene_of(crowd), camera, any_device)
    second = probe.kept_depth_camera(any_device)
    assert second.bounds.max_triangles == 32768 and second.bounds.max_rays == 65536
    large = Camera(300, 230, 200.0, 200.0, 200.0, 100.0, camera.camera_to_world)
    depth, _ = render_depth(scene, large, any_device)
    assert probe.kept_depth_camera(any_device).bounds.max_triangles == 32768
    assert probe.kept_depth_camera(any_device).bounds.max_rays == 131072
    assert depth.tobytes() == depth_camera.render(scene, large)[0].tobytes()
    again = render_depth(scene, camera)  # on the best device, another one perhaps
    assert again[0].tobytes() == expected[0].tobytes()


def test_cache_of_the_camera_sees_changes(depth_camera):
    """Two cameras in turn, and a camera whose every number changes."""
    mesh, camera = VIEWS["street"]
    scene = scene_of(mesh)
    first = depth_camera.render(scene, camera)[0]
    other = Camera(30, 20, 25.0, 25.0, 15.0, 10.0, camera.camera_to_world)
    assert depth_camera.render(scene, other)[0].shape == (20, 30)
    assert depth_camera.render(scene, camera)[0].tobytes() == first.tobytes()
