// cpu
// needs: accelerators/bvh/search.h accelerators/bvh/slabs.h@8
// constants: TREE_WIDTH
// The tree with eight children per node; see wide_tree.py.
struct WideTree {
    enum { DEPTH = 256, BOUNDS = 6 * TREE_WIDTH, LINKS = 2 * TREE_WIDTH, INNER = 0, NONE = -1 };

    static inline Search::Found search(wp::uint64 bvh, const wp::array_t<float>& bounds, const wp::array_t<int>& links,
                                       const wp::vec3& origin, const wp::vec3& direction, float longest,
                                       const wp::array_t<wp::vec4>& records, const wp::vec4& ray, float magnitude,
                                       int count, int skip) {
        const wp::vec3 inverse(1.0f / direction[0], 1.0f / direction[1], 1.0f / direction[2]);
        const int* primitives = wp::bvh_get(bvh).primitive_indices;
        Search search = { primitives, (const float*)records.data, ray, magnitude, count, skip };
        Search::Found result;
        int stack[DEPTH];
        int top = 0, node = 0;
        for (;;) {
            ++search.nodes;
            const Real8* bound = (const Real8*)(bounds.data + BOUNDS * (size_t)node);
            const int* link = links.data + LINKS * (size_t)node;
            const int* count = link + TREE_WIDTH;
            Slabs8 slabs;
            slabs.enter(bound, bound + 3, origin, inverse, longest);
            float in[TREE_WIDTH];
            Lanes8::store(in, slabs.in);
            int next = -1;
            float nearest = 3.0e38f;
            for (int k = 0; k < TREE_WIDTH; ++k) {
                if (!(slabs.met >> k & 1) || count[k] == NONE)
                    continue;
                if (count[k] != INNER) {
                    if (search.leaf(link[k], link[k] + count[k], result))
                        return search.done(result);
                    continue;
                }
                const bool nearer = in[k] < nearest;
                if (next >= 0) {
                    if (top == DEPTH)
                        return search.too_deep(result);
                    stack[top++] = nearer ? next : link[k];
                }
                if (nearer) {
                    next = link[k];
                    nearest = in[k];
                }
            }
            if (next < 0) {
                if (top == 0)
                    break;
                next = stack[--top];
            }
            node = next;
        }
        return search.done(result);
    }
};
