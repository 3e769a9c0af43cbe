// needs: device/lanes.h
// lanes
// The float32 filter: LANES rays against the record of a triangle.
struct WIDE(Filter) {
    typedef WIDE(Lanes) Lanes;
    REAL e0, e1, e2, g; // sides of the edges, and before the plane

    inline WIDE(Filter)(const float* record, REAL U, REAL V, REAL W, REAL Z) {
        CONTRACTED
        e0 = record[0] * U + record[1] * V + record[2] * W;
        e1 = record[4] * U + record[5] * V + record[6] * W;
        e2 = record[8] * U + record[9] * V + record[10] * W;
        g = record[12] * U + record[13] * V + record[14] * Z - record[15];
    }
    // Bounds of what is wrong with them, of rays of a magnitude.
    static inline REAL edge(const float* record, REAL magnitude, REAL W) {
        return record[3] * (magnitude + Lanes::absolute(W));
    }
    static inline REAL depth(const float* record, REAL magnitude) { return record[7] * magnitude + record[11]; }
    // The lanes whose answer is not a certain no, as bits. Comparisons with NaN fail, and what fails both ways is
    // possible and no yes.
    inline int possible(REAL edge, REAL depth) const {
        return ~Lanes::bits((e0 < -edge) | (e1 < -edge) | (e2 < -edge) | (g < -depth)) & Lanes::ALL;
    }
    // The lanes whose answer is a certain yes.
    inline int certain(REAL edge, REAL depth) const {
        return Lanes::bits((e0 > edge) & (e1 > edge) & (e2 > edge) & (g > depth));
    }
    // The lanes that are possible; yes: those of them that are certain. Without a branch: most rays that are tested are
    // beside the triangle, and none can be known ahead.
    static inline int possible(const float* record, REAL U, REAL V, REAL W, REAL Z, REAL magnitude, int& yes) {
        const WIDE(Filter) it(record, U, V, W, Z);
        const REAL edge = WIDE(Filter)::edge(record, magnitude, W), depth = WIDE(Filter)::depth(record, magnitude);
        const int found = it.possible(edge, depth);
        yes = it.certain(edge, depth) & found;
        return found;
    }
    // The same for rays as [U V W Z magnitude][LANES].
    static inline int possible(const float* record, const float* rays, int& yes) {
        return possible(record, Lanes::load(rays), Lanes::load(rays + LANES), Lanes::load(rays + 2 * LANES),
                        Lanes::load(rays + 3 * LANES), Lanes::load(rays + 4 * LANES), yes);
    }
};
