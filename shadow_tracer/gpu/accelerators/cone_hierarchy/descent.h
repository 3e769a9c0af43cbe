// needs: accelerators/cone_hierarchy/boxes.h accelerators/cone_hierarchy/triangle.h exact/filter.h visibility/answers.h
// constants: SHADOWED NODES_VISITED LEAF_TESTS ACCEPTED COUNTER_ROWS LEAF_QUANTITIES NODE_DONE NODE_WHOLE
// What a CUDA thread does; see descent.py.
struct Descent {
    enum { REJECTED, OPENED, COVERED };
    Traveller1 triangle;
    const RayTree& tree;
    const Answers& answers;
    wp::int64 nodes, tests, accepted;

    inline int judge(int node) const {
        if (node < tree.visits.shape[0])
            wp::atomic_add(&tree.visits.data[node], 1);
        int covered;
        const int found = triangle.judge(NodeBox::at(tree, node, tree.log_branch), 1 << tree.log_branch, covered);
        return covered ? COVERED : found ? OPENED : REJECTED;
    }
    // A node, by its number in its level, has no live rays any more, or is accepted.
    inline void finish(int level, int node, int bits) const {
        for (;;) {
            const int number = tree.offset.data[level] + node;
            if (wp::atomic_or(&tree.flags.data[number], bits) & NODE_DONE)
                return;
            NodeBox::close(NodeBox::at(tree, number, tree.log_branch), 1 << tree.log_branch);
            if (level + 1 >= tree.levels)
                return;
            ++level;
            node >>= tree.log_branch;
            bits = NODE_DONE;
            if (wp::atomic_add(&tree.live.data[tree.offset.data[level] + node], -1) > 1)
                return;
        }
    }
    inline void test(int leaf, int number) {
        const int size = 1 << tree.log_leaf;
        const float* from = tree.leaves.data + (size_t)leaf * LEAF_QUANTITIES * size;
        const float* record = (const float*)triangle.occluders.records.data + 16 * (size_t)number;
        const int live = tree.live.data[leaf];
        for (int j = 0; j < size; ++j) {
            if (!(live >> j & 1))
                continue;
            ++tests;
            int yes = 0;
            if (!Filter1::possible(record, from[j], from[size + j], from[2 * size + j], from[3 * size + j],
                                   from[4 * size + j], yes))
                continue;
            const int sample = tree.order.data[(leaf << tree.log_leaf) + j];
            if (yes)
                answers.states.data[sample] = SHADOWED;
            else if (!Settle::pair(answers, sample, number))
                continue;
            const int bit = (int)(1u << j);
            if (wp::atomic_and(&tree.live.data[leaf], ~bit) == bit)
                finish(0, leaf, NODE_DONE);
        }
    }
    // Leaves first to last: always the largest aligned node that fits into what is left and into `level`.
    inline void walk(int first, int last, int number) {
        const int log_branch = tree.log_branch;
        int level = tree.levels - 1;
        for (int at = first; at <= last;) {
            while (level > 0 && (at & ((1 << log_branch * level) - 1) || at + (1 << log_branch * level) - 1 > last))
                --level;
            const int node = at >> log_branch * level;
            ++nodes;
            const int found = judge(tree.offset.data[level] + node);
            if (found == OPENED && level > 0) {
                --level;
                continue;
            }
            if (found == OPENED)
                test(at, number);
            if (found == COVERED) {
                ++accepted;
                finish(level, node, NODE_DONE | NODE_WHOLE);
            }
            at += 1 << log_branch * level;
            // Siblings stay at this level; behind the last one, back to where the parent's siblings are.
            while (level + 1 < tree.levels && !(at & ((1 << log_branch * (level + 1)) - 1)))
                ++level;
        }
    }
    inline void count(int thread) const {
        wp::int64* counter = answers.counters.data + (size_t)(thread & (COUNTER_ROWS - 1)) * answers.counters.shape[1];
        if (nodes)
            wp::atomic_add(counter + NODES_VISITED, nodes);
        if (tests)
            wp::atomic_add(counter + LEAF_TESTS, tests);
        if (accepted)
            wp::atomic_add(counter + ACCEPTED, accepted);
    }
    // A triangle from its own cells; true if nothing was done because it may touch small_run leaves in a row or more.
    static inline bool small(int number, int small_run, const LightSpace& space, const RayTree& tree,
                             const Occluders& occluders, const Answers& answers) {
        Descent it = { { space, tree, occluders }, tree, answers, 0, 0, 0 };
        if (!it.triangle.load(number))
            return false;
        Corners1 corners;
        const int touched = it.triangle.look(number, corners);
#pragma unroll 1
        for (int pass = 0; pass < 2; ++pass)
#pragma unroll 1
            for (int face = 0; face < Corners1::FACES; ++face) {
                Runs runs;
                if (!(touched >> face & 1) || !it.triangle.enter(face, corners, runs))
                    continue;
                for (int k = 0; k < runs.count; ++k) {
                    if (pass == 0 && runs.last[k] - runs.first[k] >= small_run)
                        return true;
                    if (pass == 1)
                        it.walk(runs.first[k], runs.last[k], number);
                }
            }
        it.count(number);
        return false;
    }
    // A triangle through one chunk of the leaves, the size of a node of level chunk_level.
    static inline void large(int thread, int number, int chunk, int chunk_level, const LightSpace& space,
                             const RayTree& tree, const Occluders& occluders, const Answers& answers) {
        Descent it = { { space, tree, occluders }, tree, answers, 0, 0, 0 };
        if (!it.triangle.load(number))
            return;
        it.triangle.open();
        const int leaves = (tree.counts.data[0] + (1 << tree.log_leaf) - 1) >> tree.log_leaf;
        const int first = chunk << tree.log_branch * chunk_level;
        int last = first + (1 << tree.log_branch * chunk_level) - 1;
        last = last < leaves ? last : leaves - 1;
        if (first <= last
            && (tree.levels <= chunk_level || it.judge(tree.offset.data[chunk_level] + chunk) != REJECTED))
            it.walk(first, last, number);
        it.count(thread);
    }
};
