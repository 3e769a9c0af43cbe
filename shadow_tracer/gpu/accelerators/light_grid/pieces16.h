// cpu
// needs: accelerators/light_grid/on_face.h@16 accelerators/light_grid/tile_box.h accelerators/light_grid/tiles.h
// needs: device/fold.h accelerators/light_grid/magnitudes16.h
// constants: FACES FORWARD TILE_RAYS NO_GROUP SEVERAL_FACES ALL_RAYS
// arguments: Tiles tiles, Pieces pieces
// What holds the rays of a face.
struct Extents16 {
    Real16 low_u, high_u, low_v, high_v, farthest, deepest;

    static inline Real16 larger(Real16 x, Real16 y) { return x > y ? x : y; }
    static inline Real16 smaller(Real16 x, Real16 y) { return x < y ? x : y; }
    inline void clear() {
        low_u = low_v = deepest = 1.0e30f;
        high_u = high_v = farthest = -1.0e30f;
    }
    inline void take(Mask16 in, const OnFace16& at, Real16 Z, Real16 pad) {
        low_u = in ? smaller(low_u, at.u) : low_u;
        high_u = in ? larger(high_u, at.u) : high_u;
        low_v = in ? smaller(low_v, at.v) : low_v;
        high_v = in ? larger(high_v, at.v) : high_v;
        farthest = in ? larger(farthest, at.size + pad) : farthest;
        deepest = in ? smaller(deepest, Z - pad) : deepest;
    }
    inline void store(const Tiles& tiles, int number) const {
        float u0 = 2.0f, u1 = -2.0f, v0 = 2.0f, v1 = -2.0f, far = -3.0e38f, deep = 3.0e38f;
        for (int j = 0; j < 16; ++j) {
            u0 = low_u[j] < u0 ? low_u[j] : u0;
            u1 = high_u[j] > u1 ? high_u[j] : u1;
            v0 = low_v[j] < v0 ? low_v[j] : v0;
            v1 = high_v[j] > v1 ? high_v[j] : v1;
            far = farthest[j] > far ? farthest[j] : far;
            deep = deepest[j] < deep ? deepest[j] : deep;
        }
        tiles.far.data[number] = wp::vec2(far + 0x1p-40f, deep - 0x1p-40f);
        tiles.fit.data[number] = Fit::of(u0, v0, u1, v1);
    }
};
// Sixteen lanes of a piece.
struct Lanes32 {
    Real16 U, V, W, Z;

    inline Lanes32() {}
    inline Lanes32(Real16 u, Real16 v, Real16 w, Real16 z) : U(u), V(v), W(w), Z(z) {}
    inline explicit Lanes32(const float* lanes)
        : U(Lanes16::load(lanes)), V(Lanes16::load(lanes + 16)), W(Lanes16::load(lanes + 32)),
          Z(Lanes16::load(lanes + 48)) {}
    // Of rays that lie one behind the other.
    inline explicit Lanes32(const wp::vec4* rays) {
        const Real16* four = (const Real16*)rays;
#define EVERY_FOURTH(k)                                                                                                \
    __builtin_shufflevector(                                                                                           \
        __builtin_shufflevector(four[0], four[1], k, k + 4, k + 8, k + 12, k + 16, k + 20, k + 24, k + 28),            \
        __builtin_shufflevector(four[2], four[3], k, k + 4, k + 8, k + 12, k + 16, k + 20, k + 24, k + 28), 0, 1, 2,   \
        3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
        U = EVERY_FOURTH(0);
        V = EVERY_FOURTH(1);
        W = EVERY_FOURTH(2);
        Z = EVERY_FOURTH(3);
#undef EVERY_FOURTH
    }
    // Of half a piece. Those of points in no order lie in the order of their numbers, to be taken apart; what is made
    // of them has lanes.
    static inline Lanes32 of(const Tiles& tiles, const Pieces& pieces, int piece, int half) {
        const wp::vec3i& numbers = tiles.numbers.data[piece];
        if (!pieces.loose || numbers[1] >= pieces.pool_order)
            return Lanes32(TileMemory::lanes(tiles, piece) + half * TileMemory::SIXTEEN_RAYS);
        const int sample = numbers[1] + 16 * half, left = tiles.samples - sample;
        const wp::vec4* rays = pieces.rays.data + numbers[2] + sample;
        if (left >= 16)
            return Lanes32(rays);
        wp::vec4 some[16];
        for (int j = 0; j < 16; ++j)
            some[j] = pieces.rays.data[numbers[2] + (j < left ? sample + j : tiles.samples - 1)];
        return Lanes32(some);
    }
    inline void store(float* lanes) const {
        Lanes16::store(lanes, U);
        Lanes16::store(lanes + 16, V);
        Lanes16::store(lanes + 32, W);
        Lanes16::store(lanes + 48, Z);
    }
    inline const Real16& operator[](int k) const { return k == 0 ? U : k == 1 ? V : W; }
    // What float32 and set-up are at fault by, many times over.
    inline Real16 pad() const {
        return 0x1p-20f * (Lanes16::absolute(U) + Lanes16::absolute(V) + Lanes16::absolute(W) + Lanes16::absolute(Z));
    }
};
// What holds the live rays of a piece, before it is padded.
struct PieceBox16 {
    Real16 low[3], high[3];

    inline PieceBox16() {
        for (int q = 0; q < 3; ++q) {
            low[q] = 3.0e38f;
            high[q] = -3.0e38f;
        }
    }
    inline void take(Mask16 in, const OnFace16& at, Real16 depth) {
        const Real16 place[3] = { at.u, at.v, depth };
        for (int q = 0; q < 3; ++q) {
            low[q] = (in & (place[q] < low[q])) ? place[q] : low[q];
            high[q] = (in & (place[q] > high[q])) ? place[q] : high[q];
        }
    }
    // Low u, v, t, and high ones.
    inline void store(float* box) const {
        for (int q = 0; q < 3; ++q) {
            box[q] = Fold16::least(low[q]);
            box[3 + q] = -Fold16::least(-high[q]);
        }
    }
};
// Boxes and faces of the pieces of a light, and the extents of its rays.
struct Pieces16 {
    static inline float* at_box(const Pieces& pieces, int piece) { return pieces.box.data + 6 * (size_t)piece; }
    static inline Mask16 live(const Pieces& pieces, int piece, int half) {
        return Lanes16::mask((unsigned)pieces.live.data[piece] >> 16 * half & 0xFFFF);
    }
    // In the aligned frustum; false if a ray is not in it.
    static inline bool forward(int place, bool inverse, int piece, const Lanes32 (&ray)[2], const Pieces& pieces,
                               Extents16& front) {
        OnFace16 at;
        PieceBox16 box;
        for (int half = 0; half < 2; ++half) {
            const Lanes32& it = ray[half];
            const Mask16 in = live(pieces, piece, half);
            if (Lanes16::bits(in & ~OnFace16::ahead(it.U, it.V, it.W)))
                return false;
            at.forward(it.U, it.V, it.W);
            front.take(in, at, it.Z, it.pad());
            if (!pieces.loose)
                box.take(in, at, at.depth(it.Z, inverse));
        }
        pieces.group.data[piece] = pieces.loose ? SEVERAL_FACES : FACES * place + FORWARD;
        if (!pieces.loose)
            box.store(at_box(pieces, piece));
        return true;
    }
    // On a face that all of its live rays are on.
    static inline void bound(int number, bool inverse, int piece, const Tiles& tiles, const Pieces& pieces) {
        const int face = number % FACES, axis = face >> 1;
        PieceBox16 box;
        OnFace16 at;
        for (int half = 0; half < 2; ++half) {
            const Lanes32 ray = Lanes32::of(tiles, pieces, piece, half);
            at.set(face, ray[axis], ray[(axis + 1) % 3], ray[(axis + 2) % 3]);
            box.take(live(pieces, piece, half), at, at.depth(ray.Z, inverse));
        }
        box.store(at_box(pieces, piece));
        pieces.group.data[piece] = number;
    }
    // The boxes of those of its rays whose u, or v, is less than some value, and of the others; which the former are.
    static inline unsigned halve(int piece, int second, float value, bool inverse, const Tiles& tiles,
                                 const Pieces& pieces, float* lower, float* upper) {
        const int face = pieces.group.data[piece] % FACES, axis = face >> 1;
        PieceBox16 box[2];
        OnFace16 at;
        unsigned below = 0;
        for (int half = 0; half < 2; ++half) {
            const Lanes32 ray = Lanes32::of(tiles, pieces, piece, half);
            at.set(face, ray[axis], ray[(axis + 1) % 3], ray[(axis + 2) % 3]);
            const Mask16 in = live(pieces, piece, half), less = (second ? at.v : at.u) < value;
            const Real16 depth = at.depth(ray.Z, inverse);
            box[0].take(in & less, at, depth);
            box[1].take(in & ~less, at, depth);
            below |= (unsigned)Lanes16::bits(in & less) << 16 * half;
        }
        box[0].store(lower);
        box[1].store(upper);
        return below;
    }
    // On the six faces of the cube.
    static inline void around(int place, bool inverse, int piece, const Lanes32 (&ray)[2], const Pieces& pieces,
                              Extents16* extents) {
        OnFace16 at[2];
        int faces = 0;
        for (int half = 0; half < 2; ++half) {
            at[half].look(ray[half].U, ray[half].V, ray[half].W);
            for (int face = 0; face < FACES; ++face)
                faces |= (Lanes16::bits(live(pieces, piece, half) & (at[half].face == face)) != 0) << face;
        }
        const bool several = faces & (faces - 1) || pieces.loose;
        PieceBox16 box;
        for (int left = faces; left; left &= left - 1) {
            const int face = __builtin_ctz(left);
            for (int half = 0; half < 2; ++half) {
                const Mask16 here = live(pieces, piece, half) & (at[half].face == face);
                extents[face].take(here, at[half], ray[half].Z, ray[half].pad());
                if (!several)
                    box.take(here, at[half], at[half].depth(ray[half].Z, inverse));
            }
        }
        pieces.group.data[piece] = several ? SEVERAL_FACES : FACES * place + __builtin_ctz(faces);
        if (!several)
            box.store(at_box(pieces, piece));
    }
    // Nothing is known of a light yet.
    static inline void begin(int place, const Tiles& tiles, const Pieces& pieces) {
        tiles.aligned.data[place] = 1;
        pieces.more.data[place] = 0.0f;
        extents(pieces, place)[FORWARD].clear();
        for (int k = 0, piece = place * pieces.of_light; k < pieces.of_light; ++k, ++piece)
            tiles.numbers.data[piece] = wp::vec3i(piece, TILE_RAYS * k, place * tiles.samples);
    }
    enum { EXTENTS = 6 * 16 };
    // Of the faces of a light; those of the aligned frustum are where its face has them.
    static inline Extents16* extents(const Pieces& pieces, int place) {
        return (Extents16*)(pieces.extents.data + EXTENTS * FACES * (size_t)place);
    }
    // From a piece on the rays of a light are looked at on the cube, and those of the pieces before it in the end.
    static inline void turn(int place, int piece, const Tiles& tiles, const Pieces& pieces) {
        tiles.aligned.data[place] = 0;
        pieces.turned.data[place] = piece;
        for (int face = 0; face < FACES; ++face)
            extents(pieces, place)[face].clear();
    }
    // Takes a piece that has these rays.
    static inline void add(int place, bool inverse, int piece, const Lanes32 (&ray)[2], const Tiles& tiles,
                           const Pieces& pieces) {
        pieces.group.data[piece] = NO_GROUP;
        if (!pieces.live.data[piece])
            return;
        Extents16* to = extents(pieces, place);
        if (tiles.aligned.data[place]) {
            if (forward(place, inverse, piece, ray, pieces, to[FORWARD]))
                return;
            turn(place, piece, tiles, pieces);
        }
        around(place, inverse, piece, ray, pieces, to);
    }
    // Takes the pieces from `first` on.
    static inline void more(int place, bool inverse, int first, int end, const Tiles& tiles, const Pieces& pieces) {
        for (int piece = first; piece < end; ++piece) {
            const Lanes32 ray[2] = { Lanes32::of(tiles, pieces, piece, 0), Lanes32::of(tiles, pieces, piece, 1) };
            add(place, inverse, piece, ray, tiles, pieces);
        }
    }
    // Boxes, faces and extents of all pieces of a light.
    static inline void finish(int place, int inverse, const Tiles& tiles, const Pieces& pieces) {
        const int first = place * pieces.of_light, end = first + pieces.of_light;
        for (int piece = first; piece < end; ++piece)
            tiles.counts.data[ALL_RAYS] += __builtin_popcount(pieces.live.data[piece]);
        for (int face = 0; face < FACES; ++face)
            tiles.fit.data[FACES * place + face] = wp::vec4(0.0f, 0.0f, 0.0f, 0.0f);
        const Extents16* found = extents(pieces, place);
        if (tiles.aligned.data[place]) {
            found[FORWARD].store(tiles, FACES * place + FORWARD);
            return;
        }
        more(place, inverse != 0, first, pieces.turned.data[place], tiles, pieces);
        for (int face = 0; face < FACES; ++face)
            found[face].store(tiles, FACES * place + face);
    }
};
