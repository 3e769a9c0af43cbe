# SPDX-License-Identifier: Apache-2.0
"""Trees over space that are split level by level: which triangle is where meanwhile, and the lists of their leaves.

A *reference* is a triangle in a cell. At a level each is looked at by one thread, and passed on to a child of its cell:
the first child that holds it takes its place, for each other one a reference is appended. Nothing is sorted before the
tree is done; then references are counted by leaf, counts are scanned, and numbers of triangles are scattered.

A tree's nodes are pairs of numbers. Of a leaf they are its first place in ``members`` and its number of triangles; the
second one is times four and LEAF, which inner nodes do not have there. Children lie side by side, node 0 is the root.

How many references, cells and nodes there are at a level is decided on the device. The CPU reads it for the next
level; on CUDA nothing is read, and each level has as many threads as there may be references and cells.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.segment import OUTSIDE, SceneBox, scene_box, triangle_boxes
from shadow_tracer.gpu.accelerators.walker import Build
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.occluders.world import SceneBuffers

LEAF = wp.constant(3)
native.constants(TREE_LEAF=LEAF)
_REFERENCES_PER_TRIANGLE = 8


@wp.struct
class Growth:
    """A tree while it is split, and the padded boxes of triangles (``segment.py``).

    Reference r is triangle ``triangle[r]`` in cell ``place[r]`` of the level; in leaf ``~place[r]``, below 0. There are
    ``used[k]`` of them when level k begins, and those that are appended count as the next one's. ``reserved[0]`` is how
    many there will be, at most ``room``. ``cells[k]`` is how many cells level k has, of at most ``levels``, ``made[0]``
    how many nodes there are, of at most ``node_room``: more than fit, if some did not."""

    boxes_lower: wp.array(dtype=wp.vec3)
    boxes_upper: wp.array(dtype=wp.vec3)
    triangle: wp.array(dtype=int)
    place: wp.array(dtype=int)
    used: wp.array(dtype=int)
    reserved: wp.array(dtype=int)
    room: int
    cells: wp.array(dtype=int)
    levels: int
    nodes: wp.array(dtype=wp.vec2i)
    made: wp.array(dtype=int)
    node_room: int


@wp.kernel(enable_backward=False)
def take_triangles(growth: Growth):
    """Those that cast something, into the root. One thread each."""
    i = wp.tid()
    if growth.boxes_lower[i][0] >= OUTSIDE:
        return
    at = wp.atomic_add(growth.used, 0, 1)
    growth.triangle[at] = i
    growth.place[at] = 0


@wp.kernel(enable_backward=False)
def begin(growth: Growth):
    """The root; without triangles it is no cell. One thread."""
    growth.reserved[0] = growth.used[0]
    growth.cells[0] = wp.min(growth.used[0], 1)
    growth.nodes[0] = wp.vec2i(0, LEAF)
    growth.made[0] = 1


@wp.kernel(enable_backward=False)
def begin_level(level: int, growth: Growth):
    """The next level, before anything is in it. One thread."""
    growth.used[level + 1] = growth.used[level]
    growth.cells[level + 1] = 0


@wp.kernel(enable_backward=False)
def enter_leaves(growth: Growth, begins: wp.array(dtype=int), members: wp.array(dtype=int)):
    """Count the triangles of each leaf in ``begins``; with ``members``, store them from there on. One thread for each
    reference."""
    r = wp.tid()
    if r >= growth.used[growth.levels]:
        return
    at = wp.atomic_add(begins, -1 - growth.place[r], 1)
    if members.shape[0] > 0:
        members[at] = growth.triangle[r]


@wp.kernel(enable_backward=False)
def close_leaves(growth: Growth, start: wp.array(dtype=int)):
    """Write where the triangles of leaves are. One thread for each node."""
    i = wp.tid()
    if i < growth.made[0] and (growth.nodes[i][1] & 3) == LEAF:
        growth.nodes[i] = wp.vec2i(start[i], 4 * (start[i + 1] - start[i]) + LEAF)


@wp.func
def place_of(growth: Growth, level: int, r: int) -> int:
    """The cell of a reference at a level; below 0 if it is in a leaf, or there is no such reference."""
    if r >= growth.used[level]:
        return -1
    return growth.place[r]


@wp.func
def make_children(growth: Growth, number: int, more: int, room: int) -> int:
    """Nodes for the children of a cell, leaves for now, that together have so many references more than it; returns the
    first one's number, -1 if there is no room, or would be more than ``room`` references."""
    first = wp.atomic_add(growth.made, 0, number)
    if first + number > growth.node_room:
        return -1
    before = wp.atomic_add(growth.reserved, 0, more)
    if before + more > room:
        wp.atomic_sub(growth.reserved, 0, more)
        return -1
    for k in range(number):
        growth.nodes[first + k] = wp.vec2i(0, LEAF)
    return first


@wp.func
def make_cell(growth: Growth, level: int, count: int, few: int, room: int) -> int:
    """The place of a cell of ``count`` triangles below ``level``; -1 if it is a leaf: of ``few`` triangles, below the
    last level, or where the next one has no ``room``."""
    if count <= few or level + 1 >= growth.levels:
        return -1
    place = wp.atomic_add(growth.cells, level + 1, 1)
    return wp.where(place < room, place, -1)


@wp.func
def append(growth: Growth, level: int, triangle: int, place: int):
    """One more reference, which has been reserved, for the next level."""
    at = wp.atomic_add(growth.used, level + 1, 1)
    growth.triangle[at] = triangle
    growth.place[at] = place


@wp.func
def pass_on_to(growth: Growth, level: int, r: int, in_low: bool, in_high: bool, low: int, high: int):
    """Put the triangle of a reference into one of two children or into both."""
    growth.place[r] = wp.where(in_low, low, high)
    if in_low and in_high:
        append(growth, level, growth.triangle[r], high)


class SplitTree(Build):
    """What builds such a tree.

    Attributes:
        kind: the type of the tree, a struct with ``nodes`` and ``members``.
        most_levels: of any tree.
        children: of a cell.
        nodes_per_triangle: room for nodes.
        triangles_per_cell: room for the cells of a level.
        fewest: nodes, cells and references that a small scene may have.
    """

    kind: Any
    most_levels: int
    children = 2
    nodes_per_triangle: int
    triangles_per_cell: int
    fewest = 64

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        super().__init__(variant, scene)
        self._arrays: list[wp.array] = []
        triangles = scene.bounds.max_triangles
        nodes, entries = self.nodes_for(triangles), max(scene.bounds.grid_entries, triangles)
        self.growth = growth = Growth()
        growth.boxes_lower, growth.boxes_upper = (self.array(triangles, wp.vec3) for _ in range(2))
        growth.triangle, growth.place = self.array(entries, int), self.array(entries, int)
        growth.used, growth.cells = (self.array(self.most_levels + 1, int) for _ in range(2))
        growth.reserved, growth.made = self.array(1, int), self.array(1, int)
        self.tree = self.kind()
        self.tree.nodes = growth.nodes = self.array(nodes, wp.vec2i)
        self.tree.members = self.array(entries, int)
        self._begins, self._start, self._no_members = (self.array(size, int) for size in (nodes + 1, nodes + 1, 0))
        self._levels = [self.level(self.cells_for(triangles)) for _ in range(2)]

    def array(self, shape: int | tuple[int, ...], dtype: Any) -> wp.array:
        """One on the device, of any content, that counts in ``nbytes``."""
        made = wp.empty(shape, dtype=dtype, device=self._scene.device)
        self._arrays.append(made)
        return made

    def nodes_for(self, triangles: int) -> int:
        """Room for nodes."""
        return self.nodes_per_triangle * triangles + self.fewest

    def cells_for(self, triangles: int) -> int:
        """Room for the cells of a level."""
        return triangles // self.triangles_per_cell + self.fewest

    def levels_for(self, triangles: int) -> int:
        """How many levels a tree may have."""
        return self.most_levels

    def level(self, cells: int) -> Any:
        """The cells of a level, with ``room`` for so many."""
        raise NotImplementedError

    def begin(self, box: SceneBox, root: Any) -> None:
        """What a new tree has besides ``growth``: the cell of the root at its level."""
        raise NotImplementedError

    def split(self, level: int, cells: int, references: int, here: Any, there: Any) -> None:
        """Split cells ``here`` into cells ``there``, and pass on their references.

        Args:
            cells, references: how many there may be.
        """
        raise NotImplementedError

    def build(self) -> Any:
        """Split the scene, level by level."""
        scene, device, growth = self._scene, self._scene.device, self.growth
        count, box = scene.triangle_count, scene_box(*scene.box())
        growth.room = min(_REFERENCES_PER_TRIANGLE * count + self.fewest, growth.place.shape[0])
        growth.room = max(growth.room, count)
        growth.node_room, growth.levels = self.nodes_for(count), self.levels_for(count)
        for each in self._levels:
            each.room = self.cells_for(count)
        inputs = [0, count, box, scene.vertices, scene.triangles, growth.boxes_lower, growth.boxes_upper]
        wp.launch(triangle_boxes, dim=count, inputs=inputs, device=device)
        growth.used.zero_()
        wp.launch(take_triangles, dim=count, inputs=[growth], device=device)
        wp.launch(begin, dim=1, inputs=[growth], device=device)
        self.begin(box, self._levels[0])
        for level in range(growth.levels):
            here, there = self._levels[level % 2], self._levels[1 - level % 2]
            cells, references = min(self.children**level, here.room), self._references(level)
            if forms.wide(device):
                cells = min(int(growth.cells.numpy()[level]), cells)
            wp.launch(begin_level, dim=1, inputs=[level, growth], device=device)
            self.split(level, cells, references, here, there)
        self._list_leaves()
        return self.tree

    def _references(self, level: int) -> int:
        """How many there may be when a level begins."""
        growth = self.growth
        return int(growth.used.numpy()[level] if forms.wide(self._scene.device) else growth.room)

    def _list_leaves(self) -> None:
        """The lists of all leaves, when all references are in leaves."""
        growth, device, nodes = self.growth, self._scene.device, self.growth.node_room
        begins, start, references = self._begins[: nodes + 1], self._start[: nodes + 1], self._references(growth.levels)
        begins.zero_()
        wp.launch(enter_leaves, dim=references, inputs=[growth, begins, self._no_members], device=device)
        wp.utils.array_scan(begins, start, inclusive=False)
        wp.copy(begins, start)
        wp.launch(enter_leaves, dim=references, inputs=[growth, begins, self.tree.members], device=device)
        wp.launch(close_leaves, dim=nodes, inputs=[growth, start], device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return sum(int(array.capacity) for array in self._arrays)
