# SPDX-License-Identifier: Apache-2.0
"""Triangles into the tiles of a camera's perspective grid: (tile, triangle) entries by count, scan and emit.

There are two sizes of tiles, so that no triangle has many entries: one whose bounds touch more sorting tiles than a
coarse tile holds is listed in coarse tiles instead; a sorting tile is shown its own list and that of the coarse tile
around it.

A tile gets a triangle unless no ray of it can meet it. Two tests say so, both with pads that hold every rounding. The
bounds of the triangle's corners on the image, where all corners are in front: the corners are float32 within u
relative and 2^-46 R of exact (``corners.py``), R = 1 + the largest magnitude, so with a depth of at least 2^-18 R the
quotients are within 2^-28 (1 + |x|) + 4 u |x|, and the pad is 2^-20 (1 + |x|), and the like for the arithmetic in
pixels. And the packed record's edges: a ray that meets the triangle has n . h >= 0 on each, n . h is largest at a
corner of the tile, and evaluating it there is off by no more than at the ray: s_e m.

Entries are numbered triangle by triangle. With more of them than ``grid_entries`` a frame takes several passes, each
with the next ``grid_entries`` of them.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.camera_grid.grid import Grid
from shadow_tracer.gpu.device import native


@native.func_native("accelerators/camera_grid/binning.h", calls="Binning::count")
def entries_of(
    triangle: int,
    grid: Grid,
    triangles: wp.array(dtype=wp.vec3i),
    corners: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
) -> int:
    """Number of entries of a triangle."""
    ...


@wp.kernel(enable_backward=False)
def count_entries(
    grid: Grid,
    triangles: wp.array(dtype=wp.vec3i),
    corners: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    counts: wp.array(dtype=wp.int64),
):
    i = wp.tid()
    counts[i] = wp.int64(entries_of(i, grid, triangles, corners, records))


@native.func_native("accelerators/camera_grid/binning.h", calls="Binning::emit")
def emit_triangle(
    triangle: int,
    begin: wp.int64,
    first: wp.int64,
    grid: Grid,
    triangles: wp.array(dtype=wp.vec3i),
    corners: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    pairs: wp.array(dtype=wp.vec2i),
    tiles: wp.array(dtype=int),
):
    """Writes those entries of a triangle, numbered from ``begin`` on, that fall into the pass that starts with number
    ``first``, and counts them in their tiles."""
    ...


@wp.kernel(enable_backward=False)
def emit_entries(
    first: wp.int64,
    grid: Grid,
    triangles: wp.array(dtype=wp.vec3i),
    corners: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    ends: wp.array(dtype=wp.int64),
    pairs: wp.array(dtype=wp.vec2i),
    tiles: wp.array(dtype=int),
):
    """Entries of all triangles; ``ends`` are the inclusive sums of their numbers."""
    i = wp.tid()
    begin = wp.int64(0)
    if i > 0:
        begin = ends[i - 1]
    if ends[i] > begin and ends[i] > first and begin < first + wp.int64(pairs.shape[0]):
        emit_triangle(i, begin, first, grid, triangles, corners, records, pairs, tiles)


@wp.kernel(enable_backward=False)
def fill_lists(
    first: wp.int64,
    stride: int,
    last_triangle: int,
    ends: wp.array(dtype=wp.int64),
    pairs: wp.array(dtype=wp.vec2i),
    tile_ends: wp.array(dtype=int),
    lists: wp.array(dtype=int),
):
    """Puts every pair of the pass into its tile's list. ``tile_ends`` are inclusive sums, and become the starts of the
    lists. The order within a list varies and does not matter."""
    count = int(wp.min(ends[last_triangle] - first, wp.int64(pairs.shape[0])))
    for k in range(wp.tid(), count, stride):
        pair = pairs[k]
        lists[wp.atomic_sub(tile_ends, pair[0], 1) - 1] = pair[1]


@native.func_native("accelerators/camera_grid/in_order.h", calls="InOrder::bin")
def bin_in_order(
    count: int,
    grid: Grid,
    triangles: wp.array(dtype=wp.vec3i),
    corners: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    pairs: wp.array(dtype=wp.vec2i),
    tiles: wp.array(dtype=int),
    lists: wp.array(dtype=int),
    cursor: wp.array(dtype=int),
):
    """All of a pass in one thread. ``cursor``: the triangle to go on with, how many of its entries are done, entries of
    this pass."""
    ...


@wp.kernel(enable_backward=False)
def bin_triangles(
    count: int,
    grid: Grid,
    triangles: wp.array(dtype=wp.vec3i),
    corners: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    pairs: wp.array(dtype=wp.vec2i),
    tiles: wp.array(dtype=int),
    lists: wp.array(dtype=int),
    cursor: wp.array(dtype=int),
):
    bin_in_order(count, grid, triangles, corners, records, pairs, tiles, lists, cursor)
