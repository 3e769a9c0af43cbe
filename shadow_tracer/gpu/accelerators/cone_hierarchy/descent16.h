// cpu
// needs: accelerators/cone_hierarchy/boxes.h accelerators/cone_hierarchy/triangle.h@16 exact/filter.h@16 visibility/answers.h
// constants: SHADOWED NODES_VISITED LEAF_TESTS ACCEPTED LEAF_QUANTITIES NODE_DONE
// What the CPU does: masks of survivors on a small stack, and nodes that are accepted are finished at once, down to
// their rays; see descent.py.
struct Descent {
    // Rays of a leaf and children of a node.
    enum { LOG = 4, BRANCH = 1 << LOG, ALL = BRANCH - 1, MOST_LEVELS = 8, AHEAD = 8 };
    Traveller16 triangle;
    const RayTree& tree;
    const Answers& answers;
    int leaves; // those that hold rays of this pass: what lies behind is of another frame
    wp::int64 nodes, tests, accepted;

    // A node, by its number in its level, has no live rays any more.
    inline void finish(int level, int node) const {
        for (;;) {
            const int number = tree.offset.data[level] + node;
            if (tree.flags.data[number])
                return;
            tree.flags.data[number] = NODE_DONE;
            NodeBox::close(NodeBox::at(tree, number, LOG), BRANCH);
            if (level + 1 >= tree.levels)
                return;
            ++level;
            node /= BRANCH;
            if (--tree.live.data[tree.offset.data[level] + node] > 0)
                return;
        }
    }
    // These rays of a leaf, as bits, are in shadow.
    inline void hide(int leaf, int rays) const {
        for (; rays; rays &= rays - 1)
            answers.states.data[tree.order.data[BRANCH * leaf + __builtin_ctz(rays)]] = SHADOWED;
    }
    inline void accept(int leaf) const {
        if (tree.flags.data[leaf])
            return;
        hide(leaf, tree.live.data[leaf]);
        tree.live.data[leaf] = 0;
        finish(0, leaf);
    }
    inline void test(int leaf, int number) {
        if (tree.flags.data[leaf])
            return;
        int live = tree.live.data[leaf], yes = 0;
        tests += __builtin_popcount(live);
        const int found = live
                          & Filter16::possible((const float*)triangle.occluders.records.data + 16 * (size_t)number,
                                               tree.leaves.data + (size_t)(LEAF_QUANTITIES * BRANCH) * leaf, yes);
        if (!found)
            return;
        yes &= found;
        hide(leaf, yes);
        for (int left = found & ~yes; left; left &= left - 1)
            if (Settle::pair(answers, tree.order.data[BRANCH * leaf + __builtin_ctz(left)], number))
                yes |= left & -left;
        if (!yes)
            return;
        live &= ~yes;
        tree.live.data[leaf] = live;
        if (live == 0)
            finish(0, leaf);
    }
    inline void walk(int first, int last, int number) {
        int top = 0;
        while ((last >> (LOG * top + LOG)) - (first >> (LOG * top + LOG)) > 1)
            ++top;
        int group[MOST_LEVELS], mask[MOST_LEVELS], whole[MOST_LEVELS];
        auto enter = [&](int level, int which) {
            const int from = first >> (LOG * level), to = last >> (LOG * level);
            const int low = from > BRANCH * which ? from - BRANCH * which : 0;
            const int high = to < BRANCH * which + ALL ? to - BRANCH * which : ALL;
            const int range = (Lanes16::ALL >> (ALL - high)) & (Lanes16::ALL << low);
            group[level] = which;
            const int node = tree.offset.data[level] + BRANCH * which;
            mask[level] = range & triangle.judge(NodeBox::at(tree, node, LOG), BRANCH, whole[level]);
            nodes += high - low + 1;
        };
        for (int which = first >> (LOG * top + LOG); which <= last >> (LOG * top + LOG); ++which) {
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
                const int node = BRANCH * group[level] + lane;
                if (whole[level] >> lane & 1) {
                    const int width = 1 << (LOG * level);
                    ++accepted;
                    for (int leaf = node * width; leaf < (node + 1) * width && leaf < leaves; ++leaf)
                        accept(leaf);
                } else if (level == 0) {
                    test(node, number);
                } else {
                    --level;
                    enter(level, node);
                }
            }
        }
    }
    inline void travel(int number) {
        Corners1 corners;
        const int touched = triangle.look(number, corners);
        bool loaded = false;
        for (int face = 0; face < Corners1::FACES; ++face) {
            Runs runs;
            if (!(touched >> face & 1) || !triangle.enter(face, corners, runs) || runs.count == 0)
                continue;
            if (!loaded && !triangle.load(number))
                return;
            loaded = true;
            for (int k = 0; k < runs.count; ++k)
                walk(runs.first[k], runs.last[k], number);
        }
    }
    // All triangles, one after the other.
    static inline void all(const LightSpace& space, const RayTree& tree, const Occluders& occluders,
                           const Answers& answers) {
        const int leaves = (tree.counts.data[0] + BRANCH - 1) / BRANCH;
        Descent it = { { space, tree, occluders }, tree, answers, leaves, 0, 0, 0 };
        for (int t = 0; t < occluders.count; ++t) {
            if (t + AHEAD < occluders.count)
                __builtin_prefetch(occluders.corners.data + occluders.triangles.data[t + AHEAD][0]);
            it.travel(t);
        }
        wp::int64* counter = answers.counters.data;
        wp::atomic_add(counter + NODES_VISITED, it.nodes);
        wp::atomic_add(counter + LEAF_TESTS, it.tests);
        wp::atomic_add(counter + ACCEPTED, it.accepted);
    }
};
