// cpu
// needs: query accelerators/segment.h accelerators/bvh/descent.h
// arguments: Tree structure
// One ray through the tree with sixteen children per node.
struct Walk1 {
    static inline void walk(const Tree& tree, Query1& query) {
        Segment segment;
        const int place = segment.place(query, tree.box);
        if (place == Segment::TOO_FAR)
            query.everything();
        if (place != Segment::MEETS)
            return;
        segment.shorten(query, tree.box);
        Descent1 descent(tree, segment.origin, segment.direction, segment.longest, 0.0f);
        descent.go(query, &segment, Descent1::NO_END);
    }
};
