// needs: query accelerators/segment.h accelerators/bvh/slabs.h
// constants: CORNERS TREE_LANES
// arguments: Tree structure
// The tree with two children per node, in its order and without a stack: from a node that is met to its first child,
// from others and from blocks to where all below them is left behind.
struct Walk1 {
    static inline void walk(const Tree& tree, Query1& query) {
        Segment segment;
        const int place = segment.place(query, tree.box);
        if (place == Segment::TOO_FAR)
            query.everything();
        if (place != Segment::MEETS)
            return;
        const wp::vec3 inverse(1.0f / segment.direction[0], 1.0f / segment.direction[1], 1.0f / segment.direction[2]);
        segment.shorten(query, tree.box);
        for (int node = 0; node >= 0;) {
            const float* box = tree.corners.data + CORNERS * (size_t)node;
            Slabs1 slabs;
            slabs.enter(box, box + 4, segment.above, segment.below, inverse, segment.longest);
            ++query.nodes;
            const int first = tree.children.data[2 * (size_t)node];
            if (slabs.met && first >= 0) {
                node = first;
                continue;
            }
            node = tree.escapes.data[node];
            if (!slabs.met)
                continue;
            const int* members = tree.members.data + TREE_LANES * (size_t)~first;
            for (int k = 0; k < TREE_LANES; ++k)
                if (members[k] >= 0 && members[k] < query.triangle_count() && query.visit(members[k]))
                    return;
            segment.shorten(query, tree.box);
        }
    }
};
