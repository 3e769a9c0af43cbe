# SPDX-License-Identifier: Apache-2.0
"""A bounding volume hierarchy over the triangles (``wp.Bvh``), rays walk through it.

Warp's own mesh query is not exact, for two reasons: its box test rounds (rays aimed at vertices and edges of a closed
mesh leak), and its triangle test is float32 from the sample's side. Here the tree only proposes triangles, the shadow
test decides, and boxes are padded so that no rounding can hide a triangle: ``segment.py`` leaves 27 u E of the padding,
u = 2^-24 and E the scene's extent, and the slab test's three roundings displace a slab by at most 3 u * 2 E.

The tree is refitted while only positions change. A mesh that comes or goes leaves the triangles of others where they
are, so the tree is refitted then, too, as long as no more than an eighth of the triangles have been replaced since it
was built and there are boxes for all: where there are several meshes, a tree has some to spare. Boxes without a
triangle lie outside of the scene, where no ray meets them; but a leaf may hold them beside triangles. A refitted tree
grows worse as things move, so it is rebuilt as well once rays test twice as many triangles as they did right after the
last build. Variant ``rebuild`` rebuilds always; ``binary`` is ``refit`` without the wide form of the tree that the CPU
uses.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.bvh.wide_tree import BOUNDS_PER_NODE, LINKS_PER_NODE, collapse
from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.accelerators.segment import SceneBox, empty_boxes, holds, scene_box, triangle_boxes
from shadow_tracer.gpu.accelerators.walker import Build, Walk, Walker
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.occluders.changes import Revision
from shadow_tracer.gpu.occluders.slots import Ranges
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.queries import ANY_HIT, CLOSEST, MASK
from shadow_tracer.scene.checks import FloatArray

# Boxes to spare: one for so many triangles, and these; and the share of triangles that may be replaced, or boxes that
# may hold nothing, before the tree is built again.
_TRIANGLES_PER_SPARE, _SPARES = 64, 32
_REPLACED = 1 / 8
# A refitted tree whose rays test this many times the triangles they tested after the last build is built again.
_WORN_OUT = 2.0


@wp.struct
class Structure:
    """The tree, its box, the wide form of it, and what hid each ray of the frame before."""

    bvh: wp.uint64
    bounds: wp.array(dtype=float)
    links: wp.array(dtype=int)
    hints: wp.array(dtype=int)
    box: SceneBox


_WIDE = Walk("accelerators/bvh/wide_tree.h", Structure, queries=(ANY_HIT, MASK, CLOSEST))
_BINARY = Walk("accelerators/bvh/binary_tree.h", Structure, queries=(ANY_HIT, MASK, CLOSEST))


class MeshBvh(Build):
    """The ``mesh_bvh`` pipeline.

    Attributes:
        builds: how often the tree has been built.
        worn_out: whether rays find it so bad that it is to be built again.
    """

    queries = (ANY_HIT, MASK)

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        super().__init__(variant, scene)
        self._variant = variant
        bounds, device = scene.bounds, scene.device
        self._lowers = wp.empty(bounds.max_triangles, dtype=wp.vec3, device=device)
        self._uppers = wp.empty(bounds.max_triangles, dtype=wp.vec3, device=device)
        # Of the builders Warp offers on the CPU, cuBQL's is the fastest and its trees are as good as SAH's; on CUDA
        # only LBVH can be rebuilt on the device.
        self._constructor = "cubql" if device.is_cpu else "lbvh"
        self._bvh: wp.Bvh | None = None
        # Vector registers make eight boxes as cheap as one on the CPU; CUDA threads walk the binary tree.
        self._widens = forms.wide(device) and variant != "binary"
        nodes = max(1024, bounds.max_triangles // 4) if self._widens else 1
        self._tree = Structure()
        self._tree.bounds = wp.empty(nodes * BOUNDS_PER_NODE, dtype=float, device=device)
        self._tree.links = wp.empty(nodes * LINKS_PER_NODE, dtype=int, device=device)
        self._wide_nodes = wp.zeros(1, dtype=int, device=device)
        self._built_for: Revision | None = None
        self._built_count = 0  # boxes
        self._replaced = 0  # triangles since the last build
        self._held: tuple[FloatArray, FloatArray] | None = None  # what the tree's box was made to hold
        self.builds = 0
        self.worn_out = False

    def build(self) -> Structure:
        """Refit or build the tree."""
        scene, built_for = self._scene, self._built_for
        changed = scene.changed_since(built_for)
        if built_for is None or built_for.topology != scene.revision.topology:
            self._replaced += sum(last - first for first, last in changed.triangles)
        spare = self._built_count - scene.triangle_count
        fits = self._bvh is not None and 0 <= spare <= _REPLACED * scene.triangle_count + _SPARES
        rebuild = self._variant == "rebuild" or self.worn_out or not fits
        rebuild |= self._replaced > _REPLACED * scene.triangle_count
        if not fits or (rebuild and scene.parts == 1 and spare > 0):
            self._bvh = None  # in place is impossible with another number of boxes
        self._make_boxes(rebuild, changed.triangles)
        self._make_tree(rebuild)
        if rebuild:
            self.builds += 1
            self.worn_out, self._replaced = False, 0
        self._built_for = scene.revision
        return self._tree

    def _make_boxes(self, rebuild: bool, changed: Ranges) -> None:
        """Boxes of triangles, where they have ``changed``, in units of a box around all."""
        scene = self._scene
        low, high = scene.box()
        if self._bvh is None:
            spare = scene.triangle_count // _TRIANGLES_PER_SPARE + _SPARES if scene.parts > 1 else 0
            self._built_count = min(scene.triangle_count + spare, len(self._lowers))
        count, boxes, arrays = scene.triangle_count, self._built_count, [self._lowers, self._uppers]
        many = sum(last - first for first, last in changed) > count // 2
        if rebuild or many or self._held is None or not holds(self._held, low, high):
            self._tree.box, self._held, changed = scene_box(low, high), (low, high), ((0, boxes),)
        for first, last in changed:
            if first < count:
                inputs = [first, boxes, self._tree.box, scene.vertices, scene.triangles, *arrays]
                wp.launch(triangle_boxes, dim=min(last, count) - first, inputs=inputs, device=scene.device)
            first = max(first, count)
            if first < min(last, boxes):
                wp.launch(
                    empty_boxes, dim=min(last, boxes) - first, inputs=[first, boxes, *arrays], device=scene.device
                )

    def _make_tree(self, rebuild: bool) -> None:
        """Build the tree around the boxes, or refit it."""
        if self._bvh is None:
            some = self._lowers[: self._built_count], self._uppers[: self._built_count]
            self._bvh = wp.Bvh(*some, constructor=self._constructor, leaf_size=4)
        elif rebuild:
            self._bvh.rebuild()
        else:
            self._bvh.refit()
        self._tree.bvh = self._bvh.id
        self.walk = _BINARY
        if self._widens:
            inputs = [self._bvh.id, self._tree.bounds, self._tree.links, self._wide_nodes]
            wp.launch(collapse, dim=1, inputs=inputs, device=self._scene.device)
            self.walk = _WIDE if self._wide_nodes.numpy()[0] > 0 else _BINARY

    def forget(self) -> None:
        """Build the tree again."""
        super().forget()
        self._bvh = self._held = None

    def walker(self, context: Context) -> Walker:
        """One that judges the tree."""
        return Judge(self, context)

    def nbytes(self) -> int:
        """Boxes and trees; Warp does not tell the size of its own, which is two 32-byte nodes per triangle at most."""
        arrays = (self._lowers, self._uppers, self._tree.bounds, self._tree.links)
        return sum(int(array.capacity) for array in arrays) + 64 * self._built_count


class Judge(Walker):
    """Sends rays through a tree, and tells it when they find it bad."""

    def __init__(self, tree: MeshBvh, context: Context) -> None:
        super().__init__(tree, context)
        self._tree, self._judged = tree, 0
        samples = context.samples
        self._hints = wp.zeros(samples.bounds.max_rays, dtype=int, device=samples.device)
        self._structure = Structure()  # the tree's, with hints for these rays
        self._structure.hints = self._hints
        self._fresh_tests: float | None = None  # tests per ray of the first frame after a build

    def structure(self) -> Structure:
        """The tree, and what hid the rays of the frame before."""
        mine, tree = self._structure, self._tree.structure
        mine.bvh, mine.bounds, mine.links, mine.box = tree.bvh, tree.bounds, tree.links, tree.box
        return mine

    def nbytes(self) -> int:
        """Bytes on the device beside the tree."""
        return int(self._hints.capacity)

    def learn(self, counters: dict[str, int]) -> None:
        """Judge the tree by the triangles tested per ray in the frame that just ended."""
        if counters["rays"] == 0:
            return
        tests = counters["leaf_tests"] / counters["rays"]
        if self._fresh_tests is None or self._judged != self._tree.builds:
            self._fresh_tests, self._judged = tests, self._tree.builds
        self._tree.worn_out |= tests > _WORN_OUT * max(self._fresh_tests, 1.0)
