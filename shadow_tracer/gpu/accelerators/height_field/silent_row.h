// needs: accelerators/height_field/place.h accelerators/silent.h
// arguments: DeviceChart chart
// Triangles of a chart that a light sees edge-on, or that have no area; silent.py says why quads that are sure have
// none.
struct SilentRow {
    enum { CHUNK = 256 };
    // A light in the chart, and how far from zero a determinant is that is sure not to be zero.
    struct Seen {
        float s, t, h, d, pad;

        static inline Seen of(const DeviceChart& chart, const wp::vec4d& light) {
            const double w = light[3];
            const double x = light[0] - w * chart.center[0], y = light[1] - w * chart.center[1],
                         z = light[2] - w * chart.center[2];
            const Homogeneous at = Homogeneous::of(chart, x, y, z, w);
            const double weight = chart.weight * (fabs(x) + fabs(y) + fabs(z)) + w * chart.weight_constant;
            const double cells = (double)(chart.rows + chart.columns);
            const double pad = (fabs(at.s) + fabs(at.t) + cells * fabs(at.d)) * 0x1p-4 + fabs(at.h) * 0x1p-20
                               + cells * chart.nearest * weight * 0x1p-30;
            // So that float32 holds them, of whatever length a direction is.
            const double scale = 1.0 / (fabs(at.s) + fabs(at.t) + fabs(at.h) + cells * fabs(at.d));
            return { (float)(at.s * scale), (float)(at.t * scale), (float)(at.h * scale), (float)(at.d * scale),
                     (float)(pad * scale) };
        }
        // The determinant of a triangle over half a quad: its slopes, and a corner of it; s, t: the light from there.
        inline int sure(float across, float down, float height, float s, float t) const {
            return fabsf(h - d * height - across * s - down * t) > pad;
        }
    };
    // Whether none of the triangles over a quad of corners a, b and, in the next row, c, d is seen edge-on: those of
    // the diagonal from a to d, and of the other one, if they may be there. s, t: the light from a.
    static inline int sure(const Seen& light, bool both, float a, float b, float c, float d, float s, float t) {
        int found = light.sure(d - c, c - a, a, s, t) & light.sure(b - a, d - b, a, s, t);
        if (both)
            found &= light.sure(b - a, c - a, a, s, t) & light.sure(d - c, d - b, d, s - light.d, t - light.d);
        return found;
    }
    static inline void quads(const DeviceChart& chart, const bool both, int row, const wp::vec4d& light,
                             const wp::array_t<float>& heights, const wp::array_t<wp::vec3d>& vertices,
                             const wp::array_t<wp::vec3i>& triangles, int to, const wp::array_t<wp::vec2i>& counts) {
        const Seen seen = Seen::of(chart, light);
        const float t = seen.t - (float)row * seen.d;
        const int quads = chart.columns - 1;
        const float* __restrict__ here = heights.data + chart.first_height + (wp::int64)row * chart.columns;
        const float* __restrict__ next = here + chart.columns;
        for (int first = 0; first < quads; first += CHUNK) {
            const int end = quads - first < CHUNK ? quads : first + CHUNK;
            int unsure = 0;
            for (int c = first; c < end; ++c)
                unsure += !sure(seen, both, here[c], here[c + 1], next[c], next[c + 1], seen.s - (float)c * seen.d, t);
            for (int c = first; unsure && c < end; ++c)
                if (!sure(seen, both, here[c], here[c + 1], next[c], next[c + 1], seen.s - (float)c * seen.d, t)) {
                    const int triangle = chart.first_triangle + 2 * (row * quads + c);
                    SilentTriangles::count(triangle, triangle + 2, light, 0, vertices, triangles, to, counts);
                }
        }
    }
    // Those of a row of quads whose positions are in their places, for a light that culls nothing.
    static inline void count(const DeviceChart& chart, int row, const wp::vec4d& light,
                             const wp::array_t<float>& heights, const wp::array_t<wp::vec3d>& vertices,
                             const wp::array_t<wp::vec3i>& triangles, int to, const wp::array_t<wp::vec2i>& counts) {
        if (chart.made)
            quads(chart, true, row, light, heights, vertices, triangles, to, counts);
        else
            quads(chart, false, row, light, heights, vertices, triangles, to, counts);
    }
};
