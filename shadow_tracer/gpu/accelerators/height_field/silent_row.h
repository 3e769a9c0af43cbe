// needs: accelerators/height_field/place.h accelerators/silent.h
// arguments: DeviceChart chart
// Triangles of terrain that the sun sees edge-on, or that have no area.
struct SilentRow {
    enum { CHUNK = 256 };
    // Those of a row of quads of a parallel chart whose positions are in their places, for a sun that culls nothing;
    // silent.py says why quads that are sure have none.
    static inline void count(const DeviceChart& chart, int row, const wp::vec4d& light,
                             const wp::array_t<float>& heights, const wp::array_t<wp::vec3d>& vertices,
                             const wp::array_t<wp::vec3i>& triangles, int to, const wp::array_t<wp::vec2i>& counts) {
        const Homogeneous way = Homogeneous::of(chart, light[0], light[1], light[2], 0.0);
        const float s = (float)way.s, t = (float)way.t, h = (float)way.h;
        const float pad = (fabsf(s) + fabsf(t)) * 0x1p-5f + fabsf(h) * 0x1p-20f;
        const int quads = chart.columns - 1;
        const float* __restrict__ here = heights.data + chart.first_height + (wp::int64)row * chart.columns;
        const float* __restrict__ next = here + chart.columns;
        for (int first = 0; first < quads; first += CHUNK) {
            const int count = quads - first < CHUNK ? quads - first : CHUNK;
            int unsure = 0;
            for (int c = first; c < first + count; ++c)
                unsure += !sure(here[c], here[c + 1], next[c], next[c + 1], s, t, h, pad);
            for (int c = first; unsure && c < first + count; ++c)
                if (!sure(here[c], here[c + 1], next[c], next[c + 1], s, t, h, pad)) {
                    const int triangle = chart.first_triangle + 2 * (row * quads + c);
                    SilentTriangles::count(triangle, triangle + 2, light, 0, vertices, triangles, to, counts);
                }
        }
    }
    static inline int sure(float a, float b, float c, float d, float s, float t, float h, float pad) {
        const float one = h - s * (d - c) - t * (c - a), two = h - s * (b - a) - t * (d - b);
        return (fabsf(one) > pad) & (fabsf(two) > pad);
    }
};
