// needs: device/warp.h exact/decision.h visibility/signs.h
// arguments: Asked asked
// constants: LIT SHADOWED LEAF_TESTS NODES_VISITED RETESTED EXACT COUNTER_ROWS
// lanes
// The query *in place*: whether something hides LANES rays, each decided from the coordinates of the scene, without
// records and without a queue. A walk may also say that a ray is hidden, or that nothing more hides it, where it has
// proven it.
struct WIDE(InPlace) {
    enum { SPREADS = 0 };
    typedef WIDE(Signs) Signs;
    typedef Signs::Point Point;
    typedef Signs::Side Side;
    typedef WIDE(Double) Number;
    const Asked& asked;
    const bool looked, has_rays; // whether there was a first look, and whether samples have rays
    int ray[LANES], taken;
    int asking; // those that are not known to be hidden, as bits
    int lane;   // that which triangles are shown to
    // Of each, some triangles that are certain to hide it if it passes on the left of an edge, which is not certain,
    // and that edge's first and last vertex as the light sees them. A ray along rows or columns passes right over
    // edges. A triangle at the other side of one has it the other way round: if it hides the ray in the same way, one
    // of both does, whichever, and nothing needs to be decided exactly. Not on CUDA, where what decides would have to
    // stand twice.
#if LANES > 1
    struct Open {
        int triangle, from, to;
    };
    enum { OPEN = 4 };
    Open open[LANES][OPEN];
    int opens[LANES]; // how many there are
    // Triangles that are not judged yet, lanes that they are shown to, and of each pair the sample and the corners.
    enum { POINTS = 4, ROOM = 4 };
    int waiting, waits[LANES], shown_to[LANES];
    double pairs[LANES][POINTS][ROOM];
#endif
    int hider; // the triangle that hid a ray last, -1 if none has
    wp::int64 tests, nodes, retested, exact;

    inline explicit WIDE(InPlace)(const Asked& asked)
        : asked(asked), looked(asked.passed.shape[0] != 0), has_rays(asked.rays.shape[0] != 0), taken(0), asking(0),
          lane(0), hider(-1), tests(0), nodes(0), retested(0), exact(0) {}
    static inline bool has_ray(const Asked& asked, int number) {
        return !asked.rays.shape[0] || asked.rays.data[number][0] == asked.rays.data[number][0];
    }
    inline void take(int number) {
        if (looked && asked.passed.data[number] == 2)
            return;
        if (asked.states.data[number] != LIT || (has_rays && !has_ray(asked, number)))
            return;
#if LANES == 1
        // No index at run time: compilers for CUDA would put the query into local memory, with all that it refers to.
        ray[0] = number;
        taken = 1;
#else
        ray[taken++] = number;
#endif
    }
#if LANES > 1
    // Takes LANES rays if all of them ask, and no other waits; returns whether it has.
    inline bool take_all(const int* numbers) {
        int all = !looked && taken == 0;
        for (int j = 0; j < LANES; ++j)
            all &= asked.states.data[numbers[j]] == LIT;
        for (int j = 0; has_rays && j < LANES; ++j)
            all &= has_ray(asked, numbers[j]);
        if (!all)
            return false;
        memcpy(ray, numbers, sizeof(ray));
        taken = LANES;
        return true;
    }
#endif
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
            opens[j] = 0;
        waiting = 0;
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
        const double* from[LANES];
        for (int j = 0; j < LANES; ++j)
            from[j] = (const double*)(asked.positions.data + ray[j < taken ? j : 0]);
        WIDE(Doubles)::turn(from, at);
#endif
    }
    // The ways of rays from some samples to the light.
    inline Point way(const Point& p) const {
        const double w = asked.light[3] != 0.0 ? 1.0 : 0.0;
        return { asked.light[0] - w * p.x, asked.light[1] - w * p.y, asked.light[2] - w * p.z };
    }
    // Whether the sample is a corner: such a triangle never hides it. Samples of a depth image are corners of its
    // surface.
    static inline int touches(const Point& p, const Point& a, const Point& b, const Point& c) {
        return Point::same(p, a) | Point::same(p, b) | Point::same(p, c);
    }
    // Up to LANES triangles, each for the ray from one sample: those of `some`, as bits, are looked at.
    inline void judge(int some, const Point& p, Number bias, const Point& a, const Point& b, const Point& c,
                      const int* triangles, const int* lanes) {
        some &= WIDE(Doubles)::bits(a.sum() + b.sum() + c.sum() < HUGE_VAL); // those that have no corner are none
        tests += Warp::count(some);
        some &= ~touches(p, a, b, c);
        const Point to = way(p);
        const Side ab = Side::of(p, to, a, b), bc = Side::of(p, to, b, c), ca = Side::of(p, to, c, a);
        some &= ~Side::beside(ab, bc, ca);
        if (!some)
            return;
        const bool bounded = asked.light[3] != 0.0;
        const Signs::Own own = Signs::Own::of(p, to, bounded, a, b, c);
        const Number length = to.length(), one = 1.0, turn = own.there > 0.0 ? one : -one;
        some &= ~own.misses(bias, length, bounded);
        retested += Warp::count(some);
        const int sure = own.between(bias, length, bounded), front = WIDE(Doubles)::bits(turn > 0.0);
        some &= ~(sure & (ab.right(turn) | bc.right(turn) | ca.right(turn)));
        if (asked.cull != 0)
            some &= ~(sure & front); // they face the light
        const int left[3] = { ab.left(turn), bc.left(turn), ca.left(turn) };
        for (; some; some &= some - 1) {
            const int j = Warp::lowest(some), triangle = triangles[j];
            lane = lanes[j];
            if (!(asking >> lane & 1))
                continue;
            const int edges = 7 & ~((left[0] >> j & 1) | (left[1] >> j & 1) << 1 | (left[2] >> j & 1) << 2);
            if (!(sure >> j & 1) || (LANES == 1 ? edges : edges & (edges - 1)))
                decide(triangle);
            else if (!edges)
                hidden(triangle);
            else
                leave(triangle, Warp::lowest(edges), front >> j & 1);
        }
    }
#if LANES == 1
    // Shows a triangle; true if it hides the ray.
    inline bool visit(int triangle) {
        const wp::vec3i& corner = asked.triangles.data[triangle];
        const wp::vec4d& at = sample();
        const int only = 0;
        judge(1, point(at), at[3], point(asked.vertices.data[corner[0]]), point(asked.vertices.data[corner[1]]),
              point(asked.vertices.data[corner[2]]), &triangle, &only);
        return !asking;
    }
    static inline Point point(const wp::vec3d& x) { return { x[0], x[1], x[2] }; }
    static inline Point point(const wp::vec4d& x) { return { x[0], x[1], x[2] }; }
    inline void leave(int triangle, int edge, int front) {}
    inline void settle() {}
#else
    // Shows a triangle; true if the ray is known to be hidden. Triangles are judged LANES at a time, so that may become
    // known later.
    inline bool visit(int triangle) {
        const wp::vec3i& corner = asked.triangles.data[triangle];
        memcpy(pairs[waiting][0], &sample(), sizeof(wp::vec4d));
        for (int k = 0; k < 3; ++k)
            memcpy(pairs[waiting][k + 1], asked.vertices.data + corner[k], sizeof(wp::vec3d));
        shown_to[waiting] = lane;
        waits[waiting++] = triangle;
        if (waiting < LANES)
            return false;
        const int here = lane;
        settle();
        lane = here;
        return !(asking >> lane & 1);
    }
    // Judges what waits.
    inline void settle() {
        if (!waiting)
            return;
        Number x[POINTS][ROOM];
        for (int i = 0; i < POINTS; ++i) {
            const double* from[LANES];
            for (int j = 0; j < LANES; ++j)
                from[j] = pairs[j < waiting ? j : 0][i];
            WIDE(Doubles)::turn(from, x[i]);
        }
        judge(WIDE(Lanes)::ALL >> (LANES - waiting), point(x[0]), x[0][3], point(x[1]), point(x[2]), point(x[3]), waits,
              shown_to);
        waiting = 0;
    }
    static inline Point point(const Number (&x)[ROOM]) { return { x[0], x[1], x[2] }; }
    // A triangle that hides the ray if that passes an edge on the left as the light sees it, which is not known.
    inline void leave(int triangle, int edge, int front) {
        const wp::vec3i& corner = asked.triangles.data[triangle];
        const int begin = corner[edge], end = corner[edge == 2 ? 0 : edge + 1];
        const Open now = { triangle, front ? begin : end, front ? end : begin };
        Open* left = open[lane];
        for (int k = 0; k < opens[lane]; ++k)
            if (left[k].from == now.to && left[k].to == now.from) {
                hidden(triangle); // it passes the edge on one side or on the other, or meets it
                return;
            }
        if (opens[lane] == OPEN)
            decide(left[--opens[lane]].triangle);
        left[opens[lane]++] = now;
    }
#endif
    inline bool hidden(int triangle) {
        hide();
        hider = triangle;
        return true;
    }
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
        settle();
#if LANES > 1
        for (lane = 0; lane < taken; ++lane)
            while ((asking >> lane & 1) && opens[lane] > 0)
                decide(open[lane][--opens[lane]].triangle);
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
