# SPDX-License-Identifier: Apache-2.0
"""The device's copy of the scene: what changed is noticed, whatever it is."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import pytest

from shadow_tracer import Bounds, Camera, PointLight, Scene, ShadowTracer, State
from shadow_tracer.gpu.device.devices import pick_device
from shadow_tracer.gpu.occluders.world import Change, SceneBuffers

_BOUNDS = Bounds(max_triangles=2000, max_rays=4096, max_lights=2, queue_capacity=4096, grid_entries=8192)
_POINTS = np.random.default_rng(9).uniform(-9.0, 9.0, (40, 3))
_NONE = np.zeros((0, 3), int)


@pytest.mark.parametrize("where", ["first", "last"])
def test_vertices_without_triangles_are_missed(where: str, any_device: str) -> None:
    """All vertices of a light lie behind each other: one mesh less moves those of the next light."""
    buffers, scene = SceneBuffers(_BOUNDS, pick_device(any_device)), Scene(_BOUNDS)
    meshes: dict[str, Any] = {"ball": geometry.icosphere(1, 0.7), "points": (_POINTS, _NONE)}
    for name in meshes if where == "last" else reversed(meshes):
        scene.put(name, *meshes[name])
    assert buffers.sync(scene) == Change.TOPOLOGY and buffers.sync(scene) == Change.NOTHING
    version = buffers.version
    scene.remove("points")
    assert buffers.sync(scene) == Change.TOPOLOGY
    assert buffers.version == version + 1 and buffers.vertex_count == len(meshes["ball"][0])
    assert buffers.sync(scene) == Change.NOTHING
    scene.clear()
    assert buffers.sync(scene) == Change.TOPOLOGY and buffers.vertex_count == buffers.triangle_count == 0


@pytest.mark.parametrize("names", ["light_grid/packed", "light_grid/packed_scalar", "cone_hierarchy/linear"])
def test_masks_are_right_after_vertices_without_triangles_are_gone(names: str, any_device: str) -> None:
    camera, depth = Camera(48, 40, 48.0, 48.0, 23.5, 19.5), np.full((40, 48), 5.0, np.float32)
    lights = [PointLight("left", (-0.5, 0.0, 0.0)), PointLight("right", (0.5, 0.1, 0.0))]
    tracers = [ShadowTracer(*names.split("/"), device=any_device, bounds=_BOUNDS) for _ in range(2)]
    for tracer in tracers:
        tracer.scene.put("ball", *geometry.icosphere(2, 0.7, (0.0, 0.0, 2.5)))
    tracers[0].scene.put("points", _POINTS, _NONE)
    tracers[0].trace(depth, camera, lights)
    tracers[0].scene.remove("points")
    found, expected = (tracer.trace(depth, camera, lights) for tracer in tracers)
    assert (expected.state("right") == State.SHADOWED).any()
    assert found.differing(expected) == 0
    assert tracers[0].trace(depth, camera, lights).differing(expected) == 0
