// cpu
// needs: accelerators/light_grid/counting.h accelerators/light_grid/tile_box.h accelerators/light_grid/tiles.h
// needs: accelerators/light_grid/fit.h
// constants: MOST_BLOCKS U_BITS V_BITS FIT_BITS
// arguments: Tiles tiles, Pieces pieces
// Pieces to tiles.
struct Columns {
    // Keys and numbers of all pieces that have rays; returns how many there are.
    static inline int list(int count, const Tiles& tiles, const Pieces& pieces, const wp::array_t<int>& cells,
                           const wp::array_t<int>& keys, const wp::array_t<int>& order) {
        const auto cell = [](float x, float low, float scale) {
            const float at = (x - low) * scale, last = FIT_CELLS - 1;
            return (int)(at > 0.0f ? (at < last ? at : last) : 0.0f);
        };
        int found = 0;
        for (int piece = 0; piece < count; ++piece) {
            const int number = pieces.group.data[piece];
            if (number < 0)
                continue;
            const float* box = pieces.box.data + 6 * (size_t)piece;
            const wp::vec4& fit = tiles.fit.data[number];
            const int x = cell(0.5f * (box[0] + box[3]), fit[0], fit[2]) >> (FIT_BITS - U_BITS);
            const int y = cell(0.5f * (box[1] + box[4]), fit[1], fit[3]) >> (FIT_BITS - V_BITS);
            const int key = number << (U_BITS + V_BITS) | x << V_BITS | y;
            keys.data[found] = key;
            order.data[found++] = piece;
            ++cells.data[key >> V_BITS];
        }
        return found;
    }
    // Tiles, blocks and the box of one column: its pieces are order[begin:end], with the cells of v in `keys`.
    static inline void pack(int column, int first_block, int begin, int end, const Tiles& tiles, const Pieces& pieces,
                            const wp::array_t<int>& keys, const wp::array_t<int>& order) {
        const int n = end - begin, blocks = (n + 15) / 16;
        int sorted[16 * MOST_BLOCKS];
        Counting::sort(n, keys.data + begin, order.data + begin, sorted);
        TileBox whole;
        whole.clear();
        for (int b = 0; b < 16; ++b) {
            TileBox block;
            block.clear();
            for (int k = 16 * b; b < blocks && k < 16 * b + 16; ++k) {
                const int tile = 16 * first_block + k;
                TileBox box;
                box.clear();
                if (k < n)
                    memcpy(&box, pieces.box.data + 6 * (size_t)sorted[k], sizeof(box));
                const int piece = sorted[k < n ? k : 0];
                tiles.source.data[tile] = wp::vec2i(tiles.numbers.data[piece][0], piece);
                tiles.live.data[tile] = k < n ? pieces.live.data[piece] : 0;
                tiles.covered.data[tile] = 0;
                box.store(tiles.boxes, tile);
                block.join(box);
            }
            block.store(tiles.blocks, 16 * column + b);
            whole.join(block);
        }
        whole.store(tiles.columns, column);
    }
};
