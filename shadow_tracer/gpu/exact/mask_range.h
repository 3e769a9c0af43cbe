// cpu
// needs: device/lanes.h@16
// constants: MASK_BAND MASK_PLACE RANGE_BINS RANGE_SURE RANGE_PAD RANGE_LEAST RANGE_SLOPE RANGE_INVERSE RANGE_ROUND
// Sixteen triangles, seen from a sample, in the plane of a flat light: which of its points each may touch at all.
// mask_range.py derives the pads.
struct MaskRange {
    // The dual basis of the way to the light's middle and its two sides; and of each the sum of its magnitudes.
    float ahead[3], across[3], aside[3], ahead_sum, across_sum, aside_sum;
    // Of each triangle, as bits, whether it has a range; and the bins from and up to which it reaches along both sides.
    int known;
    int missed; // of those that have ranges, the ones that reach no point
    alignas(64) int from[2][16], to[2][16];

    // Of both sides: by how much a range is larger, bins for each half side, and what is behind the last one.
    float slack[2], scale[2], behind[2];

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
        ahead_sum = hold(ahead, normal, scale), across_sum = hold(across, one, scale);
        aside_sum = hold(aside, two, scale);
        for (int side = 0; side < 2; ++side)
            slack[side] = (float)RANGE_PAD, this->scale[side] = 0.5f * RANGE_BINS, behind[side] = 1.0f;
        return true;
    }
    // The same for a tube around half an axis u, which the sample sees as a ribbon.
    inline bool look_at_tube(const wp::vec3d& to_middle, const wp::vec3d& u, double radius, float reach, float unit) {
        const wp::vec3d across = cross(to_middle, u);
        const double length = dot(u, u), area = sqrt(dot(across, across)), part = radius * sqrt(length) / area;
        if (!(part < RANGE_ROUND))
            return false;
        const double wider = radius / (1.0 - part), least = 2.0 * RANGE_LEAST * reach;
        const double half = (wider > least ? wider : least) / area;
        if (!look(to_middle, u, wp::vec3d(half * across[0], half * across[1], half * across[2]), reach, unit))
            return false;
        slack[0] += (float)((1.0 + fabs(dot(to_middle, u)) / length) * part / (1.0 - part));
        scale[1] = 0.0f, behind[1] = RANGE_BINS;
        return true;
    }
    static inline float hold(float* to, const wp::vec3d& from, double scale) {
        float sum = 0.0f;
        for (int k = 0; k < 3; ++k)
            sum += fabsf(to[k] = (float)(scale * from[k]));
        return sum;
    }
    static inline double dot(const wp::vec3d& a, const wp::vec3d& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
    static inline wp::vec3d cross(const wp::vec3d& a, const wp::vec3d& b) {
        return wp::vec3d(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]);
    }
    static inline Real16 smaller(Real16 x, Real16 y) { return x < y ? x : y; }
    static inline Real16 larger(Real16 x, Real16 y) { return x > y ? x : y; }
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
    // Which bins sixteen places from low to high reach along a side; beside: those that reach none, as bits.
    // most: one over the least depth; off, wrong: what the distance from a corner may be off by, and a depth.
    inline int put(int number, Real16 low, Real16 high, Real16 most, Real16 off, Real16 wrong) {
        CONTRACTED
        const Real16 widest = larger(Lanes16::absolute(low), Lanes16::absolute(high)), one = 1.0f;
        const Real16 pad = 1.1f * most * (off + widest * wrong) + ((float)RANGE_INVERSE * widest + slack[number]);
        const Real16 begin = low - pad, end = high + pad;
        bins(from[number], (begin + 1.0f) * scale[number]);
        bins(to[number], (end + 1.0f) * scale[number] + behind[number]);
        return Lanes16::bits(begin > one) | Lanes16::bits(end < -one);
    }
    inline int side(int number, const Along& at, Real16 a, Real16 b, Real16 c, Real16 off, Real16 wrong) {
        const Real16 one = at.a * a, two = at.b * b, three = at.c * c;
        return put(number, smaller(smaller(one, two), three), larger(larger(one, two), three), larger(larger(a, b), c),
                   off, wrong);
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
        missed = 0;
        if (!known)
            return;
        const Real16 a = Lanes16::inverse(depth.a), b = Lanes16::inverse(depth.b), c = Lanes16::inverse(depth.c);
        missed = known
                 & (side(0, Along(corner, rows, across), a, b, c, off * across_sum, wrong)
                    | side(1, Along(corner, rows, aside), a, b, c, off * aside_sum, wrong));
    }
    // The least and the most of boxes along a vector: of each side of them one end.
    struct Reach {
        Real16 low, high;

        inline Reach(const Real16* least, const Real16* most, const float* way) {
            CONTRACTED
            low = high = 0.0f;
            for (int k = 0; k < 3; ++k) {
                const bool up = way[k] > 0.0f;
                low += (up ? least[k] : most[k]) * way[k];
                high += (up ? most[k] : least[k]) * way[k];
            }
        }
    };
    inline int side(int number, const Reach& at, Real16 most, Real16 least, Real16 off, Real16 wrong) {
        const Real16 none = 0.0f;
        return put(number, at.low * (at.low < none ? most : least), at.high * (at.high > none ? most : least), most,
                   off, wrong);
    }
    // Sixteen boxes: low x, y, z, high x, y, z.
    inline void boxes(const Real16* bounds, const float* at, float place) {
        CONTRACTED
        Real16 low[3], high[3], far = 0.0f;
        for (int k = 0; k < 3; ++k) {
            low[k] = bounds[k] - at[k], high[k] = bounds[3 + k] - at[k];
            far = larger(far, larger(Lanes16::absolute(low[k]), Lanes16::absolute(high[k])));
        }
        const Real16 off = (float)MASK_BAND * far + (float)MASK_PLACE * place, wrong = off * ahead_sum;
        const Reach depth(low, high, ahead);
        known = Lanes16::bits(depth.low > (float)RANGE_SURE * wrong);
        missed = 0;
        if (!known)
            return;
        const Real16 most = Lanes16::inverse(depth.low), least = Lanes16::inverse(depth.high);
        missed = known
                 & (side(0, Reach(low, high, across), most, least, off * across_sum, wrong)
                    | side(1, Reach(low, high, aside), most, least, off * aside_sum, wrong));
    }
    // Points that a triangle or a box may touch, as bits.
    // beyond: of each bin along both sides, and of what is behind the last, the points from there on.
    inline wp::uint64 points(int lane, const wp::uint64* beyond) const {
        if (!(known >> lane & 1))
            return ~(wp::uint64)0;
        const wp::uint64* second = beyond + RANGE_BINS + 1;
        return beyond[from[0][lane]] & ~beyond[to[0][lane]] & second[from[1][lane]] & ~second[to[1][lane]];
    }
};
