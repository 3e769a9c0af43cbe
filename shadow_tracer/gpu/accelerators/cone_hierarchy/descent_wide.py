# SPDX-License-Identifier: Apache-2.0
"""The descent of ``descent.py`` sixteen boxes or rays at a time, for the CPU: masks of survivors on a small stack, and
nodes that are accepted are finished at once, down to their rays."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.cone_hierarchy.boxes import RayTree
from shadow_tracer.gpu.accelerators.cone_hierarchy.cells import CELLS
from shadow_tracer.gpu.device.counters import PASSES
from shadow_tracer.gpu.exact.decision import FILTER_SIXTEEN
from shadow_tracer.gpu.exact.faces import TRIANGLE, Occluders
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import LightSpace, space_of
from shadow_tracer.gpu.visibility.answers import Answers

# Sixteen lanes. `boxes16` answers for the 16 boxes of a group with two bit masks.
_WIDE = (
    TRIANGLE
    + CELLS
    + FILTER_SIXTEEN
    + r"""
    auto largest = [](Sixteen x, Sixteen y) -> Sixteen { return x > y ? x : y; };
    wp::int64 nodes = 0, tests = 0, accepted = 0;
    // Of the leaves there is room for, those that hold rays of this pass: what lies behind is of another frame.
    const int leaves = (tree.counts.data[0] + 15) / 16;
    Planes it;
    Seen seen;
    auto boxes16 = [&](const float* b, int& covered) -> int {
        const float pu0 = seen.bounded ? seen.low[0] : -2.0f, pu1 = seen.bounded ? seen.high[0] : 2.0f;
        const float pv0 = seen.bounded ? seen.low[1] : -2.0f, pv1 = seen.bounded ? seen.high[1] : 2.0f;
        const float pw0 = seen.bounded ? seen.low[2] : -2.0f, pw1 = seen.bounded ? seen.high[2] : 2.0f;
        const float nearest = seen.bounded ? seen.nearest : 3.0e38f;
        auto at = [&](int k) { return *(const Sixteen*)(b + 16 * k); };
        const Sixteen cu = at(0), cv = at(1), cw = at(2), eu = at(3), ev = at(4), ew = at(5), t0 = at(6), t1 = at(7);
        if (it.blind) {
            covered = 0;
            return bits(eu >= 0.0f);
        }
        const Sixteen m = 4.0f + 2.001f * largest(largest(t0, -t0), largest(t1, -t1));
        const Sixteen edge = it.edge * m, plane = it.plane * m;
        const Sixteen c0 = it.n[0][0] * cu + it.n[0][1] * cv + it.n[0][2] * cw;
        const Sixteen c1 = it.n[1][0] * cu + it.n[1][1] * cv + it.n[1][2] * cw;
        const Sixteen c2 = it.n[2][0] * cu + it.n[2][1] * cv + it.n[2][2] * cw;
        const Sixteen r0 = it.reach[0][0] * eu + it.reach[0][1] * ev + it.reach[0][2] * ew;
        const Sixteen r1 = it.reach[1][0] * eu + it.reach[1][1] * ev + it.reach[1][2] * ew;
        const Sixteen r2 = it.reach[2][0] * eu + it.reach[2][1] * ev + it.reach[2][2] * ew;
        const Sixteen g = it.p[0] * cu + it.p[1] * cv + it.p[2] * cw;
        const Sixteen h = it.spread[0] * eu + it.spread[1] * ev + it.spread[2] * ew;
        const int mask = bits((cu - eu <= pu1) & (cu + eu >= pu0) & (cv - ev <= pv1) & (cv + ev >= pv0)
                              & (cw - ew <= pw1) & (cw + ew >= pw0) & (t0 <= nearest) & (c0 + r0 >= -edge)
                              & (c1 + r1 >= -edge) & (c2 + r2 >= -edge) & (g + h + it.p[3] * t0 >= -plane));
        covered = mask & bits((c0 - r0 > edge) & (c1 - r1 > edge) & (c2 - r2 > edge)
                              & (g - h + it.p[3] * t1 > plane));
        return mask;
    };
    // A node, by its number in its level, has no live rays any more.
    auto finish = [&](int level, int node) {
        for (;;) {
            const int number = tree.offset.data[level] + node;
            if (tree.flags.data[number])
                return;
            tree.flags.data[number] = 1;
            float* box = tree.boxes.data + 128 * (size_t)(number / 16) + number % 16;
            box[48] = box[64] = box[80] = -1.0e30f;
            if (level + 1 >= tree.levels)
                return;
            ++level;
            node /= 16;
            if (--tree.live.data[tree.offset.data[level] + node] > 0)
                return;
        }
    };
    auto accept_leaf = [&](int leaf) {
        if (tree.flags.data[leaf])
            return;
        for (int live = tree.live.data[leaf]; live; live &= live - 1)
            answers.states.data[tree.order.data[16 * leaf + __builtin_ctz(live)]] = 1;
        tree.live.data[leaf] = 0;
        finish(0, leaf);
    };
    auto test_leaf = [&](int leaf, int triangle) {
        if (tree.flags.data[leaf])
            return;
        int live = tree.live.data[leaf], yes = 0;
        tests += __builtin_popcount(live);
        const int found = live & filter16((const float*)occluders.records.data + 16 * (size_t)triangle,
                                          tree.leaves.data + 80 * (size_t)leaf, yes);
        if (!found)
            return;
        yes &= found;
        for (int left = yes; left; left &= left - 1)
            answers.states.data[tree.order.data[16 * leaf + __builtin_ctz(left)]] = 1;
        for (int left = found & ~yes; left; left &= left - 1)
            settle(tree.order.data[16 * leaf + __builtin_ctz(left)], triangle);
        if (!yes)
            return;
        live &= ~yes;
        tree.live.data[leaf] = live;
        if (live == 0)
            finish(0, leaf);
    };
    auto walk = [&](int first, int last, int triangle) {
        int top = 0;
        while ((last >> (4 * top + 4)) - (first >> (4 * top + 4)) > 1)
            ++top;
        int group[8], mask[8], whole[8];
        auto enter = [&](int level, int which) {
            const int from = first >> (4 * level), to = last >> (4 * level);
            const int low = from > 16 * which ? from - 16 * which : 0;
            const int high = to < 16 * which + 15 ? to - 16 * which : 15;
            const int range = (0xFFFF >> (15 - high)) & (0xFFFF << low);
            group[level] = which;
            mask[level] = boxes16(tree.boxes.data + 8 * ((size_t)tree.offset.data[level] + 16 * which), whole[level]);
            mask[level] &= range;
            nodes += high - low + 1;
        };
        for (int which = first >> (4 * top + 4); which <= last >> (4 * top + 4); ++which) {
            int level = top;
            enter(level, which);
            for (;;) {
                if (mask[level] == 0) {
                    if (level == top)
                        break;
                    ++level;
                    continue;
                }
                const int lane = __builtin_ctz(mask[level]);
                mask[level] &= mask[level] - 1;
                const int node = 16 * group[level] + lane;
                if (whole[level] >> lane & 1) {
                    const int width = 1 << (4 * level);
                    ++accepted;
                    for (int leaf = node * width; leaf < (node + 1) * width && leaf < leaves; ++leaf)
                        accept_leaf(leaf);
                } else if (level == 0) {
                    test_leaf(node, triangle);
                } else {
                    --level;
                    enter(level, node);
                }
            }
        }
    };
    for (int t = 0; t < occluders.count; ++t) {
        if (t + 8 < occluders.count)
            __builtin_prefetch(occluders.corners.data + occluders.triangles.data[t + 8][0]);
        wp::vec4 at[3];
        const float size = corners_of(t, 0, at);
        const int touched = touched_by(at, size);
        bool loaded = false;
        for (int face = 0; face < 6; ++face) {
            if (!(touched >> face & 1) || tree.fit.data[face][3] == 0.0f)
                continue;
            seen.bounded = false;
            if (size < far_out && !look(at[0], at[1], at[2], size, face, seen))
                continue;
            int run[8];
            const int count = runs(seen, face, run);
            if (count == 0)
                continue;
            if (!loaded && !load((const wp::vec4*)occluders.records.data + 4 * (size_t)t, it))
                break;
            loaded = true;
            for (int k = 0; k < count; ++k)
                walk(run[2 * k], run[2 * k + 1], t);
        }
    }
    wp::int64* counter = answers.counters.data;
    wp::atomic_add(counter + nodes_visited, nodes);
    wp::atomic_add(counter + leaf_tests, tests);
    wp::atomic_add(counter + accepted_nodes, accepted);
"""
)


# For CUDA the body is left out: no kernel launches it there.
@wp.func_native("#if !defined(__CUDA_ARCH__)\n" + _WIDE + "\n#endif\n")
def descend_all(
    space: LightSpace,
    tree: RayTree,
    occluders: Occluders,
    answers: Answers,
):
    """All triangles, one after the other."""
    ...


@wp.kernel(enable_backward=False)
def descend_wide(light: wp.array(dtype=LightFrame), tree: RayTree, occluders: Occluders, answers: Answers):
    """One thread."""
    wp.atomic_add(answers.counters, 0, PASSES, wp.int64(1))
    descend_all(space_of(light[0]), tree, occluders, answers)
