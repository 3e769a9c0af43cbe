// cpu
// needs: device/doubles.h@16 device/fold.h accelerators/light_grid/strip.h
// constants: TILE_RAYS PLACE_STEP PLACE_MOST LARGEST_STEP
// arguments: LightFrame frame, Tiles tiles, Pieces pieces
// Where samples are, once for all lights: in the lanes of their pieces, whole numbers of steps from the anchor in units
// of its scale; and how far rays begin from them, in the same units. aim16.h makes rays of them.
struct Shared16 {
    typedef int Whole __attribute__((ext_vector_type(16), aligned(4)));
    typedef unsigned char Bytes __attribute__((ext_vector_type(16), aligned(1)));
    enum { PLACE = 3 * TILE_RAYS, EIGHT = 8 };

    static inline int* places(const Pieces& pieces, int piece) { return pieces.places.data + PLACE * (size_t)piece; }
    static inline float* steps(const Pieces& pieces, int piece) {
        return pieces.steps.data + TILE_RAYS * (size_t)piece;
    }
    // Half of a piece; returns the lanes that are too far out, or whose rays begin too far off, as bits.
    static inline int put(int piece, int half, const double* const (&from)[16], int there, const LightFrame& frame,
                          const Pieces& pieces, Real16& longest) {
        const double most = PLACE_MOST, scale = frame.inverse_scale;
        const float none = 0.0f, largest = LARGEST_STEP;
        Double16 at[4];
        Doubles16::turn(from, at);
        const Real16 step = Doubles16::narrow(at[3] * scale);
        int fits = Lanes16::bits((step >= none) & (step <= largest));
        for (int k = 0; k < 3; ++k) {
            at[k] = (at[k] - frame.center[k]) * scale;
            fits &= Doubles16::bits(Lanes16::absolute(at[k]) <= most);
        }
        const Mask16 good = Lanes16::mask(fits);
        for (int k = 0; k < 3; ++k) {
            const Whole rounded =
                __builtin_convertvector(__builtin_elementwise_rint(at[k] * (1.0 / PLACE_STEP)), Whole);
            *(Whole*)(places(pieces, piece) + TILE_RAYS * k + 16 * half) = rounded & good;
        }
        const Real16 kept = good ? step : none;
        Lanes16::store(steps(pieces, piece) + 16 * half, kept);
        longest = (Lanes16::mask(there) & (kept > longest)) ? kept : longest;
        return ~fits & 0xFFFF;
    }
    // The samples of half a piece whose first column is this one of a strip; returns the lanes that hold one with a
    // measurement, as bits. Lanes beyond the edges of the image get the first sample.
    static inline unsigned find(const Strip& strip, int half, int column, const wp::vec4d* samples,
                                const wp::uint8* valid, const double* (&from)[16]) {
        const bool one_row = strip.rows == 1;
        const int low = one_row ? 0 : 2 * half, high = one_row ? 0 : 2 * half + 1;
        const int begin = column + (one_row ? 16 * half : 0), next = one_row ? begin + EIGHT : column;
        if (begin + EIGHT <= strip.of_row(low) && next + EIGHT <= strip.of_row(high)) {
            const size_t one = strip.at(low) + begin, two = strip.at(high) + next;
            Bytes all;
            memcpy(&all, valid + one, EIGHT);
            memcpy((wp::uint8*)&all + EIGHT, valid + two, EIGHT);
            for (int j = 0; j < EIGHT; ++j) {
                from[j] = (const double*)(samples + one + j);
                from[EIGHT + j] = (const double*)(samples + two + j);
            }
            return (unsigned)Lanes16::bits(__builtin_convertvector(all != (unsigned char)0, Mask16));
        }
        unsigned there = 0;
        for (int j = 0; j < 16; ++j) {
            const int row = j < EIGHT ? low : high, x = j < EIGHT ? begin + j : next + j - EIGHT;
            const bool inside = x < strip.of_row(row);
            const size_t at = inside ? strip.at(row) + x : 0;
            from[j] = (const double*)(samples + at);
            there |= (unsigned)(inside && valid[at]) << j;
        }
        return there;
    }
    // The place of the positions of a strip's first piece: those that are not kept lie where those of all strips do.
    static inline int place(const Strip& strip, int kept) { return kept ? strip.first : 0; }
    // Positions of the samples of a segment.
    static inline void segment(int number, int kept, const LightFrame& frame, const wp::array_t<wp::vec4d>& samples,
                               const wp::array_t<wp::uint8>& valid, const Tiles& tiles, const Pieces& pieces) {
        const Strip strip(number, tiles, pieces);
        for (int k = 0; k < strip.count; ++k) {
            const int piece = place(strip, kept) + k;
            unsigned there = 0, odd = 0;
            Real16 longest = 0.0f;
            for (int half = 0; half < 2; ++half) {
                const double* from[16];
                const unsigned some = find(strip, half, strip.wide * k, samples.data, valid.data, from);
                there |= some << 16 * half;
                odd |= (unsigned)put(piece, half, from, (int)some, frame, pieces, longest) << 16 * half;
            }
            pieces.there.data[piece] = (int)there;
            pieces.longest.data[piece] = odd & there ? -1.0f : -Fold16::least(-longest);
        }
    }
};
