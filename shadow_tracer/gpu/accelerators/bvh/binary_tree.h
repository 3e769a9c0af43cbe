// needs: query accelerators/segment.h accelerators/bvh/hints.h accelerators/bvh/slabs.h accelerators/bvh/bundle.h
// arguments: Structure structure
// Nearer child first; uses the node layout of Warp's bvh.h. Warp's own query iterator pushes both children untested and
// hands out boxes one by one: it takes three times as long.
struct Walk1 {
    enum { DEPTH = 64 };
    const wp::BVH tree;
    const SceneBox& box;
    Segment& segment;
    const BundleSides sides;
    const wp::vec3 inverse;

    // Entry distance of a node's box, or one that is not `met`.
    inline float enter(int node) const {
        const float *low = (const float*)(tree.node_lowers + node), *high = (const float*)(tree.node_uppers + node);
        if (Query1::SPREADS) {
            Bundle1 bundle;
            bundle.enter(low, high, sides, segment.longest);
            return bundle.met ? bundle.in : 3.0e38f;
        }
        Slabs1 slabs;
        slabs.enter(low, high, segment.above, segment.below, inverse, segment.longest);
        return slabs.met ? slabs.in : 3.0e38f;
    }
    static inline bool met(float distance) { return distance < 1.0e38f; }
    // False if the stack does not hold the tree.
    inline bool descend(Query1& query) const {
        int stack[DEPTH];
        int top = 0, node = *tree.root;
        segment.shorten(query, box);
        if (!met(enter(node)))
            return true;
        for (;;) {
            ++query.nodes;
            const wp::BVHPackedNodeHalf lower = tree.node_lowers[node];
            const int left = lower.i, right = tree.node_uppers[node].i;
            if (lower.b) {
                for (int k = left; k < right; ++k)
                    if (Leaf::visit(tree.primitive_indices[k], query))
                        return true;
                segment.shorten(query, box);
            } else {
                const float to_left = enter(left), to_right = enter(right);
                const bool see_left = met(to_left), see_right = met(to_right);
                if (see_left && see_right) {
                    if (top == DEPTH)
                        return false;
                    stack[top++] = to_left <= to_right ? right : left;
                    node = to_left <= to_right ? left : right;
                    continue;
                }
                if (see_left || see_right) {
                    // As a branch: the CPU guesses which child is next, and fetches it before it knows.
                    node = __builtin_expect(see_left, 1) ? left : right;
                    continue;
                }
            }
            if (top == 0)
                return true;
            node = stack[--top];
        }
    }
    static inline void walk(const Structure& structure, Query1& query) {
        Segment segment;
        const int place = segment.place(query, structure.box);
        if (place == Segment::MISSES || (place == Segment::MEETS && Hints::enough(structure, query)))
            return;
        const wp::vec3 inverse(1.0f / segment.direction[0], 1.0f / segment.direction[1], 1.0f / segment.direction[2]);
        if (place == Segment::TOO_FAR
            || !Walk1{ wp::bvh_get(structure.bvh), structure.box, segment, BundleSides(query, segment, structure.box),
                       inverse }
                    .descend(query))
            query.everything();
        Hints::leave(structure, query);
    }
};
