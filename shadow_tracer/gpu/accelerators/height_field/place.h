// arguments: DeviceChart chart
// constants: CHART_STEPS
// Where something lies in a chart, in float64.
struct Homogeneous {
    double s, t, h, d;

    static inline double row(const wp::vec4d& m, double x, double y, double z, double w) {
        return m[0] * x + m[1] * y + m[2] * z + m[3] * w;
    }
    // Of a point relative to the chart's centre (w = 1), or of a direction (w = 0).
    static inline Homogeneous of(const DeviceChart& chart, double x, double y, double z, double w) {
        return { row(chart.s, x, y, z, w), row(chart.t, x, y, z, w), row(chart.h, x, y, z, w),
                 row(chart.d, x, y, z, w) };
    }
};
struct Placed {
    // Stores the height of a position; returns how far it is from its place in the chart, 0 if it is not valid.
    static inline double height(const DeviceChart& chart, int number, const wp::array_t<wp::vec3d>& vertices,
                                const wp::array_t<float>& heights) {
        const wp::vec3d& p = vertices.data[chart.first_vertex + number];
        const Homogeneous at =
            Homogeneous::of(chart, p[0] - chart.center[0], p[1] - chart.center[1], p[2] - chart.center[2], 1.0);
        const double h = at.h / at.d;
        // A corner without depth is where the camera is.
        const bool none = chart.made && p[0] == chart.camera[0] && p[1] == chart.camera[1] && p[2] == chart.camera[2];
        heights.data[chart.first_height + number] = none ? (float)(HUGE_VAL - HUGE_VAL) : (float)h;
        if (none || !wp::isfinite(p))
            return 0.0;
        const int row = number / chart.columns, column = number - row * chart.columns;
        const double s = fabs(at.s / at.d - (double)column), t = fabs(at.t / at.d - (double)row);
        const double off = s > t ? s : t;
        return at.d >= chart.nearest && h >= 0.0 && h <= CHART_STEPS && off < 1.0e30 ? off : 1.0e30;
    }
};
