# SPDX-License-Identifier: Apache-2.0
"""The device's copy of the scene: what changed is noticed, whatever it is."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, Camera, PointLight, Scene, ShadowTracer, State
from shadow_tracer.gpu.device.devices import pick_device
from shadow_tracer.gpu.occluders.world import SceneBuffers

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
    assert _changed(buffers, scene) == (True, True) and _changed(buffers, scene) == (False, False)
    scene.remove("points")
    assert _changed(buffers, scene) == (True, True) and buffers.vertex_count == 1 + len(meshes["ball"][0])
    assert _changed(buffers, scene) == (False, False)
    scene.clear()
    assert _changed(buffers, scene) == (True, True) and buffers.vertex_count == buffers.triangle_count == 0


def _changed(buffers: SceneBuffers, scene: Scene) -> tuple[bool, bool]:
    """Whether triangles, and whether anything, is of another revision after the scene has been copied."""
    before = buffers.revision
    buffers.sync(scene)
    return buffers.revision.topology != before.topology, buffers.revision.positions != before.positions


def test_revisions_tell_positions_from_triangles(any_device: str) -> None:
    buffers, scene = SceneBuffers(_BOUNDS, pick_device(any_device)), Scene(_BOUNDS)
    vertices, triangles = geometry.icosphere(1, 0.7)
    turned = np.eye(4)
    turned[:3, 3] = 0.1
    steps = [
        (lambda: scene.put("ball", vertices, triangles), (True, True)),
        (lambda: scene.put("ball", vertices + 0.1, triangles), (False, True)),
        (lambda: scene.move("ball", turned), (False, True)),
        (lambda: scene.move("ball", turned), (False, False)),
        (lambda: scene.deform("ball", vertices), (False, True)),
        (lambda: scene.put("ball", vertices, triangles[::-1]), (True, True)),
        (lambda: scene.put("other", vertices, triangles), (True, True)),
        (lambda: scene.remove("ball"), (True, True)),
    ]
    for number, (step, expected) in enumerate(steps):
        step()
        assert _changed(buffers, scene) == expected, number


def test_a_pipeline_that_missed_revisions_follows_them_all(any_device: str) -> None:
    """Two changes of positions, or one of triangles and one of positions, between two frames of the same pipeline."""
    camera, depth = Camera(48, 40, 48.0, 48.0, 23.5, 19.5), np.full((40, 48), 5.0, np.float32)
    lamp = [PointLight("lamp", (0.5, 0.1, 0.0))]
    vertices, triangles = geometry.icosphere(2, 0.7, (0.0, 0.0, 2.5))
    tracer = ShadowTracer("mesh_bvh", device=any_device, bounds=_BOUNDS)
    oracle = ShadowTracer("brute_force", device=any_device, bounds=_BOUNDS)
    tracer.prepare_verify("light_grid")
    for each in (tracer, oracle):
        each.scene.put("ball", vertices, triangles)
    for step in range(6):
        for each in (tracer, oracle):
            each.scene.deform("ball", vertices + 0.05 * step)
            if step % 2:
                each.scene.put("ball", vertices + 0.04 * step, triangles[: len(triangles) - step])
        frame = tracer.trace(depth, camera, lamp)
        if step % 3 == 0:
            assert tracer.verify(depth, camera, lamp) == 0  # the second pipeline follows now and then
        assert frame.differing(oracle.trace(depth, camera, lamp)) == 0


@probe.in_both_forms
@pytest.mark.parametrize("names", ["light_grid/packed", "cone_hierarchy/linear"])
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
