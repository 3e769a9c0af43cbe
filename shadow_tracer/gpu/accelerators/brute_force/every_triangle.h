// needs: query
// arguments: Structure structure
// lanes
// No structure: every triangle.
struct WIDE(Walk) {
    static inline void walk(const Structure& structure, WIDE(Query) & query) { query.everything(); }
};
