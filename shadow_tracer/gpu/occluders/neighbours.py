# SPDX-License-Identifier: Apache-2.0
"""Which triangle goes on across each edge, and how the scene counts triangles.

Two edges of a mesh are neighbours where exactly two triangles have them: corners that are at the same place when the
mesh's triangles come are one. It is found on the host, once for the triangles of each mesh, and kept while only
positions change. Whoever uses it looks whether both edges are still at the same place.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.occluders.changes import Revision
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.scene.mesh import Mesh


def _welded(vertices: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """(V,) the same number for vertices at the same place."""
    order = np.lexsort(vertices.T)
    placed = vertices[order]
    new = np.ones(len(order), bool)
    new[1:] = (placed[1:] != placed[:-1]).any(axis=1)  # what is no number is nowhere else
    numbers = np.empty(len(order), np.int64)
    numbers[order] = np.cumsum(new) - 1
    return numbers


def across_edges(vertices: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """(T, 3) what is across the edge from each corner to the next: 3 * triangle + edge, or -1 where there are not
    exactly two triangles, or one of them has two corners at one place."""
    across = np.full(3 * len(triangles), -1, np.int32)
    if not len(triangles):
        return across.reshape(-1, 3)
    corners = _welded(vertices)[triangles]
    one, two = corners, np.roll(corners, -1, axis=1)
    good = np.repeat((one != two).all(axis=1), 3)
    keys = (np.minimum(one, two) * (len(vertices) + 1) + np.maximum(one, two)).reshape(-1)
    edges = np.flatnonzero(good)
    order = edges[np.argsort(keys[edges], kind="stable")]
    sorted_keys = keys[order]
    begins = np.flatnonzero(np.r_[True, sorted_keys[1:] != sorted_keys[:-1]][: len(order)])
    pairs = begins[np.diff(np.r_[begins, len(order)]) == 2]
    across[order[pairs]], across[order[pairs + 1]] = order[pairs + 1], order[pairs]
    return across.reshape(-1, 3)


class Neighbours:
    """Follows the scene.

    Attributes:
        across: (``bounds.max_triangles``,) vec3i on the device, of each edge 3 * triangle + edge across it, or -1.
        numbers: (``bounds.max_triangles``,) of each triangle, counted through the scene's meshes in their order.
    """

    def __init__(self, scene: SceneBuffers) -> None:
        self._scene = scene
        self.across = wp.empty(scene.bounds.max_triangles, dtype=wp.vec3i, device=scene.device)
        self.numbers = wp.empty(scene.bounds.max_triangles, dtype=int, device=scene.device)
        self._found: dict[str, tuple[int, npt.NDArray[np.int32]]] = {}  # by mesh: revision of its triangles, and theirs
        self._made_for: Revision | None = None

    def follow(self) -> None:
        """Make both again if the scene has other triangles, or has them elsewhere."""
        scene, made_for = self._scene, self._made_for
        if made_for is not None and made_for.topology == scene.revision.topology:
            return
        self._made_for = None
        across = np.full((scene.triangle_count, 3), -1, np.int32)
        numbers = np.full(scene.triangle_count, -1, np.int32)
        found, begin = {}, 0
        for mesh, _, first in scene.placed():
            found[mesh.name] = mesh.topology_revision, self._of(mesh)
            last, mine = first + len(mesh.triangles), found[mesh.name][1]
            own, order = np.arange(len(mesh.triangles), dtype=np.int32), scene.order_of(mesh.name)
            if order is not None:
                stands = np.empty_like(own)
                stands[order.numbers] = own
                own = order.numbers
                mine = np.where(mine < 0, -1, 3 * stands[mine // 3] + mine % 3)[own]
            across[first:last] = np.where(mine < 0, -1, mine + np.int32(3 * first))
            numbers[first:last] = begin + own
            begin += len(mesh.triangles)
        self._scene.upload(self.across, across)
        self._scene.upload(self.numbers, numbers)
        self._found, self._made_for = found, scene.revision

    def _of(self, mesh: Mesh) -> npt.NDArray[np.int32]:
        revision, found = self._found.get(mesh.name, (None, None))
        if found is not None and revision == mesh.topology_revision:
            return found
        return across_edges(mesh.vertices, mesh.triangles)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self.across.capacity + self.numbers.capacity)
