// needs: accelerators/height_field/boxes.h accelerators/height_field/at_chart.h
// arguments: Structure structure
// constants: CHART_LEVELS
// Down the nodes of each chart, a child at a time and without a stack: the next child is a matter of numbers.
struct Walk1 {
    // True if something hides the ray.
    static inline bool descend(const Structure& structure, int number, const ChartRay& ray, Query1& query) {
        const auto& chart = structure.charts.data[number];
        const auto* levels = structure.levels.data + CHART_LEVELS * number;
        int level = 0;
        while (levels[level].rows * levels[level].columns > 1)
            ++level;
        const int top = level;
        // The child that is next: of the node at (row >> 2, column >> 2), the turn-th in the order of the ray.
        int row = ray.flip >> 2, column = ray.flip & 3, turn = 0;
        ++query.nodes;
        for (;;) {
            const size_t node =
                (size_t)levels[level].first + (size_t)(row >> 2) * levels[level].columns + (column >> 2);
            const int size = 1 << 2 * level, child = (row & 3) << 2 | (column & 3);
            const int heights = (int)structure.nodes.data[16 * node + child];
            if (ChartBoxes1::met(ray, (float)(column * size), (float)(row * size), (float)size, heights)) {
                if (level > 0) {
                    --level;
                    row = row << 2 | ray.flip >> 2;
                    column = column << 2 | (ray.flip & 3);
                    turn = 0;
                    ++query.nodes;
                    continue;
                }
                if (ChartRay::show(chart, row, column, query))
                    return true;
            }
            while (turn == 15) {
                if (level == top)
                    return false;
                ++level;
                row >>= 2;
                column >>= 2;
                turn = ((row & 3) << 2 | (column & 3)) ^ ray.flip;
            }
            ++turn;
            const int next = turn ^ ray.flip;
            row = (row & ~3) | next >> 2;
            column = (column & ~3) | (next & 3);
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
