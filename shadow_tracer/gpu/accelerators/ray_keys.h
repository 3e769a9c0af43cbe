// needs: device/lanes.h
// constants: CURVE_BITS
// lanes
// Where LANES rays lie on the cube of directions, and their cells and keys there; see ray_keys.py.
struct WIDE(CubeCell) {
    enum { CELLS = 1 << CURVE_BITS };
    MASK face;
    REAL u, v;

    inline void look(REAL x, REAL y, REAL z) {
        typedef WIDE(Lanes) Lanes;
        const REAL ax = Lanes::absolute(x), ay = Lanes::absolute(y), az = Lanes::absolute(z), none = 0.0f;
        const MASK on_x = (ax >= ay) & (ax >= az), on_y = ay >= az, first = 0, second = 2, third = 4;
        const REAL major = on_x ? x : on_y ? y : z, size = Lanes::absolute(major);
        face = (on_x ? first : on_y ? second : third) + ((major < none) & 1);
        u = (on_x ? y : on_y ? z : x) / size;
        v = (on_x ? z : on_y ? x : y) / size;
    }
    // Cell of a face coordinate: monotone in x.
    static inline MASK cell(REAL x, REAL low, REAL scale) {
        const REAL at = (x - low) * scale, none = 0.0f, last = CELLS - 1;
        return WIDE(Lanes)::integer(at > none ? (at < last ? at : last) : none);
    }
    // The 16 lowest bits, a zero between each two.
    static inline MASK spread(MASK x) {
        x = (x | (x << 8)) & 0x00FF00FF;
        x = (x | (x << 4)) & 0x0F0F0F0F;
        x = (x | (x << 2)) & 0x33333333;
        return (x | (x << 1)) & 0x55555555;
    }
    // Position on the Morton curve.
    static inline MASK morton(MASK x, MASK y) { return spread(x) | (spread(y) << 1); }
};
