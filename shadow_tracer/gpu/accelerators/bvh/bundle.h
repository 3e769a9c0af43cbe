// needs: device/lanes.h accelerators/bvh/bundle_sides.h
// lanes
// LANES boxes against a bundle of rays that spreads from a sample to the points of a light: where it enters each. Six
// inequalities, of which each says from where on, or up to where, the bundle is on the box's side of a face; segment.py
// derives what they may be off by.
struct WIDE(Bundle) {
    REAL in; // for those that are met
    int met; // as bits

    static inline REAL smaller(REAL x, REAL y) { return x < y ? x : y; }
    static inline REAL larger(REAL x, REAL y) { return x > y ? x : y; }
    inline void enter(const REAL* low, const REAL* high, const BundleSides& sides, float longest) {
        REAL first = 0.0f, last = longest;
        for (int k = 0; k < 3; ++k) {
            // Where the upper side of the bundle reaches the low face, and its lower side the high face.
            const REAL one = (low[k] - sides.upper[k]) * sides.upper_inverse[k];
            const REAL two = (high[k] - sides.lower[k]) * sides.lower_inverse[k];
            if (sides.upper_inverse[k] > 0.0f)
                first = larger(first, one);
            else
                last = smaller(last, one);
            if (sides.lower_inverse[k] > 0.0f)
                last = smaller(last, two);
            else
                first = larger(first, two);
        }
        in = first;
        met = WIDE(Lanes)::bits(first <= last);
    }
};
