# SPDX-License-Identifier: Apache-2.0
"""Bounds of sixteen triangles at a time on the faces of a light: ``faces.look`` in the CPU's vector
registers, and what it rejects without looking at a record."""

from __future__ import annotations

# C++ for native functions, behind faces.TRIANGLE and decision.SIXTEEN. Expects `tiles`, `occluders`,
# `corners` (see records.prepare_block), `first_corner` of the light's, its `place`, and `aligned`; defines:
# gather(t): takes up triangles t to t + 15, t a multiple of 16, returns those there are as bits;
# bound(face): those of them that may touch the face, as bits, their bounds in `low_u` etc., `bounded` as bits.
BOUNDS = r"""
    const float* corner = nullptr;
    Sixteen reach;
    float low_u[16], high_u[16], low_v[16], high_v[16], nearest[16];
    int bounded = 0, faces_of[6];
    auto larger = [](Sixteen x, Sixteen y) -> Sixteen { return x > y ? x : y; };
    auto smaller = [](Sixteen x, Sixteen y) -> Sixteen { return x < y ? x : y; };
    auto size_of = [&](Sixteen x) -> Sixteen { return larger(x, -x); };
    auto least = [&](Sixteen x, Sixteen y, Sixteen z) -> Sixteen { return smaller(smaller(x, y), z); };
    auto most = [&](Sixteen x, Sixteen y, Sixteen z) -> Sixteen { return larger(larger(x, y), z); };
    auto at = [&](int k, int component) -> Sixteen { return *(const Sixteen*)(corner + 64 * k + 16 * component); };
    auto gather = [&](int t) -> int {
        const int n = occluders.count - t < 16 ? occluders.count - t : 16;
        corner = corners.data + 12 * (size_t)(first_corner + t);
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
        Sixteen u0 = least(ua, ub, uc), u1 = most(ua, ub, uc), v0 = least(va, vb, vc), v1 = most(va, vb, vc);
        u0 -= 0x1p-20f * (1.0f + size_of(u0));
        u1 += 0x1p-20f * (1.0f + size_of(u1));
        v0 -= 0x1p-20f * (1.0f + size_of(v0));
        v1 += 0x1p-20f * (1.0f + size_of(v1));
        const wp::vec4 grid = tiles.fit.data[6 * place + face];
        const int beside = bits((u1 < grid[0]) | (v1 < grid[1]) | ((u0 - grid[0]) * grid[2] > 4100.0f)
                                | ((v0 - grid[1]) * grid[3] > 4100.0f));
        Sixteen near = 1.0f / front;
        if (!inverse_mode) {
            const Sixteen z = most(at(0, 3), at(1, 3), at(2, 3));
            // The other way round where z is negative: the larger |h|, the larger a negative t.
            near = z / (z < 0.0f ? most(a, b, c) : front);
        }
        *(Sixteen*)low_u = u0;
        *(Sixteen*)high_u = u1;
        *(Sixteen*)low_v = v0;
        *(Sixteen*)high_v = v1;
        *(Sixteen*)nearest = near + 0x1p-18f * (1.0f + size_of(near));
        return touched & ~(beside & bounded);
    };
"""

# Behind tile_test.SIDE_SIXTEEN:
# take(record, n): takes up the n records from `record` on; `silent` and `blind` are bits of them;
# side(face, j): triangle j of them on a face.
TAKE = r"""
    float row[16][16], plane_row[4][16], pad[2][16];
    int silent = 0, blind = 0;
    auto take = [&](int record, int n) {
        const float* from = (const float*)occluders.records.data + 16 * (size_t)record;
        if (n == 16)
            for (int k = 0; k < 16; ++k)
                for (int j = 0; j < 16; ++j)
                    row[k][j] = from[16 * j + k];
        else
            for (int k = 0; k < 16; ++k)
                for (int j = 0; j < 16; ++j)
                    row[k][j] = from[16 * (j < n ? j : 0) + k];
        auto at = [&](int k) -> Sixteen { return *(const Sixteen*)row[k]; };
        silent = bits((at(12) == 0.0f) & (at(13) == 0.0f) & (at(14) == 0.0f));
        Sixteen sum = 0.0f;
        for (int k = 0; k < 16; ++k)
            sum += size_of(at(k));
        blind = ~bits(sum < 1.0e17f) & 0xFFFF;
        const Sixteen slope = inverse_mode ? space.c * at(14) - at(15) : at(14) - space.s * at(15);
        const Sixteen none = 0.0f;
        *(Sixteen*)plane_row[0] = at(12);
        *(Sixteen*)plane_row[1] = at(13);
        *(Sixteen*)plane_row[2] = inverse_mode ? -at(14) : -at(15);
        *(Sixteen*)plane_row[3] = smaller(slope, none);
        *(Sixteen*)pad[0] = 2.0f * at(3);
        *(Sixteen*)pad[1] = 7.0f * (at(7) + at(11));
    };
    auto side = [&](int face, int j) -> Side {
        const int axis = face >> 1, first = (axis + 1) % 3, second = (axis + 2) % 3;
        Side s;
        s.a = row[first] + j, s.b = row[second] + j, s.c = row[axis] + j;
        s.pa = plane_row[first] + j, s.pb = plane_row[second] + j, s.pc = plane_row[axis] + j, s.pt = plane_row[3] + j;
        s.sign = face & 1 ? -1.0f : 1.0f;
        s.edge = pad[0][j];
        s.plane = pad[1][j];
        s.blind = blind >> j & 1;
        s.bounded = bounded >> j & 1;
        s.u0 = s.bounded ? low_u[j] : -3.0f;
        s.u1 = s.bounded ? high_u[j] : 3.0f;
        s.v0 = s.bounded ? low_v[j] : -3.0f;
        s.v1 = s.bounded ? high_v[j] : 3.0f;
        s.nearest = s.bounded ? nearest[j] : 3.0e38f;
        return s;
    };
"""
