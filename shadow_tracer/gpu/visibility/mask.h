// needs: exact/decision.h
// arguments: Asked asked
// constants: SHADOWED RAYS LEAF_TESTS NODES_VISITED RETESTED EXACT COUNTER_ROWS MASK_PAD
// The query *mask*: which of up to 64 points of a light a sample does not see. All of them in one walk, of the bundle
// of rays to a sphere around the points; queries.py derives the filter's pad.
struct PointMask1 {
    enum { SPREADS = 1 };
    const Asked& asked;
    int ray[1], taken;
    int hider; // the triangle that hid a point last, -1 if none has
    wp::uint64 open;
    wp::int64 rays, tests, nodes, retested, exact;

    inline explicit PointMask1(const Asked& asked)
        : asked(asked), taken(0), hider(-1), open(0), rays(0), tests(0), nodes(0), retested(0), exact(0) {}
    inline void take(int number) {
        if (asked.states.data[number] > SHADOWED)
            return;
        ray[0] = number;
        taken = 1;
    }
    inline bool full() const { return taken == 1; }
    inline void begin() {
        open = ~(wp::uint64)0 >> (64 - asked.count);
        hider = -1;
        rays += asked.count;
    }
    // A determinant from the sample: three components and the sum of the magnitudes of what they are made of.
    struct Plane {
        double x, y, z, size;

        static inline double sum(const wp::vec3d& a) { return fabs(a[0]) + fabs(a[1]) + fabs(a[2]); }
        static inline Plane through(const wp::vec3d& a, const wp::vec3d& b) {
            return { a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0], sum(a) * sum(b) };
        }
        inline double at(const wp::vec3d& a) const { return x * a[0] + y * a[1] + z * a[2]; }
    };
    static inline wp::vec3d between(const wp::vec3d& from, const wp::vec3d& to) {
        return wp::vec3d(to[0] - from[0], to[1] - from[1], to[2] - from[2]);
    }
    // The exact decision about light point number k, and where front faces cast nothing about that.
    inline bool hides(int k, const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c) {
        const wp::vec4d light = asked.points.data[k];
        ++retested;
        double value;
        int used = 0;
        if (asked.cull != 0 && Determinant::sign(light, b, c, a, value, used) >= 0)
            return false;
        const int answer = Decision::of(asked.positions.data[ray[0]], light, a, b, c);
        exact += answer >> 1;
        return answer & 1;
    }
    // Shows a triangle; true if no point is seen any more.
    inline bool visit(int triangle) {
        ++tests;
        const wp::vec3i& corner = asked.triangles.data[triangle];
        const wp::vec3d a = asked.vertices.data[corner[0]], b = asked.vertices.data[corner[1]],
                        c = asked.vertices.data[corner[2]];
        if (!wp::isfinite(a) || !wp::isfinite(b) || !wp::isfinite(c))
            return false;
        const wp::vec4d& at = asked.positions.data[ray[0]];
        const wp::vec3d p(at[0], at[1], at[2]), to_a = between(p, a), ab = between(a, b), ac = between(a, c);
        const Plane edge[3] = { Plane::through(to_a, ab), Plane::through(between(p, b), between(b, c)),
                                Plane::through(between(p, c), between(c, a)) };
        const Plane own = Plane::through(ab, ac);
        // Of the sample; those of light points differ by own.at(d).
        const double here = -own.at(to_a), reach = own.size * Plane::sum(to_a);
        const bool sure_here = fabs(here) > MASK_PAD * reach;
        for (wp::uint64 left = open; left; left &= left - 1) {
            const int k = lowest(left);
            const wp::vec4d& light = asked.points.data[k];
            const wp::vec3d d(light[0] - p[0], light[1] - p[1], light[2] - p[2]);
            const double far = MASK_PAD * Plane::sum(d);
            int inside = 0, outside = 0;
            for (int q = 0; q < 3; ++q) {
                const double x = edge[q].at(d), pad = edge[q].size * far;
                inside += x > pad;
                outside += x < -pad;
            }
            if (inside > 0 && outside > 0)
                continue;
            const double there = here + own.at(d), pad = MASK_PAD * reach + own.size * far;
            const bool sure = sure_here && fabs(there) > pad;
            if (sure && (here > 0.0) == (there > 0.0))
                continue;
            bool certain = sure && (inside == 3 || outside == 3) && asked.cull == 0;
            if (certain && at[3] > 0.0) {
                // The biased start is behind the plane, too, by more than what either computation may be off.
                const double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
                certain = (fabs(here) - MASK_PAD * reach) * length
                          > 1.000000000001 * at[3] * (fabs(here) + fabs(there) + MASK_PAD * reach + pad);
            }
            if (certain || hides(k, a, b, c)) {
                open &= ~((wp::uint64)1 << k);
                hider = triangle;
            }
        }
        return open == 0;
    }
    static inline int lowest(wp::uint64 bits) {
#if defined(__CUDA_ARCH__)
        return __ffsll((long long)bits) - 1;
#else
        return __builtin_ctzll(bits);
#endif
    }
    inline void everything() {
        for (int t = 0; t < asked.triangle_count; ++t)
            if (visit(t))
                return;
    }
    inline int triangle_count() const { return asked.triangle_count; }
    // The sample, the middle of the light, and how far its points are from there [m].
    inline const wp::vec4d& sample() const { return asked.positions.data[ray[0]]; }
    inline const wp::vec4d& light() const { return asked.middle; }
    inline double spread() const { return asked.radius; }
    static inline bool shortened(double& metres) { return false; }
    inline void end() {
        asked.seen.data[ray[0]] = open;
        taken = 0;
    }
    inline void report(int row) const {
        wp::int64* counter = asked.counters.data + (size_t)(row & (COUNTER_ROWS - 1)) * asked.counters.shape[1];
        const wp::int64 counts[5] = { rays, tests, nodes, retested, exact };
        const int columns[5] = { RAYS, LEAF_TESTS, NODES_VISITED, RETESTED, EXACT };
        for (int k = 0; k < 5; ++k)
            if (counts[k])
                wp::atomic_add(counter + columns[k], counts[k]);
    }
};
typedef PointMask1 Query1;
