// needs: exact/filter.h
// constants: TREE_FOUND
// A ray on its way through a tree of triangles: those of leaves against the filter. What it finds is no member: it is
// indexed at run time, and what holds that lies in memory.
struct Search {
    typedef wp::vec_t<4 + TREE_FOUND, wp::int32> Found; // see binary_tree.py
    enum { CERTAIN, TESTS, NODES, UNCERTAIN, FIRST };
    enum { TOO_DEEP = -1, YES = 1 };
    const int* primitives;
    const float* records;
    const wp::vec4& ray;
    float magnitude;
    int count; // triangles; boxes of the tree beyond that hold nothing
    int skip;  // uncertain triangles that are known
    int nodes, tests, found;

    // The triangles of a leaf, from one to before another; true if one of them is a certain occluder.
    inline bool leaf(int first, int last, Found& result) {
        for (int k = first; k < last; ++k) {
            const int triangle = primitives[k];
            if (triangle >= count)
                continue;
            ++tests;
            int yes = 0;
            if (!Filter1::possible(records + 16 * (size_t)triangle, ray[0], ray[1], ray[2], ray[3], magnitude, yes))
                continue;
            if (yes) {
                result[CERTAIN] = YES;
                result[FIRST] = triangle;
                return true;
            }
            if (found >= skip && found < skip + TREE_FOUND)
                result[FIRST + found - skip] = triangle;
            ++found;
        }
        return false;
    }
    // With what has been counted.
    inline Found done(Found& result) const {
        result[TESTS] = tests;
        result[NODES] = nodes;
        if (result[CERTAIN] != YES)
            result[UNCERTAIN] = found;
        return result;
    }
    static inline Found too_deep(Found& result) {
        result[CERTAIN] = TOO_DEEP;
        return result;
    }
};
