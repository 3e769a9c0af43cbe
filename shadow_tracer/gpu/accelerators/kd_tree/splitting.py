# SPDX-License-Identifier: Apache-2.0
"""Cells of a k-d tree, and the kernels that split those of a level."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.references import LEAF, References, append, reserve
from shadow_tracer.gpu.accelerators.segment import SceneBox
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
    """The cells of a level, and boxes around what their triangles have in them. ``bins``: of each cell, of each axis,
    how many begin in each bin of that box, and how many end. ``sides``: of each cell, how many triangles either child
    gets; then the places of these (``References.place``). ``room``: for how many cells."""

    bins: wp.array(dtype=int)
    cells: wp.array(dtype=Cell)
    lowers: wp.array(dtype=wp.vec3)
    uppers: wp.array(dtype=wp.vec3)
    sides: wp.array2d(dtype=int)
    room: int


@wp.kernel(enable_backward=False)
def begin(references: References, tree: Structure, made: wp.array(dtype=int), active: wp.array(dtype=int), root: Level):
    """The root. One thread."""
    references.reserved[0] = references.used[0]
    references.used[1] = references.used[0]
    cell = Cell()
    cell.count = references.used[0]
    cell.lower = wp.vec3(-float(tree.box.half[0]), -float(tree.box.half[1]), -float(tree.box.half[2]))
    cell.upper = -cell.lower
    root.cells[0] = cell
    root.sides[0, 0] = 0
    root.sides[0, 1] = 0
    root.lowers[0] = cell.lower
    root.uppers[0] = cell.upper
    tree.nodes[0] = wp.vec2i(0, LEAF)
    made[0] = 1
    active[0] = 1
    active[1] = 0


@wp.func
def bin_of(x: float, low: float, high: float, bins: int) -> int:
    """Number of the bin between the two that x lies in."""
    return int(wp.clamp((x - low) / (high - low) * float(bins), 0.0, float(bins - 1)))


@wp.func
def along(v: wp.vec3, axis: int) -> float:
    """A component. Not by an index: on CUDA it would put the vector into local memory."""
    return wp.where(axis == 0, v[0], wp.where(axis == 1, v[1], v[2]))


@wp.kernel(enable_backward=False)
def count_bins(
    level: int,
    bins: int,
    boxes_lower: wp.array(dtype=wp.vec3),
    boxes_upper: wp.array(dtype=wp.vec3),
    references: References,
    here: Level,
):
    """Where triangles begin and end in their cells. One thread for each reference."""
    r = wp.tid()
    if r >= references.used[level] or references.place[r] < 0:
        return
    place = references.place[r]
    low = here.lowers[place]
    high = here.uppers[place]
    lower = boxes_lower[references.triangle[r]]
    upper = boxes_upper[references.triangle[r]]
    for k in range(3):
        if low[k] < high[k]:
            first = (place * 3 + k) * 2 * bins
            wp.atomic_add(here.bins, first + bin_of(lower[k], low[k], high[k], bins), 1)
            wp.atomic_add(here.bins, first + bins + bin_of(upper[k], low[k], high[k], bins), 1)


@wp.func
def area(size: wp.vec3) -> float:
    """Half of a box's surface."""
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


@wp.kernel(enable_backward=False)
def choose_planes(level: int, bins: int, references: References, active: wp.array(dtype=int), here: Level):
    """The cheapest plane of each cell: where bins begin and end, the outermost ones cut off what is empty. One thread
    for each cell; the first one also begins the next level."""
    place = wp.tid()
    if place == 0:
        references.used[level + 1] = references.used[level]
        active[level + 1] = 0
    if place >= wp.min(active[level], here.room):
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
                    below += here.bins[first + j]
                    above -= here.bins[first + bins + j]
                    here.bins[first + j] = 0
                    here.bins[first + bins + j] = 0
    cell.axis = axis
    cell.plane = plane
    here.cells[place] = cell


@wp.kernel(enable_backward=False)
def count_sides(
    level: int,
    boxes_lower: wp.array(dtype=wp.vec3),
    boxes_upper: wp.array(dtype=wp.vec3),
    references: References,
    here: Level,
):
    """How many triangles either child gets. One thread for each reference."""
    r = wp.tid()
    if r >= references.used[level] or references.place[r] < 0:
        return
    place = references.place[r]
    axis = here.cells[place].axis
    if axis == 3:
        return
    if along(boxes_lower[references.triangle[r]], axis) < here.cells[place].plane:
        wp.atomic_add(here.sides, place, 0, 1)
    if along(boxes_upper[references.triangle[r]], axis) > here.cells[place].plane:
        wp.atomic_add(here.sides, place, 1, 1)


@wp.func
def child(cell: Cell, side: int, node: int, count: int, next: int, active: wp.array(dtype=int), there: Level) -> int:
    """Make a child at level ``next``; returns the place of its triangles. At no level it is a leaf, and so it is where
    there is no room for a cell more."""
    if count <= _FEW or next == 0:
        return -1 - node
    place = wp.atomic_add(active, next, 1)
    if place >= there.room:
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
def make_children(
    level: int,
    levels: int,
    room: int,
    references: References,
    nodes: wp.array(dtype=wp.vec2i),
    made: wp.array(dtype=int),
    active: wp.array(dtype=int),
    here: Level,
    there: Level,
):
    """Split the cells that get cheaper, where there is room. One thread for each cell. ``levels``, ``room``: how many
    levels and nodes may be."""
    place = wp.tid()
    if place >= wp.min(active[level], here.room):
        return
    cell = here.cells[place]
    low = here.sides[place, 0]
    high = here.sides[place, 1]
    here.sides[place, 0] = -1 - cell.node
    here.sides[place, 1] = -1 - cell.node
    if cell.axis == 3 or (low == cell.count and high == cell.count):
        cell.axis = 3
        here.cells[place] = cell
        return
    first = wp.atomic_add(made, 0, 2)
    if first + 2 > room or not reserve(references, low + high - cell.count):
        cell.axis = 3
        here.cells[place] = cell
        return
    nodes[cell.node] = wp.vec2i(wp.cast(cell.plane, int), 4 * first + cell.axis)
    nodes[first] = wp.vec2i(0, LEAF)
    nodes[first + 1] = wp.vec2i(0, LEAF)
    next = wp.where(level + 1 < levels, level + 1, 0)
    here.sides[place, 0] = child(cell, 0, first, low, next, active, there)
    here.sides[place, 1] = child(cell, 1, first + 1, high, next, active, there)


@wp.func
def grow(there: Level, place: int, lower: wp.vec3, upper: wp.vec3):
    """The box around what a cell's triangles have in it holds another triangle."""
    if place >= 0:
        cell = there.cells[place]
        wp.atomic_min(there.lowers, place, wp.max(lower, cell.lower))
        wp.atomic_max(there.uppers, place, wp.min(upper, cell.upper))


@wp.kernel(enable_backward=False)
def pass_on(
    level: int,
    boxes_lower: wp.array(dtype=wp.vec3),
    boxes_upper: wp.array(dtype=wp.vec3),
    references: References,
    here: Level,
    there: Level,
):
    """Put triangles into the children of their cells. One thread for each reference."""
    r = wp.tid()
    if r >= references.used[level] or references.place[r] < 0:
        return
    place = references.place[r]
    triangle = references.triangle[r]
    axis = here.cells[place].axis
    plane = here.cells[place].plane
    low = here.sides[place, 0]
    high = here.sides[place, 1]
    lower = boxes_lower[triangle]
    upper = boxes_upper[triangle]
    if axis == 3:
        references.place[r] = low
        return
    is_low = along(lower, axis) < plane
    if is_low:
        references.place[r] = low
        grow(there, low, lower, upper)
    if along(upper, axis) > plane:
        grow(there, high, lower, upper)
        if is_low:
            append(references, level, triangle, high)
        else:
            references.place[r] = high
