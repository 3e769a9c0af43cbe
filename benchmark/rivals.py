# SPDX-License-Identifier: Apache-2.0
"""Embree and wp.Mesh on the shadow rays of a view: structure and query; their rays are made before the clock starts."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from scenes import View

from shadow_tracer import DirectionalLight


@wp.kernel(enable_backward=False)
def any_hit(
    mesh: wp.uint64,
    starts: wp.array(dtype=wp.vec3),
    ways: wp.array(dtype=wp.vec3),
    reach: wp.array(dtype=float),
    out: wp.array(dtype=wp.uint8),
):
    i = wp.tid()
    out[i] = wp.uint8(0)
    if wp.mesh_query_ray_anyhit(mesh, starts[i], ways[i], reach[i]):
        out[i] = wp.uint8(1)


class Rays:
    """The shadow rays of a view.

    Attributes:
        depth: (H, W) float32 metres, NaN where there is nothing.
        valid: (H W,) bool, the pixels with a depth; the other arrays have only these.
        points: (N, 3) float64 samples.
        starts, ways, reach: (N, 3), (N, 3) unit and (N,) float32: start after the bias, direction, length to the light.
    """

    def __init__(self, view: View) -> None:
        self.depth = _depth(view)
        points = view.camera.unproject(self.depth).reshape(-1, 3)
        self.valid = np.isfinite(points).all(axis=1)
        self.points = points[self.valid]
        if isinstance(view.light, DirectionalLight):
            way = np.tile(-view.light.direction / np.linalg.norm(view.light.direction), (len(self.points), 1))
            distance = np.full((len(self.points), 1), 1e30)
        else:
            way = view.light.position - self.points
            distance = np.linalg.norm(way, axis=1, keepdims=True)
            way /= distance
        self.starts = (self.points + view.bias * way).astype(np.float32)
        self.ways = way.astype(np.float32)
        self.reach = (distance[:, 0] - view.bias).astype(np.float32)


def _depth(view: View) -> np.ndarray:
    directions = (view.camera.pixel_rays() @ view.camera.camera_to_world[:3, :3].T).reshape(-1, 3).astype(np.float32)
    starts = np.tile(view.camera.position.astype(np.float32), (len(directions), 1))
    hit = _embree_scene(view, 0).run(starts, directions, output=1)
    depth = hit["tfar"].astype(np.float32)
    depth[hit["primID"] < 0] = np.nan
    depth = depth.reshape(view.camera.height, view.camera.width)
    if view.pixels is not None:
        depth[~view.pixels] = np.nan
    return depth


def _embree_scene(view: View, frame: int) -> Any:
    scene = rtcore_scene.EmbreeScene()
    # Shared vertices: built from a soup of corners, the same scene takes twice as long.
    TriangleMesh(scene, view.positions[frame].astype(np.float32), view.triangles)
    return scene


class Embree:
    """Embree through embreex: build and occluded, or occluded alone."""

    name = "Embree"
    dynamic_ways = ("build",)

    def __init__(self, view: View, rays: Rays) -> None:
        self._view, self._rays = view, rays
        self._scene = _embree_scene(view, 0)

    def dynamic(self, way: str, frame: int) -> np.ndarray:
        """(N,) bool: hidden, with the mesh of this frame."""
        self._scene = _embree_scene(self._view, frame)
        return self.static()

    def static(self) -> np.ndarray:
        """(N,) bool: hidden, the structure as it stands."""
        # embreex shortens the length array in place of returning distances; a copy keeps ours.
        found = self._scene.run(self._rays.starts, self._rays.ways, dists=self._rays.reach.copy(), query="OCCLUDED")
        hidden: np.ndarray = found != -1
        return hidden


class WarpMesh:
    """wp.Mesh and its any-hit query: built anew, refitted, or as it stands."""

    name = "wp.Mesh"
    dynamic_ways = ("build", "refit")

    def __init__(self, view: View, rays: Rays) -> None:
        self._positions = [wp.array(p.astype(np.float32), dtype=wp.vec3, device="cpu") for p in view.positions]
        self._indices = wp.array(view.triangles.ravel(), dtype=int, device="cpu")
        self._arrays = [
            wp.array(a, dtype=t, device="cpu")
            for a, t in ((rays.starts, wp.vec3), (rays.ways, wp.vec3), (rays.reach, float))
        ]
        self._out = wp.zeros(len(rays.starts), dtype=wp.uint8, device="cpu")
        self._mesh = wp.Mesh(wp.clone(self._positions[0]), self._indices)

    def dynamic(self, way: str, frame: int) -> np.ndarray:
        """(N,) bool: hidden, with the mesh of this frame."""
        if way == "build":
            self._mesh = wp.Mesh(wp.clone(self._positions[frame]), self._indices)
        else:
            wp.copy(self._mesh.points, self._positions[frame])
            self._mesh.refit()
        return self.static()

    def static(self) -> np.ndarray:
        """(N,) bool: hidden, the structure as it stands."""
        wp.launch(any_hit, dim=len(self._out), inputs=[self._mesh.id, *self._arrays, self._out], device="cpu")
        hidden: np.ndarray = self._out.numpy() == 1
        return hidden
