# SPDX-License-Identifier: Apache-2.0
"""Cells of a binary space partition, and the kernels that split those of a level."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.references import LEAF, Growth, make_cell, make_children, pass_on_to, place_of
from shadow_tracer.gpu.accelerators.segment import along
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
    """The cells of a level, with ``room`` for so many. ``picked``: of each the triangle with the least random number.
    ``sides``: of either plane, that of the triangle first, how many triangles either half gets; then, of the first two,
    the places of these (``Growth.place``)."""

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
def begin(growth: Growth, root: Level):
    """The cell of the root. One thread."""
    empty_cell(root, 0, 0, growth.used[0])


@wp.kernel(enable_backward=False)
def pick(level: int, growth: Growth, here: Level):
    """A triangle of each cell, any one. One thread for each reference."""
    r = wp.tid()
    place = place_of(growth, level, r)
    if place < 0:
        return
    triangle = growth.triangle[r]
    number = wp.int64(wp.randi(wp.rand_init(level, triangle), 0, 0x7FFFFFFF))
    wp.atomic_min(here.picked, place, number * wp.int64(0x80000000) + wp.int64(triangle))


@wp.kernel(enable_backward=False)
def make_planes(level: int, tree: Structure, growth: Growth, here: Level):
    """The two planes of each cell: through the triangle that was picked, and through its first corner across an axis.
    One thread for each cell."""
    place = wp.tid()
    if place >= wp.min(growth.cells[level], here.room):
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
def count_halves(level: int, tree: Structure, growth: Growth, here: Level):
    """How many triangles either half of either plane gets. One thread for each reference."""
    r = wp.tid()
    place = place_of(growth, level, r)
    if place < 0:
        return
    cell = here.cells[place]
    corners = tree.triangles[growth.triangle[r]]
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
def half(growth: Growth, level: int, node: int, count: int, there: Level) -> int:
    """Make a cell below a level; returns the place of its triangles."""
    place = make_cell(growth, level, count, _FEW, there.room)
    if place < 0:
        return -1 - node
    empty_cell(there, place, node, count)
    return place


@wp.kernel(enable_backward=False)
def split_cells(level: int, tree: Structure, growth: Growth, here: Level, there: Level):
    """Split the cells where it helps, where there is room. One thread for each cell."""
    place = wp.tid()
    if place >= wp.min(growth.cells[level], here.room):
        return
    cell = here.cells[place]
    low = here.sides[place, 0]
    high = here.sides[place, 1]
    kind = TRIANGLE
    if pairs(here.sides[place, 2], here.sides[place, 3]) < pairs(low, high):
        low = here.sides[place, 2]
        high = here.sides[place, 3]
        kind = AXIS
    here.sides[place, 0] = -1 - cell.node
    if not (pairs(low, high) <= _GAIN * pairs(cell.count, 0)):
        here.sides[place, 0] = half(growth, level, cell.node, cell.count, there)  # as it is: another may be picked
        return
    first = make_children(growth, 2, low + high - cell.count, growth.room)
    if first < 0:
        return
    cell.kind = kind
    here.cells[place] = cell
    tree.nodes[cell.node] = wp.vec2i(wp.where(kind == TRIANGLE, cell.triangle, cell.axis), 4 * first + kind)
    tree.offsets[cell.node] = cell.offset
    here.sides[place, 0] = half(growth, level, first, low, there)
    here.sides[place, 1] = half(growth, level, first + 1, high, there)


@wp.kernel(enable_backward=False)
def pass_on(level: int, tree: Structure, growth: Growth, here: Level):
    """Put triangles into the halves of their cells. One thread for each reference."""
    r = wp.tid()
    place = place_of(growth, level, r)
    if place < 0:
        return
    cell = here.cells[place]
    low = here.sides[place, 0]
    high = here.sides[place, 1]
    if cell.kind == LEAF:
        growth.place[r] = low
        return
    corners = tree.triangles[growth.triangle[r]]
    a = tree.vertices[corners[0]]
    b = tree.vertices[corners[1]]
    c = tree.vertices[corners[2]]
    halves = int(0)
    if cell.kind == AXIS:
        halves = halves_across(cell.axis, cell.offset, a, b, c)
    else:
        halves = halves_beside(tree, cell.triangle, a, b, c)
    pass_on_to(growth, level, r, halves & 1 != 0, halves & 2 != 0, low, high)
