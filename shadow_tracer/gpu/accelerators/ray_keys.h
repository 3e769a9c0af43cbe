// needs: exact/cube.h
// constants: CURVE_BITS
// lanes
// Cells and keys of LANES rays on their cube faces; see ray_keys.py.
struct WIDE(CubeCell) {
    enum { CELLS = 1 << CURVE_BITS };
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
