# SPDX-License-Identifier: Apache-2.0
"""The surface that a depth image shows: where it is, and its normals."""

from __future__ import annotations

from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.depth_camera import DepthAndTriangle, render_depth
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.mesh import Mesh, Scene
from shadow_tracer.scene.normals import LARGEST_JUMP, depth_normals


class NormalSource(IntEnum):
    """Where the normal of a pixel is from."""

    NONE = 0
    """There is none: irradiance is unknown where light arrives."""
    MESH = 1
    """The triangle that the pixel's ray meets first, exactly, at the depth that was measured."""
    FITTED = 2
    """A plane through neighbouring pixels."""


def triangle_normals(mesh: Mesh, triangles: Any) -> FloatArray:
    """(N, 3) unit normals in the world of some of a mesh's triangles, on the side from which their corners are seen
    counter-clockwise; NaN of those without an area."""
    corners = mesh.triangles[triangles]
    with np.errstate(all="ignore"):
        # A column at a time: numpy is several times faster along a long axis than along one of length three.
        columns = [[mesh.vertices[:, axis][corners[:, k]] for k in range(3)] for axis in range(3)]
        u, v = ([column[k] - column[0] for column in columns] for k in (1, 2))
        largest = np.maximum.reduce([np.abs(each) for each in (*u, *v)])
        u, v = ([each / largest for each in way] for way in (u, v))
        across = [u[k - 2] * v[k - 1] - u[k - 1] * v[k - 2] for k in range(3)]
        length = np.sqrt(across[0] * across[0] + across[1] * across[1] + across[2] * across[2])
        length[~(length > 0.0)] = np.nan
        x, y, z = (each / length for each in across)
        turn = mesh.pose
        return np.stack([turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] * z for k in range(3)], axis=-1)


class FrameSurface:
    """Of one depth image, with the scene as it was when this was made; what is asked for is computed then.

    Args:
        image: (H, W) float32 metres or uint16 millimetres; copied.
        camera: its camera.
        scene: the scene, whose meshes may change afterwards.
        device: where the triangles that pixels see are found.
    """

    def __init__(self, image: npt.NDArray[Any], camera: Camera, scene: Scene, device: str) -> None:
        self._image = image.copy()
        self._camera = camera
        self._scene = scene
        self._revision = scene.revision
        self._meshes = [mesh.snapshot() for mesh in scene]
        self.device = device

    @cached_property
    def metres(self) -> FloatArray:
        """(H, W) depth [m]; meaningless where there is none."""
        z = self._image.astype(np.float64)
        return z / 1000.0 if self._image.dtype == np.uint16 else z

    @cached_property
    def positions(self) -> FloatArray:
        """(H, W, 3) where pixels are in the world [m], before any bias; meaningless where there is no depth."""
        with np.errstate(all="ignore"):
            return self._camera.unproject(self.metres)

    @cached_property
    def fitted(self) -> FloatArray:
        """(H, W, 3) normals of planes through neighbouring pixels, as :attr:`normals`."""
        return depth_normals(self._image, self._camera)

    @cached_property
    def normals(self) -> tuple[FloatArray, npt.NDArray[np.uint8]]:
        """(H, W, 3) unit normals in the world on the camera's side, NaN where there is none, and (H, W) values of
        :class:`NormalSource`."""
        depth, triangle = self._look()
        with np.errstate(all="ignore"):
            there = np.abs(self.metres - depth) <= LARGEST_JUMP * depth.astype(np.float64)
        normals = self._of_triangles(np.where(there, triangle, -1))
        way = self.positions - self._camera.position
        with np.errstate(invalid="ignore"):
            away = normals[..., 0] * way[..., 0] + normals[..., 1] * way[..., 1] + normals[..., 2] * way[..., 2] > 0.0
        normals *= np.where(away, -1.0, 1.0)[..., None]
        unknown = np.isnan(normals[..., 0])
        source = np.where(unknown, NormalSource.NONE, NormalSource.MESH).astype(np.uint8)
        other = unknown & np.isfinite(self.metres) & (self.metres > 0.0)
        if other.any():
            normals[other] = self.fitted[other]
            source[other & ~np.isnan(normals[..., 0])] = NormalSource.FITTED
        return normals, source

    def _of_triangles(self, numbers: npt.NDArray[np.integer[Any]]) -> FloatArray:
        """(..., 3) normals of triangles of these numbers, NaN for -1. Each triangle's is computed once."""
        counts = [mesh.triangle_count for mesh in self._meshes]
        seen = np.zeros(sum(counts) + 1, np.bool_)
        seen[numbers] = True  # -1 is the last
        seen[-1] = False
        used, first = np.flatnonzero(seen), 0
        found = np.full((len(used) + 1, 3), np.nan)
        for mesh, count in zip(self._meshes, counts, strict=True):
            low, high = np.searchsorted(used, (first, first + count))
            if low < high:
                found[low:high] = triangle_normals(mesh, used[low:high] - first)
            first += count
        place = np.full(len(seen), len(used))
        place[used] = np.arange(len(used))
        return found[place[numbers]]

    def _look(self) -> DepthAndTriangle:
        """What the camera sees of the scene as it was."""
        scene = self._scene
        if scene.revision != self._revision:
            scene = self._as_it_was()
        return render_depth(scene, self._camera, self.device)

    def _as_it_was(self) -> Scene:
        count = sum(max(mesh.triangle_count, mesh.vertex_count) for mesh in self._meshes)
        scene = Scene(Bounds(max_triangles=max(1, count)))
        for mesh in self._meshes:
            scene.put(mesh.name, mesh.vertices, mesh.triangles, mesh.pose, nonfinite="skip")
        return scene
