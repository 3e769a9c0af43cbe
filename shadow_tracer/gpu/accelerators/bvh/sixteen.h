// cpu
// needs: query accelerators/segment.h accelerators/bvh/descent.h
// arguments: Tree structure
// One ray, or bundle of rays to the points of a light, through the tree with sixteen children per node.
struct Walk1 {
    static inline void walk(const Tree& tree, Query1& query) {
        Segment segment;
        const int place = segment.place(query, tree.box);
        if (place == Segment::TOO_FAR)
            query.everything();
        if (place != Segment::MEETS)
            return;
        segment.shorten(query, tree.box);
        float beside = 0.0f; // of a point, along all axes together
        for (int k = 0; k < 3; ++k) {
            const float most = segment.above[k] - segment.origin[k];
            beside += most * most;
        }
        Descent1 descent(tree, segment.origin, segment.direction, segment.longest, sqrtf(beside));
        descent.go(query, &segment, Descent1::NO_END);
    }
};
