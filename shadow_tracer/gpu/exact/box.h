// needs: device/lanes.h
// lanes
// LANES boxes of directions and depths against the four planes of a triangle.
struct WIDE(Box) {
    // The boxes of `within` that the triangle cannot be said to miss, as bits; covered: those it covers.
    // middle, reach: of the three edges and of P without its depth, at the box's centre, and how far they get from
    // there; near, far: P's slope times the least and the largest depth; edge, plane: pads.
    static inline int judge(int within, const REAL (&middle)[4], const REAL (&reach)[4], REAL near, REAL far, REAL edge,
                            REAL plane, int& covered) {
        typedef WIDE(Lanes) Lanes;
        const int mask = within
                         & Lanes::bits((middle[0] + reach[0] >= -edge) & (middle[1] + reach[1] >= -edge)
                                       & (middle[2] + reach[2] >= -edge) & (middle[3] + reach[3] + near >= -plane));
        covered = mask
                  & Lanes::bits((middle[0] - reach[0] > edge) & (middle[1] - reach[1] > edge)
                                & (middle[2] - reach[2] > edge) & (middle[3] - reach[3] + far > plane));
        return mask;
    }
};
