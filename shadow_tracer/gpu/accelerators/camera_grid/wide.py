# SPDX-License-Identifier: Apache-2.0
"""``hit.trace_pixels`` for the CPU: sixteen rays at a time, 8 x 2 pixels of an 8 x 8 tile."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.camera_grid.bins import COVER
from shadow_tracer.gpu.accelerators.camera_grid.hit import COMPARED, EXACT, HIT, RETESTED, TESTS, Image, Sorted
from shadow_tracer.gpu.accelerators.camera_grid.setup import Grid
from shadow_tracer.gpu.exact.decision import SIXTEEN

TILE = 8
"""The side of a tile [px]; a constant of the code below."""

# A pixel outside the image has bounds of infinity: no triangle is nearer. Lanes that float32 leaves open are finished
# one by one. The bound of a tile is that of its outermost ray, so it differs from what `visit` uses: both are right.
_TRACE = (
    HIT + f"const int column_tests = {TESTS}, column_retested = {RETESTED}, column_exact = {EXACT}, "
    f"column_compared = {COMPARED};\n"
    + COVER
    + SIXTEEN
    + r"""
    const float infinity = 3.402823466e38f * 2.0f, nan = infinity - infinity;
    const float* packed = (const float*)records.data;
    const int width = grid.width, height = grid.height, row0 = 8 * tile_y, rows = height - row0 < 8 ? height - row0 : 8;
    wp::int64 tests = 0, retested = 0, compared = 0;
    int column0, columns;
    // The tile's pixels, row by row: bounds of the inverse depth of the closest triangle, and the triangle.
    alignas(64) float x[16], y[64], low[64], high[64];
    alignas(64) int best[64];
    auto wide = [](float* at) -> Sixteen& { return *(Sixteen*)at; };
    for (int j = 0; j < 64; ++j)
        y[j] = grid.rows.data[row0 + j / 8];
    auto begin = [&]() {
        for (int j = 0; j < 16; ++j)
            x[j] = grid.columns.data[column0 + (j & 7)];
        for (int j = 0; j < 64; ++j) {
            best[j] = -1;
            low[j] = high[j] = -infinity;
        }
        if (rows == 8 && columns == 8 && !further)
            return;
        for (int j = 0; j < 64; ++j) {
            if (j / 8 >= rows || j % 8 >= columns) {
                low[j] = high[j] = infinity;
                continue;
            }
            best[j] = further ? image.triangle.data[(row0 + j / 8) * width + column0 + j % 8] : -1;
            if (best[j] >= 0) {
                const float* record = packed + 16 * (size_t)best[j];
                const float q = record[12] * x[j % 8] + (record[13] * y[j] + record[14]);
                const float slack = record[7] * (fabsf(x[j % 8]) + fabsf(y[j]) + 2.0f);
                low[j] = q - slack;
                high[j] = q + slack;
            }
        }
    };
    auto finish = [&](int pixel, int triangle, bool sure, float q, float slack) {
        double d[3];
        direction(grid.columns64.data[column0 + pixel % 8], grid.rows64.data[row0 + pixel / 8], d);
        if (!sure) {
            ++retested;
            if (!meets(triangle, d))
                return;
        }
        const int other = best[pixel];
        if (!(q - slack > high[pixel]) && other >= 0) {
            ++compared;
            if (!nearer(depth_at(triangle, d), triangle, depth_at(other, d), other))
                return;
        }
        best[pixel] = triangle;
        low[pixel] = q - slack;
        high[pixel] = q + slack;
    };
    float magnitude;
    auto visit = [&](int triangle) {
#pragma clang fp contract(fast)
        const float* n = packed + 16 * (size_t)triangle;
        const float bound = n[3] * magnitude, slack = n[7] * magnitude;
        const Sixteen X = wide(x);
        tests += columns * rows;
        for (int g = 0; 2 * g < rows; ++g) {
            const Sixteen Y = wide(y + 16 * g);
            const Sixteen e0 = n[0] * X + (n[1] * Y + n[2]);
            const Sixteen e1 = n[4] * X + (n[5] * Y + n[6]);
            const Sixteen e2 = n[8] * X + (n[9] * Y + n[10]);
            const Sixteen e01 = e0 < e1 ? e0 : e1, e = e01 < e2 ? e01 : e2;
            const SixteenInts may = e >= -bound;
            if (bits(may) == 0)
                continue;
            Sixteen &least = wide(low + 16 * g), &most = wide(high + 16 * g);
            const Sixteen q = n[12] * X + (n[13] * Y + n[14]);
            const SixteenInts open = may & ~(q + slack < least) & (least < infinity);
            const int left = bits(open);
            if (left == 0)
                continue;
            const SixteenInts inside = e > bound, taken = open & inside & (q - slack > most);
            SixteenInts& id = *(SixteenInts*)(best + 16 * g);
            id = taken ? triangle : id;
            least = taken ? q - slack : least;
            most = taken ? q + slack : most;
            const int certain = bits(inside);
            for (int rest = left & ~bits(taken); rest; rest &= rest - 1) {
                const int lane = __builtin_ctz(rest);
                finish(16 * g + lane, triangle, certain >> lane & 1, q[lane], slack);
            }
        }
    };
    auto write = [&]() {
        double way[3][8], plane[6][8];
        float depth[8];
        for (int r = 0; r < rows; ++r) {
            const double v = grid.rows64.data[row0 + r];
            const int* id = best + 8 * r;
            for (int c = 0; c < 8; ++c)
                for (int k = 0; k < 3; ++k)
                    way[k][c] = add(add(mul(grid.right[k], grid.columns64.data[column0 + c]), mul(grid.down[k], v)),
                                    grid.forward[k]);
            for (int c = 0; c < 8; ++c)
                for (int k = 0; k < 6; ++k)
                    plane[k][c] = planes.data[6 * (size_t)(id[c] < 0 ? 0 : id[c]) + k];
            for (int c = 0; c < 8; ++c) {
                const double along
                    = add(add(mul(plane[0][c], way[0][c]), mul(plane[1][c], way[1][c])), mul(plane[2][c], way[2][c]));
                const double t = measured(between(absolute(plane[3][c] / along), plane[4][c], plane[5][c]));
                depth[c] = id[c] < 0 ? nan : (float)t;
            }
            const size_t at = (size_t)(row0 + r) * width + column0;
            memcpy(image.depth.data + at, depth, 4 * columns);
            memcpy(image.triangle.data + at, id, 4 * columns);
        }
    };
    for (int tile_x = 0; tile_x < grid.tiles_x; ++tile_x) {
        column0 = 8 * tile_x;
        columns = width - column0 < 8 ? width - column0 : 8;
        begin();
        const float x0 = fabsf(x[0]), x1 = fabsf(x[7]), y0 = fabsf(y[0]), y1 = fabsf(y[63]);
        magnitude = (x0 > x1 ? x0 : x1) + (y0 > y1 ? y0 : y1) + 2.0f;
        const int fine = tile_y * grid.tiles_x + tile_x;
        const int coarse = grid.tiles_x * grid.tiles_y + tile_y / grid.group * grid.coarse_x + tile_x / grid.group;
        for (int k = starts.data[fine]; k < starts.data[fine + 1]; ++k)
            visit(lists.data[k]);
        for (int k = starts.data[coarse]; k < starts.data[coarse + 1]; ++k) {
            const int triangle = lists.data[k];
            if (may_meet(packed + 16 * (size_t)triangle, column0, column0 + 7, row0, row0 + 7))
                visit(triangle);
        }
        write();
    }
    wp::int64* counter = counters.data + 4 * (tile_y & 63);
    wp::atomic_add(counter + column_tests, tests);
    wp::atomic_add(counter + column_retested, retested);
    wp::atomic_add(counter + column_exact, (wp::int64)exact_used);
    wp::atomic_add(counter + column_compared, compared);
"""
)


# For CUDA the body is left out: no kernel launches it there.
@wp.func_native("#if !defined(__CUDA_ARCH__)\n" + _TRACE + "\n#endif\n")
def trace_row_of_tiles(
    tile_y: int,
    grid: Grid,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    planes: wp.array2d(dtype=wp.float64),
    starts: wp.array(dtype=int),
    lists: wp.array(dtype=int),
    further: int,
    image: Image,
    counters: wp.array2d(dtype=wp.int64),
):
    """Closest hits of the pixels of a row of tiles."""
    ...


@wp.kernel(enable_backward=False)
def trace_tiles(
    grid: Grid,
    scene: Sorted,
    further: int,
    image: Image,
    counters: wp.array2d(dtype=wp.int64),
):
    """One thread per row of tiles."""
    trace_row_of_tiles(
        wp.tid(),
        grid,
        scene.vertices,
        scene.triangles,
        scene.records,
        scene.planes,
        scene.starts,
        scene.lists,
        further,
        image,
        counters,
    )
