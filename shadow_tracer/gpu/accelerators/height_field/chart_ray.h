// needs: device/doubles.h accelerators/height_field/place.h
// arguments: DeviceChart chart
// constants: CHART_PADDING CHART_STEPS
// lanes
// LANES rays in a chart: the segments of them that lie among the heights, in columns, rows and steps; see
// height_field.py.
struct WIDE(ChartRay) {
    typedef WIDE(Lanes) Lanes;
    typedef WIDE(Doubles) Doubles;
    typedef WIDE(Double) Number;
    typedef Doubles::Truth Truth;
    // S, T, H and D of something.
    struct Homogeneous {
        Number s, t, h, d;
    };
    // Where the segments begin, and how far they go; the reciprocals of that, and what they make of where they begin
    // and of half a quad with its padding.
    REAL begin[3], span[3], inverse[3], gone[3], reach[3];
    float pad[3];   // of boxes
    int meets, far; // those that meet the chart, and of which that cannot be said, as bits

    static inline Number row(const wp::vec4d& m, Number x, Number y, Number z, double w) {
        CONTRACTED
        return m[0] * x + m[1] * y + m[2] * z + m[3] * w;
    }
    static inline double dot(const wp::vec4d& m, double x, double y, double z, double w) {
        return m[0] * x + m[1] * y + m[2] * z + m[3] * w;
    }
    static inline Homogeneous of(const DeviceChart& chart, Number x, Number y, Number z, double w) {
        return { row(chart.s, x, y, z, w), row(chart.t, x, y, z, w), row(chart.h, x, y, z, w),
                 row(chart.d, x, y, z, w) };
    }
    // How far inside a plane rays begin, and how fast that grows, which may be off by `off`: `from`, before which they
    // are surely outside, and `rate`, one over which is where they surely are again.
    static inline void side(REAL inside, REAL growth, REAL off, REAL& from, REAL& rate) {
        const REAL none = 0.0f, never = (float)HUGE_VAL, leaves = (-growth - off) * Lanes::inverse(inside);
        const MASK in = inside > 0.0f;
        rate = larger(rate, in ? leaves : none);
        if (Lanes::bits(in) == Lanes::ALL)
            return;
        const REAL grows = growth + off, comes = -inside * Lanes::inverse(grows) * (1.0f - 0x1p-12f);
        from = larger(from, in ? none : grows > 0.0f ? comes : never);
    }
    // Between `low` and `high` in a coordinate.
    static inline void clip(Number at, Number way, REAL d, REAL dd, float low, float high, REAL& from, REAL& rate) {
        CONTRACTED
        const REAL x = Doubles::narrow(at), dx = Doubles::narrow(way);
        const float reach = high - low;
        const REAL more = 0x1p-20f * (Lanes::absolute(x) + reach * Lanes::absolute(d));
        const REAL off = 0x1p-21f * (Lanes::absolute(dx) + reach * Lanes::absolute(dd));
        side(x - low * d + more, dx - low * dd, off, from, rate);
        side(high * d - x + more, high * dd - dx, off, from, rate);
    }
    // Where on the way to the light there begins what may count: behind the bias, but for 2^-12 of it.
    static inline REAL begins(Number bias, Number x, Number y, Number z) {
        CONTRACTED
        const REAL a = Doubles::narrow(x), b = Doubles::narrow(y), c = Doubles::narrow(z);
        const REAL sum = a * a + b * b + c * c, none = 0.0f;
        const MASK usual = (sum > 1.0e-30f) & (sum < 1.0e30f);
        return usual ? Doubles::narrow(bias) * Lanes::inverse(root(sum)) * (1.0f - 0x1p-12f) : none;
    }
    static inline REAL root(REAL x) {
#if LANES == 1
        return sqrtf(x);
#else
        return __builtin_elementwise_sqrt(x);
#endif
    }
    // What lies in front of all positions, to be sure that it is: D is at least half of what it is at the nearest one.
    inline void in_front(const DeviceChart& chart, const Homogeneous& at, const Homogeneous& way, Number& from,
                         Number& to) {
        const Number low = 0.5 * chart.nearest, place = (low - at.d) / way.d, never = HUGE_VAL, none = -1.0;
        from = at.d + from * way.d < low ? (way.d > 0.0 ? place : never) : from;
        to = at.d + to * way.d < low ? (way.d < 0.0 ? place : none) : to;
        meets &= Doubles::bits(from <= to);
    }
    // Among the rows, columns and heights of the chart.
    static inline void among(const DeviceChart& chart, double beside, const Homogeneous& at, const Homogeneous& way,
                             REAL& from, REAL& rate) {
        const float rows = chart.rows - 1, columns = chart.columns - 1, over = 2.0 * CHART_PADDING * CHART_STEPS;
        const float beyond = (float)(2.0 * CHART_PADDING * (double)(rows > columns ? rows : columns) + beside);
        const REAL d = Doubles::narrow(at.d), dd = Doubles::narrow(way.d);
        clip(at.s, way.s, d, dd, -beyond, columns + beyond, from, rate);
        clip(at.t, way.t, d, dd, -beyond, rows + beyond, from, rate);
        clip(at.h, way.h, d, dd, -over, (float)CHART_STEPS + over, from, rate);
    }
    // Where rays begin and end in the chart, as parts of their ways.
    inline void find(const DeviceChart& chart, double beside, REAL begin_at, REAL rate, const Homogeneous& at,
                     const Homogeneous& way, Number& from, Number& to) {
        CONTRACTED
        const REAL endless = (float)HUGE_VAL, none = 0.0f;
        REAL comes = begin_at;
        among(chart, beside, at, way, comes, rate);
        const REAL ends = rate > 1.0e-30f ? Lanes::inverse(rate) * (1.0f + 0x1p-12f) : endless;
        from = Doubles::widen(comes);
        to = Doubles::widen(ends);
        meets = Lanes::bits((comes <= ends) & (comes < endless));
        if (meets & Lanes::bits(comes > begin_at)) { // once more from there: a part of a long way is long
            const Homogeneous there = { at.s + from * way.s, at.t + from * way.t, at.h + from * way.h,
                                        at.d + from * way.d };
            REAL more = none, unused = none;
            among(chart, beside, there, way, more, unused);
            from += Doubles::widen(more);
            meets &= Doubles::bits(from <= to);
        }
        far = meets & ~Lanes::bits(ends < endless);
        const Number least = 0.5 * chart.nearest;
        if (meets & ~far & ~Doubles::bits((at.d + from * way.d >= least) & (at.d + to * way.d >= least)))
            in_front(chart, at, way, from, to);
    }
    inline void place(const DeviceChart& chart, double beside, const Number (&sample)[4], const wp::vec4d& light) {
        CONTRACTED
        const Number x = sample[0] - chart.center[0], y = sample[1] - chart.center[1], z = sample[2] - chart.center[2];
        const Number weight =
            chart.weight * (Lanes::absolute(x) + Lanes::absolute(y) + Lanes::absolute(z)) + chart.weight_constant;
        const bool bounded = light[3] != 0.0;
        const double w = bounded ? 1.0 : 0.0;
        const Homogeneous at = of(chart, x, y, z, 1.0);
        const double lx = light[0] - w * chart.center[0], ly = light[1] - w * chart.center[1],
                     lz = light[2] - w * chart.center[2];
        const double s = dot(chart.s, lx, ly, lz, w), t = dot(chart.t, lx, ly, lz, w), h = dot(chart.h, lx, ly, lz, w),
                     d = dot(chart.d, lx, ly, lz, w), size = fabs(s) + fabs(t) + fabs(h) + fabs(d);
        const Homogeneous way = { s - w * at.s, t - w * at.t, h - w * at.h, d - w * at.d };
        const REAL begin_at =
            begins(sample[3], light[0] - w * sample[0], light[1] - w * sample[1], light[2] - w * sample[2]);
        Number from, to;
        find(chart, beside, begin_at, bounded ? 1.0f : 0.0f, at, way, from, to);
        const bool usual = beside < 1.0e29 && chart.nearest > 1.0e-20 && chart.nearest < 1.0e20 && size < 1.0e30
                           && (bounded || size > 1.0e-10);
        far = usual ? (Lanes::ALL & ~Doubles::bits(weight <= 0x1p20)) | far : Lanes::ALL;
        meets &= ~far;
        if (meets)
            go(chart, beside, at, way, from, to);
    }
    inline void go(const DeviceChart& chart, double beside, const Homogeneous& at, const Homogeneous& way, Number from,
                   Number to) {
        CONTRACTED
        const Number near = 1.0 / (at.d + from * way.d), at_end = 1.0 / (at.d + to * way.d);
        const Number first[3] = { (at.s + from * way.s) * near, (at.t + from * way.t) * near,
                                  (at.h + from * way.h) * near };
        const Number last[3] = { (at.s + to * way.s) * at_end, (at.t + to * way.t) * at_end,
                                 (at.h + to * way.h) * at_end };
        const int rows = chart.rows - 1, columns = chart.columns - 1;
        pad[0] = pad[1] = (float)((CHART_PADDING * (double)(rows > columns ? rows : columns) + beside) * 1.0001);
        pad[2] = (float)(CHART_PADDING * CHART_STEPS);
        for (int k = 0; k < 3; ++k) {
            begin[k] = Doubles::narrow(first[k]);
            span[k] = Doubles::narrow(last[k] - first[k]);
            // What a reciprocal is taken of is never so small that it is infinite.
            const REAL least = 1.0e-20f;
            inverse[k] = 1.0f / (Lanes::absolute(span[k]) < 1.0e-20f ? least : span[k]);
            gone[k] = begin[k] * inverse[k];
            reach[k] = (k == 2 ? pad[k] : 0.5f + pad[k]) * Lanes::absolute(inverse[k]);
        }
    }
    static inline REAL smaller(REAL x, REAL y) { return x < y ? x : y; }
    static inline REAL larger(REAL x, REAL y) { return x > y ? x : y; }
    // Where they come to and leave what is within `way` of `middle`, as parts of the segments: `way` in such parts.
    inline void enter(int k, float middle, REAL way, REAL& in, REAL& out) const {
        CONTRACTED
        const REAL at = middle * inverse[k] - gone[k];
        in = larger(in, at - way);
        out = smaller(out, at + way);
    }
#if LANES == 1
    // Those that may meet a box, as bits. column, row: its first ones; size: quads along a side; heights: the least,
    // and 65536 times the largest.
    inline int met(float column, float row, float size, wp::uint32 heights) const {
        const float least = heights & 0xFFFF, most = heights >> 16, more = 0.5f * size - 0.5f;
        const REAL across = reach[0] + more * Lanes::absolute(inverse[0]),
                   down = reach[1] + more * Lanes::absolute(inverse[1]);
        return least <= most ? within(column + 0.5f * size, row + 0.5f * size, across, down, 0.5f * (least + most),
                                      0.5f * (most - least))
                             : 0;
    }
#else
    inline int met(int across, int down, int level, wp::uint32 heights) const {
        const float column = across, row = down, size = 1 << 2 * level, least = heights & 0xFFFF, most = heights >> 16,
                    more = 0.5f * size - 0.5f;
        return within((column + 0.5f) * size, (row + 0.5f) * size, reach[0] + more * Lanes::absolute(inverse[0]),
                      reach[1] + more * Lanes::absolute(inverse[1]), 0.5f * (least + most), 0.5f * (most - least));
    }
    // Those that may meet a quad, as bits, of middle column, row, and height, and so much higher and lower.
    inline int met(float column, float row, float middle, float half) const {
        return within(column, row, reach[0], reach[1], middle, half);
    }
#endif
    inline int within(float column, float row, REAL across, REAL down, float middle, float half) const {
        REAL in = 0.0f, out = 1.0001f;
        enter(0, column, across, in, out);
        enter(1, row, down, in, out);
        enter(2, middle, reach[2] + half * Lanes::absolute(inverse[2]), in, out);
        return Lanes::bits(in <= out);
    }
};
