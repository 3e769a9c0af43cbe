# SPDX-License-Identifier: Apache-2.0
"""How a triangle goes through the ray tree of variant ``linear``.

A node is rejected when one of the triangle's four planes has all of its box on the wrong side, when the box lies beside
the triangle's own bounds on a cube face, or when even its least depth is beyond the triangle's largest (nothing of the
triangle is nearer to the light). It is accepted whole when all four planes have all of it on the right side. The pads
are derived in ``light_space.py``. What is left in the leaves goes through the filter of ``decision.py``.

Nodes without live rays are done: their boxes fail every test. When the last live ray of a leaf, or the last live child
of a node, is done, so is the leaf or the node: a wall of many triangles ends the search under it as one triangle would.

Two forms of the same. ``descent_wide.py`` is for the CPU: sixteen boxes or rays at a time. Here is what a CUDA thread
does: one box at a time, no stack, only a position and a level. A node that is accepted gets a flag that the output
stage reads. A triangle that may touch more than ``SMALL_RUN`` leaves in a row is left to a second kernel, which gives
each chunk of 64 leaves to another thread, so that no thread walks a wall alone. Bits and flags only ever go one way,
and a stale read of one, or of a box, costs a test, never an answer.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.cone_hierarchy.boxes import RayTree
from shadow_tracer.gpu.accelerators.cone_hierarchy.cells import CELLS
from shadow_tracer.gpu.device.counters import PASSES
from shadow_tracer.gpu.exact.decision import FILTER
from shadow_tracer.gpu.exact.faces import TRIANGLE, Occluders
from shadow_tracer.gpu.exact.light_frame import SHADOWED, LightFrame
from shadow_tracer.gpu.exact.light_space import LightSpace, space_of
from shadow_tracer.gpu.visibility.answers import Answers

# Leaves per run that one thread walks, and leaves per chunk of a larger triangle: 4^3.
SMALL_RUN = wp.constant(64)
CHUNK_LEVEL = wp.constant(3)

# Bits of a node's flags.
DONE = wp.constant(1)
WHOLE = wp.constant(2)

_THREAD = (
    TRIANGLE
    + CELLS
    + FILTER
    + r"""
    wp::int64 nodes = 0, tests = 0, accepted = 0;
    Planes it;
    Seen seen;
    const int log_branch = tree.log_branch, log_leaf = tree.log_leaf;
    const int branch = 1 << log_branch, leaf_size = 1 << log_leaf;
    auto set_bits = [](int* word, int bits) -> int {
#if defined(__CUDA_ARCH__)
        return atomicOr(word, bits);
#else
        const int old = *word;
        *word = old | bits;
        return old;
#endif
    };
    auto clear_bits = [](int* word, int bits) -> int {
#if defined(__CUDA_ARCH__)
        return atomicAnd(word, ~bits);
#else
        const int old = *word;
        *word = old & ~bits;
        return old;
#endif
    };
    auto box_of = [&](int number) -> float* {
        return tree.boxes.data + (size_t)(number >> log_branch) * 8 * branch + (number & (branch - 1));
    };
    // 0: rejected; 1: has to be opened; 2: accepted.
    auto box1 = [&](int number) -> int {
        if (number < tree.visits.shape[0])
            wp::atomic_add(&tree.visits.data[number], 1);
        const float* b = box_of(number);
        const float e[3] = { b[3 * branch], b[4 * branch], b[5 * branch] };
        if (e[0] < 0.0f)
            return 0;
        if (it.blind)
            return 1;
        const float c[3] = { b[0], b[branch], b[2 * branch] };
        const float t0 = b[6 * branch], t1 = b[7 * branch];
        if (seen.bounded) {
            if (t0 > seen.nearest)
                return 0;
            for (int k = 0; k < 3; ++k)
                if (c[k] - e[k] > seen.high[k] || c[k] + e[k] < seen.low[k])
                    return 0;
        }
        const float m = 4.0f + 2.001f * (fabsf(t0) > fabsf(t1) ? fabsf(t0) : fabsf(t1));
        const float edge = it.edge * m, plane = it.plane * m;
        bool whole = true;
        for (int k = 0; k < 3; ++k) {
            const float middle = it.n[k][0] * c[0] + it.n[k][1] * c[1] + it.n[k][2] * c[2];
            const float reach = it.reach[k][0] * e[0] + it.reach[k][1] * e[1] + it.reach[k][2] * e[2];
            if (middle + reach < -edge)
                return 0;
            whole = whole && middle - reach > edge;
        }
        const float middle = it.p[0] * c[0] + it.p[1] * c[1] + it.p[2] * c[2];
        const float reach = it.spread[0] * e[0] + it.spread[1] * e[1] + it.spread[2] * e[2];
        if (middle + reach + it.p[3] * t0 < -plane)
            return 0;
        return whole && middle - reach + it.p[3] * t1 > plane ? 2 : 1;
    };
    // A node, by its number in its level, has no live rays any more, or is accepted.
    auto finish = [&](int level, int node, int bits) {
        for (;;) {
            const int number = tree.offset.data[level] + node;
            if (set_bits(&tree.flags.data[number], bits) & 1)
                return;
            float* box = box_of(number);
            box[3 * branch] = box[4 * branch] = box[5 * branch] = -1.0e30f;
            if (level + 1 >= tree.levels)
                return;
            ++level;
            node >>= log_branch;
            bits = 1;
            if (wp::atomic_add(&tree.live.data[tree.offset.data[level] + node], -1) > 1)
                return;
        }
    };
    auto test_leaf = [&](int leaf, int triangle) {
        const float* from = tree.leaves.data + (size_t)leaf * 5 * leaf_size;
        const wp::vec4* record = (const wp::vec4*)occluders.records.data + 4 * (size_t)triangle;
        const int live = tree.live.data[leaf];
        for (int j = 0; j < leaf_size; ++j) {
            if (!(live >> j & 1))
                continue;
            const wp::vec4 ray(from[j], from[leaf_size + j], from[2 * leaf_size + j], from[3 * leaf_size + j]);
            ++tests;
            const int answer = filter(ray, from[4 * leaf_size + j], record);
            if (answer == 0)
                continue;
            const int sample = tree.order.data[(leaf << log_leaf) + j];
            if (answer == 2) {
                settle(sample, triangle);
                continue;
            }
            answers.states.data[sample] = 1;
            const int bit = (int)(1u << j);
            const int old = clear_bits(&tree.live.data[leaf], bit);
            if (old == bit)
                finish(0, leaf, 1);
        }
    };
    // Leaves first to last: always the largest aligned node that fits into what is left and into `level`.
    auto walk = [&](int first, int last, int triangle) {
        int level = tree.levels - 1;
        for (int at = first; at <= last;) {
            while (level > 0 && (at & ((1 << log_branch * level) - 1) || at + (1 << log_branch * level) - 1 > last))
                --level;
            const int node = at >> log_branch * level;
            ++nodes;
            const int found = box1(tree.offset.data[level] + node);
            if (found == 1 && level > 0) {
                --level;
                continue;
            }
            if (found == 1)
                test_leaf(at, triangle);
            if (found == 2) {
                ++accepted;
                finish(level, node, 3);
            }
            at += 1 << log_branch * level;
            // Siblings stay at this level; behind the last one, back to where the parent's siblings are.
            while (level + 1 < tree.levels && !(at & ((1 << log_branch * (level + 1)) - 1)))
                ++level;
        }
    };
    auto count = [&]() {
        wp::int64* counter = answers.counters.data + (size_t)(thread & 63) * answers.counters.shape[1];
        if (nodes)
            wp::atomic_add(counter + nodes_visited, nodes);
        if (tests)
            wp::atomic_add(counter + leaf_tests, tests);
        if (accepted)
            wp::atomic_add(counter + accepted_nodes, accepted);
    };
"""
)


@wp.func_native(
    _THREAD
    + r"""
    const int t = thread;
    wp::vec4 at[3];
    const float size = corners_of(t, 0, at);
    if (!load((const wp::vec4*)occluders.records.data + 4 * (size_t)t, it))
        return false;
    const int touched = touched_by(at, size);
    for (int pass = 0; pass < 2; ++pass)
        for (int face = 0; face < 6; ++face) {
            if (!(touched >> face & 1) || tree.fit.data[face][3] == 0.0f)
                continue;
            seen.bounded = false;
            if (size < far_out && !look(at[0], at[1], at[2], size, face, seen))
                continue;
            int run[8];
            const int n = runs(seen, face, run);
            for (int k = 0; k < n; ++k) {
                if (pass == 0 && run[2 * k + 1] - run[2 * k] >= small_run)
                    return true;
                if (pass == 1)
                    walk(run[2 * k], run[2 * k + 1], t);
            }
        }
    count();
    return false;
    """
)
def descend_small(
    thread: int,
    small_run: int,
    space: LightSpace,
    tree: RayTree,
    occluders: Occluders,
    answers: Answers,
) -> bool:
    """Triangle number ``thread`` from its own cells; True if nothing was done because it is too large."""
    ...


@wp.func_native(
    _THREAD
    + r"""
    if (!load((const wp::vec4*)occluders.records.data + 4 * (size_t)triangle, it))
        return;
    seen.bounded = false;
    const int leaves = (tree.counts.data[0] + leaf_size - 1) >> log_leaf;
    const int first = chunk << log_branch * chunk_level;
    int last = first + (1 << log_branch * chunk_level) - 1;
    last = last < leaves ? last : leaves - 1;
    if (first <= last && (tree.levels <= chunk_level || box1(tree.offset.data[chunk_level] + chunk)))
        walk(first, last, triangle);
    count();
    """
)
def descend_chunk(
    thread: int,
    triangle: int,
    chunk: int,
    chunk_level: int,
    space: LightSpace,
    tree: RayTree,
    occluders: Occluders,
    answers: Answers,
):
    """A triangle through chunk number ``chunk`` of the leaves."""
    ...


@wp.kernel(enable_backward=False)
def descend_triangles(
    light: wp.array(dtype=LightFrame),
    tree: RayTree,
    occluders: Occluders,
    answers: Answers,
    big: wp.array(dtype=int),
    big_count: wp.array(dtype=int),
):
    """One thread per triangle; the large ones go to the list ``big``."""
    t = wp.tid()
    if t == 0:
        wp.atomic_add(answers.counters, 0, PASSES, wp.int64(1))
    if descend_small(t, SMALL_RUN, space_of(light[0]), tree, occluders, answers):
        big[wp.atomic_add(big_count, 0, 1)] = t


@wp.kernel(enable_backward=False)
def descend_big(
    stride: int,
    light: wp.array(dtype=LightFrame),
    tree: RayTree,
    occluders: Occluders,
    answers: Answers,
    big: wp.array(dtype=int),
    big_count: wp.array(dtype=int),
):
    """Large triangles, one (chunk, triangle) after the other; neighbouring threads share a chunk."""
    thread = wp.tid()
    space = space_of(light[0])
    rays_per_chunk = 1 << (tree.log_leaf + CHUNK_LEVEL * tree.log_branch)
    chunks = (tree.counts[0] + rays_per_chunk - 1) // rays_per_chunk
    count = wp.int64(big_count[0])
    k = wp.int64(thread)
    while k < count * wp.int64(chunks):
        triangle = big[int(k % count)]
        descend_chunk(
            thread,
            triangle,
            int(k // count),
            CHUNK_LEVEL,
            space,
            tree,
            occluders,
            answers,
        )
        k += wp.int64(stride)


@wp.kernel(enable_backward=False)
def write_accepted(tree: RayTree, states: wp.array(dtype=wp.uint8)):
    """The output stage: rays under an accepted node are in shadow. One thread per ray."""
    i = wp.tid()
    if i >= tree.counts[0]:
        return
    node = i >> tree.log_leaf
    for level in range(tree.levels):
        if (tree.flags[tree.offset[level] + node] & WHOLE) != 0:
            states[tree.order[i]] = wp.uint8(SHADOWED)
            return
        node = node >> tree.log_branch
