// needs: query walk
// arguments: Structure structure, Occluders occluders, Answers answers
// lanes
// Sends rays through a structure, LANES together.
struct WIDE(Walker) {
    // Those from `first` to `last`.
    static inline void some(int first, int last, int row, const Structure& structure, const wp::array_t<wp::vec4>& rays,
                            const Occluders& occluders, const Answers& answers) {
        WIDE(Query) query(rays, occluders, answers);
        for (int ray = first; ray < last; ++ray) {
            query.take(ray);
            if (query.taken && (query.full() || ray + 1 == last)) {
                query.begin();
                WIDE(Walk)::walk(structure, query);
                query.end();
            }
        }
        query.report(row);
    }
};
