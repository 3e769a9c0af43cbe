// needs: exact/filter.h visibility/answers.h
// arguments: Asked asked, Occluders asked.occluders, Answers asked.answers
// constants: LIT SHADOWED MAGNITUDE_FLOOR LEAF_TESTS NODES_VISITED COUNTER_ROWS
// lanes
// The query *any hit*: whether something hides LANES rays of one light. Walks show it triangles.
struct WIDE(AnyHit) {
    enum { SPREADS = 0 }; // whether the rays that are walked together are a bundle, see spread()
    typedef WIDE(Lanes) Lanes;
    const wp::array_t<wp::vec4>& rays;
    const Occluders& occluders;
    const Answers& answers;
    REAL u, v, w, z, magnitude;
    int ray[LANES]; // their numbers
    int taken;      // how many there are
    int asking;     // the lanes that are not known to be in shadow, as bits
    int askers;     // their number
    int hider;      // the triangle that hid one last, -1 if none has
    wp::int64 tests, nodes;

    inline explicit WIDE(AnyHit)(const Asked& asked)
        : rays(asked.rays), occluders(asked.occluders), answers(asked.answers), taken(0), asking(0), askers(0),
          hider(-1), tests(0), nodes(0) {}
    // Takes a ray, unless there is nothing to find out about it.
    inline void take(int number) {
        if (answers.states.data[number] != LIT || rays.data[number][0] != rays.data[number][0])
            return;
#if LANES == 1
        // No index at run time: compilers for CUDA would put the query into local memory, with all that it refers to.
        ray[0] = number;
        taken = 1;
#else
        ray[taken++] = number;
#endif
    }
#if LANES > 1
    // Takes LANES rays if there is something to find out about all of them, and no other waits; returns whether it has.
    inline bool take_all(const int* numbers) {
        int all = taken == 0;
        for (int j = 0; j < LANES; ++j)
            all &= (answers.states.data[numbers[j]] == LIT) & (rays.data[numbers[j]][0] == rays.data[numbers[j]][0]);
        if (!all)
            return false;
        memcpy(ray, numbers, sizeof(ray));
        taken = LANES;
        return true;
    }
#endif
    inline bool full() const { return taken == LANES; }
    inline int count() const { return answers.samples; } // of rays
    // Before triangles are shown. Lanes without a ray repeat the first one, and do not ask.
    inline void begin() {
#if LANES == 1
        const wp::vec4 at = rays.data[ray[0]];
        u = at[0], v = at[1], w = at[2], z = at[3];
#else
        float some[4][LANES];
        for (int j = 0; j < LANES; ++j)
            for (int k = 0; k < 4; ++k)
                some[k][j] = rays.data[ray[j < taken ? j : 0]][k];
        u = Lanes::load(some[0]), v = Lanes::load(some[1]), w = Lanes::load(some[2]), z = Lanes::load(some[3]);
#endif
        magnitude = Lanes::absolute(u) + Lanes::absolute(v) + Lanes::absolute(z) + (float)MAGNITUDE_FLOOR;
        asking = Lanes::ALL >> (LANES - taken);
        askers = taken;
        hider = -1;
    }
    // Shows a triangle; true if no ray needs to be shown anything more.
    inline bool visit(int triangle) {
        tests += askers;
        int yes = 0;
        const float* record = (const float*)occluders.records.data + 16 * (size_t)triangle;
        const int found = asking & WIDE(Filter)::possible(record, u, v, w, z, magnitude, yes);
        return found && note(triangle, found, yes);
    }
    // What the filter has found about those that ask; true if none does any more.
    inline bool note(int triangle, int found, int yes) {
#if LANES == 1
        if (yes)
            answers.states.data[ray[0]] = SHADOWED;
        else if (!Settle::pair(answers, ray[0], triangle))
            return false;
        asking = 0;
        hider = triangle;
        return true;
#else
        for (int left = found; left; left &= left - 1) {
            const int lane = __builtin_ctz(left);
            if (yes >> lane & 1)
                answers.states.data[ray[lane]] = SHADOWED;
            else if (!Settle::pair(answers, ray[lane], triangle))
                continue;
            asking &= ~(1 << lane);
            --askers;
            hider = triangle;
        }
        return !asking;
#endif
    }
    // Shows all triangles, where a structure cannot say which could matter.
    inline void everything() {
        const float* record = (const float*)occluders.records.data;
        for (int t = 0; t < occluders.count; ++t, record += 16) {
            int yes = 0;
            const int found = asking & WIDE(Filter)::possible(record, u, v, w, z, magnitude, yes);
            tests += askers;
            if (found && note(t, found, yes))
                return;
        }
    }
    inline int triangle_count() const { return occluders.count; }
    // The sample and the light of the only ray.
    inline const wp::vec4d& sample() const { return answers.positions.data[ray[0]]; }
    inline const wp::vec4d& light() const { return answers.lights.data[0].light; }
    static inline wp::vec3d spread() { return wp::vec3d(); }
    // Whether less of the ray matters than when this was last asked; if so, how much [m].
    static inline bool shortened(double& metres) { return false; }
    inline void end() { taken = 0; }
    inline void report(int row) const {
        wp::int64* counter = answers.counters.data + (size_t)(row & (COUNTER_ROWS - 1)) * answers.counters.shape[1];
        if (tests)
            wp::atomic_add(counter + LEAF_TESTS, tests);
        if (nodes)
            wp::atomic_add(counter + NODES_VISITED, nodes);
    }
};
typedef WIDE(AnyHit) WIDE(Query);
