// cpu
// needs: device/lanes.h@16
// constants: MASK_BAND MASK_PLACE RANGE_BINS RANGE_SURE RANGE_PAD RANGE_LEAST RANGE_SLOPE RANGE_INVERSE
// Sixteen triangles, seen from a sample, in the plane of a flat light: which of its points each may touch at all.
// mask_range.py derives the pads.
struct MaskRange {
    // The dual basis of the way to the light's middle and its two sides; and of each the sum of its magnitudes.
    float ahead[3], across[3], aside[3], ahead_sum, across_sum, aside_sum;
    // Of each triangle, as bits, whether it has a range; and the bins from and up to which it reaches along both sides.
    int known;
    alignas(64) int from[2][16], to[2][16];

    // Whether the sample is where this can be used.
    // to_middle, u, v: the way there and half sides [m]; reach: sum of the magnitudes of way and sides; unit: metres of
    // the scene's extent, at infinity 1.
    inline bool look(const wp::vec3d& to_middle, const wp::vec3d& u, const wp::vec3d& v, float reach, float unit) {
        const wp::vec3d normal = cross(u, v), one = cross(v, to_middle), two = cross(to_middle, u);
        const double volume = dot(to_middle, normal), sides = dot(normal, normal), least = RANGE_LEAST * reach;
        if (!(volume * volume > RANGE_SLOPE * RANGE_SLOPE * sides * dot(to_middle, to_middle))
            || !(least * least < dot(u, u)) || !(least * least < dot(v, v)) || !(RANGE_LEAST * unit < reach))
            return false;
        const double scale = unit / volume;
        ahead_sum = put(ahead, normal, scale), across_sum = put(across, one, scale), aside_sum = put(aside, two, scale);
        return true;
    }
    static inline float put(float* to, const wp::vec3d& from, double scale) {
        float sum = 0.0f;
        for (int k = 0; k < 3; ++k)
            sum += fabsf(to[k] = (float)(scale * from[k]));
        return sum;
    }
    static inline double dot(const wp::vec3d& a, const wp::vec3d& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
    static inline wp::vec3d cross(const wp::vec3d& a, const wp::vec3d& b) {
        return wp::vec3d(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]);
    }
    static inline Real16 smaller(Real16 x, Real16 y) { return __builtin_elementwise_min(x, y); }
    static inline Real16 larger(Real16 x, Real16 y) { return __builtin_elementwise_max(x, y); }
    static inline Real16 inverse(Real16 x) {
#if defined(__AVX512F__)
        typedef float Sixteen __attribute__((vector_size(64)));
        const Sixteen all = __builtin_bit_cast(Sixteen, x);
        return __builtin_bit_cast(Real16, __builtin_ia32_rcp14ps512_mask(all, all, (unsigned short)Lanes16::ALL));
#else
        return 1.0f / x;
#endif
    }
    // Corners a, a + e and a + f of sixteen triangles, from the sample, along a vector.
    struct Along {
        Real16 a, b, c;

        inline Along(const Real16* corner, const float* rows, const float* way) {
            CONTRACTED
            a = corner[0] * way[0] + corner[1] * way[1] + corner[2] * way[2];
            b = a + (row(rows, 3) * way[0] + row(rows, 4) * way[1] + row(rows, 5) * way[2]);
            c = a + (row(rows, 6) * way[0] + row(rows, 7) * way[1] + row(rows, 8) * way[2]);
        }
    };
    static inline Real16 row(const float* rows, int k) { return *(const Real16*)(rows + 16 * k); }
    static inline void bins(int* to, Real16 at) {
        CONTRACTED
        const Real16 none = 0.0f, last = (float)RANGE_BINS;
        const Mask16 bin = Lanes16::integer(smaller(larger(at, none), last));
        *(Mask16*)to = bin;
    }
    // rows: as MaskFilter::judge has them; at, place: the filter's.
    inline void judge(const float* rows, const float* at, float place) {
        CONTRACTED
        const Real16 corner[3] = { row(rows, 0) - at[0], row(rows, 1) - at[1], row(rows, 2) - at[2] };
        const Real16 far =
            larger(larger(Lanes16::absolute(corner[0]), Lanes16::absolute(corner[1])), Lanes16::absolute(corner[2]));
        const Real16 off = (float)MASK_BAND * (far + row(rows, 9)) + (float)MASK_PLACE * place;
        const Along depth(corner, rows, ahead);
        const Real16 nearest = smaller(smaller(depth.a, depth.b), depth.c), wrong = off * ahead_sum;
        known = Lanes16::bits(nearest > (float)RANGE_SURE * wrong);
        if (!known)
            return;
        const Real16 a = inverse(depth.a), b = inverse(depth.b), c = inverse(depth.c), most = larger(larger(a, b), c);
        for (int side = 0; side < 2; ++side) {
            const Along beside(corner, rows, side ? aside : across);
            const Real16 one = beside.a * a, two = beside.b * b, three = beside.c * c;
            const Real16 low = smaller(smaller(one, two), three), high = larger(larger(one, two), three);
            const Real16 widest = larger(Lanes16::absolute(low), Lanes16::absolute(high));
            const Real16 pad = 1.1f * most * (off * (side ? aside_sum : across_sum) + widest * wrong)
                               + ((float)RANGE_INVERSE * widest + (float)RANGE_PAD);
            bins(from[side], (low - pad + 1.0f) * (0.5f * RANGE_BINS));
            bins(to[side], (high + pad + 1.0f) * (0.5f * RANGE_BINS) + 1.0f);
        }
    }
    // Points that a triangle may touch, as bits.
    // beyond: of each bin along both sides, and of what is behind the last, the points from there on.
    inline wp::uint64 points(int lane, const wp::uint64* beyond) const {
        if (!(known >> lane & 1))
            return ~(wp::uint64)0;
        const wp::uint64* second = beyond + RANGE_BINS + 1;
        return beyond[from[0][lane]] & ~beyond[to[0][lane]] & second[from[1][lane]] & ~second[to[1][lane]];
    }
};
