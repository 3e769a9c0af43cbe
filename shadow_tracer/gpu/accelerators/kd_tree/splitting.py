# SPDX-License-Identifier: Apache-2.0
"""Cells of a k-d tree, and the kernels that split those of a level."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.references import Growth, make_cell, make_children, pass_on_to, place_of
from shadow_tracer.gpu.accelerators.segment import SceneBox, along
from shadow_tracer.gpu.device import native

LEVELS = 40
native.constants(KD_LEVELS=LEVELS)
MOST_BINS = 32
_FEW = wp.constant(3)  # triangles of a cell that is not split
# What a step down the tree costs, in triangles that are shown; and how much an empty child is liked.
_STEP, _EMPTY = wp.constant(1.0), wp.constant(0.8)


@wp.struct
class Structure:
    """The tree (``references.py``). Of an inner node, the first number is the bits of where its plane lies and the
    second one the number of its lower child, times four, and its axis."""

    box: SceneBox
    nodes: wp.array(dtype=wp.vec2i)
    members: wp.array(dtype=int)


@wp.struct
class Cell:
    """A node that may be split: its box, the axis and the place of the plane, and how many triangles it has; no axis
    is 3."""

    node: int
    count: int
    axis: int
    plane: float
    lower: wp.vec3
    upper: wp.vec3


@wp.struct
class Level:
    """The cells of a level, with ``room`` for so many, and boxes around what their triangles have in them. ``sides``:
    how many triangles either child gets; then the places of these (``Growth.place``)."""

    cells: wp.array(dtype=Cell)
    lowers: wp.array(dtype=wp.vec3)
    uppers: wp.array(dtype=wp.vec3)
    sides: wp.array2d(dtype=int)
    room: int


@wp.kernel(enable_backward=False)
def begin(growth: Growth, box: SceneBox, root: Level):
    """The cell of the root. One thread."""
    cell = Cell()
    cell.count = growth.used[0]
    cell.lower = wp.vec3(-float(box.half[0]), -float(box.half[1]), -float(box.half[2]))
    cell.upper = -cell.lower
    root.cells[0] = cell
    root.sides[0, 0] = 0
    root.sides[0, 1] = 0
    root.lowers[0] = cell.lower
    root.uppers[0] = cell.upper


@wp.func
def bin_of(x: float, low: float, high: float, bins: int) -> int:
    """Number of the bin between the two that x lies in."""
    return int(wp.clamp((x - low) / (high - low) * float(bins), 0.0, float(bins - 1)))


@wp.kernel(enable_backward=False)
def count_bins(level: int, bins: int, growth: Growth, here: Level, ends: wp.array(dtype=int)):
    """Where triangles begin and end in their cells. ``ends``: of each cell, of each axis, how many begin in each bin of
    the box around what its triangles have in it, and how many end. One thread for each reference."""
    r = wp.tid()
    place = place_of(growth, level, r)
    if place < 0:
        return
    low = here.lowers[place]
    high = here.uppers[place]
    lower = growth.boxes_lower[growth.triangle[r]]
    upper = growth.boxes_upper[growth.triangle[r]]
    for k in range(3):
        if low[k] < high[k]:
            first = (place * 3 + k) * 2 * bins
            wp.atomic_add(ends, first + bin_of(lower[k], low[k], high[k], bins), 1)
            wp.atomic_add(ends, first + bins + bin_of(upper[k], low[k], high[k], bins), 1)


@wp.func
def area(size: wp.vec3) -> float:
    """Half of a box's surface."""
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


@wp.kernel(enable_backward=False)
def choose_planes(level: int, bins: int, growth: Growth, here: Level, ends: wp.array(dtype=int)):
    """The cheapest plane of each cell: where bins begin and end, the outermost ones cut off what is empty. One thread
    for each cell."""
    place = wp.tid()
    if place >= wp.min(growth.cells[level], here.room):
        return
    cell = here.cells[place]
    size = cell.upper - cell.lower
    whole = area(size)
    best = float(cell.count)
    axis = int(3)
    plane = float(0.0)
    for k in range(3):
        low = here.lowers[place][k]
        high = here.uppers[place][k]
        if low < high:
            first = (place * 3 + k) * 2 * bins
            below = int(0)  # how many begin below the plane
            above = cell.count
            for j in range(bins + 1):
                at = low + float(j) * ((high - low) / float(bins))
                if j == bins:
                    at = high
                if at > cell.lower[k] and at < cell.upper[k]:
                    left = size
                    right = size
                    left[k] = at - cell.lower[k]
                    right[k] = cell.upper[k] - at
                    shown = (area(left) * float(below) + area(right) * float(above)) / whole
                    if below == 0 or above == 0:
                        shown *= _EMPTY
                    if _STEP + shown < best:
                        best = _STEP + shown
                        axis = k
                        plane = at
                if j < bins:
                    below += ends[first + j]
                    above -= ends[first + bins + j]
                    ends[first + j] = 0
                    ends[first + bins + j] = 0
    cell.axis = axis
    cell.plane = plane
    here.cells[place] = cell


@wp.kernel(enable_backward=False)
def count_sides(level: int, growth: Growth, here: Level):
    """How many triangles either child gets. One thread for each reference."""
    r = wp.tid()
    place = place_of(growth, level, r)
    if place < 0:
        return
    axis = here.cells[place].axis
    if axis == 3:
        return
    if along(growth.boxes_lower[growth.triangle[r]], axis) < here.cells[place].plane:
        wp.atomic_add(here.sides, place, 0, 1)
    if along(growth.boxes_upper[growth.triangle[r]], axis) > here.cells[place].plane:
        wp.atomic_add(here.sides, place, 1, 1)


@wp.func
def child(growth: Growth, level: int, cell: Cell, side: int, node: int, count: int, there: Level) -> int:
    """Make a child of a cell of a level; returns the place of its triangles."""
    place = make_cell(growth, level, count, _FEW, there.room)
    if place < 0:
        return -1 - node
    made = Cell()
    made.node = node
    made.count = count
    made.lower = cell.lower
    made.upper = cell.upper
    for k in range(3):
        if k == cell.axis:
            if side == 0:
                made.upper[k] = cell.plane
            else:
                made.lower[k] = cell.plane
    there.cells[place] = made
    there.sides[place, 0] = 0
    there.sides[place, 1] = 0
    there.lowers[place] = made.upper  # nothing yet
    there.uppers[place] = made.lower
    return place


@wp.kernel(enable_backward=False)
def split_cells(level: int, growth: Growth, here: Level, there: Level):
    """Split the cells that get cheaper, where there is room. One thread for each cell."""
    place = wp.tid()
    if place >= wp.min(growth.cells[level], here.room):
        return
    cell = here.cells[place]
    low = here.sides[place, 0]
    high = here.sides[place, 1]
    first = int(-1)
    if cell.axis != 3 and (low < cell.count or high < cell.count):
        first = make_children(growth, 2, low + high - cell.count, growth.room)
    if first < 0:
        here.sides[place, 0] = -1 - cell.node
        cell.axis = 3
        here.cells[place] = cell
        return
    growth.nodes[cell.node] = wp.vec2i(wp.cast(cell.plane, int), 4 * first + cell.axis)
    here.sides[place, 0] = child(growth, level, cell, 0, first, low, there)
    here.sides[place, 1] = child(growth, level, cell, 1, first + 1, high, there)


@wp.func
def grow(there: Level, place: int, lower: wp.vec3, upper: wp.vec3):
    """The box around what a cell's triangles have in it holds another triangle."""
    if place >= 0:
        cell = there.cells[place]
        wp.atomic_min(there.lowers, place, wp.max(lower, cell.lower))
        wp.atomic_max(there.uppers, place, wp.min(upper, cell.upper))


@wp.kernel(enable_backward=False)
def pass_on(level: int, growth: Growth, here: Level, there: Level):
    """Put triangles into the children of their cells. One thread for each reference."""
    r = wp.tid()
    place = place_of(growth, level, r)
    if place < 0:
        return
    axis = here.cells[place].axis
    plane = here.cells[place].plane
    low = here.sides[place, 0]
    high = here.sides[place, 1]
    if axis == 3:
        growth.place[r] = low
        return
    lower = growth.boxes_lower[growth.triangle[r]]
    upper = growth.boxes_upper[growth.triangle[r]]
    is_low = along(lower, axis) < plane
    is_high = along(upper, axis) > plane
    if is_low:
        grow(there, low, lower, upper)
    if is_high:
        grow(there, high, lower, upper)
    pass_on_to(growth, level, r, is_low, is_high, low, high)
