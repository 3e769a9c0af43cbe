// cpu
// needs: query accelerators/segment.h accelerators/bvh/hints.h accelerators/bvh/slabs.h@8 accelerators/bvh/bundle.h@8
// constants: TREE_WIDTH
// arguments: Structure structure
// The tree with eight children per node; see wide_tree.py.
struct Walk1 {
    enum { DEPTH = 256, BOUNDS = 6 * TREE_WIDTH, LINKS = 2 * TREE_WIDTH, INNER = 0, NONE = -1 };

    // The children that are met, as bits, and where.
    static inline int enter(const Real8* bound, const Segment& segment, const BundleSides& sides,
                            const wp::vec3& inverse, float* in) {
        if (Query1::SPREADS) {
            Bundle8 bundle;
            bundle.enter(bound, bound + 3, sides, segment.longest);
            Lanes8::store(in, bundle.in);
            return bundle.met;
        }
        Slabs8 slabs;
        slabs.enter(bound, bound + 3, segment.above, segment.below, inverse, segment.longest);
        Lanes8::store(in, slabs.in);
        return slabs.met;
    }
    // False if the stack does not hold the tree.
    static inline bool descend(const Structure& structure, Segment& segment, Query1& query) {
        const wp::vec3 inverse(1.0f / segment.direction[0], 1.0f / segment.direction[1], 1.0f / segment.direction[2]);
        const BundleSides sides(query, segment, structure.box);
        const int* primitives = wp::bvh_get(structure.bvh).primitive_indices;
        int stack[DEPTH];
        int top = 0, node = 0;
        segment.shorten(query, structure.box);
        for (;;) {
            ++query.nodes;
            const Real8* bound = (const Real8*)(structure.bounds.data + BOUNDS * (size_t)node);
            const int* link = structure.links.data + LINKS * (size_t)node;
            const int* count = link + TREE_WIDTH;
            float in[TREE_WIDTH];
            const int met = enter(bound, segment, sides, inverse, in);
            int next = -1;
            float nearest = 3.0e38f;
            for (int k = 0; k < TREE_WIDTH; ++k) {
                if (!(met >> k & 1) || count[k] == NONE)
                    continue;
                if (count[k] != INNER) {
                    for (int j = link[k]; j < link[k] + count[k]; ++j)
                        if (Leaf::visit(primitives[j], query))
                            return true;
                    segment.shorten(query, structure.box);
                    continue;
                }
                const bool nearer = in[k] < nearest;
                if (next >= 0) {
                    if (top == DEPTH)
                        return false;
                    stack[top++] = nearer ? next : link[k];
                }
                if (nearer) {
                    next = link[k];
                    nearest = in[k];
                }
            }
            if (next < 0) {
                if (top == 0)
                    return true;
                next = stack[--top];
            }
            node = next;
        }
    }
    static inline void walk(const Structure& structure, Query1& query) {
        Segment segment;
        const int place = segment.place(query, structure.box);
        if (place == Segment::MISSES || (place == Segment::MEETS && Hints::enough(structure, query)))
            return;
        if (place == Segment::TOO_FAR || !descend(structure, segment, query))
            query.everything();
        Hints::leave(structure, query);
    }
};
