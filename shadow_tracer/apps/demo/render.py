# SPDX-License-Identifier: Apache-2.0
"""A simulated colour and depth camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shadow_tracer.depth_camera import render_depth
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.lights import Light
from shadow_tracer.scene.mesh import Scene
from shadow_tracer.tracer import ShadowTracer

SKY_LOW, SKY_HIGH = (0.93, 0.95, 0.97), (0.70, 0.82, 0.94)


class RayCaster:
    """Looks at one mesh: what a camera sees of it, and what light reaches.

    Args:
        vertices: (V, 3) metres, world frame.
        triangles: (T, 3) indices.
    """

    def __init__(self, vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> None:
        self._bounds = Bounds(max_triangles=max(1, len(triangles), -(-len(vertices) // 3)), max_rays=1 << 16)
        self._scene = Scene(self._bounds)
        self._scene.put("mesh", vertices, triangles)
        self._tracer: ShadowTracer | None = None

    def image(self, camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Depth and triangle of every pixel.

        Returns:
            depth (H, W) float32 metres along the optical axis, NaN where nothing is hit, and triangle index (H, W)
            int32, -1 there.
        """
        return render_depth(self._scene, camera, "cpu")

    def hidden(self, points: NDArray[np.float64], light: Light, bias: float) -> NDArray[np.bool_]:
        """(N,) whether the mesh is between the (N, 3) points and the light, `bias` metres off the points."""
        if self._tracer is None:
            # Made for many lights and few points: a tree of the mesh, which stays.
            self._tracer = ShadowTracer("mesh_bvh", device="cpu", bounds=self._bounds)
            self._tracer.scene = self._scene
        return self._tracer.occluded(points, light, bias)


def paint(
    depth: NDArray[np.float32], ids: NDArray[np.int32], colours: NDArray[np.float32], still: int, camera: Camera
) -> NDArray[np.uint8]:
    """Albedo picture (H, W, 3) sRGB: triangle colours, faint grain on what stands still, sky where nothing was hit.

    Args:
        depth: (H, W) float32 metres, NaN where `ids` is -1.
        ids: (H, W) triangle of each pixel.
        colours: (T, 3) float32 albedo, 0..1.
        still: the first so many triangles get grain (it would swim on moving ones).
    """
    picture = colours[ids]
    grained = (ids >= 0) & (ids < still)
    points = camera.unproject(np.where(grained, depth, 1.0))[grained]
    picture[grained] *= _grain(points)[:, None]
    sky = np.linspace(0, 1, camera.height)[:, None, None] * (np.subtract(SKY_LOW, SKY_HIGH)) + np.asarray(SKY_HIGH)
    picture = np.where((ids < 0)[..., None], np.broadcast_to(sky, picture.shape), picture)
    return np.asarray(np.clip(picture, 0, 1) * 255 + 0.5, dtype=np.uint8)


def _noise(size: int, seed: int) -> NDArray[np.float32]:
    """(size, size) smooth noise that repeats, in -1..1."""
    rng = np.random.default_rng(seed)
    spectrum = np.fft.fft2(rng.standard_normal((size, size)))
    f = np.fft.fftfreq(size)
    keep = 1 / (0.01 + np.hypot(f[:, None], f[None, :])) ** 1.5
    field = np.fft.ifft2(spectrum * keep).real
    return np.asarray(field / np.abs(field).max(), dtype=np.float32)


_TEXTURE = _noise(256, 3)


def _grain(points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Factor around 1 for each (N, 3) point: mottled in the plane and down the walls."""
    i = (points[:, 0] * 45 + points[:, 2] * 22).astype(np.int64) % 256
    j = (points[:, 1] * 45 + points[:, 2] * 45).astype(np.int64) % 256
    return np.asarray(1 + 0.10 * _TEXTURE[i, j], dtype=np.float32)
