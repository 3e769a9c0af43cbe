// cpu
// needs: accelerators/light_grid/on_face.h@16 accelerators/light_grid/tile_box.h accelerators/light_grid/tiles.h
// constants: FACES TILE_RAYS BLOCK_RAYS U_CELLS V_BITS V_CELLS MAGNITUDE_FLOOR
// arguments: Tiles tiles
struct Columns {
    // Rays in the order of (group, cell of u), within a cell in that of the image: so a column is a range of them.
    // They come behind the first `count` elements of `keys` (then the cell of v) and `order`; cells: rays in each.
    static inline void gather(int count, const Tiles& tiles, const wp::array_t<int>& cells,
                              const wp::array_t<int>& keys, const wp::array_t<int>& order) {
        int sum = 0;
        for (int k = 0; k < FACES * tiles.lights * U_CELLS; ++k) {
            const int here = cells.data[k];
            cells.data[k] = sum;
            sum += here;
        }
        for (int i = 0; i < count; ++i) {
            const int key = keys.data[i], to = count + cells.data[key >> V_BITS]++;
            keys.data[to] = key & (V_CELLS - 1);
            order.data[to] = order.data[i];
        }
    }
    // The n rays of a column by their cells of v. Lanes without a ray repeat the first of their tile, and are not live.
    static inline void sort(int n, int blocks, const int* cell, const int* ray_of, int* sorted) {
        int next[V_CELLS];
        for (int j = 0; j < V_CELLS; ++j)
            next[j] = 0;
        for (int i = 0; i < n; ++i)
            ++next[cell[i]];
        int sum = 0;
        for (int j = 0; j < V_CELLS; ++j) {
            const int here = next[j];
            next[j] = sum;
            sum += here;
        }
        for (int i = 0; i < n; ++i)
            sorted[next[cell[i]]++] = ray_of[i];
        for (int i = n; i < BLOCK_RAYS * blocks; ++i)
            sorted[i] = sorted[i / TILE_RAYS * TILE_RAYS < n ? i / TILE_RAYS * TILE_RAYS : 0];
    }
    // The rays of a tile into its lanes, and what holds them. Minima are found by halving: a running minimum would have
    // to be taken in order.
    static inline void fill(int face, bool inverse, const int* sorted, const wp::array_t<wp::vec4>& rays, float* lanes,
                            TileBox& box) {
        const int axis = face >> 1, first = (axis + 1) % 3, second = (axis + 2) % 3;
        float least[3][16], most[3][16];
        for (int half = 0; half < 2; ++half, lanes += TileMemory::SIXTEEN_RAYS) {
            for (int j = 0; j < 16; ++j) {
                const wp::vec4 ray = rays.data[sorted[16 * half + j]];
                for (int k = 0; k < 4; ++k)
                    lanes[16 * k + j] = ray[k];
            }
            const Real16 Z = Lanes16::load(lanes + 48), floor = MAGNITUDE_FLOOR;
            Lanes16::store(lanes + 64, Lanes16::absolute(Lanes16::load(lanes))
                                           + Lanes16::absolute(Lanes16::load(lanes + 16)) + Lanes16::absolute(Z)
                                           + floor);
            OnFace16 at;
            at.set(face, Lanes16::load(lanes + 16 * axis), Lanes16::load(lanes + 16 * first),
                   Lanes16::load(lanes + 16 * second));
            const Real16 place[3] = { at.u, at.v, at.depth(Z, inverse) };
            for (int q = 0; q < 3; ++q) {
                const Real16 low = Lanes16::load(least[q]), high = Lanes16::load(most[q]);
                Lanes16::store(least[q], half == 0 ? place[q] : place[q] < low ? place[q] : low);
                Lanes16::store(most[q], half == 0 ? place[q] : place[q] > high ? place[q] : high);
            }
        }
        for (int q = 0; q < 3; ++q) {
            for (int half = 8; half > 0; half /= 2)
                for (int j = 0; j < half; ++j) {
                    least[q][j] = least[q][j] < least[q][j + half] ? least[q][j] : least[q][j + half];
                    most[q][j] = most[q][j] > most[q][j + half] ? most[q][j] : most[q][j + half];
                }
            box.low[q] = least[q][0];
            box.high[q] = most[q][0];
        }
    }
    // Tiles, blocks and the box of one column of group `number`: its rays are order[begin:end], with the cells of v in
    // `keys`.
    static inline void pack(int number, int inverse, int column, int first_block, int begin, int end,
                            const wp::array_t<wp::vec4>& rays, const Tiles& tiles, const wp::array_t<int>& keys,
                            const wp::array_t<int>& order) {
        const int n = end - begin, blocks = (n + BLOCK_RAYS - 1) / BLOCK_RAYS;
        int* sorted = TileMemory::order(tiles, 16 * first_block);
        sort(n, blocks, keys.data + begin, order.data + begin, sorted);
        TileBox whole;
        whole.clear();
        for (int b = 0; b < 16; ++b) {
            TileBox block;
            block.clear();
            for (int k = 0; b < blocks && k < 16; ++k) {
                const int tile = 16 * (first_block + b) + k, start = BLOCK_RAYS * b + TILE_RAYS * k;
                const int used = n - start < TILE_RAYS ? n - start : TILE_RAYS;
                TileBox box;
                box.clear();
                tiles.live.data[tile] = used > 0 ? (int)(0xFFFFFFFFu >> (TILE_RAYS - used)) : 0;
                tiles.covered.data[tile] = 0;
                if (used > 0) {
                    const int ahead = start + 2 * TILE_RAYS;
                    for (int i = ahead; i < ahead + TILE_RAYS && i < n; ++i)
                        __builtin_prefetch(rays.data + sorted[i]);
                    fill(number % FACES, inverse != 0, sorted + start, rays, TileMemory::rays(tiles, tile), box);
                }
                box.store(tiles.boxes, tile);
                block.join(box);
            }
            block.store(tiles.blocks, 16 * column + b);
            whole.join(block);
        }
        whole.store(tiles.columns, column);
    }
};
