# SPDX-License-Identifier: Apache-2.0
"""Where a triangle begins its way through the ray tree: the runs of leaves whose cells it may touch.

The triangle's bounds on a cube face (``faces.py``) become cells by the same monotone expression that rays go
through (``keys.cell_of``), at the level of the curve where they cover at most two by two; a cell of any level is a
contiguous range of keys, and the lookup table knows where its rays are.
"""

from __future__ import annotations

# C++ for native functions. It expects `tree` (boxes.RayTree) and `Seen` (faces.py), and defines
# runs(seen, face, run): fills run with pairs of first and last leaf, ascending and disjoint; returns how many.
CELLS = r"""
    auto cell = [](float x, float low, float scale) -> int {
        const float y = (x - low) * scale;
        return (int)(y > 0.0f ? (y < 16383.0f ? y : 16383.0f) : 0.0f);
    };
    auto spread = [](int x) -> int {
        x = (x | (x << 8)) & 0x00FF00FF;
        x = (x | (x << 4)) & 0x0F0F0F0F;
        x = (x | (x << 2)) & 0x33333333;
        return (x | (x << 1)) & 0x55555555;
    };
    auto runs = [&](const Seen& seen, int face, int* run) -> int {
        const int bits = tree.table_bits;
        const int* table = tree.table.data + ((size_t)face << (2 * bits));
        const int leaf = tree.log_leaf;
        if (!seen.bounded) {
            const int from = table[0], to = table[(size_t)1 << (2 * bits)];
            run[0] = from >> leaf;
            run[1] = (to - 1) >> leaf;
            return from < to ? 1 : 0;
        }
        const wp::vec4 grid = tree.fit.data[face];
        const int axis = face >> 1, first = (axis + 1) % 3, second = (axis + 2) % 3;
        const float u0 = seen.low[first], u1 = seen.high[first], v0 = seen.low[second], v1 = seen.high[second];
        // Rays lie from the lowest u of the face to one square of cells further; nothing beyond can touch them.
        if (u1 < grid[0] || v1 < grid[1] || (u0 - grid[0]) * grid[2] > 16400.0f || (v0 - grid[1]) * grid[2] > 16400.0f)
            return 0;
        int x0 = cell(u0, grid[0], grid[2]), x1 = cell(u1, grid[0], grid[2]);
        int y0 = cell(v0, grid[1], grid[2]), y1 = cell(v1, grid[1], grid[2]);
        int level = 14 - bits;
        while ((x1 >> level) - (x0 >> level) > 1 || (y1 >> level) - (y0 >> level) > 1)
            ++level;
        x0 >>= level; x1 >>= level; y0 >>= level; y1 >>= level;
        const int up = 2 * (level - (14 - bits));
        int codes[4];
        int n = 0;
        codes[n++] = spread(x0) | (spread(y0) << 1);
        if (x1 > x0)
            codes[n++] = spread(x1) | (spread(y0) << 1);
        if (y1 > y0) {
            codes[n++] = spread(x0) | (spread(y1) << 1);
            if (x1 > x0)
                codes[n++] = spread(x1) | (spread(y1) << 1);
        }
        if (n == 4 && codes[1] > codes[2]) {
            const int swap = codes[1];
            codes[1] = codes[2];
            codes[2] = swap;
        }
        int count = 0;
        for (int k = 0; k < n; ++k) {
            const int from = table[(size_t)codes[k] << up], to = table[((size_t)codes[k] + 1) << up];
            if (from >= to)
                continue;
            const int first_leaf = from >> leaf, last_leaf = (to - 1) >> leaf;
            if (count > 0 && first_leaf <= run[2 * count - 1] + 1) {
                run[2 * count - 1] = last_leaf > run[2 * count - 1] ? last_leaf : run[2 * count - 1];
            } else {
                run[2 * count] = first_leaf;
                run[2 * count + 1] = last_leaf;
                ++count;
            }
        }
        return count;
    };
"""
