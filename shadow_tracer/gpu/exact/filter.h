// needs: device/lanes.h
// lanes
// The float32 filter: LANES rays against the record of a triangle.
struct WIDE(Filter) {
    // The lanes whose answer is not a certain no, as bits; yes: those of them whose answer is a certain yes. Without a
    // branch: most rays that are tested are beside the triangle, and none can be known ahead.
    static inline int possible(const float* record, REAL U, REAL V, REAL W, REAL Z, REAL magnitude, int& yes) {
        typedef WIDE(Lanes) Lanes;
        const REAL edge = record[3] * (magnitude + Lanes::absolute(W)), depth = record[7] * magnitude + record[11];
        const REAL e0 = record[0] * U + record[1] * V + record[2] * W;
        const REAL e1 = record[4] * U + record[5] * V + record[6] * W;
        const REAL e2 = record[8] * U + record[9] * V + record[10] * W;
        const REAL g = record[12] * U + record[13] * V + record[14] * Z - record[15];
        // Comparisons with NaN fail, and what fails both ways is possible and no yes.
        const int no = Lanes::bits((e0 < -edge) | (e1 < -edge) | (e2 < -edge) | (g < -depth));
        yes = Lanes::bits((e0 > edge) & (e1 > edge) & (e2 > edge) & (g > depth)) & ~no;
        return ~no & Lanes::ALL;
    }
    // The same for rays as [U V W Z magnitude][LANES].
    static inline int possible(const float* record, const float* rays, int& yes) {
        typedef WIDE(Lanes) Lanes;
        return possible(record, Lanes::load(rays), Lanes::load(rays + LANES), Lanes::load(rays + 2 * LANES),
                        Lanes::load(rays + 3 * LANES), Lanes::load(rays + 4 * LANES), yes);
    }
};
