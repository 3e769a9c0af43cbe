// cpu
// needs: accelerators/camera_grid/cover.h exact/hit.h exact/ray_test.h@1
// needs: exact/ray_test.h@16
// constants: CAMERA_TILE
// arguments: Grid grid, Sorted scene, CameraRays grid.rays, CameraTriangles scene.seen, Image image
// A row of tiles and one thread, sixteen rays of a tile at a time. The bound of a tile is that of its outermost ray, so
// it differs from a single ray's: both are right.
struct Tiles16 : Hit {
    enum { SIDE = CAMERA_TILE, PIXELS = SIDE * SIDE, ROWS = 16 / SIDE };
    const Grid& grid;
    const Image& image;
    const int tile_y, row0, rows; // the first of its rows of pixels, and how many are in the image
    int column0, columns;         // the same of the tile at hand
    float magnitude;              // of its outermost ray
    wp::int64 tests;
    // The tile's pixels, row by row: bounds of the inverse depth of the closest triangle, and the triangle. Pixels
    // outside the image go along, and no lane of theirs is finished.
    alignas(64) float x[16], y[PIXELS], low[PIXELS], high[PIXELS];
    alignas(64) int best[PIXELS];
    int there[PIXELS / 16]; // as bits: pixels inside the image

    inline Tiles16(int tile_y, const Grid& grid, const Sorted& scene, const Image& image)
        : Hit(grid.rays, scene.seen), grid(grid), image(image), tile_y(tile_y), row0(SIDE * tile_y),
          rows(grid.rays.height - SIDE * tile_y < SIDE ? grid.rays.height - SIDE * tile_y : SIDE), column0(0),
          columns(0), magnitude(0.0f), tests(0) {
        for (int j = 0; j < PIXELS; ++j)
            y[j] = grid.rows.data[row0 + j / SIDE];
    }
    inline void begin(int tile_x, int further) {
        column0 = SIDE * tile_x;
        columns = grid.rays.width - column0 < SIDE ? grid.rays.width - column0 : SIDE;
        for (int j = 0; j < 16; ++j)
            x[j] = grid.columns.data[column0 + j % SIDE];
        magnitude = Cover::larger(x[0], x[SIDE - 1]) + Cover::larger(y[0], y[PIXELS - 1]) + 2.0f;
        for (int j = 0; j < PIXELS; ++j) {
            best[j] = -1;
            low[j] = high[j] = -(float)HUGE_VAL;
        }
        for (int& bits : there)
            bits = Lanes16::ALL;
        if (rows == SIDE && columns == SIDE && !further)
            return;
        for (int j = 0; j < PIXELS; ++j) {
            if (j / SIDE >= rows || j % SIDE >= columns)
                there[j / 16] &= ~(1 << j % 16);
            else if (further)
                resume(j);
        }
    }
    // Goes on with what a pass before has found.
    inline void resume(int j) {
        best[j] = image.triangle.data[(row0 + j / SIDE) * grid.rays.width + column0 + j % SIDE];
        if (best[j] < 0)
            return;
        RayTest1 test;
        test.measure(CameraRecord::at(seen.records, best[j]), x[j % SIDE], y[j],
                     fabsf(x[j % SIDE]) + fabsf(y[j]) + 2.0f);
        low[j] = test.low;
        high[j] = test.high;
    }
    inline void visit(int triangle) {
        const float* record = CameraRecord::at(seen.records, triangle);
        tests += columns * rows;
        for (int group = 0; ROWS * group < rows; ++group) {
            const int from = 16 * group;
            RayTest16 test;
            const Real16 least = Lanes16::load(low + from), most = Lanes16::load(high + from);
            const int left = test.judge(record, Lanes16::load(x), Lanes16::load(y + from), magnitude, least, most);
            if (left == 0)
                continue;
            Mask16& id = *(Mask16*)(best + from);
            id = test.closer ? triangle : id;
            Lanes16::store(low + from, test.closer ? test.low : least);
            Lanes16::store(high + from, test.closer ? test.high : most);
            for (int rest = left & there[group] & ~Lanes16::bits(test.closer); rest; rest &= rest - 1) {
                const int lane = __builtin_ctz(rest), pixel = from + lane;
                if (!replaces(triangle, best[pixel], test.inside >> lane & 1, test.low[lane], high[pixel],
                              rays.columns.data[column0 + pixel % SIDE], rays.rows.data[row0 + pixel / SIDE]))
                    continue;
                best[pixel] = triangle;
                low[pixel] = test.low[lane];
                high[pixel] = test.high[lane];
            }
        }
    }
    inline void write() const {
        double way[3 * SIDE], plane[PLANE_COLUMNS * SIDE];
        float depth[SIDE];
        for (int r = 0; r < rows; ++r) {
            const int* id = best + SIDE * r;
            for (int c = 0; c < SIDE; ++c)
                DepthPlane::direction(rays, rays.columns.data[column0 + c], rays.rows.data[row0 + r], way + c, SIDE);
            for (int c = 0; c < SIDE; ++c)
                for (int k = 0; k < PLANE_COLUMNS; ++k)
                    plane[SIDE * k + c] = seen.planes.data[PLANE_COLUMNS * (size_t)(id[c] < 0 ? 0 : id[c]) + k];
            for (int c = 0; c < SIDE; ++c) {
                const float t = DepthPlane::measured(DepthPlane::depth(plane + c, way + c, SIDE));
                depth[c] = id[c] < 0 ? __builtin_nanf("") : t;
            }
            const size_t at = (size_t)(row0 + r) * grid.rays.width + column0;
            memcpy(image.depth.data + at, depth, sizeof(float) * columns);
            memcpy(image.triangle.data + at, id, sizeof(int) * columns);
        }
    }
    static inline void trace(int tile_y, int further, const Grid& grid, const Sorted& scene, const Image& image,
                             const wp::array_t<wp::int64>& counters) {
        Tiles16 it(tile_y, grid, scene, image);
        for (int tile_x = 0; tile_x < grid.tiles_x; ++tile_x) {
            it.begin(tile_x, further);
            const int fine = Cover::sorting_tile(grid, tile_x, tile_y);
            const int coarse = Cover::coarse_tile(grid, tile_x / grid.group, tile_y / grid.group);
            for (int k = scene.starts.data[fine]; k < scene.starts.data[fine + 1]; ++k)
                it.visit(scene.lists.data[k]);
            for (int k = scene.starts.data[coarse]; k < scene.starts.data[coarse + 1]; ++k) {
                const int triangle = scene.lists.data[k];
                if (Cover::tile_may_meet(triangle, tile_x, tile_y, grid, scene.seen.records))
                    it.visit(triangle);
            }
            it.write();
        }
        it.report(tile_y, it.tests, counters);
    }
};
