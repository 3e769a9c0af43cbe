// needs: exact/faces.h@1 accelerators/ray_keys.h@1
// constants: CURVE_BITS
// arguments: RayTree tree
// Where a triangle begins its way through the ray tree: the runs of leaves whose cells it may touch. Its bounds on a
// cube face become cells by the same monotone expression that rays go through (CubeCell::cell), at the level of the
// curve where they cover at most two by two; a cell of any level is a contiguous range of keys, and the lookup table
// knows where its rays are.
struct Cells {
    // Rays lie from the lowest u of a face to one square of cells further; nothing beyond that and this many cells can
    // touch them.
    enum { MARGIN = 16 };

    // The table in one sweep over the keys.
    static inline void sweep(const wp::array_t<int>& keys, const RayTree& tree) {
        const int count = tree.counts.data[0], shift = 2 * (CURVE_BITS - tree.table_bits);
        const int last = Corners1::FACES << (2 * tree.table_bits);
        int entry = 0;
        for (int i = 0; i < count; ++i)
            for (const int cell = keys.data[i] >> shift; entry <= cell; ++entry)
                tree.table.data[entry] = i;
        for (; entry <= last; ++entry)
            tree.table.data[entry] = count;
    }
};
// Pairs of first and last leaf, ascending and disjoint.
struct Runs {
    enum { MOST = 4 };
    int first[MOST], last[MOST];
    int count;

    // The rays from one number to before another.
    inline void add(int from, int to, int log_leaf) {
        if (from >= to)
            return;
        const int first_leaf = from >> log_leaf, last_leaf = (to - 1) >> log_leaf;
        if (count > 0 && first_leaf <= last[count - 1] + 1) {
            last[count - 1] = last_leaf > last[count - 1] ? last_leaf : last[count - 1];
        } else {
            first[count] = first_leaf;
            last[count] = last_leaf;
            ++count;
        }
    }
    // The leaves whose cells may be touched by what is seen on a face.
    inline void find(const RayTree& tree, const Seen1& seen, int face) {
        const int bits = tree.table_bits;
        const int* table = tree.table.data + ((size_t)face << (2 * bits));
        count = 0;
        if (!seen.bounded) {
            add(table[0], table[(size_t)1 << (2 * bits)], tree.log_leaf);
            return;
        }
        const wp::vec4 grid = tree.fit.data[face];
        const float beyond = CubeCell1::CELLS + Cells::MARGIN;
        if (seen.high_u < grid[0] || seen.high_v < grid[1] || (seen.low_u - grid[0]) * grid[2] > beyond
            || (seen.low_v - grid[1]) * grid[2] > beyond)
            return;
        int x0 = CubeCell1::cell(seen.low_u, grid[0], grid[2]), x1 = CubeCell1::cell(seen.high_u, grid[0], grid[2]);
        int y0 = CubeCell1::cell(seen.low_v, grid[1], grid[2]), y1 = CubeCell1::cell(seen.high_v, grid[1], grid[2]);
        int level = CURVE_BITS - bits;
        while ((x1 >> level) - (x0 >> level) > 1 || (y1 >> level) - (y0 >> level) > 1)
            ++level;
        x0 >>= level;
        x1 >>= level;
        y0 >>= level;
        y1 >>= level;
        const int up = 2 * (level - (CURVE_BITS - bits));
        int codes[MOST];
        int n = 0;
        codes[n++] = CubeCell1::morton(x0, y0);
        if (x1 > x0)
            codes[n++] = CubeCell1::morton(x1, y0);
        if (y1 > y0) {
            codes[n++] = CubeCell1::morton(x0, y1);
            if (x1 > x0)
                codes[n++] = CubeCell1::morton(x1, y1);
        }
        if (n == MOST && codes[1] > codes[2]) {
            const int swap = codes[1];
            codes[1] = codes[2];
            codes[2] = swap;
        }
        for (int k = 0; k < n; ++k)
            add(table[(size_t)codes[k] << up], table[((size_t)codes[k] + 1) << up], tree.log_leaf);
    }
};
