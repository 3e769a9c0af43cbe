# SPDX-License-Identifier: Apache-2.0
"""Depth images of meshes in plain numpy: a depth camera for tests.

The closest triangle of every pixel's ray in float64, rounded to float32. No test hangs on its last bits: whatever it
says *is* the depth image, and the samples are what the package unprojects from it.
"""

from __future__ import annotations

import numpy as np
import oracle
from culling import candidate_pairs

from shadow_tracer import Camera

_PAIRS_AT_ONCE = 400_000


def render(camera: Camera, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(H, W) float32 depth along the optical axis, NaN where the ray meets nothing."""
    corners = oracle.corners_of(vertices, triangles)
    directions = (camera.pixel_rays() @ camera.camera_to_world[:3, :3].T).reshape(-1, 3)
    reach = 2.0 * np.linalg.norm(corners - camera.position, axis=2).max()
    ends = camera.position + reach * directions  # z of a direction is 1: beyond everything
    depth = np.full(len(directions), np.inf)
    for rays, hit in candidate_pairs(ends, camera.position, 1.0, corners, _PAIRS_AT_ONCE):
        np.minimum.at(depth, rays, _depths(camera.position, directions[rays], corners[hit]))
    depth[~np.isfinite(depth)] = np.nan
    return depth.astype(np.float32).reshape(camera.height, camera.width)


def _depths(eye: np.ndarray, ways: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Ray parameter of the hit of pair k, infinite where there is none (Moeller and Trumbore)."""
    a, ab, ac = corners[:, 0] - eye, corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(ways, ac)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (ab * across).sum(axis=1)
        u = -(a * across).sum(axis=1) * scale
        other = np.cross(-a, ab)
        v = (ways * other).sum(axis=1) * scale
        t = (ac * other).sum(axis=1) * scale
        hit = np.isfinite(t) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)
    return np.where(hit, t, np.inf)


def smaller(depth: np.ndarray, camera: Camera, step: int) -> tuple[np.ndarray, Camera]:
    """Every ``step``-th pixel and the camera that sees exactly those samples; ``step`` a power of two."""
    assert step & (step - 1) == 0, "only a power of two divides the intrinsics exactly"
    image = np.ascontiguousarray(depth[::step, ::step])
    fx, fy, cx, cy = (value / step for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    return image, Camera(image.shape[1], image.shape[0], fx, fy, cx, cy, camera.camera_to_world)
