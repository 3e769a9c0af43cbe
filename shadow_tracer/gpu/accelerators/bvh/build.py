# SPDX-License-Identifier: Apache-2.0
"""Building the tree of pipeline ``bvh``, and refitting it. ``build.h`` splits a node's triangles by one of three rules:

- ``SAH``: least expected cost of a ray, among sixteen equal bins along each axis (Wald 2007: "On fast Construction of
  SAH-based Bounding Volume Hierarchies"), where a side costs its surface times its blocks, rounded up;
- ``MEDIAN``: half of the blocks, all but two of them full, by the middles along the longest axis (Kay and Kajiya 1986:
  "Ray Tracing Complex Scenes"), found digit by digit in eight passes however they are;
- ``MORTON``: where the highest bit changes of Morton codes of thirty bits (Lauterbach et al. 2009: "Fast BVH
  Construction on GPUs"). Warp's constructor ``lbvh`` makes the same hierarchy bottom up, on CUDA alone; asked for it on
  the CPU, it warns and builds its ``sah``. This is built here on both.

A side gets ``FEWEST`` triangles at least. Where a rule finds no split, and below level ``RULED``, a node is halved, so
that no tree is deeper than ``LEVELS``: 32, and 27 to halve 2^31 triangles.

On the CPU one compiled loop builds all, depth first, and makes the wide nodes of it. On CUDA nodes are split level by
level, a thread each, which reads nothing back: the first level takes one thread as long as it takes to look at all
triangles four times, and each further level half as long. That is slow, but paid once per topology; it has not been
measured. Boxes are refitted level by level, from the last one up.

Which node gets which number depends on the order of threads there, and so do the last bits of ``areas``; answers do
not.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.bvh.tree import (
    BLOCKS,
    CORNERS,
    LEVELS,
    NODES,
    RULED,
    Tree,
    make_tree,
    most_blocks,
    tree_bytes,
)
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.sort import KeySort
from shadow_tracer.gpu.occluders.world import SceneBuffers

SAH, MEDIAN, MORTON = 0, 1, 2
native.constants(RULE_SAH=SAH, RULE_MEDIAN=MEDIAN, RULE_MORTON=MORTON)
_CODE_BITS = 30
# Threads that go through the nodes of a level together.
_TASKS = 4096


@wp.struct
class Sorting:
    """Triangles while they are sorted into blocks."""

    order: wp.array(dtype=int)
    codes: wp.array(dtype=int)  # of those at the same place of the order, for the rule that goes by them
    boxes: wp.array(dtype=float)  # as the corners of a tree, by number


@native.func_native("accelerators/bvh/refit.h", calls="Refit::triangle")
def box_of_triangle(
    number: int,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    tree: Tree,
    boxes: wp.array(dtype=float),
): ...


@native.func_native("accelerators/bvh/refit.h", calls="Refit::block")
def refit_block(
    number: int, count: int, vertices: wp.array(dtype=wp.vec3d), triangles: wp.array(dtype=wp.vec3i), tree: Tree
): ...


@native.func_native("accelerators/bvh/refit.h", calls="Refit::blocks")
def refit_all_blocks(
    count: int, vertices: wp.array(dtype=wp.vec3d), triangles: wp.array(dtype=wp.vec3i), tree: Tree
): ...


@native.func_native("accelerators/bvh/refit.h", calls="Refit::node")
def refit_node(number: int, tree: Tree): ...


@native.func_native("accelerators/bvh/refit.h", calls="Refit::area")
def area_of_node(number: int, tree: Tree) -> wp.float64: ...


@native.func_native("accelerators/bvh/refit.h", calls="Refit::measure")
def measure_all(tree: Tree, areas: wp.array(dtype=wp.float64)): ...


@native.func_native("accelerators/bvh/refit.h", calls="Refit::nodes")
def refit_all_nodes(tree: Tree): ...


@native.func_native("accelerators/bvh/refit.h", calls="Refit::wide_nodes")
def refit_all_wide_nodes(tree: Tree): ...


@native.func_native("accelerators/bvh/casting.h", calls="Casting::mark")
def mark_all(count: int, triangles: wp.array(dtype=wp.vec3i), tree: Tree): ...


@native.func_native("accelerators/bvh/build.h", calls="Build::whole")
def build_all(tree: Tree, sorting: Sorting, rule: int): ...


@native.func_native("accelerators/bvh/build.h", calls="Build::split_one")
def split_node(tree: Tree, sorting: Sorting, node: int, level: int, rule: int): ...


@native.func_native("accelerators/bvh/widen.h", calls="Widen::whole")
def widen_all(tree: Tree): ...


@wp.func
def _spread(x: int) -> int:
    """Two zeros behind each of ten bits."""
    x = (x | (x << 16)) & 0x030000FF
    x = (x | (x << 8)) & 0x0300F00F
    x = (x | (x << 4)) & 0x030C30C3
    return (x | (x << 2)) & 0x09249249


@wp.func
def _cell(low: float, high: float) -> int:
    """Of 1024 along the scene's extent, that of a box's middle."""
    return wp.clamp(int((0.25 * (low + high) + 0.5) * 1024.0), 0, 1023)


@wp.kernel(enable_backward=False)
def triangles_as_they_are(
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    tree: Tree,
    boxes: wp.array(dtype=float),
    codes: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """Boxes of triangles and their codes, in the order of the scene."""
    i = wp.tid()
    box_of_triangle(i, vertices, triangles, tree, boxes)
    k = CORNERS * i
    x = _spread(_cell(boxes[k], boxes[k + 4]))
    y = _spread(_cell(boxes[k + 1], boxes[k + 5]))
    codes[i] = x | (y << 1) | (_spread(_cell(boxes[k + 2], boxes[k + 6])) << 2)
    order[i] = i


@wp.kernel(enable_backward=False)
def begin_tree(tree: Tree, begins: wp.array(dtype=int), count: int):
    """The root, and where the first two levels begin. One thread."""
    tree.counts[NODES] = 1
    tree.counts[BLOCKS] = 0
    tree.children[0] = 0
    tree.children[1] = count
    begins[0] = 0
    begins[1] = 1


@wp.kernel(enable_backward=False)
def build_tree(tree: Tree, sorting: Sorting, begins: wp.array(dtype=int), rule: int):
    """All below the root, as if it were one level. One thread."""
    build_all(tree, sorting, rule)
    begins[1] = tree.counts[NODES]


@wp.kernel(enable_backward=False)
def split_level(tree: Tree, sorting: Sorting, begins: wp.array(dtype=int), level: int, tasks: int, rule: int):
    """The nodes of a level. Any number of threads."""
    for node in range(begins[level] + wp.tid(), begins[level + 1], tasks):
        split_node(tree, sorting, node, level, rule)


@wp.kernel(enable_backward=False)
def end_level(tree: Tree, begins: wp.array(dtype=int), level: int):
    """Where the level after the next one begins. One thread."""
    begins[level + 2] = tree.counts[NODES]


@wp.kernel(enable_backward=False)
def refit_blocks(
    count: int,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    tree: Tree,
):
    """A thread for each block that there may be."""
    number = wp.tid()
    if number < tree.counts[BLOCKS]:
        refit_block(number, count, vertices, triangles, tree)


@wp.kernel(enable_backward=False)
def refit_level(tree: Tree, begins: wp.array(dtype=int), level: int, tasks: int):
    """The nodes of a level, those of the next one being done."""
    for node in range(begins[level] + wp.tid(), begins[level + 1], tasks):
        refit_node(node, tree)


@wp.kernel(enable_backward=False)
def escape_level(tree: Tree, begins: wp.array(dtype=int), level: int, tasks: int):
    """Where to go on after the children of the nodes of a level."""
    for node in range(begins[level] + wp.tid(), begins[level + 1], tasks):
        if node == 0:
            tree.escapes[0] = -1
        first = tree.children[2 * node]
        if first >= 0:
            second = tree.children[2 * node + 1]
            tree.escapes[first] = second
            tree.escapes[second] = tree.escapes[node]


@wp.kernel(enable_backward=False)
def measure_nodes(tree: Tree, areas: wp.array(dtype=wp.float64)):
    """Add the surface of a node's box to ``areas[0]``; that of the root's is ``areas[1]``. A thread for each node that
    there may be."""
    number = wp.tid()
    if number < tree.counts[NODES]:
        wp.atomic_add(areas, 0, area_of_node(number, tree))
    if number == 0:
        areas[1] = area_of_node(0, tree)


@wp.kernel(enable_backward=False)
def measure_tree(tree: Tree, areas: wp.array(dtype=wp.float64)):
    """The same by one thread."""
    measure_all(tree, areas)


@wp.kernel(enable_backward=False)
def widen_tree(tree: Tree):
    """One thread."""
    widen_all(tree)


@wp.kernel(enable_backward=False)
def refit_tree(
    count: int,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    tree: Tree,
):
    """One thread."""
    refit_all_blocks(count, vertices, triangles, tree)
    refit_all_nodes(tree)


@wp.kernel(enable_backward=False)
def refit_wide_nodes(tree: Tree):
    """One thread."""
    refit_all_wide_nodes(tree)


@wp.kernel(enable_backward=False)
def mark_casting(count: int, triangles: wp.array(dtype=wp.vec3i), tree: Tree):
    """One thread."""
    mark_all(count, triangles, tree)


class Builder:
    """Builds a tree by a rule, and refits it.

    Args:
        triangles: the most there can be.
        threaded: whether the tree has links past all below a node.

    Attributes:
        tree: it.
        areas: two numbers on the device, the surfaces of the boxes of all its nodes together and of the root's.
    """

    def __init__(self, triangles: int, rule: int, threaded: bool, device: Any) -> None:
        self._rule, self._device = rule, device
        self._wide = forms.wide(device)
        self._tasks = forms.tasks(device, _TASKS)
        self._sort = KeySort(triangles, device)
        self._boxes = wp.empty(triangles * CORNERS, dtype=float, device=device)
        self._begins = wp.zeros(LEVELS + 3, dtype=int, device=device)
        self._sorting = Sorting()
        self._sorting.order, self._sorting.codes, self._sorting.boxes = self._sort.values, self._sort.keys, self._boxes
        self._levels = 0  # of the tree, at most
        self.tree = make_tree(triangles, self._wide, threaded, device)
        self.areas = wp.zeros(2, dtype=wp.float64, device=device)

    def build(self, scene: SceneBuffers) -> None:
        """Sort the triangles of a scene into blocks, and make nodes of these."""
        count, tree = scene.triangle_count, self.tree
        inputs = [scene.vertices, scene.triangles, tree, self._boxes, self._sort.keys, self._sort.values]
        self._launch(triangles_as_they_are, count, inputs)
        if self._rule == MORTON:
            self._sort.sort(count, 0, _CODE_BITS)
        self._launch(begin_tree, 1, [tree, self._begins, count])
        if self._wide:
            self._levels = 1
            self._launch(build_tree, 1, [tree, self._sorting, self._begins, self._rule])
        else:
            self._levels = min(most_blocks(count), RULED + most_blocks(count).bit_length())
            for level in range(self._levels):
                inputs = [tree, self._sorting, self._begins, level, self._tasks, self._rule]
                self._launch(split_level, self._tasks, inputs)
                self._launch(end_level, 1, [tree, self._begins, level])
        if len(tree.escapes):
            for level in range(self._levels):
                self._launch(escape_level, self._tasks, [tree, self._begins, level, self._tasks])
        self._refit(scene)
        if len(tree.links):
            self._launch(widen_tree, 1, [tree])
            self._launch(refit_wide_nodes, 1, [tree])

    def refit(self, scene: SceneBuffers) -> None:
        """Boxes of blocks and nodes, and the rows of blocks, for triangles that are elsewhere."""
        self._refit(scene)
        if len(self.tree.links):
            self._launch(refit_wide_nodes, 1, [self.tree])

    def mark(self, scene: SceneBuffers) -> None:
        """What casts something though meshes of the scene are left out."""
        if len(self.tree.links):
            self._launch(mark_casting, 1, [scene.triangle_count, scene.triangles, self.tree])

    def _refit(self, scene: SceneBuffers) -> None:
        tree, count = self.tree, scene.triangle_count
        inputs = [count, scene.vertices, scene.triangles, tree]
        if self._wide:
            self._launch(refit_tree, 1, inputs)
            self._launch(measure_tree, 1, [tree, self.areas])
            return
        self._launch(refit_blocks, most_blocks(count), inputs)
        for level in reversed(range(self._levels)):
            self._launch(refit_level, self._tasks, [tree, self._begins, level, self._tasks])
        self.areas.zero_()
        self._launch(measure_nodes, 2 * most_blocks(count), [tree, self.areas])

    def _launch(self, kernel: Any, dim: int, inputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self._device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return self._sort.nbytes() + int(self._boxes.capacity + self._begins.capacity) + tree_bytes(self.tree)
