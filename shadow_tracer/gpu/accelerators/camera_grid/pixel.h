// needs: accelerators/camera_grid/cover.h visibility/nearest.h
// arguments: Grid grid, Sorted scene, CameraRays grid.rays, CameraTriangles scene.seen, Image image
// One ray and one thread.
struct Pixel {
    // Puts the closest triangle of the lists of a tile into the image, or what is there from a pass before.
    static inline void trace(int column, int row, int further, int tile_x, int tile_y, int number, const Grid& grid,
                             const Sorted& scene, const Image& image, const wp::array_t<wp::int64>& counters) {
        const size_t at = (size_t)row * grid.rays.width + column;
        Nearest it(grid.rays, scene.seen);
        it.look(column, row, further ? image.triangle.data[at] : -1);
        const int fine = Cover::sorting_tile(grid, tile_x, tile_y);
        const int coarse = Cover::coarse_tile(grid, tile_x / grid.group, tile_y / grid.group);
        const int first = scene.starts.data[fine], mine = scene.starts.data[fine + 1] - first;
        const int second = scene.starts.data[coarse], others = scene.starts.data[coarse + 1] - second;
        // Both lists in one loop, so that the exact decision is compiled once.
        for (int k = 0; k < mine + others; ++k) {
            const int triangle = scene.lists.data[k < mine ? first + k : second + k - mine];
            if (k < mine || Cover::tile_may_meet(triangle, tile_x, tile_y, grid, scene.seen.records))
                it.nearer(triangle);
        }
        it.report(number, it.tests, counters);
        image.triangle.data[at] = it.best;
        image.depth.data[at] = it.measured();
    }
};
