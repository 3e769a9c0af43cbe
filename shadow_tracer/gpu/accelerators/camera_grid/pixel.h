// needs: accelerators/camera_grid/cover.h accelerators/camera_grid/hit.h accelerators/camera_grid/ray_test.h@1
// One ray and one thread.
struct Pixel : Hit {
    const wp::vec2& ray; // x and -y
    const int column, row;
    const float magnitude;
    int tests;
    int best;        // the closest triangle so far
    float low, high; // bounds of its inverse depth

    inline Pixel(int column, int row, const wp::vec2& ray, int before, const Grid& grid, const Sorted& scene)
        : Hit(grid, scene), ray(ray), column(column), row(row), magnitude(fabsf(ray[0]) + fabsf(ray[1]) + 2.0f),
          tests(0), best(before), low(-(float)HUGE_VAL), high(-(float)HUGE_VAL) {
        if (before < 0)
            return;
        RayTest1 found;
        found.measure(CameraRecord::at(scene.records, before), ray[0], ray[1], magnitude);
        low = found.low;
        high = found.high;
    }
    inline void visit(int triangle) {
        ++tests;
        RayTest1 test;
        const float* record = CameraRecord::at(scene.records, triangle);
        if (!test.judge(record, ray[0], ray[1], magnitude, low, high))
            return;
        if (!test.closer) {
            const double x = grid.tabled ? (double)ray[0] : grid.columns64.data[column];
            const double y = grid.tabled ? -(double)ray[1] : grid.rows64.data[row];
            if (!replaces(triangle, best, test.inside, test.low, high, x, y))
                return;
        }
        best = triangle;
        low = test.low;
        high = test.high;
    }
    // The closest triangle of the lists of a tile and of what was found `before`, -1 for none.
    static inline int trace(int column, int row, const wp::vec2& ray, int before, int tile_x, int tile_y, int number,
                            const Grid& grid, const Sorted& scene, const wp::array_t<wp::int64>& counters) {
        Pixel it(column, row, ray, before, grid, scene);
        const int fine = Cover::sorting_tile(grid, tile_x, tile_y);
        const int coarse = Cover::coarse_tile(grid, tile_x / grid.group, tile_y / grid.group);
        const int first = scene.starts.data[fine], mine = scene.starts.data[fine + 1] - first;
        const int further = scene.starts.data[coarse], others = scene.starts.data[coarse + 1] - further;
        // Both lists in one loop, so that the exact decision is compiled once.
        for (int k = 0; k < mine + others; ++k) {
            const int triangle = scene.lists.data[k < mine ? first + k : further + k - mine];
            if (k < mine || Cover::tile_may_meet(triangle, tile_x, tile_y, grid, scene.records))
                it.visit(triangle);
        }
        it.report(number, it.tests, counters);
        return it.best;
    }
};
