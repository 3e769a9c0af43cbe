// needs: device/lanes.h
// constants: WILD_RATIO
// lanes
// LANES rays that fit into light space; admission.py says what the others are.
struct WIDE(Fits) {
    static inline REAL larger(REAL x, REAL y) { return x > y ? x : y; }
    static inline MASK of(REAL U, REAL V, REAL W, REAL Z) {
        typedef WIDE(Lanes) Lanes;
        const REAL x = Lanes::absolute(U), y = Lanes::absolute(V), z = Lanes::absolute(W);
        const REAL sum = x + y + z + Lanes::absolute(Z) + 1.0f;
        return (sum <= (float)WILD_RATIO * larger(larger(x, y), z)) & (sum < 1.0e30f);
    }
};
