// needs: exact/decision.h visibility/sides.h device/lanes.h
// arguments: Asked asked
// constants: LIT SHADOWED LEAF_TESTS NODES_VISITED RETESTED EXACT COUNTER_ROWS MASK_PAD
// lanes
// The query *in place*: whether something hides LANES rays, each decided from the coordinates of the scene, without
// records and without a queue. A walk may also say that a ray is hidden, or that nothing more hides it, where it has
// proven it.
struct WIDE(InPlace) {
    enum { SPREADS = 0 };
    const Asked& asked;
    int ray[LANES], taken;
    int asking; // those that are not known to be hidden, as bits
    int lane;   // that which triangles are shown to
    int hider;  // the triangle that hid a ray last, -1 if none has
    wp::int64 tests, nodes, retested, exact;

    inline explicit WIDE(InPlace)(const Asked& asked)
        : asked(asked), taken(0), asking(0), lane(0), hider(-1), tests(0), nodes(0), retested(0), exact(0) {}
    static inline bool has_ray(const Asked& asked, int number) {
        return !asked.rays.shape[0] || asked.rays.data[number][0] == asked.rays.data[number][0];
    }
    inline void take(int number) {
        if (asked.passed.shape[0] && asked.passed.data[number] == 2)
            return;
        if (asked.states.data[number] != LIT || !has_ray(asked, number))
            return;
#if LANES == 1
        // No index at run time: compilers for CUDA would put the query into local memory, with all that it refers to.
        ray[0] = number;
        taken = 1;
#else
        ray[taken++] = number;
#endif
    }
    // That which triangles are shown to.
    inline int number() const {
#if LANES == 1
        return ray[0];
#else
        return ray[lane];
#endif
    }
    // Those that the part of the structure that was looked at before does not hide, as bits.
    inline int passing() const {
        int found = 0;
        if (asked.passed.shape[0])
            for (int j = 0; j < taken; ++j)
                found |= (asked.passed.data[ray[j]] != 0) << j;
        return found;
    }
    inline bool full() const { return taken == LANES; }
    inline int count() const { return asked.states.shape[0]; } // of rays
    inline void begin() {
        hider = -1;
        lane = 0;
        asking = WIDE(Lanes)::ALL >> (LANES - taken);
    }
    inline void hide() {
        asked.states.data[number()] = SHADOWED;
        asking &= ~(1 << lane);
    }
    // Positions of the samples, and their biases; lanes without a ray repeat the first one.
    inline void samples(WIDE(Double) (&at)[4]) const {
#if LANES == 1
        for (int k = 0; k < 4; ++k)
            at[k] = sample()[k];
#else
        for (int j = 0; j < LANES; ++j)
            for (int k = 0; k < 4; ++k)
                at[k][j] = asked.positions.data[ray[j < taken ? j : 0]][k];
#endif
    }
    static inline bool same(const wp::vec3d& p, const wp::vec3d& q) {
        return p[0] == q[0] && p[1] == q[1] && p[2] == q[2];
    }
    inline wp::vec3d way() const {
        const wp::vec3d light(asked.light[0], asked.light[1], asked.light[2]);
        const wp::vec4d& at = sample();
        return asked.light[3] != 0.0 ? Sides::between(wp::vec3d(at[0], at[1], at[2]), light) : light;
    }
    // The determinant of the ray's way and an edge from the sample, and by how much it may be off: its sign is the side
    // that the ray passes the edge on.
    struct Side {
        double value, off;

        static inline Side of(const wp::vec3d& p, const wp::vec3d& way, const wp::vec3d& a, const wp::vec3d& b) {
            const Sides::Plane plane = Sides::Plane::through(Sides::between(p, a), Sides::between(a, b));
            return { plane.at(way), MASK_PAD * Sides::Plane::sum(way) * plane.size };
        }
        // The same edge, from its end to its begin.
        inline Side back() const { return { -value, off }; }
        // Whether it is certain that the ray passes beside a triangle of these edges.
        static inline bool beside(const Side& x, const Side& y, const Side& z) {
            return (x.value > x.off || y.value > y.off || z.value > z.off)
                   && (x.value < -x.off || y.value < -y.off || z.value < -z.off);
        }
    };
    // Whether the sample is a corner: such a triangle never hides it. Samples of a depth image are corners of its
    // surface.
    static inline bool touches(const wp::vec3d& p, const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c) {
        return same(p, a) || same(p, b) || same(p, c);
    }
    // Whether it is certain that a triangle does not hide the ray, if that does not pass beside it. It is for most of
    // those around a sample, which would go to exact arithmetic, as the sample lies in their planes.
    inline bool misses(const wp::vec3d& p, const wp::vec3d& way, const wp::vec3d& a, const wp::vec3d& b,
                       const wp::vec3d& c) const {
        // The own plane, from the sample and from the light, and by how much either may be off.
        const bool bounded = asked.light[3] != 0.0;
        const wp::vec3d to_a = Sides::between(p, a);
        const Sides::Plane own = Sides::Plane::through(Sides::between(a, b), Sides::between(a, c));
        const double here = -own.at(to_a), reach = MASK_PAD * own.size * Sides::Plane::sum(to_a);
        const double there = own.at(way) + (bounded ? here : 0.0);
        const double off = MASK_PAD * own.size * Sides::Plane::sum(way) + (bounded ? reach : 0.0);
        if ((here > reach && there > off) || (here < -reach && there < -off))
            return true;
        // The biased start is not behind it, if the light is farther off than that, and the sample nearer.
        const double bias = sample()[3], length = sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
        return bias > 0.0
               && (fabs(here) + reach) * (length - (bounded ? bias : 0.0)) <= 0.99999999 * bias * (fabs(there) - off);
    }
    // Shows a triangle; true if it hides the ray.
    inline bool visit(int triangle) {
        const wp::vec3i& corner = asked.triangles.data[triangle];
        const wp::vec3d &a = asked.vertices.data[corner[0]], &b = asked.vertices.data[corner[1]],
                        &c = asked.vertices.data[corner[2]];
        if (!wp::isfinite(a) || !wp::isfinite(b) || !wp::isfinite(c))
            return false;
        ++tests;
        const wp::vec4d& at = sample();
        const wp::vec3d p(at[0], at[1], at[2]), to = way();
        if (touches(p, a, b, c) || Side::beside(Side::of(p, to, a, b), Side::of(p, to, b, c), Side::of(p, to, c, a))
            || misses(p, to, a, b, c))
            return false;
        ++retested;
        double value;
        int used = 0;
        if (asked.cull != 0 && Determinant::sign(asked.light, b, c, a, value, used) >= 0)
            return false; // its front faces the light
        const int answer = Decision::of(at, asked.light, a, b, c);
        exact += answer >> 1;
        if (!(answer & 1))
            return false;
        hide();
        hider = triangle;
        return true;
    }
    inline void everything() {
        for (int t = 0; t < asked.triangle_count; ++t)
            if (visit(t))
                return;
    }
    inline int triangle_count() const { return asked.triangle_count; }
    inline const wp::vec4d& sample() const { return asked.positions.data[number()]; }
    inline const wp::vec4d& light() const { return asked.light; }
    static inline wp::vec3d spread() { return wp::vec3d(); }
    static inline bool shortened(double& metres) { return false; }
    inline void end() { taken = 0; }
    inline void report(int row) const {
        wp::int64* counter = asked.counters.data + (size_t)(row & (COUNTER_ROWS - 1)) * asked.counters.shape[1];
        const wp::int64 counts[4] = { tests, nodes, retested, exact };
        const int columns[4] = { LEAF_TESTS, NODES_VISITED, RETESTED, EXACT };
        for (int k = 0; k < 4; ++k)
            if (counts[k])
                wp::atomic_add(counter + columns[k], counts[k]);
    }
};
typedef WIDE(InPlace) WIDE(Query);
