// needs: visibility/in_place.h accelerators/height_field/place.h
// arguments: DeviceChart chart
// constants: CHART_PADDING CHART_STEPS
// A ray in a chart: the segment of it that lies among the heights, in columns, rows and steps; see height_field.py.
struct ChartRay {
    enum { MISSES, MEETS, TOO_FAR };
    // What the low and the high sides of boxes are compared with: where the segment begins, moved by the padding.
    float above[3], below[3], inverse[3];
    int flip; // turns the numbers of a node's children so that they come in the order of the ray

    static inline void clip(double at, double way, double& from, double& to) {
        if (way > 0.0) {
            const double enters = -at / way;
            from = enters > from ? enters : from;
        } else if (way < 0.0) {
            const double leaves = -at / way;
            to = leaves < to ? leaves : to;
        } else if (at < 0.0)
            to = -1.0;
    }
    // Between `low` and `high` in a coordinate.
    static inline void clip(const Homogeneous& at, const Homogeneous& way, double x, double dx, double low, double high,
                            double& from, double& to) {
        clip(x - low * at.d, dx - low * way.d, from, to);
        clip(high * at.d - x, high * way.d - dx, from, to);
    }
    // Where on the way to the light there begins what may count: behind the bias, but for a 1e-8 of it.
    static inline double begins(const wp::vec4d& sample, const wp::vec4d& light) {
        double sum = 0.0;
        for (int k = 0; k < 3; ++k) {
            const double way = light[k] - (light[3] != 0.0 ? sample[k] : 0.0);
            sum += way * way;
        }
        return sum > 1.0e-200 ? 0.99999999 * sample[3] / sqrt(sum) : 0.0;
    }
    inline int place(const DeviceChart& chart, double beside, const wp::vec4d& sample, const wp::vec4d& light) {
        const double x = sample[0] - chart.center[0], y = sample[1] - chart.center[1], z = sample[2] - chart.center[2];
        const double weight = chart.weight * (fabs(x) + fabs(y) + fabs(z)) + chart.weight_constant;
        if (!(beside < 1.0e29) || !(weight <= 0x1p20))
            return TOO_FAR;
        const bool bounded = light[3] != 0.0;
        const Homogeneous at = Homogeneous::of(chart, x, y, z, 1.0);
        const Homogeneous way =
            Homogeneous::of(chart, light[0] - (bounded ? sample[0] : 0.0), light[1] - (bounded ? sample[1] : 0.0),
                            light[2] - (bounded ? sample[2] : 0.0), 0.0);
        const int rows = chart.rows - 1, columns = chart.columns - 1;
        const double along = (double)(rows > columns ? rows : columns);
        const double beyond = 2.0 * CHART_PADDING * along + beside, over = 2.0 * CHART_PADDING * CHART_STEPS;
        double from = begins(sample, light), to = bounded ? 1.0 : HUGE_VAL;
        clip(at, way, at.s, way.s, -beyond, (double)columns + beyond, from, to);
        clip(at, way, at.t, way.t, -beyond, (double)rows + beyond, from, to);
        clip(at, way, at.h, way.h, -over, CHART_STEPS + over, from, to);
        if (!(from <= to))
            return MISSES;
        if (!(to < HUGE_VAL))
            return TOO_FAR;
        const double begin = 1.0 / (at.d + from * way.d), end = 1.0 / (at.d + to * way.d);
        const double first[3] = { (at.s + from * way.s) * begin, (at.t + from * way.t) * begin,
                                  (at.h + from * way.h) * begin };
        const double last[3] = { (at.s + to * way.s) * end, (at.t + to * way.t) * end, (at.h + to * way.h) * end };
        const float pads[3] = { (float)((CHART_PADDING * along + beside) * 1.0001),
                                (float)((CHART_PADDING * along + beside) * 1.0001),
                                (float)(CHART_PADDING * CHART_STEPS) };
        flip = (last[0] < first[0] ? 3 : 0) | (last[1] < first[1] ? 12 : 0);
        for (int k = 0; k < 3; ++k) {
            const double span = last[k] - first[k];
            above[k] = (float)first[k] + pads[k];
            below[k] = (float)first[k] - pads[k];
            // What a reciprocal is taken of is never so small that it is infinite.
            inverse[k] = 1.0f / (fabs(span) < 1.0e-20 ? 1.0e-20f : (float)span);
        }
        return MEETS;
    }
    // Shows the two triangles of a quad.
    static inline bool show(const DeviceChart& chart, int row, int column, Query1& query) {
        const int first = chart.first_triangle + 2 * (row * (chart.columns - 1) + column);
        return query.visit(first) || query.visit(first + 1);
    }
    // Shows all of a chart.
    static inline bool everything(const DeviceChart& chart, Query1& query) {
        const int count = 2 * (chart.rows - 1) * (chart.columns - 1);
        for (int k = 0; k < count; ++k)
            if (query.visit(chart.first_triangle + k))
                return true;
        return false;
    }
};
