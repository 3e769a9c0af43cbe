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
        const wp::vec3 beside = segment.above - segment.origin; // of a point, along each axis at most
        Descent1 descent(tree, segment.origin, segment.direction, segment.longest,
                         sqrtf(beside[0] * beside[0] + beside[1] * beside[1] + beside[2] * beside[2]));
        descent.go(query, &segment, Descent1::NO_END);
    }
};
