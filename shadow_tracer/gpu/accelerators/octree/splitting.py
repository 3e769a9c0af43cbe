# SPDX-License-Identifier: Apache-2.0
"""Cells of an octree, and the kernels that split those of a level."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.references import Growth, append, make_cell, make_children, place_of
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
    of these (``Growth.place``)."""

    cells: wp.array(dtype=Cell)
    octants: wp.array2d(dtype=int)
    room: int


@wp.kernel(enable_backward=False)
def begin(growth: Growth, root: Level):
    """The cell of the root. One thread."""
    cell = Cell()
    cell.count = growth.used[0]
    root.cells[0] = cell
    for k in range(8):
        root.octants[0, k] = 0


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
def count_octants(level: int, growth: Growth, here: Level):
    """How many triangles each child gets. One thread for each reference."""
    r = wp.tid()
    place = place_of(growth, level, r)
    if place < 0:
        return
    triangle = growth.triangle[r]
    found = reached(here.cells[place].middle, growth.boxes_lower[triangle], growth.boxes_upper[triangle])
    for k in range(8):
        if (found >> k) & 1 != 0:
            wp.atomic_add(here.octants, place, k, 1)


@wp.func
def child(growth: Growth, level: int, place: int, octant: int, half: float, node: int, here: Level, there: Level):
    """Make a child of the cell at ``place``, and say in ``here`` where its triangles go."""
    count = here.octants[place, octant]
    here.octants[place, octant] = -1 - node
    number = make_cell(growth, level, count, _FEW, there.room)
    if number < 0:
        return
    made = Cell()
    made.node = node
    made.count = count
    for k in range(3):
        made.middle[k] = here.cells[place].middle[k] + wp.where((octant >> k) & 1 != 0, half, -half)
    there.cells[number] = made
    for k in range(8):
        there.octants[number, k] = 0
    here.octants[place, octant] = number


@wp.kernel(enable_backward=False)
def split_cells(level: int, growth: Growth, here: Level, there: Level):
    """Split cells where there is room. One thread for each cell."""
    place = wp.tid()
    if place >= wp.min(growth.cells[level], here.room):
        return
    cell = here.cells[place]
    more = -cell.count
    fewest = cell.count
    for k in range(8):
        more += here.octants[place, k]
        fewest = wp.min(fewest, here.octants[place, k])
    first = int(-1)
    if fewest < cell.count:  # or it is of no use, as each child has them all
        # Small cells whose triangles are in many children leave room to large ones that are far from being done.
        first = make_children(growth, 8, more, wp.where(more > cell.count, 2 * (growth.room / 3), growth.room))
    if first < 0:
        here.octants[place, 0] = -1 - cell.node
        cell.node = -1
        here.cells[place] = cell
        return
    growth.nodes[cell.node] = wp.vec2i(0, 4 * first)
    half = _HALF / float(2 << level)
    for k in range(8):
        child(growth, level, place, k, half, first + k, here, there)


@wp.kernel(enable_backward=False)
def pass_on(level: int, growth: Growth, here: Level):
    """Put triangles into the children of their cells. One thread for each reference."""
    r = wp.tid()
    place = place_of(growth, level, r)
    if place < 0:
        return
    triangle = growth.triangle[r]
    if here.cells[place].node < 0:
        growth.place[r] = here.octants[place, 0]
        return
    found = reached(here.cells[place].middle, growth.boxes_lower[triangle], growth.boxes_upper[triangle])
    first = bool(True)
    for k in range(8):
        if (found >> k) & 1 != 0:
            if first:
                growth.place[r] = here.octants[place, k]
                first = False
            else:
                append(growth, level, triangle, here.octants[place, k])
