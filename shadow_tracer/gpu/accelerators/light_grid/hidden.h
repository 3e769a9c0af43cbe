// cpu
// needs: visibility/answers.h accelerators/light_grid/tiles.h
// constants: SHADOWED TILE_RAYS
// arguments: Tiles tiles, Answers answers
// What has been found of the rays of a tile is kept as bits and written down once, at the end: which samples they are
// of is not at hand while triangles are tested.
struct Hidden {
    typedef unsigned char Bytes __attribute__((ext_vector_type(8)));
    typedef int Numbers __attribute__((ext_vector_type(8)));
    enum { EIGHT = 8, AHEAD = 8 };

    static inline bool in_a_row(const int* numbers) {
        const Numbers lane = { 0, 1, 2, 3, 4, 5, 6, 7 };
        Numbers all;
        memcpy(&all, numbers, sizeof(all));
        return !__builtin_reduce_or(all ^ (lane + numbers[0]));
    }
    // Those of eight states side by side that are set in `bits`.
    static inline void write_eight(wp::uint8* states, unsigned char bits) {
        const Bytes bit = { 1, 2, 4, 8, 16, 32, 64, 128 }, shadowed = (unsigned char)SHADOWED;
        Bytes all;
        memcpy(&all, states, sizeof(all));
        all = (bit & bits) != 0 ? shadowed : all;
        memcpy(states, &all, sizeof(all));
    }
    static inline void write(const Tiles& tiles, const Answers& answers, int tile, unsigned rays) {
        const wp::vec3i& numbers = tiles.numbers.data[TileMemory::piece(tiles, tile)];
        const int* order = tiles.order.data + numbers[1];
        wp::uint8* states = answers.states.data + numbers[2];
        for (; rays; rays >>= EIGHT, order += EIGHT) {
            unsigned some = rays & 0xFF;
            if (some && in_a_row(order))
                write_eight(states + order[0], (unsigned char)some);
            else
                for (; some; some &= some - 1)
                    states[order[__builtin_ctz(some)]] = SHADOWED;
        }
    }
    // Of the first `count` tiles.
    static inline void write_all(const Tiles& tiles, const Answers& answers, const wp::array_t<int>& hidden,
                                 int count) {
        for (int tile = 0; tile < count; ++tile) {
            const int next = tile + AHEAD;
            if (next < count && hidden.data[next]) {
                const int* order = tiles.order.data + tiles.numbers.data[TileMemory::piece(tiles, next)][1];
                __builtin_prefetch(order);
                __builtin_prefetch(order + TILE_RAYS / 2);
            }
            if (hidden.data[tile])
                write(tiles, answers, tile, (unsigned)hidden.data[tile]);
        }
    }
};
