# SPDX-License-Identifier: Apache-2.0
"""Depth images for tests: what ``render_depth`` sees of a mesh. Its own tests compare it with other arithmetic."""

from __future__ import annotations

import numpy as np

from shadow_tracer import Camera, Scene, render_depth


def render(camera: Camera, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(H, W) float32 depth along the optical axis, NaN where the ray meets nothing."""
    scene = Scene()
    scene.put("mesh", vertices, triangles)
    return render_depth(scene, camera, "cpu")[0]


def smaller(depth: np.ndarray, camera: Camera, step: int) -> tuple[np.ndarray, Camera]:
    """Every ``step``-th pixel and the camera that sees exactly those samples; ``step`` a power of two."""
    assert step & (step - 1) == 0, "only a power of two divides the intrinsics exactly"
    image = np.ascontiguousarray(depth[::step, ::step])
    fx, fy, cx, cy = (value / step for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    return image, Camera(image.shape[1], image.shape[0], fx, fy, cx, cy, camera.camera_to_world)
