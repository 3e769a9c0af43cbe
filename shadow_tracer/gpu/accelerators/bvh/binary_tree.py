# SPDX-License-Identifier: Apache-2.0
"""Walking a ray through a ``wp.Bvh`` with the shadow test's filter at the leaves: the search that CUDA uses.

Why no triangle can be missed is in ``mesh_bvh.py``.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.exact.decision import FILTER

# What a walk through the tree found: whether an occluder is certain, triangles tested, nodes visited, uncertain
# triangles found, and the first of them.
FOUND = 5
Candidates = wp.types.vector(length=4 + FOUND, dtype=wp.int32)


# The triangles of a leaf through the filter; true if one of them is a certain occluder. For both forms of the tree.
LEAF = (
    FILTER
    + r"""
    wp::vec_t<9, wp::int32> result;
    int nodes = 0, tests = 0, found = 0;
    const int* primitives = wp::bvh_get(bvh).primitive_indices;
    const wp::vec4* record = (const wp::vec4*)records.data;
    const wp::vec4 r = ray;
    auto test_leaf = [&](int first, int last) -> bool {
        for (int k = first; k < last; ++k) {
            const int triangle = primitives[k];
            ++tests;
            const int answer = filter(r, magnitude, record + 4 * (size_t)triangle);
            if (answer == 1) {
                result[0] = 1;
                result[1] = tests;
                result[2] = nodes;
                result[4] = triangle;
                return true;
            }
            if (answer == 2) {
                if (found >= skip && found < skip + 5)
                    result[4 + found - skip] = triangle;
                ++found;
            }
        }
        return false;
    };
"""
)


# Warp's own query iterator pushes both children untested and hands out boxes one by one; walking its nodes here,
# nearer child first, with the filter inline, takes a third of the time. Uses the node layout of Warp's bvh.h.
@wp.func_native(
    LEAF
    + r"""
    const wp::BVH tree = wp::bvh_get(bvh);
    const wp::vec3 o = origin;
    const wp::vec3 inverse(1.0f / direction[0], 1.0f / direction[1], 1.0f / direction[2]);
    // Entry distance of a node's box, or a value beyond the ray if it is missed.
    auto least = [](float x, float y) { return x < y ? x : y; };
    auto most = [](float x, float y) { return x > y ? x : y; };
    const float ox = o[0], oy = o[1], oz = o[2], ix = inverse[0], iy = inverse[1], iz = inverse[2];
    auto enter = [&](int node) -> float {
        const float* lower = (const float*)(tree.node_lowers + node);
        const float* upper = (const float*)(tree.node_uppers + node);
        const float x0 = (lower[0] - ox) * ix, x1 = (upper[0] - ox) * ix;
        const float y0 = (lower[1] - oy) * iy, y1 = (upper[1] - oy) * iy;
        const float z0 = (lower[2] - oz) * iz, z1 = (upper[2] - oz) * iz;
        const float in = most(most(least(x0, x1), least(y0, y1)), most(least(z0, z1), 0.0f));
        const float out = least(least(most(x0, x1), most(y0, y1)), least(most(z0, z1), longest));
        return in <= out ? in : 3.0e38f;
    };
    int stack[64];
    int top = 0;
    int node = *tree.root;
    if (enter(node) > 1.0e38f)
        return result;
    for (;;) {
        ++nodes;
        const wp::BVHPackedNodeHalf lower = tree.node_lowers[node];
        const int left = lower.i, right = tree.node_uppers[node].i;
        if (lower.b) {
            if (test_leaf(left, right))
                return result;
        } else {
            const float to_left = enter(left), to_right = enter(right);
            const bool see_left = to_left < 1.0e38f, see_right = to_right < 1.0e38f;
            if (see_left && see_right) {
                if (top == 64) {
                    result[0] = -1;
                    return result;
                }
                stack[top++] = to_left <= to_right ? right : left;
                node = to_left <= to_right ? left : right;
                continue;
            }
            if (see_left || see_right) {
                node = see_left ? left : right;
                continue;
            }
        }
        if (top == 0)
            break;
        node = stack[--top];
    }
    result[1] = tests;
    result[2] = nodes;
    result[3] = found;
    return result;
    """
)
def search(
    bvh: wp.uint64,
    origin: wp.vec3,
    direction: wp.vec3,
    longest: float,
    records: wp.array2d(dtype=wp.vec4),
    ray: wp.vec4,
    magnitude: float,
    skip: int,
) -> Candidates:
    """(1 if certain, -1 if the tree is too deep; tests; nodes; uncertain triangles; five of them from ``skip`` on, or
    the occluder if it is certain)."""
    ...
