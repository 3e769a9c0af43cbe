// cpu
// needs: device/lanes.h@8 samples/view.h accelerators/admission.h accelerators/fits.h@16 accelerators/light_grid/aim16.h
// needs: accelerators/light_grid/on_face.h@1
// constants: TILE_RAYS PIECE_ROWS SEGMENT LIT INVALID RAYS COUNTER_ROWS
// arguments: LightFrame frame, Tiles tiles, Pieces pieces
// Samples in the order of their pieces straight into lanes: rays of a light are written once, where they stay.
struct Image16 {
    typedef unsigned char Bytes __attribute__((ext_vector_type(16), aligned(1)));
    // Which rays of a piece take part, and as bits those of them that are wild.
    struct Admitted {
        unsigned live, odd;
        Magnitudes16 magnitudes;

        inline Admitted() : live(0), odd(0) {}
        inline void take(int half, Bytes state, Real16 U, Real16 V, Real16 W, Real16 Z) {
            const Mask16 lit = __builtin_convertvector(state == (unsigned char)LIT, Mask16);
            const Mask16 some = lit & (U == U), fits = Fits16::of(U, V, W, Z);
            magnitudes.take(some & fits, U, V, W, Z);
            live |= (unsigned)Lanes16::bits(some & fits) << 16 * half;
            odd |= (unsigned)Lanes16::bits(some & ~fits) << 16 * half;
        }
        inline void store(int piece, const Tiles& tiles, const Pieces& pieces) const {
            pieces.live.data[piece] = (int)live;
            magnitudes.store(tiles, piece);
        }
    };
    enum { CHUNK = 8, MOST = SEGMENT, ASKED = 61 };
    float ray[4][PIECE_ROWS][MOST]; // U V W Z of some samples of some rows
    wp::uint8 state[PIECE_ROWS][MOST];
    int traced;

    inline Image16() : traced(0) { memset(ray, 0, sizeof(ray)); }

    // A row beyond the last.
    inline void none(int row) { memset(state[row], INVALID, MOST); }
    // n samples of a row: their rays and states.
    inline void look(int row, const View& view, const wp::vec4d* samples, const wp::uint8* valid, int n,
                     wp::uint8* states) {
        typedef double Four[4];
        const Four* __restrict__ sample = (const Four*)samples;
        float u[MOST], v[MOST], w[MOST], z[MOST];
        wp::uint8 found_state[MOST]; // bytes may alias anything
        int rays = 0;
        for (int j = 0; j < n; ++j) {
            const Projected found = view.of(sample[j][0], sample[j][1], sample[j][2], sample[j][3], valid[j] != 0);
            u[j] = found.u;
            v[j] = found.v;
            w[j] = found.w;
            z[j] = found.z;
            found_state[j] = (wp::uint8)found.state;
            rays += found.ray;
        }
        memcpy(ray[0][row], u, n * sizeof(float));
        memcpy(ray[1][row], v, n * sizeof(float));
        memcpy(ray[2][row], w, n * sizeof(float));
        memcpy(ray[3][row], z, n * sizeof(float));
        none(row);
        memcpy(state[row], found_state, n);
        memcpy(states, found_state, n);
        traced += rays;
    }
    // Sixteen lanes of eight numbers and eight others.
    static inline Real16 joined(const float* low, const float* high) {
        const Real8 a = Lanes8::load(low), b = Lanes8::load(high);
        return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    }
    // The lanes of a piece whose samples begin at `column`, in chunks of eight, which are put together in registers:
    // what has been written in parts is slow to read as a whole.
    inline void put(int piece, int column, const Tiles& tiles, const Pieces& pieces, const wp::array_t<int>& wild,
                    const wp::array_t<int>& wild_counts) const {
        const bool one_row = pieces.rows == 1;
        float* lanes = TileMemory::lanes(tiles, piece);
        Admitted admitted;
        for (int half = 0; half < 2; ++half) {
            const int low = one_row ? 0 : 2 * half, high = one_row ? 0 : 2 * half + 1;
            const int from = one_row ? column + 2 * CHUNK * half : column, to = one_row ? from + CHUNK : column;
            Real16 lane[4];
            for (int k = 0; k < 4; ++k) {
                lane[k] = joined(ray[k][low] + from, ray[k][high] + to);
                Lanes16::store(lanes + half * TileMemory::SIXTEEN_RAYS + 16 * k, lane[k]);
            }
            Bytes of;
            memcpy(&of, state[low] + from, CHUNK);
            memcpy((wp::uint8*)&of + CHUNK, state[high] + to, CHUNK);
            admitted.take(half, of, lane[0], lane[1], lane[2], lane[3]);
        }
        unsigned odd = admitted.odd;
        admitted.store(piece, tiles, pieces);
        for (; odd; odd &= odd - 1) {
            const int lane = __builtin_ctz(odd), number = TileMemory::ray_of(tiles, piece, lane);
            pieces.rays.data[number] = TileMemory::ray(tiles, piece, lane);
            Admission::list(number, wild, wild_counts);
        }
    }
    // The same for points in no order, whose rays stay in that of their numbers.
    inline void leave(int piece, int column, int n, const Tiles& tiles, const Pieces& pieces,
                      const wp::array_t<int>& wild, const wp::array_t<int>& wild_counts) const {
        typedef float Four[4];
        const int first = TileMemory::ray_of(tiles, piece, 0);
        Four* to = (Four*)(pieces.rays.data + first);
        for (int j = 0; j < n; ++j)
            for (int k = 0; k < 4; ++k)
                to[j][k] = ray[k][0][column + j];
        Admitted admitted;
        for (int half = 0; half < 2; ++half) {
            const Lanes32 it = Lanes32::of(tiles, pieces, piece, half);
            admitted.take(half, *(const Bytes*)(state[0] + column + 16 * half), it.U, it.V, it.W, it.Z);
        }
        admitted.store(piece, tiles, pieces);
        for (unsigned odd = admitted.odd; odd; odd &= odd - 1)
            Admission::list(first + __builtin_ctz(odd), wild, wild_counts);
    }
    // Looks at some samples of a light that nothing is known of: if one has a ray beyond the aligned frustum, none
    // needs to be asked for it.
    static inline void look_around(int place, const LightFrame& frame, const wp::array_t<wp::vec4d>& samples,
                                   const wp::array_t<wp::uint8>& valid, const Tiles& tiles, const Pieces& pieces) {
        const View view(frame);
        for (int k = 0; k < ASKED; ++k) {
            const size_t i = (size_t)tiles.samples * k / ASKED;
            const wp::vec4d& at = samples.data[i];
            const Projected found = view.of(at[0], at[1], at[2], at[3], valid.data[i] != 0);
            if (found.ray && !OnFace1::ahead(found.u, found.v, found.w)) {
                Pieces16::turn(place, place * pieces.of_light, tiles, pieces);
                return;
            }
        }
    }
    // A segment of a light.
    static inline void segment(int number, int kept, int place, const LightFrame& frame, int inverse, int counted,
                               const wp::array_t<wp::vec4d>& samples, const wp::array_t<wp::uint8>& valid,
                               const wp::array_t<wp::uint8>& states, const wp::array_t<int>& wild,
                               const wp::array_t<int>& wild_counts, const Tiles& tiles, const Pieces& pieces,
                               const wp::array_t<wp::int64>& counters) {
        const Strip strip(number, tiles, pieces);
        wp::uint8* to = states.data + (size_t)place * tiles.samples;
        const int traced =
            Aim16::serves(frame, pieces)
                ? aimed(strip, kept, place, inverse, frame, samples, valid, to, wild, wild_counts, tiles, pieces)
                : one_by_one(strip, place, inverse, frame, samples, valid, to, wild, wild_counts, tiles, pieces);
        if (counted == 0)
            counters.data[(number & (COUNTER_ROWS - 1)) * counters.shape[1] + RAYS] += traced;
    }
    // From positions that lights share, but for the pieces that these are no good for; returns how many rays there are.
    static inline int aimed(const Strip& strip, int kept, int place, int inverse, const LightFrame& frame,
                            const wp::array_t<wp::vec4d>& samples, const wp::array_t<wp::uint8>& valid,
                            wp::uint8* states, const wp::array_t<int>& wild, const wp::array_t<int>& wild_counts,
                            const Tiles& tiles, const Pieces& pieces) {
        const Aim16 aim(frame);
        const int first = place * pieces.of_light + strip.first, shared = Shared16::place(strip, kept);
        // All samples with a measurement have a ray.
        for (int row = 0; row < strip.rows; ++row)
            for (int j = 0, n = strip.of_row(row); j < n; ++j)
                states[strip.at(row) + j] = valid.data[strip.at(row) + j] ? LIT : INVALID;
        int traced = 0, from = -1; // the first of pieces that are left out
        for (int k = 0; k <= strip.count; ++k) {
            if (k < strip.count && !aim.take(first + k, shared + k, place, inverse != 0, tiles, pieces)) {
                from = from < 0 ? k : from;
                continue;
            }
            if (from >= 0)
                traced += one_by_one(strip.part(from, k), place, inverse, frame, samples, valid, states, wild,
                                     wild_counts, tiles, pieces);
            from = -1;
            if (k < strip.count)
                traced += __builtin_popcount(pieces.there.data[shared + k]);
        }
        return traced;
    }
    // Sample by sample in float64; returns how many rays there are.
    static inline int one_by_one(const Strip& strip, int place, int inverse, const LightFrame& frame,
                                 const wp::array_t<wp::vec4d>& samples, const wp::array_t<wp::uint8>& valid,
                                 wp::uint8* states, const wp::array_t<int>& wild, const wp::array_t<int>& wild_counts,
                                 const Tiles& tiles, const Pieces& pieces) {
        Image16 it;
        const View view(frame);
        const int wide = strip.wide, first = place * pieces.of_light + strip.first;
        for (int row = 0; row < strip.rows; ++row) {
            const size_t at = strip.at(row);
            const int n = strip.of_row(row);
            if (n == 0)
                it.none(row);
            else
                it.look(row, view, samples.data + at, valid.data + at, n, states + at);
        }
        for (int k = 0; k < strip.count; ++k)
            if (pieces.loose)
                it.leave(first + k, wide * k, strip.n - wide * k < wide ? strip.n - wide * k : wide, tiles, pieces,
                         wild, wild_counts);
            else
                it.put(first + k, wide * k, tiles, pieces, wild, wild_counts);
        Pieces16::more(place, inverse != 0, first, first + strip.count, tiles, pieces);
        return it.traced;
    }
};
