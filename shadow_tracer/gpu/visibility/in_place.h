// needs: exact/decision.h visibility/sides.h device/lanes.h
// arguments: Asked asked
// constants: LIT SHADOWED LEAF_TESTS NODES_VISITED RETESTED EXACT COUNTER_ROWS MASK_PAD IN_PLACE_LEAST
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
    // Of each, a triangle that is certain to hide it if it passes on the left of an edge, which is not certain, and
    // that edge's first and last vertex as the light sees them; -1 if there is none. A ray along rows or columns passes
    // right over edges. A triangle at the other side of one has it the other way round: if it hides the ray in the same
    // way, one of both does, whichever, and nothing needs to be decided exactly. Not on CUDA, where what decides would
    // have to stand twice.
#if LANES > 1
    struct Open {
        int triangle, from, to;
    };
    Open open[LANES];
#endif
    int hider; // the triangle that hid a ray last, -1 if none has
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
#if LANES > 1
        for (int j = 0; j < LANES; ++j)
            open[j].triangle = -1;
#endif
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
    // The plane of a triangle: determinants of the sample and of the light with it, and by how much they may be off.
    struct Own {
        double here, reach, there, off;

        static inline Own of(const wp::vec3d& p, const wp::vec3d& way, bool bounded, const wp::vec3d& a,
                             const wp::vec3d& b, const wp::vec3d& c) {
            const wp::vec3d to_a = Sides::between(p, a);
            const Sides::Plane plane = Sides::Plane::through(Sides::between(a, b), Sides::between(a, c));
            const double here = -plane.at(to_a), reach = MASK_PAD * plane.size * Sides::Plane::sum(to_a);
            return { here, reach, plane.at(way) + (bounded ? here : 0.0),
                     MASK_PAD * plane.size * Sides::Plane::sum(way) + (bounded ? reach : 0.0) };
        }
    };
    inline double far(const wp::vec3d& way) const { return sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]); }
    // Whether it is certain that a triangle does not hide the ray, if that does not pass beside it. It is for most of
    // those around a sample, which would go to exact arithmetic, as the sample lies in their planes.
    inline bool misses(const Own& own, const wp::vec3d& way) const {
        if ((own.here > own.reach && own.there > own.off) || (own.here < -own.reach && own.there < -own.off))
            return true;
        // The biased start is not behind it, if the light is farther off than that, and the sample nearer.
        const double bias = sample()[3], length = far(way) - (asked.light[3] != 0.0 ? bias : 0.0);
        return bias > 0.0 && (fabs(own.here) + own.reach) * length <= 0.99999999 * bias * (fabs(own.there) - own.off);
    }
    // Whether it is certain, of one that does not miss it, that the biased start is behind its plane, and the light
    // before it.
    inline bool between(const Own& own, const wp::vec3d& way) const {
        const double behind = fabs(own.here) - own.reach, before = fabs(own.there) - own.off;
        const double bias = sample()[3], all = fabs(own.there) + own.off;
        const double front = all + (asked.light[3] != 0.0 ? fabs(own.here) + own.reach : 0.0);
        return behind > IN_PLACE_LEAST && before > IN_PLACE_LEAST && behind * far(way) >= 1.00000001 * bias * front;
    }
    // Shows a triangle; true if it hides the ray, or together with another one that was shown before.
    inline bool visit(int triangle) {
        const wp::vec3i& corner = asked.triangles.data[triangle];
        const wp::vec3d &a = asked.vertices.data[corner[0]], &b = asked.vertices.data[corner[1]],
                        &c = asked.vertices.data[corner[2]];
        if (!wp::isfinite(a) || !wp::isfinite(b) || !wp::isfinite(c))
            return false;
        ++tests;
        const wp::vec4d& at = sample();
        const wp::vec3d p(at[0], at[1], at[2]), to = way();
        if (touches(p, a, b, c))
            return false;
        const Side side[3] = { Side::of(p, to, a, b), Side::of(p, to, b, c), Side::of(p, to, c, a) };
        if (Side::beside(side[0], side[1], side[2]))
            return false;
        const Own own = Own::of(p, to, asked.light[3] != 0.0, a, b, c);
        if (misses(own, to))
            return false;
        ++retested;
        // Corners of an edge, in the order in which the light sees them, if it is the only thing that is not certain.
        int from = -1, to_corner = -1, unsure = 3;
        if (between(own, to)) {
            const double turn = own.there > 0.0 ? 1.0 : -1.0;
            if (asked.cull != 0 && turn > 0.0)
                return false; // its front faces the light
            unsure = 0;
            for (int k = 0; k < 3; ++k) {
                if (turn * side[k].value < -side[k].off - IN_PLACE_LEAST)
                    return false;
                if (!(turn * side[k].value > side[k].off + IN_PLACE_LEAST)) {
                    const int next = k == 2 ? 0 : k + 1;
                    from = corner[turn > 0.0 ? k : next], to_corner = corner[turn > 0.0 ? next : k];
                    ++unsure;
                }
            }
        }
        return unsure == 0 ? hidden(triangle) : unsure == 1 ? leave(triangle, from, to_corner) : decide(triangle);
    }
    inline bool hidden(int triangle) {
        hide();
        hider = triangle;
        return true;
    }
#if LANES == 1
    inline bool leave(int triangle, int from, int to) { return decide(triangle); }
#else
    // A triangle that hides the ray if that passes an edge on the left, which is not known; true if the ray is hidden.
    inline bool leave(int triangle, int from, int to) {
        const Open left = open[lane];
        open[lane] = { triangle, from, to };
        if (left.triangle < 0)
            return false;
        if (left.from != to || left.to != from)
            return decide(left.triangle);
        return hidden(triangle); // it passes the edge on one side or on the other, or meets it
    }
#endif
    // What is decided exactly.
    inline bool decide(int triangle) {
        const wp::vec3i& corner = asked.triangles.data[triangle];
        const wp::vec3d &a = asked.vertices.data[corner[0]], &b = asked.vertices.data[corner[1]],
                        &c = asked.vertices.data[corner[2]];
        double value;
        int used = 0;
        if (asked.cull != 0 && Determinant::sign(asked.light, b, c, a, value, used) >= 0)
            return false; // its front faces the light
        const int answer = Decision::of(sample(), asked.light, a, b, c);
        exact += answer >> 1;
        return (answer & 1) && hidden(triangle);
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
    inline void end() {
#if LANES > 1
        for (lane = 0; lane < taken; ++lane)
            if ((asking >> lane & 1) && open[lane].triangle >= 0)
                decide(open[lane].triangle);
#endif
        taken = 0;
    }
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
