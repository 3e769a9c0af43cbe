# SPDX-License-Identifier: Apache-2.0
"""The device's copy of the scene: what has changed is copied, and vertices are put where their mesh is in the world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.transfers import Uploads
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.checks import FloatArray, all_three
from shadow_tracer.scene.mesh import Mesh, Scene


@dataclass(frozen=True)
class Revision:
    """What is on the device. Whoever makes something of the scene keeps the revision that it was made for.

    Attributes:
        topology: another number whenever triangles may have others' places or corners.
        positions: another number whenever anything is different.
    """

    topology: int = 0
    positions: int = 0


_BLOCK = wp.constant(1024)


@native.func_native("occluders/transform.h", calls="Transform::block")
def transform_block(
    row0: wp.vec4d,
    row1: wp.vec4d,
    row2: wp.vec4d,
    first: int,
    begin: int,
    end: int,
    local: wp.array(dtype=wp.vec3d),
    world: wp.array(dtype=wp.vec3d),
):
    """Vertices ``begin`` to ``end`` of a mesh, whose first is number ``first`` of ``world``."""
    ...


@wp.kernel(enable_backward=False)
def transform_vertices(
    row0: wp.vec4d,
    row1: wp.vec4d,
    row2: wp.vec4d,
    first: int,
    local: wp.array(dtype=wp.vec3d),
    world: wp.array(dtype=wp.vec3d),
):
    """world = pose * local, one vertex per thread; ``local`` is as long as ``world``."""
    i = first + wp.tid()
    transform_block(row0, row1, row2, 0, i, i + 1, local, world)


@wp.kernel(enable_backward=False)
def transform_blocks(
    row0: wp.vec4d,
    row1: wp.vec4d,
    row2: wp.vec4d,
    first: int,
    local: wp.array(dtype=wp.vec3d),
    world: wp.array(dtype=wp.vec3d),
):
    """``transform_vertices`` for a mesh whose vertices are read where the host has them."""
    begin = wp.tid() * _BLOCK
    transform_block(row0, row1, row2, first, begin, wp.min(begin + _BLOCK, local.shape[0]), local, world)


@dataclass
class _Part:
    """Where a mesh lies in the buffers, and which of its revisions is there."""

    first_vertex: int
    first_triangle: int
    vertex_count: int
    triangle_count: int
    topology: int
    vertices: int
    pose: int
    mesh_vertices: FloatArray  # (V, 3) in the mesh's own frame
    mesh_pose: FloatArray


class SceneBuffers:
    """The scene on the device: all meshes behind each other, vertices local and in the world (float64), corner
    indices."""

    def __init__(self, bounds: Bounds, device: Any, upload: Uploads | None = None) -> None:
        self.device = device
        self.upload = upload or Uploads(device)
        vertices = 3 * bounds.max_triangles
        # The CPU reads them where the meshes have them.
        self.local = wp.empty(0 if forms.wide(device) else vertices, dtype=wp.vec3d, device=device)
        self.vertices = wp.empty(vertices, dtype=wp.vec3d, device=device)
        self.triangles = wp.empty(bounds.max_triangles, dtype=wp.vec3i, device=device)
        self.triangle_count = 0
        self.vertex_count = 0
        self.revision = Revision()
        self._box: tuple[Revision, FloatArray, FloatArray] | None = None
        self._parts: dict[str, _Part] = {}
        self._copied = -1  # revision of the scene

    def sync(self, scene: Scene) -> None:
        """Copy what changed in ``scene`` since the last call; all of it after a call that raised."""
        if scene.revision == self._copied:
            return
        try:
            self._copy(scene)
        except BaseException:
            self._parts, self._copied = {}, -1
            raise

    def _copy(self, scene: Scene) -> None:
        placed = positioned = True
        parts: dict[str, _Part] = {}
        first_vertex = first_triangle = 0
        for mesh in scene:
            part, part_placed, part_positioned = self._sync_part(mesh, first_vertex, first_triangle)
            parts[mesh.name] = part
            placed, positioned = placed and part_placed, positioned and part_positioned
            first_vertex += part.vertex_count
            first_triangle += part.triangle_count
        # A mesh that is gone leaves the others in their places if it was the last, be it vertices without triangles.
        placed = placed and (first_vertex, first_triangle) == (self.vertex_count, self.triangle_count)
        self._parts = parts
        self._copied = scene.revision
        self.triangle_count = first_triangle
        self.vertex_count = first_vertex
        if not (placed and positioned):
            next_one = self.revision.positions + 1
            self.revision = Revision(self.revision.topology if placed else next_one, next_one)

    def nbytes(self) -> int:
        """Bytes reserved on the device."""
        return int(self.local.capacity + self.vertices.capacity + self.triangles.capacity)

    def _sync_part(self, mesh: Mesh, first_vertex: int, first_triangle: int) -> tuple[_Part, bool, bool]:
        """Copy what changed of a mesh; returns whether its triangles, and its vertices, were there."""
        old = self._parts.get(mesh.name)
        placed = (
            old is not None
            and old.topology == mesh.topology_revision
            and (old.first_vertex, old.first_triangle) == (first_vertex, first_triangle)
        )
        if not placed:
            self.upload(self.triangles, mesh.triangles + np.int32(first_vertex), first_triangle)
        moved = not placed or old is None or old.vertices != mesh.vertices_revision
        if moved and not forms.wide(self.device):
            self.upload(self.local, mesh.vertices, first_vertex)
        positioned = not moved and old is not None and old.pose == mesh.pose_revision
        if not positioned:
            self._place(mesh, first_vertex)
        part = _Part(
            first_vertex,
            first_triangle,
            len(mesh.vertices),
            len(mesh.triangles),
            mesh.topology_revision,
            mesh.vertices_revision,
            mesh.pose_revision,
            mesh.vertices,
            mesh.pose,
        )
        return part, placed, positioned

    def _place(self, mesh: Mesh, first: int) -> None:
        """A mesh's vertices in the world, from vertex ``first`` on."""
        count = len(mesh.vertices)
        rows = [wp.vec4d(*row) for row in mesh.pose[:3]]
        if forms.wide(self.device):
            local = wp.array(ptr=mesh.vertices.ctypes.data, dtype=wp.vec3d, shape=(count,), device=self.device)
            inputs, blocks = [*rows, first, local, self.vertices], -(-count // int(_BLOCK))
            wp.launch(transform_blocks, dim=blocks, inputs=inputs, device=self.device)
        else:
            inputs = [*rows, first, self.local, self.vertices]
            wp.launch(transform_vertices, dim=count, inputs=inputs, device=self.device)

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Low and high corner of a box in the world around all finite vertices; zeros if there are none."""
        if self._box is None or self._box[0] != self.revision:
            self._box = (self.revision, *self._find_box())
        return self._box[1], self._box[2]

    def _find_box(self) -> tuple[FloatArray, FloatArray]:
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for part in self._parts.values():
            least, most = _finite_box(part.mesh_vertices)
            if part.triangle_count == 0 or not np.all(least <= most):
                continue
            rotation, position = part.mesh_pose[:3, :3], part.mesh_pose[:3, 3]
            middle = rotation @ (0.5 * least + 0.5 * most) + position
            half = np.abs(rotation) @ (0.5 * most - 0.5 * least)
            # A few roundings either way: the box only has to hold, not to be tight.
            slack = 1e-14 * (np.abs(middle) + np.abs(half))
            low, high = np.minimum(low, middle - half - slack), np.maximum(high, middle + half + slack)
        return (low, high) if np.all(low <= high) else (np.zeros(3), np.zeros(3))


def _finite_box(vertices: FloatArray) -> tuple[FloatArray, FloatArray]:
    if len(vertices) == 0:
        return np.full(3, np.inf), np.full(3, -np.inf)
    # A column at a time: numpy reduces a long strided column several times faster than an axis of length three.
    low = np.array([vertices[:, k].min() for k in range(3)])
    high = np.array([vertices[:, k].max() for k in range(3)])
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        finite = vertices[all_three(np.isfinite(vertices))]
        return _finite_box(finite)
    return low, high
