// needs: exact/decision.h visibility/sides.h
// arguments: Asked asked
// constants: LIT SHADOWED LEAF_TESTS NODES_VISITED RETESTED EXACT COUNTER_ROWS MASK_PAD
// The query *in place*: whether something hides a ray, decided from the coordinates of the scene, without records and
// without a queue. A walk may also say that a ray is hidden, or that nothing more hides it, where it has proven it.
struct InPlace1 {
    enum { SPREADS = 0 };
    const Asked& asked;
    int ray[1], taken;
    int hider; // the triangle that hid it, -1 if none has
    wp::int64 tests, nodes, retested, exact;

    inline explicit InPlace1(const Asked& asked)
        : asked(asked), taken(0), hider(-1), tests(0), nodes(0), retested(0), exact(0) {}
    inline void take(int number) {
        if (asked.states.data[number] != LIT || asked.rays.data[number][0] != asked.rays.data[number][0])
            return;
        ray[0] = number;
        taken = 1;
    }
    inline bool full() const { return taken == 1; }
    inline void begin() { hider = -1; }
    inline void hide() { asked.states.data[ray[0]] = SHADOWED; }
    static inline bool same(const wp::vec3d& p, const wp::vec3d& q) {
        return p[0] == q[0] && p[1] == q[1] && p[2] == q[2];
    }
    // Whether it is certain that a triangle does not hide the ray. It is for most of those around a sample, which would
    // go to exact arithmetic, as the sample lies in their planes.
    inline bool misses(const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c) const {
        const wp::vec4d& at = sample();
        const wp::vec3d p(at[0], at[1], at[2]);
        if (same(p, a) || same(p, b) || same(p, c))
            return true;
        const bool bounded = asked.light[3] != 0.0;
        wp::vec3d way(asked.light[0], asked.light[1], asked.light[2]);
        if (bounded)
            way = Sides::between(p, way);
        const Sides sides(p, a, b, c);
        const double pad = MASK_PAD * Sides::Plane::sum(way);
        bool inside = false, outside = false;
        for (int k = 0; k < 3; ++k) {
            const double value = sides.edge[k].at(way);
            inside |= value > pad * sides.edge[k].size;
            outside |= value < -pad * sides.edge[k].size;
        }
        if (inside && outside)
            return true;
        // The own plane, from the sample and from the light, and by how much either may be off.
        const double here = sides.here, there = sides.own.at(way) + (bounded ? here : 0.0);
        const double off = pad * sides.own.size + (bounded ? sides.reach : 0.0);
        if ((here > sides.reach && there > off) || (here < -sides.reach && there < -off))
            return true;
        // The biased start is not behind it, if the light is farther off than that, and the sample nearer.
        const double bias = at[3], length = sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
        return bias > 0.0
               && (fabs(here) + sides.reach) * (length - (bounded ? bias : 0.0))
                      <= 0.999999999999 * bias * (fabs(there) - off);
    }
    // Shows a triangle; true if it hides the ray.
    inline bool visit(int triangle) {
        const wp::vec3i& corner = asked.triangles.data[triangle];
        const wp::vec3d &a = asked.vertices.data[corner[0]], &b = asked.vertices.data[corner[1]],
                        &c = asked.vertices.data[corner[2]];
        if (!wp::isfinite(a) || !wp::isfinite(b) || !wp::isfinite(c))
            return false;
        ++tests;
        if (misses(a, b, c))
            return false;
        ++retested;
        double value;
        int used = 0;
        if (asked.cull != 0 && Determinant::sign(asked.light, b, c, a, value, used) >= 0)
            return false; // its front faces the light
        const int answer = Decision::of(asked.positions.data[ray[0]], asked.light, a, b, c);
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
    inline const wp::vec4d& sample() const { return asked.positions.data[ray[0]]; }
    inline const wp::vec4d& light() const { return asked.light; }
    static inline double spread() { return 0.0; }
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
typedef InPlace1 Query1;
