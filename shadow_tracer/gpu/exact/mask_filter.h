// cpu
// needs: device/lanes.h@16
// constants: MASK_BAND MASK_PLACE MASK_TINY MASK_FLOOR MASK_SLACK MASK_SMALLEST MASK_LARGEST MASK_MOST
// Sixteen triangles against up to 64 points of a light, as a sample sees them, in float32: which points a triangle
// surely hides, and which it may hide; mask_filter.py derives the bands.
struct MaskFilter {
    // Up to so many points are judged one by one, more by sixteen in a row.
    enum { MOST = MASK_MOST, FORMS = 4, FEW = 4 };
    // A sample and the light; see mask_filter.py.
    float at[3], middle[3], extent[3];
    float place, reach, unit, nearest, farthest, w; // Q, L, m, least and most bias, 1 or 0 at infinity
    // What is found of sixteen triangles, as bits: those that may hide points; of these the ones that hide all, and the
    // ones whose forms say which. Of the others the forms say nothing.
    int may, all, told;
    // Of each triangle three edges and its plane as linear forms of the offset of a point from the middle, divided by
    // their bands: a constant and three factors.
    typedef float Lane[16];
    alignas(64) Lane forms[FORMS][4];

    // Whether the sample, (x, y, z) from the scene's centre in units of its extent, is where this can be used.
    // to_middle, half: of the box around the points; shortest, longest: the lengths of the ways to them;
    // all in metres, at infinity of ways whose middle has length 1. bias, scale: metres, and per metre.
    inline bool look(const double* sample, const wp::vec3d& to_middle, const wp::vec3d& half, double shortest,
                     double longest, double bias, double scale, bool endless) {
        double most = 1.0, sum = 0.0;
        for (int k = 0; k < 3; ++k) {
            most = fabs(sample[k]) > most ? fabs(sample[k]) : most;
            sum += fabs(to_middle[k]) + fabs(half[k]);
            at[k] = (float)sample[k], middle[k] = (float)to_middle[k], extent[k] = (float)(MASK_SLACK * half[k]);
        }
        const double metres = endless ? 1.0 : 1.0 / scale, ahead = endless ? bias * scale : bias;
        place = (float)(1.0 + most), reach = (float)(MASK_SLACK * sum), unit = (float)metres, w = endless ? 0.0f : 1.0f;
        farthest = bias == 0.0 ? 0.0f : (float)(shortest > 1e-6 * longest ? MASK_SLACK * ahead / shortest : HUGE_VAL);
        nearest = (float)(ahead / (MASK_SLACK * longest));
        return sum > MASK_SMALLEST && sum < MASK_LARGEST && metres > MASK_SMALLEST && metres < MASK_LARGEST;
    }
    static inline Real16 smaller(Real16 x, Real16 y) { return x < y ? x : y; }
    static inline Real16 larger(Real16 x, Real16 y) { return x > y ? x : y; }
    // A linear form: what it is in the middle, and how far from that it may be at any point.
    struct Form {
        Real16 x, y, z, value;

        inline Form(const MaskFilter& filter, Real16 x, Real16 y, Real16 z) : x(x), y(y), z(z) {
            CONTRACTED
            const float* m = filter.middle;
            value = x * m[0] + y * m[1] + z * m[2];
        }
        inline Real16 beside(const MaskFilter& filter) const {
            CONTRACTED
            const float* e = filter.extent;
            return Lanes16::absolute(x) * e[0] + Lanes16::absolute(y) * e[1] + Lanes16::absolute(z) * e[2];
        }
        inline void put(Lane* to, Real16 sign, Real16 constant) const {
            Lanes16::store(to[0], constant * sign);
            Lanes16::store(to[1], x * sign);
            Lanes16::store(to[2], y * sign);
            Lanes16::store(to[3], z * sign);
        }
    };
    static inline Real16 row(const float* rows, int k) { return *(const Real16*)(rows + 16 * k); }
    // rows: a corner, the edges from there to the other two, and the longest edge; negative where there is no triangle.
    // few: all points will be judged; which triangles touch none, or hide all, need not be found out.
    inline void judge(const float* rows, bool few) {
        CONTRACTED
        const Real16 cx = row(rows, 0) - at[0], cy = row(rows, 1) - at[1], cz = row(rows, 2) - at[2];
        const Real16 ax = row(rows, 3), ay = row(rows, 4), az = row(rows, 5);
        const Real16 bx = row(rows, 6), by = row(rows, 7), bz = row(rows, 8), size = row(rows, 9);
        const Real16 nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
        const Form plane(*this, nx, ny, nz);
        const Real16 square = (float)MASK_BAND * size * size + (float)MASK_FLOOR;
        const Real16 from = larger(larger(Lanes16::absolute(cx), Lanes16::absolute(cy)), Lanes16::absolute(cz))
                            + (float)MASK_TINY * place;
        const Real16 normal = Lanes16::absolute(nx) + Lanes16::absolute(ny) + Lanes16::absolute(nz);
        // Bands of the own plane's form at a point, and at the sample.
        const Real16 there = square * reach;
        const Real16 here = (square * from + (float)MASK_PLACE * place * normal + (float)MASK_FLOOR) * unit;
        const Real16 off = (nx * cx + ny * cy + nz * cz) * unit, distance = Lanes16::absolute(off);
        const Real16 none = 0.0f, one = 1.0f, sign = off < none ? -one : one;
        // The own plane's form, how far from that it may be, and how far from zero.
        const Real16 slope = plane.value * sign, wide = plane.beside(*this) + there, away = Lanes16::absolute(slope);
        const Real16 beyond = slope - w * distance, both = wide + here;
        const int clear = Lanes16::bits(distance - here > farthest * (away + wide));
        const int never = Lanes16::bits(nearest * (away - wide) > distance + here);
        const int front = clear & Lanes16::bits(beyond + both < none);
        may = Lanes16::bits(size > none) & ~never & ~front;
        all = told = 0;
        if (!may)
            return;
        const Real16 px = cy * az - cz * ay, py = cz * ax - cx * az, pz = cx * ay - cy * ax;
        const Real16 qx = cy * bz - cz * by, qy = cz * bx - cx * bz, qz = cx * by - cy * bx;
        const Form first(*this, px, py, pz), second(*this, (qx - px) + nx, (qy - py) + ny, (qz - pz) + nz),
            third(*this, -qx, -qy, -qz);
        const Real16 band = ((float)MASK_BAND * (from + size) + (float)MASK_PLACE * place) * (reach * size);
        if (!few || (may & ~clear)) {
            const Real16 u = first.value * sign, v = second.value * sign, t = third.value * sign;
            const Real16 du = first.beside(*this), dv = second.beside(*this), dt = third.beside(*this);
            const Real16 up = smaller(smaller(u + du, v + dv), t + dt);
            const Real16 down = larger(larger(u - du, v - dv), t - dt), low = smaller(smaller(u - du, v - dv), t - dt);
            const int positive = Lanes16::bits(up > -band), negative = Lanes16::bits(down < band);
            may &= positive | (negative & ~clear);
            told = may & clear;
            if (!told)
                return;
            all = told & Lanes16::bits((low > band) & (beyond - both > none));
        } else
            told = may & clear;
        const Real16 per_band = sign * Lanes16::inverse(band), per_both = sign * Lanes16::inverse(there + here);
        first.put(forms[0], per_band, first.value);
        second.put(forms[1], per_band, second.value);
        third.put(forms[2], per_band, third.value);
        plane.put(forms[3], per_both, plane.value - w * off);
    }
    // Of all triangles at once, as bits, those that surely hide a point, and those that may: of what is told.
    inline void of_point(const float* at, int& sure, int& maybe) const {
        CONTRACTED
        Real16 least = 2.0f;
        for (int form = 0; form < FORMS; ++form)
            least =
                smaller(Lanes16::load(forms[form][0]) + Lanes16::load(forms[form][1]) * at[0]
                            + Lanes16::load(forms[form][2]) * at[MOST] + Lanes16::load(forms[form][3]) * at[2 * MOST],
                        least);
        sure = told & Lanes16::bits(least > 1.0f), maybe = told & Lanes16::bits(least > -1.0f);
    }
    // The least form of a triangle at a point.
    inline float one(int triangle, const float* at) const {
        CONTRACTED
        float least = 2.0f;
        for (int form = 0; form < FORMS; ++form) {
            const float value = forms[form][0][triangle] + forms[form][1][triangle] * at[0]
                                + forms[form][2][triangle] * at[MOST] + forms[form][3][triangle] * at[2 * MOST];
            least = value < least ? value : least;
        }
        return least;
    }
    // Of one: which points are surely hidden and which may be, as bits, of sixteen in a row all or none.
    // offsets: MOST along each axis; wanted: those that are asked about, as bits.
    inline void points(int triangle, const float* offsets, wp::uint64 wanted, wp::uint64& sure,
                       wp::uint64& maybe) const {
        CONTRACTED
        sure = maybe = 0;
        if (__builtin_popcountll(wanted) <= FEW) {
            for (wp::uint64 left = wanted; left; left &= left - 1) {
                const float least = one(triangle, offsets + __builtin_ctzll(left));
                sure |= least > 1.0f ? left & -left : 0;
                maybe |= least > -1.0f ? left & -left : 0;
            }
            return;
        }
        for (int k = 0; k < MOST; k += 16) {
            if (!(wanted >> k & Lanes16::ALL))
                continue;
            const float* at = offsets + k;
            const Real16 x = Lanes16::load(at), y = Lanes16::load(at + MOST), z = Lanes16::load(at + 2 * MOST);
            Real16 least = 2.0f;
            for (int form = 0; form < FORMS; ++form)
                least = smaller(forms[form][0][triangle] + forms[form][1][triangle] * x + forms[form][2][triangle] * y
                                    + forms[form][3][triangle] * z,
                                least);
            sure |= (wp::uint64)Lanes16::bits(least > 1.0f) << k;
            maybe |= (wp::uint64)Lanes16::bits(least > -1.0f) << k;
        }
    }
};
