// needs: accelerators/height_field/at_chart.h
// arguments: Structure structure
// constants: CHART_LEVELS
// Down the nodes of each chart, a child at a time and without a stack: the next child is a matter of numbers.
struct Walk1 {
    // Until something hides the ray.
    static inline void descend(const Structure& structure, int number, const ChartRay1& ray, Query1& query) {
        const auto& chart = structure.charts.data[number];
        const auto* levels = structure.levels.data + CHART_LEVELS * number;
        int level = 0;
        while (levels[level].rows * levels[level].columns > 1)
            ++level;
        const int top = level;
        // Turns the numbers of a node's children so that they come in the order of the ray.
        const int flip = (ray.span[0] < 0.0f ? 3 : 0) | (ray.span[1] < 0.0f ? 12 : 0);
        // The child that is next: of the node at (row >> 2, column >> 2), the turn-th in the order of the ray.
        int row = flip >> 2, column = flip & 3, turn = 0;
        ++query.nodes;
        for (;;) {
            const size_t node =
                (size_t)levels[level].first + (size_t)(row >> 2) * levels[level].columns + (column >> 2);
            const int size = 1 << 2 * level, child = (row & 3) << 2 | (column & 3);
            const wp::uint32 heights = structure.nodes.data[16 * node + child];
            if (ray.met((float)(column * size), (float)(row * size), (float)size, heights)) {
                if (level > 0) {
                    --level;
                    row = row << 2 | flip >> 2;
                    column = column << 2 | (flip & 3);
                    turn = 0;
                    ++query.nodes;
                    continue;
                }
                if (AtChart1::show(chart, row, column, query))
                    return;
            }
            while (turn == 15) {
                if (level == top)
                    return;
                ++level;
                row >>= 2;
                column >>= 2;
                turn = ((row & 3) << 2 | (column & 3)) ^ flip;
            }
            ++turn;
            const int next = turn ^ flip;
            row = (row & ~3) | next >> 2;
            column = (column & ~3) | (next & 3);
        }
    }
    static inline void walk(const Structure& structure, Query1& query) {
        for (int number = 0; number < structure.count && query.asking; ++number) {
            ChartRay1 ray;
            if (AtChart1::come(structure, number, ray, query))
                descend(structure, number, ray, query);
        }
    }
};
