// needs: device/lanes.h
// lanes
// LANES boxes against a ray: where it enters each.
struct WIDE(Slabs) {
    REAL in; // for those that are met
    int met; // as bits

    static inline REAL smaller(REAL x, REAL y) { return x < y ? x : y; }
    static inline REAL larger(REAL x, REAL y) { return x > y ? x : y; }
    // low, high: of the boxes; above, below: where the ray begins, as Segment has it; inverse: of its direction.
    inline void enter(const REAL* low, const REAL* high, const wp::vec3& above, const wp::vec3& below,
                      const wp::vec3& inverse, float longest) {
        REAL near[3], far[3];
        const REAL none = 0.0f, most = longest;
        for (int k = 0; k < 3; ++k) {
            const REAL one = (low[k] - above[k]) * inverse[k];
            const REAL two = (high[k] - below[k]) * inverse[k];
            near[k] = smaller(one, two);
            far[k] = larger(one, two);
        }
        in = larger(larger(near[0], near[1]), larger(near[2], none));
        const REAL out = smaller(smaller(far[0], far[1]), smaller(far[2], most));
        met = WIDE(Lanes)::bits(in <= out);
    }
};
