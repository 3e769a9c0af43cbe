# SPDX-License-Identifier: Apache-2.0
"""Bounds of sixteen triangles at a time on the faces of a light: ``triangle_planes.look`` in the CPU's vector
registers, and what it rejects without looking at a record."""

from __future__ import annotations

# C++ for native functions, behind triangle_planes.TRIANGLE and shadow_test.SIXTEEN. Expects `tiles`, `occluders`,
# `place` of the light, `aligned`, and `first_corner` of the light's corners; defines:
# gather(t): takes up triangles t to t + 15 (the last one repeated), returns those there are as bits;
# bound(face): those of them that may touch the face, as bits, their bounds in `low_u` etc., `bounded` as bits.
FRONT = r"""
    float corner[3][4][16];
    Sixteen reach;
    Sixteen low_u, high_u, low_v, high_v, nearest;
    int bounded = 0, faces_of[6];
    auto larger = [](Sixteen x, Sixteen y) -> Sixteen { return x > y ? x : y; };
    auto smaller = [](Sixteen x, Sixteen y) -> Sixteen { return x < y ? x : y; };
    auto size_of = [&](Sixteen x) -> Sixteen { return larger(x, -x); };
    auto least = [&](Sixteen x, Sixteen y, Sixteen z) -> Sixteen { return smaller(smaller(x, y), z); };
    auto most = [&](Sixteen x, Sixteen y, Sixteen z) -> Sixteen { return larger(larger(x, y), z); };
    auto at = [&](int k, int component) -> Sixteen { return *(const Sixteen*)corner[k][component]; };
    auto gather = [&](int t) -> int {
        const int n = occluders.count - t < 16 ? occluders.count - t : 16;
        for (int j = 0; j < 16; ++j) {
            const wp::vec3i& of = occluders.triangles.data[t + (j < n ? j : n - 1)];
            for (int k = 0; k < 3; ++k) {
                const wp::vec4& p = occluders.corners.data[first_corner + of[k]];
                for (int c = 0; c < 4; ++c)
                    corner[k][c][j] = p[c];
            }
        }
        auto length = [&](int k) -> Sixteen {
            return size_of(at(k, 0)) + size_of(at(k, 1)) + size_of(at(k, 2)) + size_of(at(k, 3));
        };
        reach = 1.0f + most(length(0), length(1), length(2));
        // A comparison with NaN fails, and what fails is not sure to be near.
        const int all = 0xFFFF >> (16 - n), far = ~bits(reach < far_out) & 0xFFFF;
        for (int face = 0; face < 6; ++face)
            faces_of[face] = aligned ? (face == 4 ? all : 0) : all;
        if (aligned)
            return all;
        Sixteen low[3], high[3], near[3];
        for (int c = 0; c < 3; ++c) {
            low[c] = least(at(0, c), at(1, c), at(2, c));
            high[c] = most(at(0, c), at(1, c), at(2, c));
            const Sixteen none = 0.0f;
            near[c] = larger(larger(low[c], -high[c]), none) - 0x1p-20f * reach;
        }
        for (int c = 0; c < 3; ++c) {
            const Sixteen limit = larger(larger(near[(c + 1) % 3], near[(c + 2) % 3]), -0x1p-40f * reach);
            faces_of[2 * c] = all & (~bits(high[c] < limit) | far);
            faces_of[2 * c + 1] = all & (~bits(-low[c] < limit) | far);
        }
        return all;
    };
    auto bound = [&](int face) -> int {
        int touched = faces_of[face];
        if (!touched)
            return 0;
        const int axis = face >> 1, first = (axis + 1) % 3, second = (axis + 2) % 3;
        const float sign = face & 1 ? -1.0f : 1.0f;
        const Sixteen a = sign * at(0, axis), b = sign * at(1, axis), c = sign * at(2, axis);
        const Sixteen front = least(a, b, c);
        const SixteenInts in_front = (front > 0x1p-18f * reach) & (reach < far_out);
        bounded = bits(in_front);
        // Cube faces have been asked for that before.
        if (aligned)
            touched &= ~bits((most(a, b, c) < -0x1p-18f * reach) & (reach < far_out));
        if (!(bounded & touched))
            return touched;
        const Sixteen ia = 1.0f / a, ib = 1.0f / b, ic = 1.0f / c;
        const Sixteen ua = at(0, first) * ia, ub = at(1, first) * ib, uc = at(2, first) * ic;
        const Sixteen va = at(0, second) * ia, vb = at(1, second) * ib, vc = at(2, second) * ic;
        low_u = least(ua, ub, uc), high_u = most(ua, ub, uc), low_v = least(va, vb, vc), high_v = most(va, vb, vc);
        low_u -= 0x1p-20f * (1.0f + size_of(low_u));
        high_u += 0x1p-20f * (1.0f + size_of(high_u));
        low_v -= 0x1p-20f * (1.0f + size_of(low_v));
        high_v += 0x1p-20f * (1.0f + size_of(high_v));
        const wp::vec4 grid = tiles.fit.data[6 * place + face];
        const int beside = bits((high_u < grid[0]) | (high_v < grid[1]) | ((low_u - grid[0]) * grid[2] > 4100.0f)
                                | ((low_v - grid[1]) * grid[3] > 4100.0f));
        nearest = 1.0f / front;
        if (!inverse_mode) {
            const Sixteen z = most(at(0, 3), at(1, 3), at(2, 3));
            // The other way round where z is negative: the larger |h|, the larger a negative t.
            nearest = z / (z < 0.0f ? most(a, b, c) : front);
        }
        nearest += 0x1p-18f * (1.0f + size_of(nearest));
        return touched & ~(beside & bounded);
    };
"""
