// needs: device/lanes.h
// lanes
// Triangles over light space, LANES at a time: the faces they may touch, and their bounds there. faces.py derives the
// pads.
struct WIDE(Corners) {
    enum { FACES = 6 };
    typedef int Faces[FACES]; // of each face: lanes, as bits
    REAL at[3][4];            // U V W Z of each corner
    REAL reach;               // 1 + the largest magnitude of them

    static inline REAL larger(REAL x, REAL y) { return x > y ? x : y; }
    static inline REAL smaller(REAL x, REAL y) { return x < y ? x : y; }
    static inline REAL size_of(REAL x) { return larger(x, -x); }
    static inline REAL least(REAL x, REAL y, REAL z) { return smaller(smaller(x, y), z); }
    static inline REAL most(REAL x, REAL y, REAL z) { return larger(larger(x, y), z); }
    inline REAL length(int k) const {
        return size_of(at[k][0]) + size_of(at[k][1]) + size_of(at[k][2]) + size_of(at[k][3]);
    }
    // From [corner][U V W Z][LANES].
    inline void load(const float* from) {
        for (int k = 0; k < 3; ++k)
            for (int c = 0; c < 4; ++c)
                at[k][c] = WIDE(Lanes)::load(from + LANES * (4 * k + c));
        measure();
    }
#if LANES == 1
    // Those of a triangle, from the corners of all vertices.
    inline void gather(const wp::vec4* vertices, const wp::vec3i& triangle) {
        for (int k = 0; k < 3; ++k)
            for (int c = 0; c < 4; ++c)
                at[k][c] = vertices[triangle[k]][c];
        measure();
    }
#endif
    // To be called when `at` is set.
    inline void measure() { reach = 1.0f + most(length(0), length(1), length(2)); }
    // Corners too far out are not judged. NaN compares false, so it counts as far.
    inline MASK near() const { return reach < 1.0e18f; }
    // Of each face, the lanes that may touch it, as bits: of each face axis a triangle must reach a positive value, and
    // one as large as the least absolute value of the other axes. Margins are many times the error of corners.
    inline void touched(Faces& faces) const {
        const int far = ~WIDE(Lanes)::bits(near());
        REAL low[3], high[3], beside[3];
        for (int c = 0; c < 3; ++c) {
            const REAL none = 0.0f;
            low[c] = least(at[0][c], at[1][c], at[2][c]);
            high[c] = most(at[0][c], at[1][c], at[2][c]);
            beside[c] = larger(larger(low[c], -high[c]), none) - 0x1p-20f * reach;
        }
        for (int c = 0; c < 3; ++c) {
            const REAL limit = larger(larger(beside[(c + 1) % 3], beside[(c + 2) % 3]), -0x1p-40f * reach);
            faces[2 * c] = (~WIDE(Lanes)::bits(high[c] < limit) | far) & WIDE(Lanes)::ALL;
            faces[2 * c + 1] = (~WIDE(Lanes)::bits(-low[c] < limit) | far) & WIDE(Lanes)::ALL;
        }
    }
};
struct WIDE(Seen) {
    typedef WIDE(Corners) Corners;
    REAL low_u, high_u, low_v, high_v; // of the directions on the face, along its two axes
    REAL nearest;                      // the largest depth t of the triangle
    int bounded;                       // the lanes for which these mean something, as bits

    // Where nothing is known: what no box of directions and depths lies beyond.
    inline void open() {
        low_u = low_v = -3.0f;
        high_u = high_v = 3.0f;
        nearest = 3.0e38f;
        bounded = 0;
    }
    // The bounds on a face; returns the lanes that have nothing before it, as bits: they cannot touch it.
    inline int look(const Corners& corners, int face, bool inverse) {
        typedef WIDE(Lanes) Lanes;
        const int axis = face >> 1, first = (axis + 1) % 3, second = (axis + 2) % 3;
        const float sign = face & 1 ? -1.0f : 1.0f;
        const auto& at = corners.at;
        const REAL a = sign * at[0][axis], b = sign * at[1][axis], c = sign * at[2][axis];
        const REAL front = Corners::least(a, b, c), back = Corners::most(a, b, c);
        bounded = Lanes::bits((front > 0x1p-18f * corners.reach) & corners.near());
        const int behind = Lanes::bits((back < -0x1p-18f * corners.reach) & corners.near());
        if (!bounded)
            return behind;
        const REAL ia = 1.0f / a, ib = 1.0f / b, ic = 1.0f / c;
        const REAL ua = at[0][first] * ia, ub = at[1][first] * ib, uc = at[2][first] * ic;
        const REAL va = at[0][second] * ia, vb = at[1][second] * ib, vc = at[2][second] * ic;
        low_u = Corners::least(ua, ub, uc);
        high_u = Corners::most(ua, ub, uc);
        low_v = Corners::least(va, vb, vc);
        high_v = Corners::most(va, vb, vc);
        low_u -= 0x1p-20f * (1.0f + Corners::size_of(low_u));
        high_u += 0x1p-20f * (1.0f + Corners::size_of(high_u));
        low_v -= 0x1p-20f * (1.0f + Corners::size_of(low_v));
        high_v += 0x1p-20f * (1.0f + Corners::size_of(high_v));
        // t is 1/|h| or Z/|h|. On a face |h| is the distance in front of it, and that is between the corners'; the
        // other way round where Z is negative: the larger |h|, the larger a negative t.
        REAL near = 1.0f / front;
        if (!inverse) {
            const REAL z = Corners::most(at[0][3], at[1][3], at[2][3]);
            near = z / (z < 0.0f ? back : front);
        }
        nearest = near + 0x1p-18f * (1.0f + Corners::size_of(near));
        return behind;
    }
};
