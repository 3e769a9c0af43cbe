// needs: device/lanes.h accelerators/height_field/place.h
// arguments: DeviceChart chart
// constants: CHART_PADDING CHART_STEPS
// lanes
// LANES rays in a chart: the segments of them that lie among the heights, in columns, rows and steps; see
// height_field.py.
struct WIDE(ChartRay) {
    typedef WIDE(Lanes) Lanes;
    typedef WIDE(Double) Number;
#if LANES == 1
    typedef int Truth;
#else
    typedef long Truth __attribute__((ext_vector_type(LANES)));
#endif
    // S, T, H and D of something.
    struct Homogeneous {
        Number s, t, h, d;
    };
    // What the low and the high sides of boxes are compared with: where the segment begins, moved by the padding.
    REAL above[3], below[3], inverse[3];
    REAL span[3];
    int meets, far; // those that meet the chart, and of which that cannot be said, as bits

    static inline int bits(Truth x) {
#if LANES == 1
        return x != 0;
#else
        return Lanes::bits(__builtin_convertvector(x, MASK));
#endif
    }
    static inline Number root(Number x) {
#if LANES == 1
        return sqrt(x);
#else
        return __builtin_elementwise_sqrt(x);
#endif
    }
    static inline REAL narrow(Number x) {
#if LANES == 1
        return (float)x;
#else
        return __builtin_convertvector(x, REAL);
#endif
    }
    static inline Number row(const wp::vec4d& m, Number x, Number y, Number z, double w) {
        return m[0] * x + m[1] * y + m[2] * z + m[3] * w;
    }
    static inline Homogeneous of(const DeviceChart& chart, Number x, Number y, Number z, double w) {
        return { row(chart.s, x, y, z, w), row(chart.t, x, y, z, w), row(chart.h, x, y, z, w),
                 row(chart.d, x, y, z, w) };
    }
    static inline void clip(Number at, Number way, Number& from, Number& to) {
        const Number place = -at / way, none = -1.0; // what is divided by zero is not looked at
        from = ((way > 0.0) & (place > from)) ? place : from;
        to = ((way < 0.0) & (place < to)) ? place : to;
        to = ((way == 0.0) & (at < 0.0)) ? none : to;
    }
    // Between `low` and `high` in a coordinate.
    static inline void clip(const Homogeneous& at, const Homogeneous& way, Number x, Number dx, double low, double high,
                            Number& from, Number& to) {
        clip(x - low * at.d, dx - low * way.d, from, to);
        clip(high * at.d - x, high * way.d - dx, from, to);
    }
    // Where on the way to the light there begins what may count: behind the bias, but for 1e-8 of it.
    static inline Number begins(Number bias, Number x, Number y, Number z) {
        const Number sum = x * x + y * y + z * z, none = 0.0;
        return sum > 1.0e-200 ? 0.99999999 * bias / root(sum) : none;
    }
    inline void place(const DeviceChart& chart, double beside, const Number (&sample)[4], const wp::vec4d& light) {
        const Number x = sample[0] - chart.center[0], y = sample[1] - chart.center[1], z = sample[2] - chart.center[2];
        const Number weight =
            chart.weight * (Lanes::absolute(x) + Lanes::absolute(y) + Lanes::absolute(z)) + chart.weight_constant;
        const bool bounded = light[3] != 0.0;
        const double w = bounded ? 1.0 : 0.0;
        const Number ways[3] = { light[0] - w * sample[0], light[1] - w * sample[1], light[2] - w * sample[2] };
        const Homogeneous at = of(chart, x, y, z, 1.0), way = of(chart, ways[0], ways[1], ways[2], 0.0);
        const int rows = chart.rows - 1, columns = chart.columns - 1;
        const double along = (double)(rows > columns ? rows : columns);
        const double beyond = 2.0 * CHART_PADDING * along + beside, over = 2.0 * CHART_PADDING * CHART_STEPS;
        Number from = begins(sample[3], ways[0], ways[1], ways[2]), to = bounded ? 1.0 : HUGE_VAL;
        clip(at, way, at.s, way.s, -beyond, (double)columns + beyond, from, to);
        clip(at, way, at.t, way.t, -beyond, (double)rows + beyond, from, to);
        clip(at, way, at.h, way.h, -over, CHART_STEPS + over, from, to);
        meets = bits(from <= to);
        far = beside < 1.0e29 ? (Lanes::ALL & ~bits(weight <= 0x1p20)) | (meets & ~bits(to < HUGE_VAL)) : Lanes::ALL;
        meets &= ~far;
        if (!meets)
            return;
        const Number begin = 1.0 / (at.d + from * way.d), end = 1.0 / (at.d + to * way.d);
        const Number first[3] = { (at.s + from * way.s) * begin, (at.t + from * way.t) * begin,
                                  (at.h + from * way.h) * begin };
        const Number last[3] = { (at.s + to * way.s) * end, (at.t + to * way.t) * end, (at.h + to * way.h) * end };
        const float pad = (float)((CHART_PADDING * along + beside) * 1.0001);
        const float pads[3] = { pad, pad, (float)(CHART_PADDING * CHART_STEPS) };
        for (int k = 0; k < 3; ++k) {
            const REAL start = narrow(first[k]), least = 1.0e-20f;
            above[k] = start + pads[k];
            below[k] = start - pads[k];
            span[k] = narrow(last[k] - first[k]);
            // What a reciprocal is taken of is never so small that it is infinite.
            inverse[k] = 1.0f / (Lanes::absolute(span[k]) < 1.0e-20f ? least : span[k]);
        }
    }
    static inline REAL smaller(REAL x, REAL y) { return x < y ? x : y; }
    static inline REAL larger(REAL x, REAL y) { return x > y ? x : y; }
    inline void enter(int k, float low, float high, REAL& in, REAL& out) const {
        const REAL one = (low - above[k]) * inverse[k], two = (high - below[k]) * inverse[k];
        in = larger(in, smaller(one, two));
        out = smaller(out, larger(one, two));
    }
    // Those that may meet a box, as bits. column, row: its first ones; size: quads along a side; heights: the least,
    // and 65536 times the largest.
    inline int met(float column, float row, float size, wp::uint32 heights) const {
        const wp::uint32 least = heights & 0xFFFF, most = heights >> 16;
        REAL in = 0.0f, out = 1.0001f;
        enter(0, column, column + size, in, out);
        enter(1, row, row + size, in, out);
        enter(2, (float)least, (float)most, in, out);
        return least <= most ? Lanes::bits(in <= out) : 0;
    }
};
