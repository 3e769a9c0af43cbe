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
#if defined(__CUDA_ARCH__)
    enum { CHUNK = 1 };
#else
    enum { CHUNK = 128 };
#endif
    // Stores the heights of a row of positions; returns how far they are from their places in the chart at most, of
    // those that are valid.
    static inline double row(const DeviceChart& chart, int row, const wp::array_t<wp::vec3d>& vertices,
                             const wp::array_t<float>& heights) {
        const double* from = (const double*)(vertices.data + chart.first_vertex + (size_t)row * chart.columns);
        float* to = heights.data + chart.first_height + (size_t)row * chart.columns;
        const double x0 = chart.center[0], y0 = chart.center[1], z0 = chart.center[2];
        // A corner without depth is where the camera is.
        const double none = chart.made ? 0.0 : HUGE_VAL;
        const double x1 = chart.camera[0] + none, y1 = chart.camera[1] + none, z1 = chart.camera[2] + none;
        // Of each place of a chunk, as a single largest number would wait for the one before.
        double most[CHUNK] = {};
        for (int first = 0; first < chart.columns; first += CHUNK) {
            const int count = chart.columns - first < CHUNK ? chart.columns - first : CHUNK;
            for (int k = 0; k < count; ++k) {
                const int column = first + k;
                const double x = from[3 * column], y = from[3 * column + 1], z = from[3 * column + 2];
                const Homogeneous at = Homogeneous::of(chart, x - x0, y - y0, z - z0, 1.0);
                const double part = 1.0 / at.d, h = at.h * part;
                const bool gone = (x == x1) & (y == y1) & (z == z1);
                to[column] = gone ? (float)(HUGE_VAL - HUGE_VAL) : (float)h;
                const double s = fabs(at.s * part - (double)column), t = fabs(at.t * part - (double)row);
                const double farther = s > t ? s : t;
                const bool placed =
                    (at.d >= chart.nearest) & (h >= 0.0) & (h <= CHART_STEPS) & (s < 1.0e30) & (t < 1.0e30);
                const bool valid = (fabs(x) < HUGE_VAL) & (fabs(y) < HUGE_VAL) & (fabs(z) < HUGE_VAL) & !gone;
                const double off = valid ? (placed ? farther : 1.0e30) : 0.0;
                most[k] = off > most[k] ? off : most[k];
            }
        }
        for (int half = CHUNK / 2; half > 0; half /= 2)
            for (int k = 0; k < half; ++k)
                most[k] = most[k + half] > most[k] ? most[k + half] : most[k];
        return most[0];
    }
};
