# SPDX-License-Identifier: Apache-2.0
"""The device's copy of the scene: what has changed is copied, and vertices are put where their mesh is in the world.

A mesh keeps its range of vertices and its range of triangles while it lives and its numbers of them stay. What it
leaves when it goes is a gap: triangles that cast nothing, until another mesh fits in there. All corners of such a
triangle are vertex 0, which is no mesh's and not a number, so that they may be looked at like any others. When there is
no gap for a mesh, or gaps are large, all meshes are laid end to end.

Meshes that cast nothing for some lights are left out while these are traced: for so long their triangles are those of a
gap. What looks at triangles then finds that they cast nothing, and what has been made of the whole scene before only
holds more than it need.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.shared import Shared
from shadow_tracer.gpu.device.transfers import Uploads
from shadow_tracer.gpu.exact.records import GAP_VERTEX
from shadow_tracer.gpu.occluders.changes import Changed, History, Revision
from shadow_tracer.gpu.occluders.depth_surface import DepthSurfaces
from shadow_tracer.gpu.occluders.order import MeshOrder, find_order
from shadow_tracer.gpu.occluders.placing import Placing
from shadow_tracer.gpu.occluders.slots import Range, Ranges, Room, merged
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.checks import FloatArray, all_three
from shadow_tracer.scene.mesh import Mesh, Scene
from shadow_tracer.scene.parts import DepthSurface
from shadow_tracer.scene.some import Some

# Gaps of more than this share of what there is are closed.
_WASTE = 0.5


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
    mesh: Mesh
    find_box: Callable[[], tuple[FloatArray, FloatArray]]  # of its vertices in its own frame
    mesh_pose: FloatArray
    finite: list[tuple[FloatArray, FloatArray]]  # box of its vertices, once it is known
    order: MeshOrder | None  # in which triangles and vertices stand; None: that of the mesh
    settled: bool  # whether one has been looked for

    @property
    def slot(self) -> tuple[Range, Range]:
        """Its vertices, and its triangles."""
        vertices = self.first_vertex, self.first_vertex + self.vertex_count
        return vertices, (self.first_triangle, self.first_triangle + self.triangle_count)

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Around its finite vertices, in its own frame."""
        if not self.finite:
            self.finite.append(self.find_box())
        return self.finite[0]

    def fits(self, mesh: Mesh) -> bool:
        """Whether the mesh may lie there."""
        return (self.vertex_count, self.triangle_count) == (mesh.vertex_count, mesh.triangle_count)


class SceneBuffers:
    """The scene on the device: vertices local and in the world (float64), corner indices.

    Args:
        ordered: for those who see all meshes, whether they cast shadows or not, and to whom triangles' numbers matter:
            meshes always lie end to end in their order.

    Attributes:
        made: what is made of the scene alone, once for all that ask about it.
        by_sixteens: whether somebody looks at sixteen triangles at once: then meshes that are seen a second time may
            be put into another order (``order.py``).
        triangle_count, vertex_count: what is looked at: those of meshes and of the gaps between them.
        live_triangles: those of meshes alone.
        left_out: triangles that cast nothing for the time being, see ``leave_out``; ``names_left_out``: what was asked.
    """

    def __init__(self, bounds: Bounds, device: Any, upload: Uploads | None = None, ordered: bool = False) -> None:
        self.bounds, self.device = bounds, device
        self.upload = upload or Uploads(device)
        self.made = Shared()
        vertices = GAP_VERTEX + 1 + 3 * bounds.max_triangles
        # The CPU reads them where the meshes have them.
        self.local = wp.empty(0 if forms.wide(device) else vertices, dtype=wp.vec3d, device=device)
        self.vertices = wp.empty(vertices, dtype=wp.vec3d, device=device)
        self.triangles = wp.empty(bounds.max_triangles, dtype=wp.vec3i, device=device)
        self._placing = Placing(device, self.local, self.vertices)
        self._depths = DepthSurfaces(device, self.upload)
        self.triangle_count = self.vertex_count = self.live_triangles = 0
        self.revision = Revision()
        self.left_out: Ranges = ()
        self.names_left_out: Collection[str] = ()
        self._ordered, self.by_sixteens = ordered, False
        self._history = History()
        self._box: tuple[Revision, FloatArray, FloatArray] | None = None
        self._parts: dict[str, _Part] = {}
        self._copied = -1  # revision of the scene
        self._whole = False  # whether what is said here is so

    def sync(self, scene: Scene | Some) -> None:
        """Copy what changed in ``scene`` since the last call, of the meshes that cast shadows; all of it after a call
        that raised."""
        if self._whole and scene.revision == self._copied and not self._unsettled():
            return
        if not self._whole:
            self._begin_anew()
        self._whole = False
        self._copy(scene.occluders if isinstance(scene, Scene) and not self._ordered else scene)
        self._whole = True

    def _unsettled(self) -> bool:
        """Whether there are meshes for which it is time to look for another order."""
        return self.by_sixteens and not all(part.settled for part in self._parts.values())

    def changed_since(self, revision: Revision | None) -> Changed:
        """What is not as it was in an earlier revision; None is before the first."""
        changed = None if revision is None else self._history.since(revision.positions)
        if changed is None:
            return Changed(((0, self.triangle_count),), ((0, self.vertex_count),), everything=True)
        return changed

    def leave_out(self, names: Collection[str]) -> None:
        """From now on the meshes of these names, or of names that begin with one and a slash, cast nothing, and all
        others do; the revision stays. Names of no mesh mean nothing. To be ended, by no names, before the next
        ``sync``."""
        self.names_left_out = names
        groups = tuple(f"{name}/" for name in names)
        gone = {name for name in self._parts if name in names or name.startswith(groups)} if names else set()
        out = merged(self._parts[name].slot[1] for name in gone)
        if out == self.left_out:
            return
        for first, last in out:
            self.triangles[first:last].fill_(wp.vec3i(GAP_VERTEX, GAP_VERTEX, GAP_VERTEX))
        for name, part in self._parts.items():
            first, last = part.slot[1]
            if name not in gone and any(begin < last and first < end for begin, end in self.left_out):
                self._put_triangles(part.mesh, part.first_vertex, first, part.order)
        self.left_out = out

    def _put_triangles(self, mesh: Mesh, first_vertex: int, first: int, order: MeshOrder | None) -> None:
        """A mesh's triangles, from number ``first`` on; of a depth image after its vertices."""
        if isinstance(mesh, DepthSurface):
            self._depths.triangles(mesh, self.local, first_vertex, first, self.triangles)
        else:
            triangles = mesh.triangles if order is None else order.triangles
            self.upload(self.triangles, triangles + np.int32(first_vertex), first)

    def _begin_anew(self) -> None:
        """What is there is not known: a revision that nothing has been made for."""
        number = self.revision.positions + 1
        self._history.clear()
        self._parts, self.revision = {}, Revision(number, number)
        self.upload(self.vertices, np.full((1, 3), np.nan), GAP_VERTEX)

    def _copy(self, scene: Scene | Some) -> None:
        placed, before = True, self._parts
        parts: dict[str, _Part] = {}
        vertices: list[Range] = []
        triangles: list[Range] = []
        self._placing.begin()
        for mesh, place in zip(scene, self._places(scene), strict=True):
            part, part_placed, part_positioned = self._sync_part(mesh, *place)
            parts[mesh.name] = part
            placed = placed and part_placed
            if not part_positioned:
                triangles.append(part.slot[1])
                vertices += [part.slot[0]] if part.triangle_count else []
        self._placing.end()
        left = [old.slot for name, old in before.items() if name not in parts or parts[name].slot != old.slot]
        self._parts = parts
        self._depths.keep({name for name, part in parts.items() if isinstance(part.mesh, DepthSurface)})
        self._copied = scene.revision
        self.live_triangles = scene.triangle_count
        slots = [part.slot for part in parts.values()]
        self.vertex_count = max((last for (first, last), _ in slots if first < last), default=0)
        self.triangle_count = max((last for _, (first, last) in slots if first < last), default=0)
        self._empty([slot[1] for slot in left])
        if left or vertices or triangles or not placed:
            number = self.revision.positions + 1
            self._history.add(number, merged([*triangles, *(slot[1] for slot in left)]), merged(vertices))
            self.revision = Revision(number if left or not placed else self.revision.topology, number)

    def _places(self, scene: Scene | Some) -> list[tuple[int, int]]:
        """First vertex and triangle of each mesh: where it is, in a gap, behind the others, or, if that does not do,
        end to end."""
        if self._ordered:
            return _end_to_end(scene)
        meshes = list(scene)
        parts = [self._parts.get(mesh.name) for mesh in meshes]
        kept = [
            part if part is not None and part.fits(mesh) else None for part, mesh in zip(parts, meshes, strict=True)
        ]
        if len(kept) == len(self._parts) and None not in kept:
            return [(part.first_vertex, part.first_triangle) for part in kept if part is not None]
        slots = [part.slot for part in kept if part is not None]
        vertices = Room(GAP_VERTEX + 1, len(self.vertices), (slot[0] for slot in slots))
        triangles = Room(0, len(self.triangles), (slot[1] for slot in slots))
        places: list[tuple[int, int]] = []
        most_vertices = most_triangles = 0
        for mesh, part in zip(meshes, kept, strict=True):
            at: tuple[int | None, int | None]
            if part is None:
                at = vertices.take(mesh.vertex_count), triangles.take(mesh.triangle_count)
            else:
                at = part.first_vertex, part.first_triangle
            if at[0] is None or at[1] is None:
                return _end_to_end(scene)
            places.append((at[0], at[1]))
            most_vertices = max(most_vertices, at[0] + mesh.vertex_count)
            most_triangles = max(most_triangles, at[1] + mesh.triangle_count)
        wasted = most_vertices - 1 > (1.0 + _WASTE) * scene.vertex_count
        wasted |= most_triangles > (1.0 + _WASTE) * scene.triangle_count
        return _end_to_end(scene) if wasted else places

    def _empty(self, left: list[Range]) -> None:
        """Triangles that cast nothing where meshes have been and none is, up to the last that is looked at."""
        taken = (part.slot[1] for part in self._parts.values())
        for first, last in Room(0, len(self.triangles), taken).within(left, self.triangle_count) if left else ():
            self.triangles[first:last].fill_(wp.vec3i(GAP_VERTEX, GAP_VERTEX, GAP_VERTEX))

    @property
    def parts(self) -> int:
        """Number of meshes."""
        return len(self._parts)

    def order_of(self, name: str) -> MeshOrder | None:
        """The order in which a mesh's triangles and vertices stand; None if it is their own."""
        return self._parts[name].order

    def placed(self) -> list[tuple[Mesh, int, int]]:
        """Each mesh, as it is there, with its first vertex and its first triangle."""
        return [(part.mesh, part.first_vertex, part.first_triangle) for part in self._parts.values()]

    @property
    def copied(self) -> int:
        """Revision of the scene that is there."""
        return self._copied

    def nbytes(self) -> int:
        """Bytes reserved on the device, and by what is made of the scene."""
        own = int(self.local.capacity + self.vertices.capacity + self.triangles.capacity)
        own += sum(part.order.nbytes() for part in self._parts.values() if part.order is not None)
        return own + self._placing.nbytes() + self._depths.nbytes() + self.made.nbytes()

    def _sync_part(self, mesh: Mesh, first_vertex: int, first_triangle: int) -> tuple[_Part, bool, bool]:
        """Copy what changed of a mesh; returns whether its triangles, and its vertices, were there."""
        old = self._parts.get(mesh.name)
        kept = old if old is not None and old.topology == mesh.topology_revision else None
        placed = kept is not None and (kept.first_vertex, kept.first_triangle) == (first_vertex, first_triangle)
        moved = kept is None or not placed or kept.vertices != mesh.vertices_revision
        part = _Part(
            first_vertex,
            first_triangle,
            mesh.vertex_count,
            mesh.triangle_count,
            mesh.topology_revision,
            mesh.vertices_revision,
            mesh.pose_revision,
            mesh,
            mesh.box if isinstance(mesh, DepthSurface) else partial(_finite_box, mesh.vertices),
            mesh.pose,
            old.finite if old is not None and old.vertices == mesh.vertices_revision else [],
            None if kept is None else kept.order,
            kept is not None and kept.settled,
        )
        if kept is not None and self.by_sixteens and not part.settled:
            part.order, part.settled = find_order(mesh, part.box, self.device), True
            placed, moved = placed and part.order is None, moved or part.order is not None
        positioned = kept is not None and not moved and kept.pose == mesh.pose_revision
        if not positioned:
            self._place(mesh, first_vertex, moved, part.order)
        if not placed:
            self._put_triangles(mesh, first_vertex, first_triangle, part.order)
        return part, placed, positioned

    def _place(self, mesh: Mesh, first: int, moved: bool, order: MeshOrder | None) -> None:
        """A mesh's vertices in the world, from vertex ``first`` on; ``moved``: in its frame they are other ones."""
        if isinstance(mesh, DepthSurface):
            local = int(self._depths.corners(mesh, self.local, first).ptr or 0)
        else:
            local = mesh.vertices.__array_interface__["data"][0]
            if moved and not forms.wide(self.device):
                self.upload(self.local, mesh.vertices, first)
        self._placing.place(mesh.pose, first, mesh.vertex_count, local, None if order is None else order.vertices)

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Low and high corner of a box in the world around all finite vertices; zeros if there are none."""
        if self._box is None or self._box[0] != self.revision:
            self._box = (self.revision, *self._find_box())
        return self._box[1], self._box[2]

    def _find_box(self) -> tuple[FloatArray, FloatArray]:
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for part in self._parts.values():
            least, most = part.box()
            if part.triangle_count == 0 or not np.all(least <= most):
                continue
            rotation, position = part.mesh_pose[:3, :3], part.mesh_pose[:3, 3]
            middle = rotation @ (0.5 * least + 0.5 * most) + position
            half = np.abs(rotation) @ (0.5 * most - 0.5 * least)
            # A few roundings either way: the box only has to hold, not to be tight.
            slack = 1e-14 * (np.abs(middle) + np.abs(half))
            low, high = np.minimum(low, middle - half - slack), np.maximum(high, middle + half + slack)
        return (low, high) if np.all(low <= high) else (np.zeros(3), np.zeros(3))


def _end_to_end(scene: Scene | Some) -> list[tuple[int, int]]:
    """First vertex and triangle of each mesh if there are no gaps."""
    places = []
    vertices, triangles = GAP_VERTEX + 1, 0
    for mesh in scene:
        places.append((vertices, triangles))
        vertices += mesh.vertex_count
        triangles += mesh.triangle_count
    return places


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
