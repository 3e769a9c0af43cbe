// needs: accelerators/bvh/search.h accelerators/bvh/slabs.h
// Nearer child first; uses the node layout of Warp's bvh.h.
struct BinaryTree {
    enum { DEPTH = 64 };
    const wp::BVH tree;
    const wp::vec3 origin, inverse;
    float longest;

    // Entry distance of a node's box, or one that is not `met`.
    inline float enter(int node) const {
        Slabs1 slabs;
        slabs.enter((const float*)(tree.node_lowers + node), (const float*)(tree.node_uppers + node), origin, inverse,
                    longest);
        return slabs.met ? slabs.in : 3.0e38f;
    }
    static inline bool met(float distance) { return distance < 1.0e38f; }
    static inline Search::Found search(wp::uint64 bvh, const wp::vec3& origin, const wp::vec3& direction, float longest,
                                       const wp::array_t<wp::vec4>& records, const wp::vec4& ray, float magnitude,
                                       int count, int skip) {
        const wp::vec3 inverse(1.0f / direction[0], 1.0f / direction[1], 1.0f / direction[2]);
        const BinaryTree it = { wp::bvh_get(bvh), origin, inverse, longest };
        Search search = { it.tree.primitive_indices, (const float*)records.data, ray, magnitude, count, skip };
        Search::Found result;
        int stack[DEPTH];
        int top = 0, node = *it.tree.root;
        if (!met(it.enter(node)))
            return result;
        for (;;) {
            ++search.nodes;
            const wp::BVHPackedNodeHalf lower = it.tree.node_lowers[node];
            const int left = lower.i, right = it.tree.node_uppers[node].i;
            if (lower.b) {
                if (search.leaf(left, right, result))
                    break;
            } else {
                const float to_left = it.enter(left), to_right = it.enter(right);
                const bool see_left = met(to_left), see_right = met(to_right);
                if (see_left && see_right) {
                    if (top == DEPTH)
                        return search.too_deep(result);
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
                break;
            node = stack[--top];
        }
        return search.done(result);
    }
};
