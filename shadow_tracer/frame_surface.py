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
    a, b, c = (mesh.vertices[mesh.triangles[triangles, k]] for k in range(3))
    with np.errstate(all="ignore"):
        u, v = b - a, c - a
        largest = np.maximum(np.abs(u), np.abs(v)).max(axis=1, keepdims=True)
        across = np.cross(u / largest, v / largest)
        across /= np.sqrt((across * across).sum(axis=1, keepdims=True))
    across[~np.isfinite(across).all(axis=1)] = np.nan
    turned: FloatArray = across @ mesh.pose[:3, :3].T
    return turned


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
        self._device = device

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
        normals = np.full((*self._image.shape, 3), np.nan)
        source = np.full(self._image.shape, NormalSource.NONE, np.uint8)
        depth, triangle = self._look()
        with np.errstate(all="ignore"):
            there = np.abs(self.metres - depth) <= LARGEST_JUMP * depth.astype(np.float64)
        first = 0
        for mesh in self._meshes:
            seen = there & (triangle >= first) & (triangle < first + mesh.triangle_count)
            found = triangle_normals(mesh, triangle[seen] - first)
            way = self.positions[seen] - self._camera.camera_to_world[:3, 3]
            found *= np.where((found * way).sum(axis=1) > 0.0, -1.0, 1.0)[:, None]
            known = ~np.isnan(found[:, 0])
            seen[seen] = known
            normals[seen] = found[known]
            source[seen] = NormalSource.MESH
            first += mesh.triangle_count
        other = (source == NormalSource.NONE) & np.isfinite(self.metres) & (self.metres > 0.0)
        if other.any():
            normals[other] = self.fitted[other]
            source[other & ~np.isnan(normals[..., 0])] = NormalSource.FITTED
        return normals, source

    def _look(self) -> DepthAndTriangle:
        """What the camera sees of the scene as it was."""
        scene = self._scene
        if scene.revision != self._revision:
            scene = self._as_it_was()
        return render_depth(scene, self._camera, self._device)

    def _as_it_was(self) -> Scene:
        count = sum(max(mesh.triangle_count, mesh.vertex_count) for mesh in self._meshes)
        scene = Scene(Bounds(max_triangles=max(1, count)))
        for mesh in self._meshes:
            scene.put(mesh.name, mesh.vertices, mesh.triangles, mesh.pose, nonfinite="skip")
        return scene
