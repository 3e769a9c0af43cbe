// arguments: Image image
// Quads of a geometry image by their keys, and nodes over keys; see images.py.
struct Order {
    // Every other bit, from the lowest on.
    static inline int even_bits(wp::uint32 key) {
        key &= 0x55555555u;
        key = (key | key >> 1) & 0x33333333u;
        key = (key | key >> 2) & 0x0F0F0F0Fu;
        key = (key | key >> 4) & 0x00FF00FFu;
        return (int)((key | key >> 8) & 0x0000FFFFu);
    }
    // Row and column of the quad that a key is of; false if it is of none.
    static inline bool place(const Image& image, wp::uint32 key, int& row, int& column) {
        const int bits = 2 * image.tile_bits, tile = (int)(key >> bits);
        const wp::uint32 within = key & ((1u << bits) - 1u);
        // Tiles follow each other along the shorter side first.
        const int along = image.tiles_over == 1 ? tile : tile / image.tiles_over;
        const int i = ((tile - along * image.tiles_over) << image.tile_bits) + even_bits(within >> 1);
        const int j = (along << image.tile_bits) + even_bits(within);
        row = image.upright ? j : i;
        column = image.upright ? i : j;
        return row < image.rows && column < image.columns;
    }
    // How many nodes a level has.
    static inline int nodes(const Image& image, int level) {
        return (int)(((wp::uint32)image.keys + (1u << 2 * level) - 1u) >> 2 * level);
    }
};
