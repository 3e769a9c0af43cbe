// cpu
// needs: accelerators/height_field/bundle.h accelerators/height_field/at_chart.h@16
// arguments: Structure structure
// constants: CHART_LEVELS
// Down the nodes of each chart with sixteen rays at a time: as a bundle against all sixteen children of a node, and
// each for itself against a quad. Rays that lie far apart go down one by one, as bundles of one.
struct Walk16 {
    enum { APART = 64 }; // rows or columns, between rays that go together
    typedef int Pairs __attribute__((ext_vector_type(16), aligned(4)));

    // The children of a node that rays may meet, as bits, the first that they come to lowest.
    static inline int children(const Structure& structure, const ChartBundle& bundle, int first, int columns, int level,
                               int row, int column) {
        const Real16 across = { 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3 };
        const Real16 down = { 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3 };
        const int size = 1 << 2 * level;
        const size_t node = (size_t)first + (size_t)row * columns + column;
        const Mask16 heights = *(const Pairs*)(structure.nodes.data + 16 * node);
        int met = bundle.met(across * (float)size + (float)(4 * column * size),
                             down * (float)size + (float)(4 * row * size), (float)size, heights);
        if (bundle.flip & 3) {
            met = (met & 0x5555) << 1 | (met >> 1 & 0x5555);
            met = (met & 0x3333) << 2 | (met >> 2 & 0x3333);
        }
        if (bundle.flip & 12) {
            met = (met & 0x0F0F) << 4 | (met >> 4 & 0x0F0F);
            met = (met & 0x00FF) << 8 | met >> 8;
        }
        return met;
    }
    // Some rays at a quad.
    static inline void show(const Structure& structure, const DeviceChart& chart, const ChartRay16& ray, int lanes,
                            const wp::uint32* leaf, int row, int column, Query16& query) {
        const wp::uint32 heights = leaf[4 * (row & 3) + (column & 3)];
        int left = lanes & query.asking & ray.met((float)column, (float)row, 1.0f, heights);
        for (; left; left &= left - 1) {
            query.lane = __builtin_ctz(left);
            AtChart16::show(chart, row, column, query);
        }
    }
    // Until something hides all of them.
    static inline void descend(const Structure& structure, int number, const ChartRay16& ray, int lanes,
                               const ChartBundle& bundle, Query16& query) {
        const auto& chart = structure.charts.data[number];
        const auto* levels = structure.levels.data + CHART_LEVELS * number;
        int top = 0, left[CHART_LEVELS], row = 0, column = 0;
        while (levels[top].rows * levels[top].columns > 1)
            ++top;
        int level = top;
        ++query.nodes;
        left[level] = children(structure, bundle, levels[level].first, levels[level].columns, level, 0, 0);
        for (;;) {
            if (!left[level]) {
                if (level == top)
                    return;
                ++level;
                row >>= 2;
                column >>= 2;
                continue;
            }
            const int child = __builtin_ctz(left[level]) ^ bundle.flip;
            left[level] &= left[level] - 1;
            const int r = 4 * row + child / 4, c = 4 * column + child % 4;
            if (level == 0) {
                const size_t node = (size_t)levels[0].first + (size_t)row * levels[0].columns + column;
                show(structure, chart, ray, lanes, structure.nodes.data + 16 * node, r, c, query);
                if (!(lanes & query.asking))
                    return;
                continue;
            }
            --level;
            row = r;
            column = c;
            ++query.nodes;
            left[level] = children(structure, bundle, levels[level].first, levels[level].columns, level, row, column);
        }
    }
    static inline void walk(const Structure& structure, Query16& query) {
        for (int number = 0; number < structure.count && query.asking; ++number) {
            ChartRay16 ray;
            int lanes = AtChart16::come(structure, number, ray, query);
            if (!lanes)
                continue;
            const ChartBundle bundle(ray, lanes);
            if (bundle.wide() <= (float)APART) {
                descend(structure, number, ray, lanes, bundle, query);
                continue;
            }
            for (; lanes; lanes &= lanes - 1) {
                const int one = lanes & -lanes;
                descend(structure, number, ray, one, ChartBundle(ray, one), query);
            }
        }
    }
};
