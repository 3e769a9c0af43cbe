// needs: device/lanes.h
// lanes
// Depths in light space, LANES at a time; light_space.py derives the numbers.
struct WIDE(LightDepth) {
    // t of rays whose 1/|h| is inverse_norm.
    static inline REAL of(REAL Z, REAL inverse_norm, bool inverse_mode) {
        return inverse_mode ? inverse_norm : Z * inverse_norm;
    }
    // M of nodes whose depths lie between the two values.
    static inline REAL magnitude(REAL nearest, REAL farthest) {
        const REAL x = WIDE(Lanes)::absolute(nearest), y = WIDE(Lanes)::absolute(farthest);
        return 4.0f + 2.001f * (x > y ? x : y);
    }
};
