// cpu
// needs: samples/view.h accelerators/light_grid/shared16.h accelerators/light_grid/pieces16.h
// constants: PLACE_STEP PLACE_FLOOR STEP_FACTOR NEAREST MOST_PART
// arguments: LightFrame frame, Tiles tiles, Pieces pieces
// Rays of a light from the positions that lights share: straight into lanes, and to the boxes of their pieces while
// they are in registers. exactness.md says what they are off by.
struct Aim16 {
    Double16 rx, ry, rz, sx, sy, sz, fx, fy, fz, constant, slope;

    // The axes in steps.
    inline explicit Aim16(const LightFrame& frame)
        : rx(PLACE_STEP * frame.r[0]), ry(PLACE_STEP * frame.r[1]), rz(PLACE_STEP * frame.r[2]),
          sx(PLACE_STEP * frame.s[0]), sy(PLACE_STEP * frame.s[1]), sz(PLACE_STEP * frame.s[2]),
          fx(PLACE_STEP * frame.f[0]), fy(PLACE_STEP * frame.f[1]), fz(PLACE_STEP * frame.f[2]),
          constant(frame.w_constant), slope(frame.w_slope) {}
    // Whether the light lights all that is before it, so that each sample with a measurement has a ray.
    static inline bool serves(const LightFrame& frame, const Pieces& pieces) {
        return !pieces.loose && (frame.light[3] == 0.0 || (frame.cosine < -1.0 && frame.reach == HUGE_VAL));
    }
    static inline Real16 larger(Real16 x, Real16 y) { return x > y ? x : y; }
    // One over the square root, within 2^-22 of that.
    static inline Real16 inverse_root(Real16 x) {
#if defined(__AVX512F__)
        typedef float Sixteen __attribute__((vector_size(64)));
        const Sixteen all = __builtin_bit_cast(Sixteen, x);
        const Real16 near =
            __builtin_bit_cast(Real16, __builtin_ia32_rsqrt14ps512_mask(all, all, (unsigned short)0xFFFF));
        return near * (1.5f - 0.5f * x * near * near);
#else
        return 1.0f / __builtin_elementwise_sqrt(x);
#endif
    }
    static inline Double16 wide(const int* places) {
        return __builtin_convertvector(*(const Shared16::Whole*)places, Double16);
    }
    // Half of a piece. part: how much of the way to the light lies before where its rays begin.
    inline Lanes32 rays(const int* places, const float* steps, Real16& part) const {
        CONTRACTED
        const Double16 x = wide(places), y = wide(places + TILE_RAYS), z = wide(places + 2 * TILE_RAYS);
        const Double16 u = rx * x + ry * y + rz * z, v = sx * x + sy * y + sz * z, h = fx * x + fy * y + fz * z;
        const Double16 w = constant - slope * h;
        // The way to the light is (-slope u, -slope v, w) in (U, V, Z), of a light at infinity as well.
        const Real16 far = Doubles16::narrow(slope * slope * (u * u + v * v) + w * w);
        const Double16 step = Doubles16::widen(Lanes16::load(steps) * inverse_root(far)), passed = slope * step;
        const Double16 rest = 1.0 - passed;
        part = Doubles16::narrow(passed);
        return Lanes32(Doubles16::narrow(u * rest), Doubles16::narrow(v * rest), Doubles16::narrow(w * rest),
                       Doubles16::narrow(h + step * w));
    }
    // The rays of a piece of the light at `place` into its lanes, from the positions at `shared`; false if some are too
    // near to the light to be told from here.
    inline bool take(int piece, int shared, int place, bool inverse, const Tiles& tiles, const Pieces& pieces) const {
        const unsigned there = (unsigned)pieces.there.data[shared];
        const float longest = pieces.longest.data[shared], nearest = NEAREST, most = MOST_PART;
        if (there && !(longest >= 0.0f))
            return false;
        pieces.live.data[piece] = (int)there;
        Lanes32 ray[2];
        Magnitudes16 magnitudes;
        float* lanes = TileMemory::lanes(tiles, piece);
        for (int half = 0; half < 2 && there; ++half) {
            Real16 part;
            ray[half] =
                rays(Shared16::places(pieces, shared) + 16 * half, Shared16::steps(pieces, shared) + 16 * half, part);
            const Lanes32& it = ray[half];
            const Mask16 in = Lanes16::mask(there >> 16 * half & 0xFFFF);
            const Real16 size =
                larger(larger(Lanes16::absolute(it.U), Lanes16::absolute(it.V)), Lanes16::absolute(it.W));
            if (Lanes16::bits(in & ~((size >= nearest) & (part <= most))))
                return false;
            it.store(lanes + half * TileMemory::SIXTEEN_RAYS);
            magnitudes.take(in, it.U, it.V, it.W, it.Z);
        }
        const float more = (float)PLACE_FLOOR + (float)STEP_FACTOR * longest;
        magnitudes.store(tiles, piece, more);
        pieces.more.data[place] = more > pieces.more.data[place] ? more : pieces.more.data[place];
        Pieces16::add(place, inverse, piece, ray, tiles, pieces);
        return true;
    }
};
