# SPDX-License-Identifier: Apache-2.0
"""The tree of a ``wp.Bvh`` with up to eight children per node, for the CPU: eight boxes are tested in one go of the
vector registers, and a ray visits a third of the nodes.

It is made from the binary tree after every build and refit, top down: a node takes a subtree's root and opens its
largest inner node until it has eight children (Wald, Benthin, Boulos 2008: multi-branching trees). One node takes 256
bytes: six times eight bounds, and eight children (a node's number, or a range of triangles).
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.bvh.binary_tree import LEAF, Candidates

WIDTH = 8
BOUNDS_PER_NODE = 6 * WIDTH
# Per child: first triangle and number of triangles of a leaf; node number and 0 of an inner node; 0 and -1 of none.
LINKS_PER_NODE = 2 * WIDTH


@wp.func_native(
    r"""
    const wp::BVH tree = wp::bvh_get(bvh);
    const int capacity = links.shape[0] / 16;
    auto area = [&](int node) -> float {
        const wp::BVHPackedNodeHalf lower = tree.node_lowers[node], upper = tree.node_uppers[node];
        const float x = upper.x - lower.x, y = upper.y - lower.y, z = upper.z - lower.z;
        return x * y + y * z + z * x;
    };
    // Roots of the subtrees that wait to become nodes stand in links.data[16 * node]: it is written only afterwards.
    int count = 1;
    links.data[0] = *tree.root;
    for (int node = 0; node < count; ++node) {
        int children[8];
        int n = 1;
        children[0] = links.data[16 * node];
        while (n < 8) {
            int largest = -1;
            float size = -1.0f;
            for (int k = 0; k < n; ++k)
                if (!tree.node_lowers[children[k]].b && area(children[k]) > size) {
                    largest = k;
                    size = area(children[k]);
                }
            if (largest < 0)
                break;
            const int opened = children[largest];
            children[largest] = tree.node_lowers[opened].i;
            children[n++] = tree.node_uppers[opened].i;
        }
        for (int k = 0; k < 8; ++k) {
            float* bound = bounds.data + 48 * (size_t)node + k;
            int* link = links.data + 16 * (size_t)node + k;
            for (int axis = 0; axis < 6; ++axis)
                bound[8 * axis] = 0.0f;
            link[0] = 0;
            link[8] = -1;
            if (k >= n)
                continue;
            const wp::BVHPackedNodeHalf lower = tree.node_lowers[children[k]], upper = tree.node_uppers[children[k]];
            bound[0] = lower.x;
            bound[8] = lower.y;
            bound[16] = lower.z;
            bound[24] = upper.x;
            bound[32] = upper.y;
            bound[40] = upper.z;
            if (lower.b) {
                link[0] = lower.i;
                link[8] = upper.i - lower.i;
            } else {
                if (count == capacity)
                    return -1;
                link[0] = count;
                link[8] = 0;
                links.data[16 * (size_t)count++] = children[k];
            }
        }
    }
    return count;
    """
)
def collapse_tree(bvh: wp.uint64, bounds: wp.array(dtype=float), links: wp.array(dtype=int)) -> int:
    """Fill the wide tree; returns the number of its nodes, or -1 if they do not fit."""
    ...


@wp.kernel(enable_backward=False)
def collapse(bvh: wp.uint64, bounds: wp.array(dtype=float), links: wp.array(dtype=int), count: wp.array(dtype=int)):
    """One thread: ``count[0]`` becomes the number of nodes, or -1 if they do not fit."""
    count[0] = collapse_tree(bvh, bounds, links)


# The CPU alone walks this form. For CUDA the body is left out, or its stack would cost every thread a kilobyte; it says
# "too deep" there, which makes the caller look at every triangle.
@wp.func_native(
    LEAF
    + r"""
#if defined(__CUDA_ARCH__)
    result[0] = -1;
    return result;
#else
    auto least = [](float x, float y) { return x < y ? x : y; };
    auto most = [](float x, float y) { return x > y ? x : y; };
    const float ox = origin[0], oy = origin[1], oz = origin[2];
    const float ix = 1.0f / direction[0], iy = 1.0f / direction[1], iz = 1.0f / direction[2];
    int stack[256];
    int top = 0, node = 0;
    for (;;) {
        ++nodes;
        const float* b = bounds.data + 48 * (size_t)node;
        const int* link = links.data + 16 * (size_t)node;
        float in[8], out[8];
        for (int k = 0; k < 8; ++k) {
            const float x0 = (b[k] - ox) * ix, x1 = (b[24 + k] - ox) * ix;
            const float y0 = (b[8 + k] - oy) * iy, y1 = (b[32 + k] - oy) * iy;
            const float z0 = (b[16 + k] - oz) * iz, z1 = (b[40 + k] - oz) * iz;
            in[k] = most(most(least(x0, x1), least(y0, y1)), most(least(z0, z1), 0.0f));
            out[k] = least(least(most(x0, x1), most(y0, y1)), least(most(z0, z1), longest));
        }
        int next = -1;
        float nearest = 3.0e38f;
        for (int k = 0; k < 8; ++k) {
            if (!(in[k] <= out[k]) || link[8 + k] < 0)
                continue;
            if (link[8 + k] == 0) {
                if (next < 0) {
                    next = link[k];
                    nearest = in[k];
                    continue;
                }
                if (top == 256) {
                    result[0] = -1;
                    return result;
                }
                const bool nearer = in[k] < nearest;
                stack[top++] = nearer ? next : link[k];
                if (nearer) {
                    next = link[k];
                    nearest = in[k];
                }
                continue;
            }
            if (test_leaf(link[k], link[k] + link[8 + k]))
                return result;
        }
        if (next < 0) {
            if (top == 0)
                break;
            next = stack[--top];
        }
        node = next;
    }
    result[1] = tests;
    result[2] = nodes;
    result[3] = found;
    return result;
#endif
    """
)
def search_wide(
    bvh: wp.uint64,
    bounds: wp.array(dtype=float),
    links: wp.array(dtype=int),
    origin: wp.vec3,
    direction: wp.vec3,
    longest: float,
    records: wp.array2d(dtype=wp.vec4),
    ray: wp.vec4,
    magnitude: float,
    skip: int,
) -> Candidates:
    """As ``binary_tree.search``."""
    ...
