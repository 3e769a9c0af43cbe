// cpu
// needs: accelerators/height_field/boxes.h@16 accelerators/height_field/at_chart.h
// arguments: Structure structure
// constants: CHART_LEVELS
// Down the nodes of each chart, all sixteen children of a node in one go of the vector registers.
struct Walk1 {
    typedef int Pairs __attribute__((ext_vector_type(16), aligned(4)));

    // The children of a node that the ray may meet, as bits, the first it comes to lowest.
    static inline int children(const Structure& structure, const ChartRay& ray, int first, int columns, int level,
                               int row, int column) {
        const Real16 across = { 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3 };
        const Real16 down = { 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3 };
        const int size = 1 << 2 * level;
        const size_t node = (size_t)first + (size_t)row * columns + column;
        const Mask16 heights = *(const Pairs*)(structure.nodes.data + 16 * node);
        int met = ChartBoxes16::met(ray, across * (float)size + (float)(4 * column * size),
                                    down * (float)size + (float)(4 * row * size), (float)size, heights);
        if (ray.flip & 3) {
            met = (met & 0x5555) << 1 | (met >> 1 & 0x5555);
            met = (met & 0x3333) << 2 | (met >> 2 & 0x3333);
        }
        if (ray.flip & 12) {
            met = (met & 0x0F0F) << 4 | (met >> 4 & 0x0F0F);
            met = (met & 0x00FF) << 8 | met >> 8;
        }
        return met;
    }
    // True if something hides the ray.
    static inline bool descend(const Structure& structure, int number, const ChartRay& ray, Query1& query) {
        const auto& chart = structure.charts.data[number];
        const auto* levels = structure.levels.data + CHART_LEVELS * number;
        int top = 0, left[CHART_LEVELS], row = 0, column = 0;
        while (levels[top].rows * levels[top].columns > 1)
            ++top;
        int level = top;
        ++query.nodes;
        left[level] = children(structure, ray, levels[level].first, levels[level].columns, level, 0, 0);
        for (;;) {
            if (!left[level]) {
                if (level == top)
                    return false;
                ++level;
                row >>= 2;
                column >>= 2;
                continue;
            }
            const int child = __builtin_ctz(left[level]) ^ ray.flip;
            left[level] &= left[level] - 1;
            const int r = 4 * row + child / 4, c = 4 * column + child % 4;
            if (level == 0) {
                if (ChartRay::show(chart, r, c, query))
                    return true;
                continue;
            }
            --level;
            row = r;
            column = c;
            ++query.nodes;
            left[level] = children(structure, ray, levels[level].first, levels[level].columns, level, row, column);
        }
    }
    static inline void walk(const Structure& structure, Query1& query) {
        for (int number = 0; number < structure.count; ++number) {
            ChartRay ray;
            const int at = AtChart::come(structure, number, ray, query);
            if (at == AtChart::ENDS || (at == AtChart::ENTERS && descend(structure, number, ray, query)))
                return;
        }
    }
};
