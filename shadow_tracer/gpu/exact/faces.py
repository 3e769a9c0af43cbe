# SPDX-License-Identifier: Apache-2.0
"""Triangles over light space, as nodes and tiles of rays see them: four planes, and bounds on each cube face.

If all corners of a triangle are in front of a cube face, it lies within the bounds of their (u, v) there, since each
point of its cone is a convex combination of corners; if none is, it cannot touch the face; if some are, it may touch
anything there.

Corners are float32: within u relative and 2^-46 R of exact, R = 1 + the corner's magnitude. With a distance in front of
the face of at least 2^-18 R, (u, v) is within 2^-27 (1 + |u|) + 3 u of exact; bounds are padded by 2^-20 (1 + |u|).
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device.counters import ACCEPTED, LEAF_TESTS, NODES_VISITED


@wp.struct
class Occluders:
    """The triangles of the scene and what is known of them from a light."""

    count: int
    triangles: wp.array(dtype=wp.vec3i)
    corners: wp.array(dtype=wp.vec4)
    records: wp.array2d(dtype=wp.vec4)


# Seen: what is known of a triangle on one face;
# faces(a, b, c, size): the faces it may touch, as bits;
# look(a, b, c, size, face, seen): false if the triangle cannot touch the face.
_SEEN = r"""
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
        const float ia = 1.0f / ma, ib = 1.0f / mb, ic = 1.0f / mc;
        const float ua = a[first] * ia, ub = b[first] * ib, uc = c[first] * ic;
        const float va = a[second] * ia, vb = b[second] * ib, vc = c[second] * ic;
        float u0 = least3(ua, ub, uc), u1 = most3(ua, ub, uc), v0 = least3(va, vb, vc), v1 = most3(va, vb, vc);
        u0 -= 0x1p-20f * (1.0f + fabsf(u0));
        v0 -= 0x1p-20f * (1.0f + fabsf(v0));
        u1 += 0x1p-20f * (1.0f + fabsf(u1));
        v1 += 0x1p-20f * (1.0f + fabsf(v1));
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
"""

# C++ for native functions that have `space`, `occluders` and `answers` (visibility/answers.py) among their arguments: a
# triangle's planes over light space, its bounds, and what becomes of its uncertain pairs. `load` is false for triangles
# that cast nothing; `blind` triangles have a record with a value that is not finite, and no box may be judged by it.
TRIANGLE = (
    f"const int nodes_visited = {NODES_VISITED}, leaf_tests = {LEAF_TESTS}, accepted_nodes = {ACCEPTED};\n"
    "const bool inverse_mode = space.inverse != 0;\n"
    + _SEEN
    + r"""
    struct Planes {
        float n[3][3], reach[3][3];  // edges, and their absolute values
        float p[4], spread[4];       // P of light_space.py, and its absolute values
        float edge, plane;           // factors of the pads
        bool blind;
    };
    auto load = [&](const wp::vec4* record, Planes& it) -> bool {
        const wp::vec4 plane = record[3];
        if (plane[0] == 0.0f && plane[1] == 0.0f && plane[2] == 0.0f)
            return false;
        float sum = 0.0f;
        for (int k = 0; k < 3; ++k)
            for (int i = 0; i < 3; ++i) {
                it.n[k][i] = record[k][i];
                it.reach[k][i] = fabsf(record[k][i]);
                sum += it.reach[k][i] + fabsf(record[k][3]) + fabsf(plane[i]);
            }
        it.p[0] = plane[0];
        it.p[1] = plane[1];
        it.p[2] = inverse_mode ? -plane[2] : -plane[3];
        const float slope = inverse_mode ? space.c * plane[2] - plane[3] : plane[2] - space.s * plane[3];
        it.p[3] = slope < 0.0f ? slope : 0.0f;
        for (int i = 0; i < 4; ++i)
            it.spread[i] = fabsf(it.p[i]);
        it.edge = 2.0f * record[0][3];
        it.plane = 7.0f * (record[1][3] + record[2][3]);
        it.blind = !(sum + fabsf(plane[3]) + it.edge + it.plane < 1.0e18f);
        return true;
    };
    auto settle = [&](int sample, int triangle) {
        if (answers.states.data[sample] == 1)
            return;
        wp::atomic_add(&answers.resume.data[sample], 1);
        // As queue.enqueue: the counter stops behind the capacity.
        const int capacity = answers.queue.shape[0];
        int slot = answers.queue_count.data[0];
        if (slot <= capacity)
            slot = wp::atomic_add(&answers.queue_count.data[0], 1);
        if (slot < capacity)
            answers.queue.data[slot] = wp::vec2i(sample, triangle);
        else
            answers.states.data[sample] = 4;
    };
    // Corners of a triangle, those of its light from `first` on; returns 1 + the largest magnitude of them.
    auto corners_of = [&](int triangle, int first, wp::vec4* at) -> float {
        float size[3];
        for (int k = 0; k < 3; ++k) {
            at[k] = occluders.corners.data[first + occluders.triangles.data[triangle][k]];
            size[k] = fabsf(at[k][0]) + fabsf(at[k][1]) + fabsf(at[k][2]) + fabsf(at[k][3]);
        }
        return 1.0f + most3(size[0], size[1], size[2]);
    };
    // The faces a triangle may touch, as bits; all if its corners are too far out to be judged.
    const float far_out = 1.0e18f;
    auto touched_by = [&](const wp::vec4* at, float size) -> int {
        return size < far_out ? faces(at[0], at[1], at[2], size) : 63;
    };
"""
)
