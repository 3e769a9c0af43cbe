# SPDX-License-Identifier: Apache-2.0
"""Depth images along a table of rays: against float64 closest hits, against a pinhole's image of the same rays, and in
both forms bit for bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import probe
import pytest
from depth_views import BOUNDS, VIEWS, check, generator, lens, same, scene_of

from shadow_tracer import Bias, Bounds, Camera, DepthCamera, PointLight, ShadowTracer, State, render_depth


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rational", "fisheye", "wild", "narrow"])
@pytest.mark.parametrize("name", ["street", "museum, inside", "around", "ground"])
def test_closest_hit(depth_camera: DepthCamera, plain_forms: list[Any], name: str, kind: str) -> None:
    mesh, camera = VIEWS[name]
    camera, scene = lens(kind, camera), scene_of(mesh)
    depth, triangle = depth_camera.render(scene, camera)
    assert (triangle >= 0).mean() > 0.02
    assert (triangle[~camera.rays.known] == -1).all() and np.isnan(depth[~camera.rays.known]).all()
    assert camera.rays.known.all() == (kind in ("rational", "narrow"))
    same(plain_forms, scene, camera, depth, triangle)
    # The reference has a ray for each pixel; that of one changes nothing for another.
    known = camera.rays.known
    full = replace(camera, rays=np.where(known[..., None], camera.rays.xy, np.float32(0.0)))
    seen = depth_camera.render(scene, full)
    assert seen[0][known].tobytes() == depth[known].tobytes() and np.array_equal(seen[1][known], triangle[known])
    check(full, mesh, *seen)


@pytest.mark.parametrize("name", ["street", "museum, inside", "around", "slivers"])
def test_the_rays_of_a_pinhole_in_any_order(depth_camera: DepthCamera, name: str) -> None:
    """Numbers that float32 holds: the very rays, so the very image, each pixel where its ray has gone."""
    mesh, camera = VIEWS[name]
    scene, optics = scene_of(mesh), (72, 56, 64.0, 64.0, 36.0, 28.5)
    pinhole = Camera(*optics, camera.camera_to_world)
    depth, triangle = depth_camera.render(scene, pinhole)
    assert (triangle >= 0).mean() > 0.02
    rays = pinhole.pixel_rays()[..., :2].reshape(-1, 2)
    for order in (np.arange(len(rays)), generator().permutation(len(rays))):
        table = replace(pinhole, rays=rays[order].reshape(56, 72, 2))
        seen = depth_camera.render(scene, table)
        assert seen[0].tobytes() == depth.reshape(-1)[order].tobytes()
        assert np.array_equal(seen[1].reshape(-1), triangle.reshape(-1)[order])
    again = depth_camera.render(scene, pinhole)
    assert again[0].tobytes() == depth.tobytes() and np.array_equal(again[1], triangle)


@pytest.mark.parametrize("wide", [True, False])
@pytest.mark.parametrize("kind", ["fisheye", "wild"])
def test_few_entries_cost_passes_and_nothing_else(
    any_device: str, depth_camera: DepthCamera, kind: str, wide: bool
) -> None:
    from shadow_tracer.gpu.accelerators.camera_grid.primary import PrimaryRays
    from shadow_tracer.gpu.device.devices import pick_device

    if wide and not probe.wide(any_device):
        pytest.skip("the wide form is the CPU's")
    mesh, camera = VIEWS["street"]
    camera = lens(kind, Camera(24, 18, 20.0, 20.0, 12.0, 9.0, camera.camera_to_world))
    scene = scene_of(mesh)
    depth, triangle = depth_camera.render(scene, camera)
    total = depth_camera.counters["entries"]
    assert total > 10
    for capacity in (1, 7, total - 1):
        bounds = Bounds(max_triangles=3000, max_rays=1000, grid_entries=capacity)
        seen = PrimaryRays(pick_device(any_device), bounds, wide=wide).render(scene, camera)
        assert seen.counters["passes"] == -(-total // capacity) and seen.counters["entries"] == total
        assert seen.depth.tobytes() == depth.tobytes() and np.array_equal(seen.triangle, triangle.ravel())


@pytest.mark.parametrize("kind", ["rational", "fisheye"])
def test_what_is_seen_is_lit_from_the_eye(any_device: str, kind: str) -> None:
    mesh, camera = VIEWS["museum, inside"]
    camera = lens(kind, camera)
    depth, triangle = render_depth(scene_of(mesh), camera, any_device)
    tracer = ShadowTracer(device=any_device, bounds=Bounds(max_triangles=4000, max_rays=10_000))
    tracer.scene.put("all", *mesh)
    away = float(np.nanmax(np.linalg.norm(camera.unproject(depth) - camera.position, axis=2)))
    state = tracer.trace(depth, camera, [PointLight("eye", camera.position)], Bias(constant=1e-6 * away)).state("eye")
    assert np.array_equal(state == State.LIT, triangle >= 0) and np.array_equal(state == State.INVALID, triangle < 0)


@pytest.mark.parametrize(
    "rays",
    [
        np.full((3, 5, 2), np.nan),
        np.full((3, 5, 2), 3e38),
        np.full((3, 5, 2), 7.0),
        np.zeros((3, 5, 2)),
        np.where(np.arange(5)[:, None] == 2, 0.0, (3e38, -3e38)) * np.ones((3, 1, 1)),
    ],
)
def test_tables_at_the_end_of_numbers(depth_camera: DepthCamera, plain_forms: list[Any], rays: np.ndarray) -> None:
    """A wall before the camera: hit along the axis, and by all rays that do not miss it."""
    wall = np.array([(-9.0, -9.0, 2.0), (9.0, -9.0, 2.0), (-9.0, 9.0, 2.0), (9.0, 9.0, 2.0)])
    scene = scene_of((wall, np.array([(0, 1, 2), (1, 3, 2)])))
    camera = Camera(5, 3, 4.0, 4.0, 2.0, 1.0, rays=rays)
    depth, triangle = depth_camera.render(scene, camera)
    hit = (np.abs(rays) <= 4.5).all(axis=2)
    np.testing.assert_array_equal(depth, np.where(hit, np.float32(2.0), np.float32(np.nan)))
    np.testing.assert_array_equal(triangle >= 0, hit)
    same(plain_forms, scene, camera, depth, triangle)


def test_another_pose_uploads_no_rays(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from shadow_tracer.gpu.device.transfers import Uploads

    mesh, camera = VIEWS["street"]
    camera, scene = lens("rational", camera), scene_of(mesh)
    made = DepthCamera(any_device, BOUNDS)
    before = made.device_bytes
    made.render(scene, camera)
    uploaded: list[int] = []
    original = Uploads.__call__

    def count(uploads: Uploads, to: Any, what: np.ndarray, offset: int = 0) -> None:
        uploaded.append(len(what))
        original(uploads, to, what, offset)

    monkeypatch.setattr(Uploads, "__call__", count)
    for step in range(3):
        pose = np.array(camera.camera_to_world)
        pose[0, 3] += 0.1 * step
        moved = replace(camera, camera_to_world=pose)
        seen = made.render(scene, moved)
        assert uploaded == []
        assert seen[0].tobytes() == DepthCamera(any_device, BOUNDS).render(scene, moved)[0].tobytes()
        uploaded.clear()
    made.render(scene, lens("fisheye", camera))
    assert camera.width * camera.height in uploaded
    assert made.device_bytes == before
