// needs: visibility/in_place.h accelerators/height_field/chart_ray.h
// arguments: Structure structure, DeviceChart wp::load(structure.charts.data)
// lanes
// What becomes of LANES rays at a chart before its nodes are looked at, and of a ray at a quad.
struct WIDE(AtChart) {
    // Shows all of a chart.
    static inline void everything(const DeviceChart& chart, WIDE(Query) & query) {
        const int count = 2 * (chart.rows - 1) * (chart.columns - 1);
        for (int k = 0; k < count; ++k)
            if (query.visit(chart.first_triangle + k))
                return;
    }
    // Those that enter it, as bits: as `ray`.
    static inline int come(const Structure& structure, int number, WIDE(ChartRay) & ray, WIDE(Query) & query) {
        const auto& chart = structure.charts.data[number];
        const int some = number == structure.sweep.number ? query.asking & ~query.passing() : query.asking;
        if (!some)
            return 0;
        WIDE(Double) samples[4];
        query.samples(samples);
        ray.place(chart, structure.beside.data[number], samples, query.light());
#if LANES == 1
        if (ray.far)
            everything(chart, query);
#else
        for (int left = ray.far & some; left; left &= left - 1) {
            query.lane = __builtin_ctz(left);
            everything(chart, query);
        }
#endif
        return ray.meets & some;
    }
#if LANES > 1
    // Lets the memory that `show` will read come nearer.
    static inline void fetch(const DeviceChart& chart, int row, int column, const WIDE(Query) & query) {
        const auto& asked = query.asked;
        __builtin_prefetch(asked.triangles.data + chart.first_triangle + 2 * (row * (chart.columns - 1) + column));
        const wp::vec3d* corner = asked.vertices.data + chart.first_vertex + (size_t)row * chart.columns + column;
        __builtin_prefetch(corner);
        __builtin_prefetch(corner + chart.columns);
    }
#endif
    // Shows the two triangles of a quad; true if one hides the ray.
    static inline bool show(const DeviceChart& chart, int row, int column, WIDE(Query) & query) {
        const int first = chart.first_triangle + 2 * (row * (chart.columns - 1) + column);
        // One call in a loop that stays a loop: what decides is large.
#pragma unroll 1
        for (int k = 0; k < 2; ++k)
            if (query.visit(first + k))
                return true;
        return false;
    }
};
