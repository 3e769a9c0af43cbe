// needs: device/lanes.h accelerators/height_field/chart_ray.h
// lanes
// LANES boxes of a node against a ray.
struct WIDE(ChartBoxes) {
    static inline REAL smaller(REAL x, REAL y) { return x < y ? x : y; }
    static inline REAL larger(REAL x, REAL y) { return x > y ? x : y; }
    static inline void enter(const ChartRay& ray, int k, REAL low, REAL high, REAL& in, REAL& out) {
        const REAL one = (low - ray.above[k]) * ray.inverse[k], two = (high - ray.below[k]) * ray.inverse[k];
        in = larger(in, smaller(one, two));
        out = smaller(out, larger(one, two));
    }
    // Those that the ray may meet, as bits. column, row: their first ones; size: quads along a side; heights: of each
    // the least, and 65536 times the largest.
    static inline int met(const ChartRay& ray, REAL column, REAL row, float size, MASK heights) {
        const MASK least = heights & 0xFFFF, most = heights >> 16 & 0xFFFF;
#if LANES == 1
        const REAL low = (float)least, high = (float)most;
#else
        const REAL low = __builtin_convertvector(least, REAL), high = __builtin_convertvector(most, REAL);
#endif
        REAL in = 0.0f, out = 1.0001f;
        enter(ray, 0, column, column + size, in, out);
        enter(ray, 1, row, row + size, in, out);
        enter(ray, 2, low, high, in, out);
        return WIDE(Lanes)::bits((in <= out) & (least <= most));
    }
};
