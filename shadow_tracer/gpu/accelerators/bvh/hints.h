// needs: query
// arguments: Structure structure
// What hid the neighbour mostly hides a ray too. Any triangle may be tried: a stale hint costs a test, no bit.
struct Hints {
    // Shows the neighbour's; true if that was enough.
    static inline bool enough(const Structure& structure, Query1& query) {
        const int ray = query.ray[0], hint = structure.hints.data[ray > 0 ? ray - 1 : 0];
        structure.hints.data[ray] = hint;
        return hint < query.triangle_count() && query.visit(hint);
    }
    static inline void leave(const Structure& structure, const Query1& query) {
        if (query.hider >= 0)
            structure.hints.data[query.ray[0]] = query.hider;
    }
};
// A box of a tree. Those of a leaf that it has to spare hold nothing.
struct Leaf {
    static inline bool visit(int triangle, Query1& query) {
        return triangle < query.triangle_count() && query.visit(triangle);
    }
};
