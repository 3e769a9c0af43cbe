# SPDX-License-Identifier: Apache-2.0
"""Triangles as the descent through the ray tree of ``linear`` sees them: planes over light space."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.buffers import ACCEPTED, LEAF_TESTS, NODES_VISITED
from shadow_tracer.gpu.cone_hierarchy.cells import CELLS


@wp.struct
class Occluders:
    """Triangles as the descent sees them."""

    count: int
    triangles: wp.array(dtype=wp.vec3i)
    corners: wp.array(dtype=wp.vec4)
    records: wp.array2d(dtype=wp.vec4)


# A triangle's planes over light space, and what becomes of its uncertain pairs. `load` is false for triangles that cast
# nothing; `blind` triangles have a record with a value that is not finite, and no box may be judged by it.
TRIANGLE = (
    f"const int nodes_visited = {NODES_VISITED}, leaf_tests = {LEAF_TESTS}, accepted_nodes = {ACCEPTED};\n"
    "const bool inverse_mode = space.inverse != 0;\n"
    + CELLS
    + r"""
    struct Planes {
        float n[3][3], reach[3][3];  // edges, and their absolute values
        float p[4], spread[4];       // P of space.py, and its absolute values
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
        it.plane = 4.0f * (record[1][3] + record[2][3]);
        it.blind = !(sum + fabsf(plane[3]) + it.edge + it.plane < 1.0e18f);
        return true;
    };
    auto settle = [&](int sample, int triangle) {
        if (answers.states.data[sample] == 1)
            return;
        wp::atomic_add(&answers.resume.data[sample], 1);
        // As shadow_test.enqueue: the counter stops behind the capacity.
        const int capacity = answers.queue.shape[0];
        int slot = answers.queue_count.data[0];
        if (slot <= capacity)
            slot = wp::atomic_add(&answers.queue_count.data[0], 1);
        if (slot < capacity)
            answers.queue.data[slot] = wp::vec2i(sample, triangle);
        else
            answers.states.data[sample] = 4;
    };
    // Corners of a triangle; returns 1 + the largest magnitude of them.
    auto corners_of = [&](int triangle, wp::vec4* at) -> float {
        float size[3];
        for (int k = 0; k < 3; ++k) {
            at[k] = occluders.corners.data[occluders.triangles.data[triangle][k]];
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
