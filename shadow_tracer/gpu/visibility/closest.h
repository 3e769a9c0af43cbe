// needs: visibility/nearest.h
// arguments: Asked asked, CameraRays asked.rays, CameraTriangles asked.seen
// constants: COUNTER_ROWS
// The query *closest hit*: which triangle the ray of a pixel meets first, and how far away. What is met, and what is
// closer, is decided as for the camera's own grid; walks learn how far away nothing matters any more.
struct ClosestHit1 : Nearest {
    enum { SPREADS = 0 };
    const Asked& asked;
    int ray[1], taken;
    int hider; // the closest triangle
    double
        reach; // along the ray [m]: nothing farther off can be closer than what has been found; no end if a walk knows
    wp::int64 shown, nodes;

    inline explicit ClosestHit1(const Asked& asked)
        : Nearest(asked.rays, asked.seen), asked(asked), taken(0), hider(-1), reach(HUGE_VAL), shown(0), nodes(0) {}
    inline void take(int number) {
        ray[0] = number;
        look(number % rays.width, number / rays.width, -1);
        if (x == x)
            taken = 1;
        else
            write(); // no ray
    }
    inline bool full() const { return taken == 1; }
    inline void begin() {
        hider = -1;
        reach = HUGE_VAL;
    }
    // Shows a triangle. Never true: another one may be closer.
    inline bool visit(int triangle) {
        // Others are met by no ray, and have not been left out.
        if (CameraRecord::at(seen.records, triangle)[CameraRecord::CASTS] == 0.0f || !nearer(triangle))
            return false;
        double d[3];
        DepthPlane::direction(rays, across(), down(), d, 1);
        reach = (depth(triangle, d) + asked.slack.data[0]) * norm(d[0], d[1], d[2]);
        hider = triangle;
        return false;
    }
    // Whether less of the ray matters than when this was last asked; if so, how much [m].
    inline bool shortened(double& metres) {
        metres = reach;
        reach = HUGE_VAL;
        return metres < HUGE_VAL;
    }
    inline void everything() {
        for (int t = 0; t < asked.count; ++t)
            visit(t);
    }
    inline int triangle_count() const { return asked.count; }
    inline wp::vec4d sample() const { return wp::vec4d(rays.position[0], rays.position[1], rays.position[2], 1.0); }
    // Its direction, as that to a light at infinity.
    inline wp::vec4d light() const {
        double d[3];
        DepthPlane::direction(rays, across(), down(), d, 1);
        return wp::vec4d(d[0], d[1], d[2], 0.0);
    }
    static inline wp::vec3d spread() { return wp::vec3d(); }
    inline void write() const {
        asked.image.triangle.data[ray[0]] = best;
        asked.image.depth.data[ray[0]] = measured();
    }
    inline void end() {
        write();
        shown += tests;
        taken = 0;
    }
    inline void report(int row) const {
        Hit::report(row, shown, asked.counters);
        wp::atomic_add(asked.nodes.data + row % COUNTER_ROWS, nodes);
    }
};
typedef ClosestHit1 Query1;
