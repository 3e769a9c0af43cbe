# SPDX-License-Identifier: Apache-2.0
"""THE test of a pixel's ray and a triangle, and the closest hit of a tile's rays: one ray per thread, or on the CPU
sixteen at a time.

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
the two bounds of its inverse depth. One ray and sixteen are judged by one text (``ray_test.h``), and what that leaves
open is by another (``hit.h``).
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.camera_grid.setup import Grid
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.counters import ROWS

# The side of a tile in the CPU's form [px].
TILE = 8
# Columns of the counters.
COUNTERS = ("tests", "retested", "exact", "compared")
COUNTER_SHAPE = (ROWS, len(COUNTERS))
native.constants(CAMERA_TILE=TILE, CAMERA_TESTS=0, CAMERA_RETESTED=1, CAMERA_EXACT=2, CAMERA_COMPARED=3)


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


@native.func_native("accelerators/camera_grid/pixel.h", calls="Pixel::trace")
def closest_triangle(
    column: int,
    row: int,
    ray: wp.vec2,
    before: int,
    tile_x: int,
    tile_y: int,
    number: int,
    grid: Grid,
    scene: Sorted,
    counters: wp.array2d(dtype=wp.int64),
) -> int:
    """The closest triangle on a pixel's ``ray``, x and -y, of those in the lists of a tile and that of a pass before,
    -1 for none. ``number``: of the thread, which row of the counters it adds to."""
    ...


@native.func_native("accelerators/camera_grid/depth_plane.h", calls="DepthPlane::measured_at")
def measured_depth(
    triangle: int, x: wp.float64, y: wp.float64, grid: Grid, planes: wp.array2d(dtype=wp.float64)
) -> float:
    """Depth of a hit as it is handed out: positive and finite float32 [m]."""
    ...


@native.func_native("accelerators/camera_grid/cover.h", calls="Cover::tile_may_meet")
def tile_may_meet(triangle: int, tile_x: int, tile_y: int, grid: Grid, records: wp.array2d(dtype=wp.vec4)) -> bool:
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
    best = closest_triangle(column, row, ray, before, tile_x, tile_y, number, grid, scene, counters)
    image.triangle[at] = best
    image.depth[at] = float(wp.nan)
    if best >= 0:
        x = grid.columns64[column]
        y = grid.rows64[row]
        if grid.tabled != 0:
            x = wp.float64(ray[0])
            y = -wp.float64(ray[1])
        image.depth[at] = measured_depth(best, x, y, grid, scene.planes)


@native.func_native("accelerators/camera_grid/tiles16.h", calls="Tiles16::trace")
def trace_row_of_tiles(
    tile_y: int, further: int, grid: Grid, scene: Sorted, image: Image, counters: wp.array2d(dtype=wp.int64)
):
    """Closest hits of the pixels of a row of tiles, sixteen rays at a time: 8 x 2 pixels of an 8 x 8 tile."""
    ...


@wp.kernel(enable_backward=False)
def trace_tiles(grid: Grid, scene: Sorted, further: int, image: Image, counters: wp.array2d(dtype=wp.int64)):
    """``trace_pixels`` for the CPU: one thread per row of tiles."""
    trace_row_of_tiles(wp.tid(), further, grid, scene, image, counters)


def threads_of(grid: Any, block: int) -> int:
    """Threads that ``trace_pixels`` takes."""
    return int(-(-grid.tiles_x // block) * -(-grid.tiles_y // block) * (block * grid.tile) ** 2)
