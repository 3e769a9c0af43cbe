// arguments: Asked asked
// A query that nothing answers: rays from an eye are shown all triangles of their way, and these are counted.
struct EveryTriangle1 {
    enum { SPREADS = 0 };
    const Asked& asked;
    int ray[1], taken, hider;
    wp::int64 nodes;
    int shown;

    inline explicit EveryTriangle1(const Asked& asked) : asked(asked), taken(0), hider(-1), nodes(0), shown(0) {}
    inline void take(int number) {
        ray[0] = number;
        taken = 1;
    }
    inline bool full() const { return taken == 1; }
    inline void begin() {
        nodes = 0;
        shown = 0;
    }
    inline bool visit(int triangle) {
        ++shown;
        if (ray[0] < asked.counted.marks.shape[0])
            asked.counted.marks.data[(size_t)ray[0] * asked.counted.marks.shape[1] + triangle] = 1;
        return false;
    }
    inline void everything() {
        for (int triangle = 0; triangle < asked.count; ++triangle)
            visit(triangle);
    }
    inline int triangle_count() const { return asked.count; }
    inline wp::vec4d sample() const {
        const wp::vec3d& from = asked.apices.data[ray[0]];
        return wp::vec4d(from[0], from[1], from[2], 1.0);
    }
    inline const wp::vec4d& light() const { return asked.ways.data[ray[0]]; }
    static inline wp::vec3d spread() { return wp::vec3d(); }
    static inline bool shortened(double& metres) { return false; }
    inline void end() {
        asked.counted.nodes.data[ray[0]] = (int)nodes;
        asked.counted.triangles.data[ray[0]] = shown;
        taken = 0;
    }
    inline void report(int row) const {}
};
typedef EveryTriangle1 Query1;
