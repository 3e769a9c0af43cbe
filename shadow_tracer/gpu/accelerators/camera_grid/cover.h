// needs: exact/arithmetic32.h exact/camera_record.h
// arguments: Grid grid
// The tiles of a camera's grid that a triangle may be seen in; bins.py has the proof. Nothing that decides is
// contracted: the kernels that count and that emit must find the same tiles.
struct Cover : Arithmetic32 {
    enum { NONE = -1 };
    const Grid& grid;
    const float* record;
    int coarse, x0, x1, y0, y1; // tiles of the one or the other size; none if x1 < x0
    int x, y;                   // the tile that `next` has been at

    inline Cover(int triangle, const Grid& grid, const wp::array_t<wp::vec3i>& triangles,
                 const wp::array_t<wp::vec4>& corners, const wp::array_t<wp::vec4>& records)
        : grid(grid), record(CameraRecord::at(records, triangle)), coarse(0), x0(0), x1(-1), y0(0), y1(-1) {
        const wp::vec3i& corner = triangles.data[triangle];
        const wp::vec4 at[3] = { corners.data[corner[0]], corners.data[corner[1]], corners.data[corner[2]] };
        if (record[CameraRecord::CASTS] != 0.0f)
            bound(at);
        x = x0 - 1;
        y = y0;
    }
    // Places among the lists of tiles, the coarse ones behind the sorting tiles.
    static inline int sorting_tile(const Grid& grid, int x, int y) { return y * grid.tiles_x + x; }
    static inline int coarse_tile(const Grid& grid, int x, int y) {
        return grid.tiles_x * grid.tiles_y + y * grid.coarse_x + x;
    }
    // Whether any ray of these columns and rows may be inside the edges of a record.
    static inline bool may_meet(const Grid& grid, const float* record, int column0, int column1, int row0, int row1) {
        // The axes of a table of rays are the edges of the tiles, those of a pinhole the rays themselves.
        const float x0 = grid.columns.data[column0], x1 = grid.columns.data[column1 + grid.rays.tabled];
        const float y0 = grid.rows.data[row0], y1 = grid.rows.data[row1 + grid.rays.tabled];
        const float bound = times(record[CameraRecord::EDGE_BOUND], larger(x0, x1) + larger(y0, y1) + 2.0f);
        for (int k = 0; k < CameraRecord::EDGES; ++k) {
            const float* n = record + 4 * k;
            const float e = plus(times(n[0], n[0] > 0.0f ? x1 : x0), plus(times(n[1], n[1] > 0.0f ? y0 : y1), n[2]));
            if (e < -bound)
                return false;
        }
        return true;
    }
    // The same for a sorting tile.
    static inline bool tile_may_meet(int triangle, int tile_x, int tile_y, const Grid& grid,
                                     const wp::array_t<wp::vec4>& records) {
        const int column = tile_x * grid.tile, row = tile_y * grid.tile, last = grid.tile - 1;
        return may_meet(grid, CameraRecord::at(records, triangle), column, column + last, row, row + last);
    }
    // The next tile, by its place among the lists; NONE after the last one.
    inline int next() {
        // Triangles are small, most of them, and the corners' bounds say nearly all.
        if (x0 == x1 && y0 == y1 && !coarse)
            return ++x == x0 ? sorting_tile(grid, x0, y0) : NONE;
        const int side = coarse ? grid.tile * grid.group : grid.tile;
        const int last_column = grid.tiles_x * grid.tile - 1, last_row = grid.tiles_y * grid.tile - 1;
        for (;;) {
            if (++x > x1) {
                x = x0;
                if (++y > y1)
                    return NONE;
            }
            const int column1 = (x + 1) * side - 1 < last_column ? (x + 1) * side - 1 : last_column;
            const int row1 = (y + 1) * side - 1 < last_row ? (y + 1) * side - 1 : last_row;
            if (may_meet(grid, record, x * side, column1, y * side, row1))
                return coarse ? coarse_tile(grid, x, y) : sorting_tile(grid, x, y);
        }
    }

    static inline float larger(float x, float y) { return fabsf(x) > fabsf(y) ? fabsf(x) : fabsf(y); }
    static inline float within(float x, float end) { return x < 0.0f ? 0.0f : x > end ? end : x; }
    // Tiles by the bounds of the corners on the image.
    inline void bound(const wp::vec4 (&at)[3]) {
        float size = 0.0f, front = 3.0e38f, back = -3.0e38f;
        for (int k = 0; k < 3; ++k) {
            const float sum = 1.0f + fabsf(at[k][0]) + fabsf(at[k][1]) + fabsf(at[k][2]) + fabsf(at[k][3]);
            size = sum > size ? sum : size;
            front = at[k][2] < front ? at[k][2] : front;
            back = at[k][2] > back ? at[k][2] : back;
        }
        if (back < -0x1p-40f * size)
            return;
        const float right = (float)(grid.rays.width - 1), bottom = (float)(grid.rays.height - 1);
        float c0 = 0.0f, c1 = right, r0 = 0.0f, r1 = bottom;
        if (front > 0x1p-18f * size && size < 1.0e30f) {
            float u0 = 3.0e38f, u1 = -3.0e38f, v0 = 3.0e38f, v1 = -3.0e38f;
            for (int k = 0; k < 3; ++k) {
                const float inverse = 1.0f / at[k][2], u = times(at[k][0], inverse), v = times(-at[k][1], inverse);
                u0 = u < u0 ? u : u0;
                u1 = u > u1 ? u : u1;
                v0 = v < v0 ? v : v0;
                v1 = v > v1 ? v : v1;
            }
            const float pad_x = 0x1p-20f * plus(times(grid.fx, 1.0f + larger(u0, u1)), fabsf(grid.cx) + right);
            const float pad_y = 0x1p-20f * plus(times(grid.fy, 1.0f + larger(v0, v1)), fabsf(grid.cy) + bottom);
            u0 = minus(plus(times(u0, grid.fx), grid.cx), pad_x);
            u1 = plus(plus(times(u1, grid.fx), grid.cx), pad_x);
            v0 = minus(plus(times(v0, grid.fy), grid.cy), pad_y);
            v1 = plus(plus(times(v1, grid.fy), grid.cy), pad_y);
            if (grid.rays.tabled) {
                // Rays are anywhere, and beyond the grid in its outermost tiles.
                c0 = within(floorf(u0), right);
                c1 = within(floorf(u1), right);
                r0 = within(floorf(v0), bottom);
                r1 = within(floorf(v1), bottom);
            } else {
                if (u0 > right || u1 < 0.0f || v0 > bottom || v1 < 0.0f)
                    return;
                // Between them lies no pixel centre: no ray.
                c0 = u0 > 0.0f ? ceilf(u0) : 0.0f;
                c1 = u1 < right ? floorf(u1) : right;
                r0 = v0 > 0.0f ? ceilf(v0) : 0.0f;
                r1 = v1 < bottom ? floorf(v1) : bottom;
                if (c0 > c1 || r0 > r1)
                    return;
            }
        }
        x0 = (int)c0 / grid.tile;
        x1 = (int)c1 / grid.tile;
        y0 = (int)r0 / grid.tile;
        y1 = (int)r1 / grid.tile;
        x1 = x1 < grid.tiles_x ? x1 : grid.tiles_x - 1;
        y1 = y1 < grid.tiles_y ? y1 : grid.tiles_y - 1;
        if ((wp::int64)(x1 - x0 + 1) * (y1 - y0 + 1) <= grid.group * grid.group)
            return;
        coarse = 1;
        x0 /= grid.group;
        x1 /= grid.group;
        y0 /= grid.group;
        y1 /= grid.group;
    }
};
