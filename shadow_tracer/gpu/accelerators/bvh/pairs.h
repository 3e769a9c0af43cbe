// needs: query accelerators/segment.h accelerators/bvh/slabs.h
// constants: CORNERS TREE_LANES LEVELS
// arguments: Tree structure
// The tree with two children per node, nearer child first.
struct Walk1 {
    const Tree& tree;
    Segment& segment;
    const wp::vec3 inverse;

    // Entry distance of a node's box, or one that is not `met`.
    inline float enter(int node) const {
        const float* box = tree.corners.data + CORNERS * (size_t)node;
        Slabs1 slabs;
        slabs.enter(box, box + 4, segment.above, segment.below, inverse, segment.longest);
        return slabs.met ? slabs.in : 3.0e38f;
    }
    static inline bool met(float distance) { return distance < 1.0e38f; }
    // Shows a block; true if that was enough.
    inline bool block(int number, Query1& query) const {
        const int* members = tree.members.data + TREE_LANES * (size_t)number;
        for (int k = 0; k < TREE_LANES; ++k)
            if (members[k] >= 0 && members[k] < query.triangle_count() && query.visit(members[k]))
                return true;
        segment.shorten(query, tree.box);
        return false;
    }
    // The tree is never deeper than the stack.
    inline void descend(Query1& query) const {
        int stack[LEVELS];
        int top = 0, node = 0;
        segment.shorten(query, tree.box);
        if (!met(enter(node)))
            return;
        for (;;) {
            ++query.nodes;
            const int left = tree.children.data[2 * (size_t)node], right = tree.children.data[2 * (size_t)node + 1];
            if (left < 0) {
                if (block(~left, query))
                    return;
            } else {
                const float to_left = enter(left), to_right = enter(right);
                const bool see_left = met(to_left), see_right = met(to_right);
                if (see_left && see_right)
                    stack[top++] = to_left <= to_right ? right : left;
                if (see_left || see_right) {
                    node = see_left && (!see_right || to_left <= to_right) ? left : right;
                    continue;
                }
            }
            if (top == 0)
                return;
            node = stack[--top];
        }
    }
    static inline void walk(const Tree& tree, Query1& query) {
        Segment segment;
        const int place = segment.place(query, tree.box);
        if (place == Segment::TOO_FAR)
            query.everything();
        if (place != Segment::MEETS)
            return;
        const wp::vec3 inverse(1.0f / segment.direction[0], 1.0f / segment.direction[1], 1.0f / segment.direction[2]);
        Walk1{ tree, segment, inverse }.descend(query);
    }
};
