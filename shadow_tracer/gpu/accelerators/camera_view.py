# SPDX-License-Identifier: Apache-2.0
"""The rays of a camera's pixels, and the triangles of a scene as it sees them, on the device."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from shadow_tracer.gpu.device.transfers import HostValues
from shadow_tracer.gpu.exact.camera_records import (
    PLANE_COLUMNS,
    CameraRays,
    CameraTriangles,
    make_camera_frame,
    pack_triangles,
)
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.records import BLOCK
from shadow_tracer.gpu.occluders.seen import prepare
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera, RayTable
from shadow_tracer.scene.checks import FloatArray


class CameraView:
    """One camera at a time, of a scene.

    Args:
        scene: the world; others may use it too.
        bounds: capacities.
        beyond: how many columns and rows behind the last pixel of a pinhole have rays as well.

    Attributes:
        records: of the triangles.
        rays: of the camera that was looked from last.
        frame: of a light at its optical centre.
    """

    def __init__(self, scene: SceneBuffers, bounds: Bounds, beyond: int = 0) -> None:
        device, pixels, triangles = scene.device, bounds.max_rays, bounds.max_triangles
        self._scene, self._beyond = scene, beyond
        self._frame = HostValues(LightFrame, 1, device)
        self.records = wp.empty((triangles, 4), dtype=wp.vec4, device=device)
        self._planes = wp.empty((triangles, PLANE_COLUMNS), dtype=wp.float64, device=device)
        self._silent = wp.zeros(-(-triangles // BLOCK), dtype=wp.vec2i, device=device)
        self._columns, self._rows = (wp.empty(pixels + beyond, dtype=wp.float64, device=device) for _ in range(2))
        self._table = wp.empty(pixels, dtype=wp.vec2, device=device)
        self._table_has: RayTable | None = None
        self._made_for: Camera | None = None
        self.rays = CameraRays()

    @property
    def frame(self) -> Any:
        """One LightFrame on the device."""
        return self._frame.array

    def look_from(self, camera: Camera) -> None:
        """Take another camera; its image fits the bounds."""
        if camera is self._made_for:
            return
        self._made_for = None
        self._frame.write([make_camera_frame(camera)])
        rays, rotation = CameraRays(), camera.camera_to_world[:3, :3]
        rays.width, rays.height, rays.tabled = camera.width, camera.height, camera.rays is not None
        rays.position = wp.vec3d(*camera.position)
        rays.right, rays.down, rays.forward = (wp.vec3d(*rotation[:, k]) for k in range(3))
        rays.depth_row = wp.vec3d(*np.linalg.inv(rotation)[2])
        rays.columns, rays.rows, rays.table = self._columns, self._rows, self._table
        if camera.rays is None:
            for axis, values in zip((self._columns, self._rows), pinhole_axes(camera, self._beyond), strict=True):
                self._scene.upload(axis, values)
        elif self._table_has != camera.rays:  # which another pose leaves as they are
            self._table_has = None
            self._scene.upload(self._table, camera.rays.xy.reshape(-1, 2))
            self._table_has = camera.rays
        self.rays, self._made_for = rays, camera

    def set_up(self) -> None:
        """Make what the rays ask of the triangles of the scene, of which there are some."""
        scene = self._scene
        self._silent.zero_()
        prepare(self.frame, scene, self.records, False, self._silent)
        inputs = [self.rays, scene.vertices, scene.triangles, self.records, self._planes]
        wp.launch(pack_triangles, dim=scene.triangle_count, inputs=inputs, device=scene.device)

    def unseen(self) -> int:
        """Number of triangles that it cannot see."""
        blocks = -(-self._scene.triangle_count // BLOCK)
        return int(self._silent.numpy()[:blocks, 0].sum())

    def seen(self) -> CameraTriangles:
        """The triangles as they are after ``set_up``."""
        seen = CameraTriangles()
        seen.vertices, seen.triangles = self._scene.vertices, self._scene.triangles
        seen.records, seen.planes = self.records, self._planes
        return seen

    def nbytes(self) -> int:
        """Bytes reserved on the device."""
        return int(sum(array.capacity for array in vars(self).values() if isinstance(array, wp.array)))


def pinhole_axes(camera: Camera, beyond: int) -> tuple[FloatArray, FloatArray]:
    """x of each column and y of each row of a pinhole, and of as many ``beyond`` the last."""
    x = (np.arange(camera.width + beyond, dtype=np.float64) - camera.cx) / camera.fx
    y = (np.arange(camera.height + beyond, dtype=np.float64) - camera.cy) / camera.fy
    return x, y
