// needs: query accelerators/ray_classification/place.h
// arguments: Structure structure
// constants: FEW_CANDIDATES
// Asks for the list of a smaller cell, unless the one that there is is short; shows no triangles.
struct Walk1 {
    static inline void walk(const Structure& structure, Query1& query) {
        Segment segment;
        if (segment.place(query, structure.box) != Segment::MEETS)
            return;
        RayPlace place(segment);
        wp::int64 steps = 0;
        const int slot = place.find(structure, steps);
        if (slot < 0 || structure.count.data[place.node] <= FEW_CANDIDATES)
            return;
        // The first one that asks; who comes later finds that it has been asked for.
        int* child = structure.children.data + slot;
        if (*child != 0 || wp::atomic_add(child, -1) != 0)
            return;
        const int made = wp::atomic_add(structure.made.data, 1);
        if (made < structure.level.shape[0])
            structure.asked.data[made] = slot;
    }
};
