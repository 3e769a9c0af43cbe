# SPDX-License-Identifier: Apache-2.0
"""Where a triangle begins its way through the ray tree: the runs of leaves whose cells it may touch.

For each cube face that has rays the triangle is projected onto the face. If all its corners are in front of the face,
it lies within the bounds of their (u, v), since each point of its cone is a convex combination of corners; if none is,
it cannot touch the face; if some are, it may touch anything there. Bounds become cells by the same monotone expression
that rays go through (``keys.cell_of``), at the level of the curve where they cover at most two by two; a cell of any
level is a contiguous range of keys, and the lookup table knows where its rays are.

Corners are float32: within u relative and 2^-46 R of exact, R = 1 + the corner's magnitude. With a distance in front of
the face of at least 2^-18 R, (u, v) is within 2^-27 (1 + |u|) + 3 u of exact; bounds are padded by 2^-20 (1 + |u|).
"""

from __future__ import annotations

# C++ for native functions. It expects `tree` (boxes.RayTree), `inverse_mode` and the four functions' arguments, and
# defines:
# Seen: what is known of a triangle on one face;
# look(a, b, c, size, face, seen): false if the triangle cannot touch the face;
# runs(seen, face, run): fills run with pairs of first and last leaf, ascending and disjoint; returns how many.
CELLS = r"""
    struct Seen {
        bool bounded;           // low, high and nearest mean something
        float low[3], high[3];  // of the direction on the face
        float nearest;          // the largest depth t of the triangle
    };
    auto least3 = [](float x, float y, float z) { const float m = x < y ? x : y; return m < z ? m : z; };
    auto most3 = [](float x, float y, float z) { const float m = x > y ? x : y; return m > z ? m : z; };
    // The faces it may touch, as bits: of each face axis it must reach a positive value, and one as large as the least
    // absolute value of the other axes. Margins are many times the error of corners.
    auto faces = [&](const wp::vec4& a, const wp::vec4& b, const wp::vec4& c, float size) -> int {
        float high[3], low[3], least[3];
        for (int k = 0; k < 3; ++k) {
            low[k] = least3(a[k], b[k], c[k]);
            high[k] = most3(a[k], b[k], c[k]);
            least[k] = (low[k] > 0.0f ? low[k] : high[k] < 0.0f ? -high[k] : 0.0f) - 0x1p-20f * size;
        }
        const float side[3] = { least[1] > least[2] ? least[1] : least[2], least[2] > least[0] ? least[2] : least[0],
                                least[0] > least[1] ? least[0] : least[1] };
        int bits = 0;
        for (int k = 0; k < 3; ++k) {
            const float limit = side[k] > -0x1p-40f * size ? side[k] : -0x1p-40f * size;
            bits |= (!(high[k] < limit) ? 1 : 0) << 2 * k;
            bits |= (!(-low[k] < limit) ? 2 : 0) << 2 * k;
        }
        return bits;
    };
    auto look = [&](const wp::vec4& a, const wp::vec4& b, const wp::vec4& c, float size, int face,
                    Seen& seen) -> bool {
        const int axis = face >> 1, first = (axis + 1) % 3, second = (axis + 2) % 3;
        const float sign = face & 1 ? -1.0f : 1.0f;
        const float ma = sign * a[axis], mb = sign * b[axis], mc = sign * c[axis];
        const float front = least3(ma, mb, mc);
        seen.bounded = false;
        if (!(front > 0x1p-18f * size))
            return true;
        const wp::vec4 grid = tree.fit.data[face];
        const float ia = 1.0f / ma, ib = 1.0f / mb, ic = 1.0f / mc;
        const float ua = a[first] * ia, ub = b[first] * ib, uc = c[first] * ic;
        const float va = a[second] * ia, vb = b[second] * ib, vc = c[second] * ic;
        float u0 = least3(ua, ub, uc), u1 = most3(ua, ub, uc), v0 = least3(va, vb, vc), v1 = most3(va, vb, vc);
        u0 -= 0x1p-20f * (1.0f + fabsf(u0));
        v0 -= 0x1p-20f * (1.0f + fabsf(v0));
        u1 += 0x1p-20f * (1.0f + fabsf(u1));
        v1 += 0x1p-20f * (1.0f + fabsf(v1));
        // Rays lie from the lowest u of the face to one square of cells further; nothing beyond can touch them.
        if (u1 < grid[0] || v1 < grid[1] || (u0 - grid[0]) * grid[2] > 16400.0f || (v0 - grid[1]) * grid[2] > 16400.0f)
            return false;
        seen.bounded = true;
        seen.low[axis] = seen.high[axis] = sign;
        seen.low[first] = u0;
        seen.high[first] = u1;
        seen.low[second] = v0;
        seen.high[second] = v1;
        // t is 1/|h| or Z/|h|, and |h| on this triangle is at least the least distance in front of the face.
        float nearest = 1.0f / front;
        if (!inverse_mode) {
            const float z = most3(a[3], b[3], c[3]);
            nearest = z / front;
            if (z < 0.0f)
                // The other way round: the larger |h|, the larger a negative t.
                nearest = z / most3(most3(fabsf(a[0]), fabsf(a[1]), fabsf(a[2])),
                                    most3(fabsf(b[0]), fabsf(b[1]), fabsf(b[2])),
                                    most3(fabsf(c[0]), fabsf(c[1]), fabsf(c[2])));
        }
        seen.nearest = nearest + 0x1p-18f * (1.0f + fabsf(nearest));
        return true;
    };
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
        int x0 = cell(seen.low[first], grid[0], grid[2]), x1 = cell(seen.high[first], grid[0], grid[2]);
        int y0 = cell(seen.low[second], grid[1], grid[2]), y1 = cell(seen.high[second], grid[1], grid[2]);
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
