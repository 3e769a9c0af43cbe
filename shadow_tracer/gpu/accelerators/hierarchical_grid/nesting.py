# SPDX-License-Identifier: Apache-2.0
"""Grids within cells of grids: the structure, and the kernels that build it. What one kernel counts and another stores
is the same in both: what they compute from a shape is exact, or rounded once."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.cells import (
    ROWS,
    Cells,
    Shape,
    cells_of,
    level_that_fits,
    number_of,
    shape_of,
    sum_of_rows,
)
from shadow_tracer.gpu.accelerators.segment import SceneBox
from shadow_tracer.gpu.device import native

DEPTHS = 3  # grids that a point may lie in
native.constants(GRID_DEPTHS=DEPTHS)
STEPS = wp.constant(11)  # from the finest grids in cells to those of one cell, which are none: 64 cells to 2
LEAVES = wp.constant(-1)  # instead of a depth: cells that hold no grid, at any
_DENSE = wp.constant(8)  # triangles that a cell may have without a nested grid
_CELLS_PER_MEMBER = wp.constant(3.0)
_MOST_ALONG = wp.constant(64)  # an axis of a grid in a cell
# Cells get no smaller: four times what triangles are padded by, which all triangles span.
_PER_UNIT = wp.constant(2.0**16)


@wp.struct
class Grid:
    """Its shape, and the number of its first cell; the cells of all grids are counted through."""

    shape: Shape
    first: int


@wp.struct
class Structure:
    """The grids, that of the scene first. Cell k holds grid ``inside[k]``; or, where that is 0, the triangles
    ``members[start[k]]`` to ``members[start[k + 1]]``. While grids are made, ``start[k]`` is the grid of cell k."""

    box: SceneBox
    grids: wp.array(dtype=Grid)
    inside: wp.array(dtype=int)
    start: wp.array(dtype=int)
    members: wp.array(dtype=int)


@wp.struct
class Plan:
    """How far the grids are made. The cells at depth d end at ``ends[d + 1]``, and ``made`` counts grids.

    In sums over rows of threads, for each step of coarsening: ``needed``, memberships in the cells of the next grids;
    ``cells``, how many these are; ``grids``, how many grids. ``dense``: memberships in cells that they are planned in.
    ``total`` is the memberships in all cells that hold no grid, ``step`` the coarsening chosen last.
    """

    ends: wp.array(dtype=int)
    made: wp.array(dtype=int)
    step: wp.array(dtype=int)
    total: wp.array(dtype=wp.int64)
    needed: wp.array2d(dtype=wp.int64)
    cells: wp.array2d(dtype=wp.int64)
    grids: wp.array2d(dtype=wp.int64)
    dense: wp.array2d(dtype=wp.int64)


@wp.func
def place(cells: Cells, n: int) -> wp.vec3i:
    """The n-th of them."""
    x = cells.last[0] - cells.first[0] + 1
    y = cells.last[1] - cells.first[1] + 1
    return cells.first + wp.vec3i(n % x, (n / x) % y, n / (x * y))


@wp.func
def cell_at(grid: Grid, at: wp.vec3i) -> int:
    """The number of a cell."""
    count = grid.shape.count
    return grid.first + (at[2] * count[1] + at[1]) * count[0] + at[0]


@wp.func
def inner_shape(outer: Shape, at: wp.vec3i, count: wp.vec3i) -> Shape:
    """The shape of a grid in a cell."""
    shape = Shape()
    shape.count = count
    for k in range(3):
        # The product is exact, so that it does not matter whether it is contracted with the sum.
        shape.low[k] = float(wp.float64(outer.low[k]) + wp.float64(at[k]) * wp.float64(outer.size[k]))
        shape.size[k] = outer.size[k] / float(count[k])
        shape.per_unit[k] = 1.0 / shape.size[k]
    return shape


@wp.func
def finest(size: wp.vec3, members: int) -> wp.vec3i:
    """Cells along each axis for so many triangles in a cell of this size, as near to cubes as may be."""
    free = wp.vec3i(1, 1, 1)
    edge = float(0.0)
    for _ in range(3):  # an axis shorter than a cube's edge gets one cell
        volume = float(1.0)
        axes = float(0.0)
        for k in range(3):
            if free[k] > 0:
                volume *= size[k]
                axes += 1.0
        edge = wp.pow(volume / (_CELLS_PER_MEMBER * float(members)), 1.0 / axes)
        for k in range(3):
            if size[k] < edge:
                free[k] = 0
    count = wp.vec3i(1, 1, 1)
    for k in range(3):
        most = wp.min(_MOST_ALONG, int(size[k] * _PER_UNIT))
        count[k] = wp.clamp(int(size[k] / edge), 1, wp.max(most, 1))
    return count


@wp.func
def pack(count: wp.vec3i) -> int:
    """Cells along each axis as one number, below 0: a grid that is planned."""
    return -((count[2] * 128 + count[1]) * 128 + count[0])


@wp.func
def coarser(packed: int, step: int) -> wp.vec3i:
    """Cells along each axis after so many steps: to three quarters, two quarters, three eighths, ..."""
    some = -packed
    count = wp.vec3i(some % 128, (some / 128) % 128, some / (128 * 128))
    for k in range(3):
        fewer = count[k] >> (step / 2)
        if step % 2 == 1:
            fewer = (3 * count[k]) >> (step / 2 + 2)
        count[k] = wp.max(fewer, 1)
    return count


@wp.func
def cells_in(count: wp.vec3i) -> int:
    """How many cells a grid in a cell has; none if it would be the same cell again."""
    cells = count[0] * count[1] * count[2]
    if cells == 1:
        cells = 0
    return cells


@wp.func
def outer_place(tree: Structure, cell: int) -> wp.vec3i:
    """Where a cell lies in its grid, while grids are made."""
    grid = tree.grids[tree.start[cell]]
    count = grid.shape.count
    n = cell - grid.first
    return wp.vec3i(n % count[0], (n / count[0]) % count[1], n / (count[0] * count[1]))


@wp.kernel(enable_backward=False)
def begin(finest: wp.vec3i, capacity: wp.int64, needed: wp.array2d(dtype=wp.int64), plan: Plan, tree: Structure):
    """The grid of the scene: the finest one whose memberships fit. One thread."""
    level = level_that_fits(needed, capacity)
    grid = Grid()
    grid.shape = shape_of(tree.box, finest, level)
    tree.grids[0] = grid
    plan.total[0] = sum_of_rows(needed, level)
    plan.ends[0] = 0
    plan.ends[1] = grid.shape.count[0] * grid.shape.count[1] * grid.shape.count[2]
    plan.made[0] = 1


@wp.kernel(enable_backward=False)
def find_dense(depth: int, counts: wp.array(dtype=int), plan: Plan, tree: Structure):
    """Plan grids at a depth, in cells with many triangles above it. One thread per cell of any depth."""
    cell = wp.tid()
    if cell < plan.ends[depth - 1] or cell >= plan.ends[depth]:
        return
    members = counts[cell]
    if members <= _DENSE:
        return
    packed = pack(finest(tree.grids[tree.start[cell]].shape.size, members))
    if cells_in(coarser(packed, 0)) == 0:
        return
    tree.inside[cell] = packed
    row = cell & (ROWS - 1)
    wp.atomic_add(plan.dense, row, 0, wp.int64(members))
    for step in range(STEPS):
        cells = cells_in(coarser(packed, step))
        if cells > 0:
            wp.atomic_add(plan.cells, row, step, wp.int64(cells))
            wp.atomic_add(plan.grids, row, step, wp.int64(1))


@wp.func
def needed_in(grid: Grid, at: wp.vec3i, packed: int, step: int, lower: wp.vec3, upper: wp.vec3) -> wp.int64:
    """Memberships of a box in a planned grid."""
    return number_of(cells_of(inner_shape(grid.shape, at, coarser(packed, step)), lower, upper))


@wp.kernel(enable_backward=False)
def count_needed(
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
    depth: int,
    first: int,
    plan: Plan,
    tree: Structure,
):
    """How many memberships there are in planned grids, at the steps from ``first`` on. One thread per step and
    triangle."""
    step, i = wp.tid()
    step += first
    if first > 0 and plan.step[0] < STEPS:
        return  # finer grids fit
    lower, upper = lowers[i], uppers[i]
    count = wp.int64(0)
    outer = tree.grids[0]
    cells = cells_of(outer.shape, lower, upper)
    for a in range(int(number_of(cells))):
        at = place(cells, a)
        found = tree.inside[cell_at(outer, at)]
        if found < 0:
            count += needed_in(outer, at, found, step, lower, upper)
        if found > 0 and depth > 1:
            middle = tree.grids[found]
            some = cells_of(middle.shape, lower, upper)
            for b in range(int(number_of(some))):
                within = place(some, b)
                packed = tree.inside[cell_at(middle, within)]
                if packed < 0:
                    count += needed_in(middle, within, packed, step, lower, upper)
    if count > wp.int64(0):
        wp.atomic_add(plan.needed, i & (ROWS - 1), step, count)


@wp.kernel(enable_backward=False)
def choose_step(depth: int, room: int, first: int, last: int, plan: Plan, tree: Structure):
    """The finest grids at a depth that fit, if none before step ``first`` did: their memberships, their cells and
    themselves. None, where none before ``last`` do. One thread."""
    if first > 0 and plan.step[0] < STEPS:
        return
    others = plan.total[0] - sum_of_rows(plan.dense, 0)
    begun = plan.ends[depth]
    plan.step[0] = STEPS
    plan.ends[depth + 1] = begun
    for step in range(first, last):
        members = others + sum_of_rows(plan.needed, step)
        cells = wp.int64(begun) + sum_of_rows(plan.cells, step)
        grids = wp.int64(plan.made[0]) + sum_of_rows(plan.grids, step)
        fits = members <= wp.int64(tree.members.shape[0]) and cells <= wp.int64(room)
        if fits and grids <= wp.int64(tree.grids.shape[0]):
            plan.step[0] = step
            plan.total[0] = members
            return


@wp.kernel(enable_backward=False)
def make_grids(depth: int, counts: wp.array(dtype=int), plan: Plan, tree: Structure):
    """Make what is planned at a depth. One thread per cell of any depth."""
    cell = wp.tid()
    if cell < plan.ends[depth - 1] or cell >= plan.ends[depth] or tree.inside[cell] >= 0:
        return
    count = coarser(tree.inside[cell], plan.step[0])
    cells = cells_in(count)
    tree.inside[cell] = 0
    if cells == 0 or plan.step[0] == STEPS:
        return
    number = wp.atomic_add(plan.made, 0, 1)
    grid = Grid()
    grid.shape = inner_shape(tree.grids[tree.start[cell]].shape, outer_place(tree, cell), count)
    grid.first = wp.atomic_add(plan.ends, depth + 1, cells)
    tree.grids[number] = grid
    tree.inside[cell] = number
    counts[cell] = 0  # its triangles are to be those of the grid's cells


@wp.func
def enter(tree: Structure, grid: int, cell: int, i: int, store: bool, begins: wp.array(dtype=int)):
    """Count a triangle of a cell, or store it."""
    at = wp.atomic_add(begins, cell, 1)
    if store:
        tree.members[at] = i
    else:
        tree.start[cell] = grid


@wp.kernel(enable_backward=False)
def enter_cells(
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
    depth: int,
    begins: wp.array(dtype=int),
    tree: Structure,
):
    """Count the triangles of each cell at a depth in ``begins``; at ``LEAVES``, store them from there on. One thread
    per triangle."""
    i = wp.tid()
    lower, upper, store = lowers[i], uppers[i], depth == LEAVES
    outer = tree.grids[0]
    cells = cells_of(outer.shape, lower, upper)
    for a in range(int(number_of(cells))):
        cell = cell_at(outer, place(cells, a))
        one = tree.inside[cell]
        if one == 0:
            if store or depth == 0:
                enter(tree, 0, cell, i, store, begins)
        else:
            middle = tree.grids[one]
            some = cells_of(middle.shape, lower, upper)
            for b in range(int(number_of(some))):
                within = cell_at(middle, place(some, b))
                two = tree.inside[within]
                if two == 0:
                    if store or depth == 1:
                        enter(tree, one, within, i, store, begins)
                else:
                    inner = tree.grids[two]
                    few = cells_of(inner.shape, lower, upper)
                    for c in range(int(number_of(few))):
                        enter(tree, two, cell_at(inner, place(few, c)), i, store, begins)
