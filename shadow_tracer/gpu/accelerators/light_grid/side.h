// needs: exact/faces.h exact/planes.h exact/box.h
// constants: FACES FIT_CELLS FORWARD
// lanes
// LANES triangles seen from a light, face by face.
struct WIDE(Front) {
    typedef WIDE(Lanes) Lanes;
    typedef WIDE(Corners) Corners;
    typedef WIDE(Seen) Seen;
    Corners corners;
    Corners::Faces faces;

    // To be called when `corners` is set. all: the lanes that hold a triangle, as bits.
    inline void open(int all, bool aligned) {
        // The rays of the aligned frustum are all on one face, though they reach beyond it.
        if (aligned)
            for (int face = 0; face < FACES; ++face)
                faces[face] = face == FORWARD ? all : 0;
        else
            corners.touched(faces);
        for (int face = 0; face < FACES; ++face)
            faces[face] &= all;
    }
    // The lanes that may touch the rays of a face, as bits, and their bounds.
    inline int bound(int face, const wp::vec4& fit, bool inverse, Seen& seen) const {
        if (!faces[face])
            return 0;
        const int touched = faces[face] & ~seen.look(corners, face, inverse);
        if (!(seen.bounded & touched))
            return touched;
        const float last = FIT_CELLS + 4;
        const int beside =
            Lanes::bits((seen.high_u < fit[0]) | (seen.high_v < fit[1]) | ((seen.low_u - fit[0]) * fit[2] > last)
                        | ((seen.low_v - fit[1]) * fit[3] > last));
        return touched & ~(beside & seen.bounded);
    }
};
// The planes of one of them on a face.
struct WIDE(Numbers) {
    typedef WIDE(Planes) Planes;
    float a[4], b[4], c[4]; // of the edges and of P: factors of u and v, and what is left
    float slope;            // of P along t
    float edge, plane;      // factors of the pads

    static inline float lane(const REAL& x, int number) { return ((const float*)&x)[number]; }
    inline void take(const Planes* planes, int face, int number) {
        const int axis = face >> 1, first = (axis + 1) % 3, second = (axis + 2) % 3;
        const float sign = face & 1 ? -1.0f : 1.0f;
        for (int k = 0; k < 3; ++k) {
            a[k] = lane(planes->n[k][first], number);
            b[k] = lane(planes->n[k][second], number);
            c[k] = sign * lane(planes->n[k][axis], number);
        }
        a[3] = lane(planes->p[first], number);
        b[3] = lane(planes->p[second], number);
        c[3] = sign * lane(planes->p[axis], number);
        slope = lane(planes->p[3], number);
        edge = lane(planes->edge, number);
        plane = lane(planes->plane, number);
    }
};
// One thread reads the numbers of a triangle once. For several lanes they are read by whoever needs them, in a function
// that is not inlined: else they are spread over lanes ahead of loops that mostly end without them.
#if LANES == 1
#define CALLED inline
#else
#define CALLED __attribute__((noinline))
#endif
// One of the triangles on a face, against LANES boxes of directions and depths.
struct WIDE(Side) {
    typedef WIDE(Lanes) Lanes;
    typedef WIDE(Planes) Planes;
    typedef WIDE(Seen) Seen;
    typedef WIDE(Numbers) Numbers;
#if LANES == 1
    Numbers numbers;
#else
    const Planes* planes;
    int face, number;
#endif
    float low_u, high_u, low_v, high_v, nearest;
    bool blind, bounded;

    // planes: to stay where they are.
    inline void take(const Planes& planes, const Seen& seen, int face, int number) {
#if LANES == 1
        numbers.take(&planes, face, number);
#else
        this->planes = &planes;
        this->face = face;
        this->number = number;
#endif
        blind = planes.blind >> number & 1;
        bounded = seen.bounded >> number & 1;
        // Beyond all boxes, where nothing is known.
        low_u = bounded ? Numbers::lane(seen.low_u, number) : -3.0f;
        high_u = bounded ? Numbers::lane(seen.high_u, number) : 3.0f;
        low_v = bounded ? Numbers::lane(seen.low_v, number) : -3.0f;
        high_v = bounded ? Numbers::lane(seen.high_v, number) : 3.0f;
        nearest = bounded ? Numbers::lane(seen.nearest, number) : 3.0e38f;
    }
    // The boxes that its bounds touch, as bits. box: the first quantity of the first of them, the next is 16 behind.
    inline int touches(const float* box) const {
        const REAL cu = Lanes::load(box), cv = Lanes::load(box + 16), eu = Lanes::load(box + 32);
        const REAL ev = Lanes::load(box + 48), t0 = Lanes::load(box + 64);
        return Lanes::bits((cu - eu <= high_u) & (cu + eu >= low_u) & (cv - ev <= high_v) & (cv + ev >= low_v)
                           & (t0 <= nearest));
    }
    // The boxes it cannot be said to miss, as bits; covered: those it covers.
    CALLED int meets(const float* box, int& covered) const {
        covered = 0;
        const int within = touches(box);
        // One thread gains by an early end; of sixteen boxes some are nearly always touched.
        if (blind || (LANES == 1 && !within))
            return within;
#if LANES > 1
        Numbers numbers;
        numbers.take(planes, face, number);
#endif
        const REAL cu = Lanes::load(box), cv = Lanes::load(box + 16), eu = Lanes::load(box + 32);
        const REAL ev = Lanes::load(box + 48), t0 = Lanes::load(box + 64), t1 = Lanes::load(box + 80);
        REAL middle[4], reach[4];
        for (int k = 0; k < 4; ++k) {
            middle[k] = numbers.a[k] * cu + numbers.b[k] * cv + numbers.c[k];
            reach[k] = fabsf(numbers.a[k]) * eu + fabsf(numbers.b[k]) * ev;
        }
        const REAL s0 = Lanes::absolute(t0), s1 = Lanes::absolute(t1), m = 6.0f + 2.001f * (s0 > s1 ? s0 : s1);
        return WIDE(Box)::judge(within, middle, reach, numbers.slope * t0, numbers.slope * t1, numbers.edge * m,
                                numbers.plane * m, covered);
    }
};
#undef CALLED
