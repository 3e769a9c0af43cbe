// cpu
// needs: accelerators/light_grid/fit.h accelerators/light_grid/keys.h@16
// constants: IN_TREE SHADOWED FACES FORWARD
// arguments: Tiles tiles
// The rays of a light in the order of the image, sixteen at a time.
struct Rays16 {
    typedef unsigned char Bytes __attribute__((ext_vector_type(16), aligned(1)));
    const wp::vec4* rays;
    const wp::uint8* group;
    int count;
    Real16 U, V, W, Z;
    Mask16 in; // which of them are in tiles

    inline Rays16(int place, const wp::array_t<wp::vec4>& rays, const wp::array_t<wp::uint8>& group, const Tiles& tiles)
        : rays(rays.data + (size_t)place * tiles.samples), group(group.data + (size_t)place * tiles.samples),
          count(tiles.samples) {}
    inline int left(int base) const { return count - base < 16 ? count - base : 16; }
    static inline Mask16 equal(const wp::uint8* from, int n, unsigned char value) {
        unsigned char some[16];
        if (n < 16)
            for (int j = 0; j < 16; ++j)
                some[j] = j < n ? from[j] : 255;
        return __builtin_convertvector(*(const Bytes*)(n < 16 ? some : from) == value, Mask16);
    }
    // Those from `base` on; false if none of them is in tiles. Lanes behind the last sample repeat it.
    inline bool look(int base) {
        const int n = left(base);
        in = equal(group + base, n, IN_TREE);
        if (Lanes16::bits(in) == 0)
            return false;
        wp::vec4 some[16];
        if (n < 16)
            for (int j = 0; j < 16; ++j)
                some[j] = rays[base + (j < n ? j : n - 1)];
        const Real16* four = (const Real16*)(n < 16 ? some : rays + base);
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
        return true;
    }
};
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
struct Packing16 {
    // Frustum and extents of the rays of the light at `place`.
    static inline void measure(int place, const wp::array_t<wp::vec4>& rays, const wp::array_t<wp::uint8>& group,
                               const Tiles& tiles) {
        Rays16 it(place, rays, group, tiles);
        OnFace16 at;
        Extents16 front;
        front.clear();
        bool aligned = true, some = false;
        for (int base = 0; base < it.count && aligned; base += 16) {
            if (!it.look(base))
                continue;
            some = true;
            aligned = Lanes16::bits(it.in & ~OnFace16::ahead(it.U, it.V, it.W)) == 0;
            at.forward(it.U, it.V, it.W);
            front.take(it.in, at, it.Z, pad_of(it));
        }
        tiles.aligned.data[place] = aligned;
        if (aligned) {
            for (int face = 0; face < FACES; ++face)
                tiles.fit.data[FACES * place + face] = wp::vec4(0.0f, 0.0f, 0.0f, 0.0f);
            if (some)
                front.store(tiles, FACES * place + FORWARD);
            return;
        }
        Extents16 extents[FACES];
        for (int face = 0; face < FACES; ++face)
            extents[face].clear();
        for (int base = 0; base < it.count; base += 16) {
            if (!it.look(base))
                continue;
            at.look(it.U, it.V, it.W);
            const Real16 pad = pad_of(it);
            for (int face = 0; face < FACES; ++face) {
                const Mask16 here = it.in & (at.face == face);
                if (Lanes16::bits(here))
                    extents[face].take(here, at, it.Z, pad);
            }
        }
        for (int face = 0; face < FACES; ++face)
            extents[face].store(tiles, FACES * place + face);
    }
    static inline Real16 pad_of(const Rays16& it) {
        return 0x1p-20f
               * (Lanes16::absolute(it.U) + Lanes16::absolute(it.V) + Lanes16::absolute(it.W)
                  + Lanes16::absolute(it.Z));
    }
    // Keys and numbers of the light's rays that are in tiles and not known to be in shadow, stored from `first` on;
    // returns the end. Cells of u, behind the group, are counted for the columns' sake.
    static inline int keys(int place, int first, const wp::array_t<wp::vec4>& rays,
                           const wp::array_t<wp::uint8>& states, const wp::array_t<wp::uint8>& group,
                           const Tiles& tiles, const wp::array_t<int>& cells, const wp::array_t<int>& keys,
                           const wp::array_t<int>& order) {
        Rays16 it(place, rays, group, tiles);
        int found = first;
        const bool aligned = tiles.aligned.data[place] != 0;
        const wp::vec4* fit = tiles.fit.data + FACES * place;
        const wp::uint8* state = states.data + (size_t)place * tiles.samples;
        int* count_of = cells.data;
        OnFace16 at;
        Real16 grid[4];
        for (int q = 0; q < 4; ++q)
            grid[q] = fit[FORWARD][q];
        for (int base = 0; base < it.count; base += 16) {
            if (!it.look(base))
                continue;
            if (aligned) {
                at.forward(it.U, it.V, it.W);
            } else {
                at.look(it.U, it.V, it.W);
                for (int face = 0; face < FACES; ++face)
                    for (int q = 0; q < 4; ++q)
                        grid[q] = at.face == face ? Real16(fit[face][q]) : grid[q];
            }
            const Mask16 key = Keys16::make(place, at, grid[0], grid[1], grid[2], grid[3]);
            const int from = place * tiles.samples + base;
            int code[16];
            memcpy(code, &key, sizeof(code));
            int take = Lanes16::bits(it.in & ~Rays16::equal(state + base, it.left(base), SHADOWED));
            for (; take; take &= take - 1) {
                const int j = __builtin_ctz(take);
                keys.data[found] = code[j];
                order.data[found++] = from + j;
                ++count_of[code[j] >> V_BITS];
            }
        }
        return found;
    }
};
