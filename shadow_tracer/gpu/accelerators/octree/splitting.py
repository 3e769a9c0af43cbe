# SPDX-License-Identifier: Apache-2.0
"""Cells of an octree, and the kernels that split those of a level."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.references import LEAF, References, append, reserve
from shadow_tracer.gpu.accelerators.segment import SceneBox
from shadow_tracer.gpu.device import native

# Half the size of the root, in units of the scene's extent, and how often a cell may be halved: 129 * 2^16 is less than
# 2^24, so every plane is a float32.
HALF = 129.0 / 128.0
LEVELS = 16
native.constants(OCTREE_HALF=HALF, OCTREE_LEVELS=LEVELS)
_HALF = wp.constant(HALF)
_FEW = wp.constant(8)  # triangles of a cell that is not split


@wp.struct
class Structure:
    """The tree (``references.py``). Of an inner node, the second number is that of the first of its eight children,
    times four; bit k of a child's place among them says that it is the upper one along axis k."""

    box: SceneBox
    nodes: wp.array(dtype=wp.vec2i)
    members: wp.array(dtype=int)


@wp.struct
class Cell:
    """A node that may be split: its middle, and how many triangles it has. ``node`` is -1 if it is a leaf after all."""

    node: int
    count: int
    middle: wp.vec3


@wp.struct
class Level:
    """The cells of a level, with ``room`` for so many. ``octants``: how many triangles each child gets; then the places
    of these (``References.place``)."""

    cells: wp.array(dtype=Cell)
    octants: wp.array2d(dtype=int)
    room: int


@wp.kernel(enable_backward=False)
def begin(references: References, tree: Structure, made: wp.array(dtype=int), active: wp.array(dtype=int), root: Level):
    """The root. One thread."""
    references.reserved[0] = references.used[0]
    references.used[1] = references.used[0]
    cell = Cell()
    cell.count = references.used[0]
    root.cells[0] = cell
    for k in range(8):
        root.octants[0, k] = 0
    tree.nodes[0] = wp.vec2i(0, LEAF)
    made[0] = 1
    active[0] = 1
    active[1] = 0


@wp.func
def reached(middle: wp.vec3, lower: wp.vec3, upper: wp.vec3) -> int:
    """The octants that a box reaches into, as bits."""
    found = int(255)
    if lower[0] >= middle[0]:
        found = found & 0xAA
    if upper[0] <= middle[0]:
        found = found & 0x55
    if lower[1] >= middle[1]:
        found = found & 0xCC
    if upper[1] <= middle[1]:
        found = found & 0x33
    if lower[2] >= middle[2]:
        found = found & 0xF0
    if upper[2] <= middle[2]:
        found = found & 0x0F
    return found


@wp.kernel(enable_backward=False)
def count_octants(
    level: int,
    boxes_lower: wp.array(dtype=wp.vec3),
    boxes_upper: wp.array(dtype=wp.vec3),
    references: References,
    here: Level,
):
    """How many triangles each child gets. One thread for each reference."""
    r = wp.tid()
    if r >= references.used[level] or references.place[r] < 0:
        return
    place = references.place[r]
    triangle = references.triangle[r]
    found = reached(here.cells[place].middle, boxes_lower[triangle], boxes_upper[triangle])
    for k in range(8):
        if (found >> k) & 1 != 0:
            wp.atomic_add(here.octants, place, k, 1)


@wp.func
def child(
    place: int,
    octant: int,
    half: float,
    node: int,
    next: int,
    active: wp.array(dtype=int),
    here: Level,
    there: Level,
):
    """Make a child of the cell at ``place`` at level ``next``, and say in ``here`` where its triangles go. At no level
    it is a leaf, and so it is where there is no room for a cell more."""
    cell = here.cells[place]
    count = here.octants[place, octant]
    here.octants[place, octant] = -1 - node
    if count <= _FEW or next == 0:
        return
    number = wp.atomic_add(active, next, 1)
    if number >= there.room:
        return
    made = Cell()
    made.node = node
    made.count = count
    for k in range(3):
        made.middle[k] = cell.middle[k] + wp.where((octant >> k) & 1 != 0, half, -half)
    there.cells[number] = made
    for k in range(8):
        there.octants[number, k] = 0
    here.octants[place, octant] = number


@wp.kernel(enable_backward=False)
def make_children(
    level: int,
    room: int,
    references: References,
    nodes: wp.array(dtype=wp.vec2i),
    made: wp.array(dtype=int),
    active: wp.array(dtype=int),
    here: Level,
    there: Level,
):
    """Split cells where there is room. One thread for each cell. ``room``: how many nodes may be."""
    place = wp.tid()
    if place >= wp.min(active[level], here.room):
        return
    cell = here.cells[place]
    more = -cell.count
    fewest = cell.count
    for k in range(8):
        more += here.octants[place, k]
        fewest = wp.min(fewest, here.octants[place, k])
    leaf = fewest == cell.count  # of no use, each child has them all
    first = int(0)
    if not leaf:
        first = wp.atomic_add(made, 0, 8)
        leaf = first + 8 > room or not reserve(references, more)
    if leaf:
        here.octants[place, 0] = -1 - cell.node
        cell.node = -1
        here.cells[place] = cell
        return
    nodes[cell.node] = wp.vec2i(0, 4 * first)
    half = _HALF / float(2 << level)
    next = wp.where(level + 1 < LEVELS, level + 1, 0)
    for k in range(8):
        nodes[first + k] = wp.vec2i(0, LEAF)
        child(place, k, half, first + k, next, active, here, there)


@wp.kernel(enable_backward=False)
def begin_level(level: int, references: References, active: wp.array(dtype=int)):
    """The next level, before anything is in it. One thread."""
    references.used[level + 1] = references.used[level]
    active[level + 1] = 0


@wp.kernel(enable_backward=False)
def pass_on(
    level: int,
    boxes_lower: wp.array(dtype=wp.vec3),
    boxes_upper: wp.array(dtype=wp.vec3),
    references: References,
    here: Level,
):
    """Put triangles into the children of their cells. One thread for each reference."""
    r = wp.tid()
    if r >= references.used[level] or references.place[r] < 0:
        return
    place = references.place[r]
    triangle = references.triangle[r]
    if here.cells[place].node < 0:
        references.place[r] = here.octants[place, 0]
        return
    found = reached(here.cells[place].middle, boxes_lower[triangle], boxes_upper[triangle])
    first = bool(True)
    for k in range(8):
        if (found >> k) & 1 != 0:
            if first:
                references.place[r] = here.octants[place, k]
                first = False
            else:
                append(references, level, triangle, here.octants[place, k])
