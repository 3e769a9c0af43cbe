# SPDX-License-Identifier: Apache-2.0
"""The closest hit of a tile's rays: one ray per thread, or on the CPU sixteen at a time. ``exact/hit.py`` says what a
hit is, and which is closer."""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.camera_grid.grid import Grid
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.camera_records import CameraTriangles
from shadow_tracer.gpu.visibility.depth_image import Image

# The side of a tile in the CPU's form [px].
TILE = 8
native.constants(CAMERA_TILE=TILE)


@wp.struct
class Sorted:
    """The triangles of the scene and the tiles' lists of them."""

    seen: CameraTriangles
    starts: wp.array(dtype=int)  # of each tile's list, the coarse tiles behind the others
    lists: wp.array(dtype=int)


@native.func_native("accelerators/camera_grid/pixel.h", calls="Pixel::trace")
def trace_pixel(
    column: int,
    row: int,
    further: int,
    tile_x: int,
    tile_y: int,
    number: int,
    grid: Grid,
    scene: Sorted,
    image: Image,
    counters: wp.array2d(dtype=wp.int64),
):
    """The closest triangle on a pixel's ray, of those in the lists of a tile and, of a ``further`` pass, what the image
    has. ``number``: of the thread, which row of the counters it adds to."""
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
    if column >= grid.rays.width or row >= grid.rays.height:
        return
    if grid.rays.tabled != 0:
        # Neighbours in the image mostly lie in the same tile here, too.
        at = row * grid.rays.width + column
        tile = grid.tile_of[at]
        if tile < 0:
            image.triangle[at] = -1
            image.depth[at] = float(wp.nan)
            return
        tile_x = tile % grid.tiles_x
        tile_y = tile // grid.tiles_x
    trace_pixel(column, row, further, tile_x, tile_y, number, grid, scene, image, counters)


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
