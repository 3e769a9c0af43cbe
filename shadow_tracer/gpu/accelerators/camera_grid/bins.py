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

from shadow_tracer.gpu.accelerators.camera_grid.setup import Grid

# corners_of(triangle, at): corners in the camera's frame; cover(record, at): which tiles, by bounds;
# each_tile(record, cover, visit): visit(tile) for those that the edges leave, until it returns false.
COVER = r"""
    // Never contracted: the kernels that count and that emit must find the same tiles.
    auto plus = [](float x, float y) {
#if defined(__CUDA_ARCH__)
        return __fadd_rn(x, y);
#else
#if defined(__clang__)
#pragma clang fp contract(off)
#endif
        return x + y;
#endif
    };
    auto times = [](float x, float y) {
#if defined(__CUDA_ARCH__)
        return __fmul_rn(x, y);
#else
#if defined(__clang__)
#pragma clang fp contract(off)
#endif
        return x * y;
#endif
    };
    struct Cover {
        int coarse, x0, x1, y0, y1;  // tiles of the one or the other size; none if x1 < x0
    };
    auto cover = [&](const float* record, const wp::vec4* at) -> Cover {
        const Cover none = { 0, 0, -1, 0, -1 };
        if (record[11] == 0.0f)
            return none;
        float size = 0.0f, front = 3.0e38f, back = -3.0e38f;
        for (int k = 0; k < 3; ++k) {
            const float sum = 1.0f + fabsf(at[k][0]) + fabsf(at[k][1]) + fabsf(at[k][2]) + fabsf(at[k][3]);
            size = sum > size ? sum : size;
            front = at[k][2] < front ? at[k][2] : front;
            back = at[k][2] > back ? at[k][2] : back;
        }
        if (back < -0x1p-40f * size)
            return none;
        const float right = (float)(grid.width - 1), bottom = (float)(grid.height - 1);
        float c0 = 0.0f, c1 = right, r0 = 0.0f, r1 = bottom;
        if (front > 0x1p-18f * size && size < 1.0e30f) {
            float x0 = 3.0e38f, x1 = -3.0e38f, y0 = 3.0e38f, y1 = -3.0e38f;
            for (int k = 0; k < 3; ++k) {
                const float inverse = 1.0f / at[k][2], x = times(at[k][0], inverse), y = times(-at[k][1], inverse);
                x0 = x < x0 ? x : x0;
                x1 = x > x1 ? x : x1;
                y0 = y < y0 ? y : y0;
                y1 = y > y1 ? y : y1;
            }
            const float most_x = fabsf(x0) > fabsf(x1) ? fabsf(x0) : fabsf(x1);
            const float most_y = fabsf(y0) > fabsf(y1) ? fabsf(y0) : fabsf(y1);
            const float pad_x = 0x1p-20f * plus(times(grid.fx, 1.0f + most_x), fabsf(grid.cx) + right);
            const float pad_y = 0x1p-20f * plus(times(grid.fy, 1.0f + most_y), fabsf(grid.cy) + bottom);
            x0 = plus(times(x0, grid.fx), grid.cx) - pad_x;
            x1 = plus(times(x1, grid.fx), grid.cx) + pad_x;
            y0 = plus(times(y0, grid.fy), grid.cy) - pad_y;
            y1 = plus(times(y1, grid.fy), grid.cy) + pad_y;
            if (grid.tabled) {
                // Rays are anywhere, and beyond the grid in its outermost tiles.
                auto within = [](float x, float end) { return x < 0.0f ? 0.0f : x > end ? end : x; };
                c0 = within(floorf(x0), right);
                c1 = within(floorf(x1), right);
                r0 = within(floorf(y0), bottom);
                r1 = within(floorf(y1), bottom);
            } else {
                if (x0 > right || x1 < 0.0f || y0 > bottom || y1 < 0.0f)
                    return none;
                // Between them lies no pixel centre: no ray.
                c0 = x0 > 0.0f ? ceilf(x0) : 0.0f;
                c1 = x1 < right ? floorf(x1) : right;
                r0 = y0 > 0.0f ? ceilf(y0) : 0.0f;
                r1 = y1 < bottom ? floorf(y1) : bottom;
                if (c0 > c1 || r0 > r1)
                    return none;
            }
        }
        Cover it = { 0, (int)c0 / grid.tile, (int)c1 / grid.tile, (int)r0 / grid.tile, (int)r1 / grid.tile };
        if (it.x1 >= grid.tiles_x)
            it.x1 = grid.tiles_x - 1;
        if (it.y1 >= grid.tiles_y)
            it.y1 = grid.tiles_y - 1;
        if ((wp::int64)(it.x1 - it.x0 + 1) * (it.y1 - it.y0 + 1) > grid.group * grid.group) {
            it.coarse = 1;
            it.x0 /= grid.group;
            it.x1 /= grid.group;
            it.y0 /= grid.group;
            it.y1 /= grid.group;
        }
        return it;
    };
    // Whether any ray of these columns and rows may be inside the edges of a record.
    auto may_meet = [&](const float* record, int column0, int column1, int row0, int row1) -> bool {
        // The axes of a table of rays are the edges of the tiles, those of a pinhole the rays themselves.
        const float x0 = grid.columns.data[column0], x1 = grid.columns.data[column1 + grid.tabled];
        const float y0 = grid.rows.data[row0], y1 = grid.rows.data[row1 + grid.tabled];
        const float most_x = fabsf(x0) > fabsf(x1) ? fabsf(x0) : fabsf(x1);
        const float most_y = fabsf(y0) > fabsf(y1) ? fabsf(y0) : fabsf(y1);
        const float bound = times(record[3], most_x + most_y + 2.0f);
        for (int k = 0; k < 3; ++k) {
            const float* n = record + 4 * k;
            const float e = plus(times(n[0], n[0] > 0.0f ? x1 : x0), plus(times(n[1], n[1] > 0.0f ? y0 : y1), n[2]));
            if (e < -bound)
                return false;
        }
        return true;
    };
    auto each_tile = [&](const float* record, const Cover& it, auto visit) {
        if (it.x0 == it.x1 && it.y0 == it.y1 && !it.coarse) {
            visit(it.y0 * grid.tiles_x + it.x0);
            return;
        }
        const int side = it.coarse ? grid.tile * grid.group : grid.tile;
        const int last_column = grid.tiles_x * grid.tile - 1, last_row = grid.tiles_y * grid.tile - 1;
        for (int y = it.y0; y <= it.y1; ++y) {
            const int row1 = (y + 1) * side - 1 < last_row ? (y + 1) * side - 1 : last_row;
            for (int x = it.x0; x <= it.x1; ++x) {
                const int column1 = (x + 1) * side - 1 < last_column ? (x + 1) * side - 1 : last_column;
                if (!may_meet(record, x * side, column1, y * side, row1))
                    continue;
                if (!visit(it.coarse ? grid.tiles_x * grid.tiles_y + y * grid.coarse_x + x : y * grid.tiles_x + x))
                    return;
            }
        }
    };
"""

_LOOK = (
    COVER
    + r"""
    auto look = [&](int triangle, auto visit) {
        const wp::vec3i corner = triangles.data[triangle];
        const wp::vec4 at[3] = { corners.data[corner[0]], corners.data[corner[1]], corners.data[corner[2]] };
        const float* record = (const float*)records.data + 16 * (size_t)triangle;
        const Cover it = cover(record, at);
        if (it.x0 <= it.x1)
            each_tile(record, it, visit);
    };
"""
)


@wp.func_native(
    _LOOK
    + r"""
    int count = 0;
    look(triangle, [&](int) { ++count; return true; });
    return count;
    """
)
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


@wp.func_native(
    _LOOK
    + r"""
    wp::int64 number = begin - first;
    look(triangle, [&](int tile) {
        if (number >= 0 && number < pairs.shape[0]) {
            pairs.data[number] = wp::vec2i(tile, triangle);
            wp::atomic_add(&tiles.data[tile], 1);
        }
        ++number;
        return number < pairs.shape[0];
    });
    """
)
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


# One thread of the CPU: emit until the pairs are full or the triangles at an end, then the lists, in order. cursor: the
# triangle to go on with, how many of its entries are done, entries of this pass.
@wp.func_native(
    "#if !defined(__CUDA_ARCH__)\n"
    + _LOOK
    + r"""
    const int capacity = pairs.shape[0], tile_count = tiles.shape[0];
    int n = 0, triangle = cursor.data[0], done = cursor.data[1];
    for (int k = 0; k < tile_count; ++k)
        tiles.data[k] = 0;
    for (; triangle < count; ++triangle) {
        if (triangle + 8 < count)
            __builtin_prefetch(corners.data + triangles.data[triangle + 8][0]);
        int number = 0;
        bool full = false;
        look(triangle, [&](int tile) {
            if (number >= done) {
                if (n == capacity) {
                    full = true;
                    return false;
                }
                pairs.data[n++] = wp::vec2i(tile, triangle);
                ++tiles.data[tile];
            }
            ++number;
            return true;
        });
        done = 0;
        if (full) {
            done = number;
            break;
        }
    }
    int end = 0;
    for (int k = 0; k < tile_count; ++k)
        tiles.data[k] = end += tiles.data[k];
    for (int k = n - 1; k >= 0; --k)
        lists.data[--tiles.data[pairs.data[k][0]]] = pairs.data[k][1];
    cursor.data[0] = triangle;
    cursor.data[1] = done;
    cursor.data[2] = n;
    """
    + "\n#endif\n"
)
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
    """All of a pass in one thread."""
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
