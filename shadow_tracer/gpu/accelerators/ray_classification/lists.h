// needs: query accelerators/ray_classification/place.h
// arguments: Structure structure
// The triangles that rays of a ray's cell could meet; see ray_classification.py.
struct Walk1 {
    static inline void walk(const Structure& structure, Query1& query) {
        Segment segment;
        const int where = segment.place(query, structure.box);
        if (where == Segment::MISSES)
            return;
        if (where == Segment::TOO_FAR) {
            query.everything();
            return;
        }
        RayPlace place(segment);
        place.find(structure, query.nodes);
        const int first = structure.first.data[place.node], last = first + structure.count.data[place.node];
        for (int k = first; k < last; ++k)
            if (query.visit(structure.members.data[k]))
                return;
    }
};
