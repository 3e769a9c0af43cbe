# SPDX-License-Identifier: Apache-2.0
"""Boxes around sixteen triangles each, made again only where the scene has changed, and how threads divide among them
what several need. For the CPU.

Triangles that follow each other in a mesh mostly lie together, or are put into an order in which they do
(``order.py``), so a box says no for sixteen of them at once; in a soup of triangles it says no to nothing, and costs
little.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.occluders.changes import Revision
from shadow_tracer.gpu.occluders.slots import Ranges, blocks
from shadow_tracer.gpu.occluders.world import SceneBuffers

CLUSTER = 16  # triangles
_BOXES = 16  # clusters whose boxes are made, and looked at, together


@wp.struct
class Clusters:
    """Boxes in the world, [sixteen][low x y z, high x y z][16] float32, rounded outwards; those of clusters that are
    not there, and of triangles without any finite corner, reach everywhere or hold nothing: it does not matter."""

    triangles: int
    boxes: wp.array(dtype=float)
    made: wp.array(dtype=int)  # of each sixteen: see claim


@native.func_native("device/atomics.h", calls="Claims::claim", otherwise="return 0;")
def claim(made: wp.array(dtype=int), item: int) -> int:
    """Whether the item is for the caller to make; then ``publish`` it."""
    ...


@native.func_native("device/atomics.h", calls="Claims::publish")
def publish(made: wp.array(dtype=int), item: int):
    """Let others know that the item is made."""
    ...


@native.func_native("device/atomics.h", calls="Claims::await")
def await_made(made: wp.array(dtype=int), item: int):
    """Return when an item that somebody has claimed is made."""
    ...


@native.func_native("occluders/boxes.h", calls="ClusterBoxes::make")
def make_boxes(item: int, clusters: Clusters, vertices: wp.array(dtype=wp.vec3d), triangles: wp.array(dtype=wp.vec3i)):
    """Boxes of sixteen clusters, those from ``16 * item`` on."""
    ...


class ClusterBoxes:
    """Owns the memory of ``Clusters``."""

    def __init__(self, max_triangles: int, scene: SceneBuffers) -> None:
        self._scene = scene
        scene.by_sixteens = forms.wide(scene.device)
        self._made_for: Revision | None = None
        self._left_out: Ranges = ()
        items = -(-max_triangles // (CLUSTER * _BOXES))
        self._boxes = wp.empty(6 * _BOXES * items, dtype=float, device=scene.device)
        self._made = wp.zeros(items, dtype=int, device=scene.device)
        self._mades = self._made.numpy()

    def follow(self) -> None:
        """Boxes of another revision of the scene are not used, where it has changed since; nor those of what was left
        out, or is."""
        scene = self._scene
        if (self._made_for, self._left_out) == (scene.revision, scene.left_out):
            return
        made, changed = self._mades, scene.changed_since(self._made_for).triangles
        if self._left_out != scene.left_out:
            changed += self._left_out + scene.left_out
        for first, last in blocks(changed, CLUSTER * _BOXES, scene.triangle_count):
            made[first:last] = 0
        self._made_for, self._left_out = scene.revision, scene.left_out

    def clusters(self) -> Clusters:
        """As kernels see them: ``claim`` and make what is needed."""
        clusters = Clusters()
        clusters.triangles, clusters.boxes, clusters.made = self._scene.triangle_count, self._boxes, self._made
        return clusters

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self._boxes.capacity + self._made.capacity)
