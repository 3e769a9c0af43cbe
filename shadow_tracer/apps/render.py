# SPDX-License-Identifier: Apache-2.0
"""A simulated colour and depth camera: one ray per pixel through a triangle mesh, by Embree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shadow_tracer.scene.camera import Camera

SKY_LOW, SKY_HIGH = (0.93, 0.95, 0.97), (0.70, 0.82, 0.94)


class RayCaster:
    """Casts rays into one mesh.

    Args:
        vertices: (V, 3) metres, world frame.
        triangles: (T, 3) indices.

    Raises:
        RuntimeError: if embreex is not installed.
    """

    def __init__(self, vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise RuntimeError("the simulated camera needs embreex: pip install 'shadow_tracer[demo]'") from error
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(triangles, np.int32))

    def image(self, camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Depth and triangle of every pixel.

        Returns:
            depth (H, W) float32 metres along the optical axis, NaN where nothing is hit, and triangle index (H, W)
            int32, -1 there.
        """
        pose = camera.camera_to_world
        # z of each direction is 1 in the optical frame, so the ray parameter is the depth itself
        directions = (camera.pixel_rays().reshape(-1, 3) @ pose[:3, :3].T).astype(np.float32)
        origins = np.tile(pose[:3, 3].astype(np.float32), (len(directions), 1))
        hits = self._scene.run(origins, directions, query="INTERSECT", output=1)
        ids = np.asarray(hits["primID"], dtype=np.int32).reshape(camera.height, camera.width)
        depth = np.asarray(hits["tfar"], dtype=np.float32).reshape(ids.shape).copy()
        depth[ids < 0] = np.nan
        return depth, ids

    def distances(self, starts: NDArray[np.float64], ways: NDArray[np.float64]) -> NDArray[np.float32]:
        """(N,) metres from each start along each unit way to the mesh; very large where nothing is hit.

        Good enough to choose lights by; shadows are the tracer's business.
        """
        hits = self._scene.run(starts.astype(np.float32), ways.astype(np.float32), query="DISTANCE")
        return np.asarray(hits, dtype=np.float32)


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
