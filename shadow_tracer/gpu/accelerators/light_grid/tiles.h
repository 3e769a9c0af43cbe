// needs: accelerators/light_grid/fit.h accelerators/light_grid/tile_box.h
// constants: BLOCK_RAYS COLUMN_LOOKUP RAYS_OF LENGTH FIRST_COLUMN FIRST_BLOCK GROUP_COLUMNS
// arguments: Tiles tiles
// Where things lie in Tiles; see tiles.py.
struct TileMemory {
    enum { SIXTEEN_RAYS = 16 * 4, RAYS = 2 * SIXTEEN_RAYS };
    // Of a piece.
    static inline float* lanes(const Tiles& tiles, int piece) {
        return tiles.rays.data + RAYS * (size_t)tiles.numbers.data[piece][0];
    }
    static inline wp::vec4 ray(const Tiles& tiles, int piece, int lane) {
        const float* at = lanes(tiles, piece) + (lane >> 4) * SIXTEEN_RAYS + (lane & 15);
        return wp::vec4(at[0], at[16], at[32], at[48]);
    }
    // The number of a ray.
    static inline int ray_of(const Tiles& tiles, int piece, int lane) {
        const wp::vec3i& numbers = tiles.numbers.data[piece];
        return tiles.order.data[numbers[1] + lane] + numbers[2];
    }
    // Of a tile, on the CPU.
    static inline const float* rays(const Tiles& tiles, int tile) {
        return tiles.rays.data + RAYS * (size_t)tiles.source.data[tile][0];
    }
    static inline int piece(const Tiles& tiles, int tile) { return tiles.source.data[tile][1]; }
    // The largest of its rays, and with |W|.
    static inline const wp::vec2& magnitudes(const Tiles& tiles, int tile) {
        return tiles.magnitudes.data[tiles.source.data[tile][0]];
    }
};
// A face of a light, and the columns of tiles on it.
struct TileGroup {
    int first_column, first_block;
    int length; // blocks of a column
    int blocks;
    wp::vec4 fit;
    const wp::vec2i* lookup;

    inline TileGroup(const Tiles& tiles, int number) {
        const int* of = tiles.groups.data + GROUP_COLUMNS * number;
        first_column = of[FIRST_COLUMN];
        first_block = of[FIRST_BLOCK];
        length = of[LENGTH] / BLOCK_RAYS;
        blocks = (of[RAYS_OF] + BLOCK_RAYS - 1) / BLOCK_RAYS;
        fit = tiles.fit.data[number];
        lookup = tiles.lookup.data + COLUMN_LOOKUP * (size_t)number;
    }
    static inline bool any(const Tiles& tiles, int number) {
        return tiles.groups.data[GROUP_COLUMNS * number + RAYS_OF] != 0;
    }
    // First and last column that something between two values of u may touch.
    inline void columns(float low_u, float high_u, int& from, int& to) const {
        from = lookup[Fit::cell(low_u, fit)][0];
        to = lookup[Fit::cell(high_u, fit)][1];
    }
    inline int blocks_of(int column) const {
        const int left = blocks - column * length;
        return left < length ? left : length;
    }
};
