# SPDX-License-Identifier: Apache-2.0
"""Cells of a binary space partition, and the kernels that split those of a level."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.references import LEAF, References, append, reserve
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.determinant import determinant_sign

LEVELS = 48
TRIANGLE = wp.constant(0)
AXIS = wp.constant(1)
# What values of planes may be off, in units of the magnitudes that they are sums of; bsp.py derives it.
PAD = 1e-14
native.constants(BSP_LEVELS=LEVELS, BSP_TRIANGLE=int(TRIANGLE), BSP_PAD=PAD)
_FEW = wp.constant(8)  # triangles of a cell that is not split
# Halves are to have less than this share of the pairs of triangles that the whole has.
_GAIN = wp.constant(0.95)


@wp.struct
class Structure:
    """The tree (``references.py``). Of an inner node, the second number is that of its lower half, times four, and
    the kind of its plane. The first one is a triangle, which the plane goes through: the lower half is where
    determinants with its corners are negative; or an axis, and the plane is at ``offsets`` of the node."""

    nodes: wp.array(dtype=wp.vec2i)
    offsets: wp.array(dtype=wp.float64)
    members: wp.array(dtype=int)
    vertices: wp.array(dtype=wp.vec3d)
    triangles: wp.array(dtype=wp.vec3i)


@wp.struct
class Cell:
    """A node that may be split, and how many triangles it has. Its planes: one through a triangle, and one across an
    axis at ``offset``. ``kind``: of the plane that is taken, LEAF if it is not split."""

    node: int
    count: int
    kind: int
    triangle: int
    axis: int
    offset: wp.float64


@wp.struct
class Level:
    """The cells of a level, with ``room`` for so many. ``picked``: of each the
    triangle with the least random number. ``sides``: of either plane, that of the triangle first, how many triangles
    either half gets; then, of the first two, the places of these (``References.place``)."""

    cells: wp.array(dtype=Cell)
    picked: wp.array(dtype=wp.int64)
    sides: wp.array2d(dtype=int)
    room: int


@wp.func
def empty_cell(there: Level, place: int, node: int, count: int):
    """A cell of which nothing is known."""
    cell = Cell()
    cell.node = node
    cell.count = count
    cell.kind = LEAF
    there.cells[place] = cell
    there.picked[place] = wp.int64(0x7FFFFFFFFFFFFFFF)
    for k in range(4):
        there.sides[place, k] = 0


@wp.kernel(enable_backward=False)
def begin(references: References, tree: Structure, made: wp.array(dtype=int), active: wp.array(dtype=int), root: Level):
    """The root. One thread."""
    references.reserved[0] = references.used[0]
    empty_cell(root, 0, 0, references.used[0])
    tree.nodes[0] = wp.vec2i(0, LEAF)
    made[0] = 1
    active[0] = wp.min(references.used[0], 1)  # nothing can be picked of no triangles


@wp.kernel(enable_backward=False)
def begin_level(level: int, references: References, active: wp.array(dtype=int)):
    """The next level, before anything is in it. One thread."""
    references.used[level + 1] = references.used[level]
    active[level + 1] = 0


@wp.kernel(enable_backward=False)
def pick(level: int, references: References, here: Level):
    """A triangle of each cell, any one. One thread for each reference."""
    r = wp.tid()
    if r >= references.used[level] or references.place[r] < 0:
        return
    place = references.place[r]
    triangle = references.triangle[r]
    number = wp.int64(wp.randi(wp.rand_init(level, triangle), 0, 0x7FFFFFFF))
    wp.atomic_min(here.picked, place, number * wp.int64(0x80000000) + wp.int64(triangle))


@wp.func
def along(v: wp.vec3d, axis: int) -> wp.float64:
    """A component. Not by an index: on CUDA it would put the vector into local memory."""
    return wp.where(axis == 0, v[0], wp.where(axis == 1, v[1], v[2]))


@wp.kernel(enable_backward=False)
def make_planes(level: int, tree: Structure, active: wp.array(dtype=int), here: Level):
    """The two planes of each cell: through the triangle that was picked, and through its first corner across an axis.
    One thread for each cell."""
    place = wp.tid()
    if place >= wp.min(active[level], here.room):
        return
    cell = here.cells[place]
    cell.triangle = int(here.picked[place] % wp.int64(0x80000000))
    cell.axis = level % 3
    cell.offset = along(tree.vertices[tree.triangles[cell.triangle][0]], cell.axis)
    here.cells[place] = cell


@wp.func
def sides_of(below: bool, above: bool) -> int:
    """Bit 0: in the lower half, as are those within the plane; bit 1: in the upper one."""
    return wp.where(below or not above, 1, 0) + wp.where(above, 2, 0)


@wp.func
def halves_across(axis: int, offset: wp.float64, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> int:
    """The halves that a triangle reaches into, of a plane across an axis."""
    x = along(a, axis)
    y = along(b, axis)
    z = along(c, axis)
    return sides_of(wp.min(wp.min(x, y), z) < offset, wp.max(wp.max(x, y), z) > offset)


@wp.func
def halves_beside(tree: Structure, triangle: int, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> int:
    """The same of the plane through a triangle, by exact signs."""
    corners = tree.triangles[triangle]
    o = tree.vertices[corners[0]]
    r = tree.vertices[corners[1]]
    s = tree.vertices[corners[2]]
    below = bool(False)
    above = bool(False)
    one = wp.float64(1.0)
    corner = wp.vec4d(a[0], a[1], a[2], one)
    k = int(0)
    while k < 3:  # stays a loop, or compilers inline the expansion arithmetic thrice
        sign = determinant_sign(corner, r, s, o)
        below = below or sign < 0
        above = above or sign > 0
        corner = wp.where(k == 0, wp.vec4d(b[0], b[1], b[2], one), wp.vec4d(c[0], c[1], c[2], one))
        k += 1
    return sides_of(below, above)


@wp.kernel(enable_backward=False)
def count_halves(level: int, tree: Structure, references: References, here: Level):
    """How many triangles either half of either plane gets. One thread for each reference."""
    r = wp.tid()
    if r >= references.used[level] or references.place[r] < 0:
        return
    place = references.place[r]
    cell = here.cells[place]
    corners = tree.triangles[references.triangle[r]]
    a = tree.vertices[corners[0]]
    b = tree.vertices[corners[1]]
    c = tree.vertices[corners[2]]
    halves = halves_beside(tree, cell.triangle, a, b, c) + 4 * halves_across(cell.axis, cell.offset, a, b, c)
    for k in range(4):
        if (halves >> k) & 1 != 0:
            wp.atomic_add(here.sides, place, k, 1)


@wp.func
def pairs(low: int, high: int) -> float:
    """What halves cost: pairs of triangles in one half."""
    return float(low) * float(low) + float(high) * float(high)


@wp.func
def half(node: int, count: int, next: int, active: wp.array(dtype=int), there: Level) -> int:
    """Make a cell at level ``next``; returns the place of its triangles. At no level it is a leaf, and so it is where
    there is no room for a cell more."""
    if count <= _FEW or next == 0:
        return -1 - node
    place = wp.atomic_add(active, next, 1)
    if place >= there.room:
        return -1 - node
    empty_cell(there, place, node, count)
    return place


@wp.kernel(enable_backward=False)
def make_halves(
    level: int,
    levels: int,
    room: int,
    references: References,
    tree: Structure,
    made: wp.array(dtype=int),
    active: wp.array(dtype=int),
    here: Level,
    there: Level,
):
    """Split the cells where it helps, where there is room. One thread for each cell. ``levels``, ``room``: how many
    levels and nodes may be."""
    place = wp.tid()
    if place >= wp.min(active[level], here.room):
        return
    cell = here.cells[place]
    low = here.sides[place, 0]
    high = here.sides[place, 1]
    kind = TRIANGLE
    if pairs(here.sides[place, 2], here.sides[place, 3]) < pairs(low, high):
        low = here.sides[place, 2]
        high = here.sides[place, 3]
        kind = AXIS
    next = wp.where(level + 1 < levels, level + 1, 0)
    here.sides[place, 0] = -1 - cell.node
    if not (pairs(low, high) <= _GAIN * pairs(cell.count, 0)):
        here.sides[place, 0] = half(cell.node, cell.count, next, active, there)  # as it is: another may be picked
        return
    first = wp.atomic_add(made, 0, 2)
    if first + 2 > room or not reserve(references, low + high - cell.count):
        return
    cell.kind = kind
    here.cells[place] = cell
    tree.nodes[cell.node] = wp.vec2i(wp.where(kind == TRIANGLE, cell.triangle, cell.axis), 4 * first + kind)
    tree.offsets[cell.node] = cell.offset
    tree.nodes[first] = wp.vec2i(0, LEAF)
    tree.nodes[first + 1] = wp.vec2i(0, LEAF)
    here.sides[place, 0] = half(first, low, next, active, there)
    here.sides[place, 1] = half(first + 1, high, next, active, there)


@wp.kernel(enable_backward=False)
def pass_on(level: int, tree: Structure, references: References, here: Level):
    """Put triangles into the halves of their cells. One thread for each reference."""
    r = wp.tid()
    if r >= references.used[level] or references.place[r] < 0:
        return
    place = references.place[r]
    triangle = references.triangle[r]
    cell = here.cells[place]
    low = here.sides[place, 0]
    high = here.sides[place, 1]
    references.place[r] = low
    if cell.kind == LEAF:
        return
    corners = tree.triangles[triangle]
    a = tree.vertices[corners[0]]
    b = tree.vertices[corners[1]]
    c = tree.vertices[corners[2]]
    halves = int(0)
    if cell.kind == AXIS:
        halves = halves_across(cell.axis, cell.offset, a, b, c)
    else:
        halves = halves_beside(tree, cell.triangle, a, b, c)
    if halves == 2:
        references.place[r] = high
    if halves == 3:
        append(references, level, triangle, high)
