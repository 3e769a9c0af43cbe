# SPDX-License-Identifier: Apache-2.0
"""THE test of a pixel's ray and a triangle, and the closest hit of a tile's rays, one ray per thread.

The ray of a pixel is o + t d: o the optical centre as given, d = (R0 x + R1 y) + R2 with x = (column - cx) / fx and y =
(row - cy) / fy, or x and y of the camera's table, every operation rounded to float64 and none fused. o and d are taken
as exact, as the corners are.

It meets a triangle iff d lies in the closed cone of the triangle: with the exact determinants D = det[o - a, b - a, c -
a] and E_ab = det[d, o - a, b - a] (and cyclic), iff D is not zero and no D E is negative. E_bc / D is a's share in d =
sum of shares times corners, so t > 0 follows and needs no test: there is no near plane. A triangle seen exactly
edge-on, without area, or with a corner that is not finite has D = 0 and is not met.

The hit's depth is t, in float64 without contraction from the triangle's plane, kept between the depths of its corners.
The least depth wins, of equal ones the least triangle index: that does not depend on the order in which triangles come.

float32 answers what it can: edges n . h > s_e m sure, n . h < -s_e m no (``docs/exactness.md`` section 3), and inverse
depths that are more than s_q m away from each other (``setup.py``). Of a ray's best triangle the filter keeps
the two bounds of its inverse depth.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.camera_grid.bins import COVER
from shadow_tracer.gpu.accelerators.camera_grid.setup import Grid
from shadow_tracer.gpu.exact.determinant import ARITHMETIC, DETERMINANT

_DEPTH = r"""
    auto direction = [&](double x, double y, double* d) {
        for (int k = 0; k < 3; ++k)
            d[k] = add(add(mul(grid.right[k], x), mul(grid.down[k], y)), grid.forward[k]);
    };
    // NaN becomes the nearest corner's.
    auto between = [](double t, double low, double high) {
        t = t > low ? t : low;
        return t < high ? t : high;
    };
    auto depth_at = [&](int triangle, const double* d) {
        const double* plane = planes.data + 6 * (size_t)triangle;
        const double along = add(add(mul(plane[0], d[0]), mul(plane[1], d[1])), mul(plane[2], d[2]));
        return between(absolute(plane[3] / along), plane[4], plane[5]);
    };
    // As a measurement: a positive and finite float32, whatever the hit.
    auto measured = [](double t) {
        t = t > 1.0e-37 ? t : 1.0e-37;
        return (float)(t < 3.0e38 ? t : 3.0e38);
    };
"""
DEPTH = ARITHMETIC + _DEPTH

# meets(triangle, d): exact; nearer(t1, i1, t2, i2). For functions with `grid`, `vertices`, `triangles` and `planes`.
HIT = (
    DETERMINANT
    + _DEPTH
    + r"""
    auto meets = [&](int triangle, const double* d) -> bool {
        const wp::vec3i corner = triangles.data[triangle];
        const vec3d v[3] = { vertices.data[corner[0]], vertices.data[corner[1]], vertices.data[corner[2]] };
        const vec3d o = grid.position;
        int facing = 0;
        // One call in a loop that stays a loop, or compilers inline the expansion arithmetic four times.
#pragma unroll 1
        for (int question = 0; question < 4; ++question) {
            const int k = question == 0 ? 0 : question - 1;
            const wp::vec4d q = question == 0 ? wp::vec4d(o[0], o[1], o[2], 1.0) : wp::vec4d(d[0], d[1], d[2], 0.0);
            const vec3d r = question == 0 ? v[1] : o, s = question == 0 ? v[2] : v[(k + 1) % 3];
            double value;
            const int side = determinant(q, r, s, v[k], value);
            if (question == 0)
                facing = side;
            if (question == 0 ? side == 0 : side * facing < 0)
                return false;
        }
        return true;
    };
    auto nearer = [](double t1, int i1, double t2, int i2) { return t1 < t2 || (t1 == t2 && i1 < i2); };
"""
)


@wp.func_native(
    HIT
    + r"""
    double d[3];
    direction(x, y, d);
    const int met = meets(triangle, d) ? 1 : 0;
    return met | exact_used << 1;
    """
)
def ray_meets(
    grid: Grid,
    x: wp.float64,
    y: wp.float64,
    triangle: int,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    planes: wp.array2d(dtype=wp.float64),
) -> int:
    """Bit 0: whether a ray meets a triangle, exact; the other bits count expansion arithmetic."""
    ...


@wp.func_native(DEPTH + "double d[3]; direction(x, y, d); return depth_at(triangle, d);")
def hit_depth(
    grid: Grid, x: wp.float64, y: wp.float64, triangle: int, planes: wp.array2d(dtype=wp.float64)
) -> wp.float64:
    """Depth of a hit [m]."""
    ...


@wp.func_native(DEPTH + "double d[3]; direction(x, y, d); return measured(depth_at(triangle, d));")
def measured_depth(
    grid: Grid, x: wp.float64, y: wp.float64, triangle: int, planes: wp.array2d(dtype=wp.float64)
) -> float:
    """Depth of a hit as it is handed out: positive and finite float32 [m]."""
    ...


@wp.struct
class Sorted:
    """The triangles of the scene and the tiles' lists of them."""

    vertices: wp.array(dtype=wp.vec3d)
    triangles: wp.array(dtype=wp.vec3i)
    records: wp.array2d(dtype=wp.vec4)
    planes: wp.array2d(dtype=wp.float64)
    starts: wp.array(dtype=int)  # of each tile's list, the coarse tiles behind the others
    lists: wp.array(dtype=int)


@wp.struct
class Image:
    """Where the answer goes. ``triangle`` is also what a further pass goes on with."""

    depth: wp.array(dtype=float)
    triangle: wp.array(dtype=int)


@wp.struct
class Best:
    """The closest triangle so far, bounds of its inverse depth, and what was done to find it."""

    triangle: int
    low: float
    high: float
    tests: int
    retested: int
    exact: int
    compared: int


@wp.func
def inverse_depth(record: wp.vec4, x: float, y: float) -> float:
    return record[0] * x + (record[1] * y + record[2])


@wp.func
def ray_x(grid: Grid, column: int, ray: wp.vec2) -> wp.float64:
    if grid.tabled != 0:
        return wp.float64(ray[0])
    return grid.columns64[column]


@wp.func
def ray_y(grid: Grid, row: int, ray: wp.vec2) -> wp.float64:
    if grid.tabled != 0:
        return -wp.float64(ray[1])
    return grid.rows64[row]


@wp.func
def visit(grid: Grid, scene: Sorted, column: int, row: int, ray: wp.vec2, triangle: int, best: Best) -> Best:
    """One ray, one triangle; ``ray`` is x and -y in float32."""
    x = ray[0]
    y = ray[1]
    magnitude = wp.abs(x) + wp.abs(y) + 2.0
    ab = scene.records[triangle, 0]
    bc = scene.records[triangle, 1]
    ca = scene.records[triangle, 2]
    bound = ab[3] * magnitude
    e = wp.min(
        wp.min(ab[0] * x + (ab[1] * y + ab[2]), bc[0] * x + (bc[1] * y + bc[2])), ca[0] * x + (ca[1] * y + ca[2])
    )
    best.tests += 1
    if e < -bound:
        return best
    q = inverse_depth(scene.records[triangle, 3], x, y)
    slack = bc[3] * magnitude
    if q + slack < best.low:
        return best
    if not e > bound:
        u = ray_x(grid, column, ray)
        met = ray_meets(grid, u, ray_y(grid, row, ray), triangle, scene.vertices, scene.triangles, scene.planes)
        best.retested += 1
        best.exact += met >> 1
        if (met & 1) == 0:
            return best
    if not q - slack > best.high and best.triangle >= 0:
        best.compared += 1
        across = ray_x(grid, column, ray)
        down = ray_y(grid, row, ray)
        mine = hit_depth(grid, across, down, triangle, scene.planes)
        other = hit_depth(grid, across, down, best.triangle, scene.planes)
        if mine > other or (mine == other and triangle >= best.triangle):
            return best
    best.triangle = triangle
    best.low = q - slack
    best.high = q + slack
    return best


@wp.func
def begin_with(scene: Sorted, triangle: int, ray: wp.vec2) -> Best:
    """A triangle that a pass before has found, -1 if it has found none."""
    best = Best()
    best.triangle = triangle
    best.low = float(-wp.inf)
    best.high = float(-wp.inf)
    if triangle >= 0:
        q = inverse_depth(scene.records[triangle, 3], ray[0], ray[1])
        slack = scene.records[triangle, 1][3] * (wp.abs(ray[0]) + wp.abs(ray[1]) + 2.0)
        best.low = q - slack
        best.high = q + slack
    return best


@wp.func_native(
    COVER
    + r"""
    const int column = tile_x * grid.tile, row = tile_y * grid.tile, last = grid.tile - 1;
    return may_meet((const float*)records.data + 16 * (size_t)triangle, column, column + last, row, row + last);
    """
)
def tile_may_meet(grid: Grid, records: wp.array2d(dtype=wp.vec4), triangle: int, tile_x: int, tile_y: int) -> bool:
    """False if no ray of a sorting tile meets a triangle of its coarse tile."""
    ...


@wp.kernel(enable_backward=False)
def trace_pixels(
    block: int,
    grid: Grid,
    scene: Sorted,
    further: int,
    image: Image,
    counters: wp.array2d(dtype=wp.int64),
):
    """One thread per pixel, ordered by tracing block of ``block`` x ``block`` sorting tiles and by sorting tile
    within: the threads of a warp share a list, and those of a thread block a few."""
    number = wp.tid()
    in_tile = grid.tile * grid.tile
    pixel = number % in_tile
    tile = number // in_tile
    inner = tile % (block * block)
    outer = tile // (block * block)
    across = (grid.tiles_x + block - 1) // block
    tile_x = (outer % across) * block + inner % block
    tile_y = (outer // across) * block + inner // block
    column = tile_x * grid.tile + pixel % grid.tile
    row = tile_y * grid.tile + pixel // grid.tile
    if column >= grid.width or row >= grid.height:
        return
    at = row * grid.width + column
    ray = wp.vec2(0.0, 0.0)
    if grid.tabled != 0:
        # Neighbours in the image mostly lie in the same tile here, too.
        tile = grid.tile_of[at]
        if tile < 0:
            image.triangle[at] = -1
            image.depth[at] = float(wp.nan)
            return
        tile_x = tile % grid.tiles_x
        tile_y = tile // grid.tiles_x
        ray = wp.vec2(grid.table[at][0], -grid.table[at][1])
    else:
        ray = wp.vec2(grid.columns[column], grid.rows[row])
    before = int(-1)
    if further != 0:
        before = image.triangle[at]
    best = begin_with(scene, before, ray)
    fine = tile_y * grid.tiles_x + tile_x
    coarse = grid.tiles_x * grid.tiles_y + (tile_y // grid.group) * grid.coarse_x + tile_x // grid.group
    # Both lists in one loop, so that the exact decision is compiled once.
    mine = scene.starts[fine + 1] - scene.starts[fine]
    for k in range(mine + scene.starts[coarse + 1] - scene.starts[coarse]):
        triangle = int(0)
        if k < mine:
            triangle = scene.lists[scene.starts[fine] + k]
        else:
            triangle = scene.lists[scene.starts[coarse] + k - mine]
        if k < mine or tile_may_meet(grid, scene.records, triangle, tile_x, tile_y):
            best = visit(grid, scene, column, row, ray, triangle, best)
    image.triangle[at] = best.triangle
    image.depth[at] = float(wp.nan)
    if best.triangle >= 0:
        u = ray_x(grid, column, ray)
        image.depth[at] = measured_depth(grid, u, ray_y(grid, row, ray), best.triangle, scene.planes)
    add_counts(best, number, counters)


# Columns of the counters.
TESTS = wp.constant(0)
RETESTED = wp.constant(1)
EXACT = wp.constant(2)
COMPARED = wp.constant(3)
COUNTERS = ("tests", "retested", "exact", "compared")


@wp.func
def add_counts(best: Best, number: int, counters: wp.array2d(dtype=wp.int64)):
    row = number & 63
    wp.atomic_add(counters, row, TESTS, wp.int64(best.tests))
    if best.retested > 0:
        wp.atomic_add(counters, row, RETESTED, wp.int64(best.retested))
    if best.exact > 0:
        wp.atomic_add(counters, row, EXACT, wp.int64(best.exact))
    if best.compared > 0:
        wp.atomic_add(counters, row, COMPARED, wp.int64(best.compared))


def threads_of(grid: Any, block: int) -> int:
    """Threads that ``trace_pixels`` takes."""
    return int(-(-grid.tiles_x // block) * -(-grid.tiles_y // block) * (block * grid.tile) ** 2)
