// needs: exact/cone_entry.h exact/decision.h cone_walk
// constants: CONE_ADDED BOX_PADDING
// arguments: ConeScene scene, ConesAsked asked
// The nearest triangles of a cone, by distance and number: cones.py says why none is missed.
struct ConeHits {
    const ConeScene& scene;
    const ConesAsked& asked;
    const Cone& cone;
    const wp::vec4d apex, end;
    double* distances; // of those found, nearest first
    int* numbers;
    const double after;
    const int after_number;
    int found;

    static inline bool before(double t, int number, double other_t, int other) {
        return t < other_t || (t == other_t && number < other);
    }
    // The box of a triangle, which all boxes around it hold; not smaller than the one that the tree was made of.
    inline void box(const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c, float* box) const {
        const SceneBox& around = scene.tree.box;
        for (int k = 0; k < 3; ++k) {
            const double x = (a[k] - around.center[k]) * around.inverse_extent;
            const double y = (b[k] - around.center[k]) * around.inverse_extent;
            const double z = (c[k] - around.center[k]) * around.inverse_extent;
            const double low = x < y ? x : y, high = x > y ? x : y;
            // Half of the padding: whatever is contracted here or there, the leaf's box is the larger one.
            box[k] = (float)((low < z ? low : z) - 0.5 * BOX_PADDING);
            box[4 + k] = (float)((high > z ? high : z) + 0.5 * BOX_PADDING);
        }
    }
    // Once, however often it is shown.
    inline void keep(double t, int number) {
        for (int k = found; k > 0 && !before(distances[k - 1], numbers[k - 1], t, number); --k)
            if (numbers[k - 1] == number)
                return;
        int at = found < asked.most ? found : found - 1;
        for (; at > 0 && before(t, number, distances[at - 1], numbers[at - 1]); --at) {
            distances[at] = distances[at - 1];
            numbers[at] = numbers[at - 1];
        }
        distances[at] = t;
        numbers[at] = number;
        found += found < asked.most ? 1 : 0;
    }
    inline void show(int triangle, const ConeWalk& walk) {
        const wp::vec3i& corners = scene.triangles.data[triangle];
        const wp::vec3d &p = scene.vertices.data[corners[0]], &q = scene.vertices.data[corners[1]],
                        &r = scene.vertices.data[corners[2]];
        if (!Cone::finite(p, q, r))
            return;
        double in = 0.0, out = cone.length.number;
        if (!walk.everything) {
            float around[8];
            box(p, q, r, around);
            if (!walk.meets(around, in, out))
                return;
            in = Arithmetic::mul(in, walk.unit);
            out = Arithmetic::mul(out, walk.unit);
        }
        const Cone::Corner a = cone.corner(p), b = cone.corner(q), c = cone.corner(r);
        double t = -1.0;
        if (cone.slope.number > 0.0) {
            t = cone.misses(a, b, c) || Cone::flat(p, q, r) ? -1.0 : ConeEntry::of(cone, a, b, c).number;
        } else if (Decision::of(apex, end, p, q, r) & 1) {
            const Cone::Plane plane = cone.plane(a, b, c);
            t = (plane.off / plane.along).number;
            t = t > 0.0 ? t : 0.0; // what is not, but for roundings, is at the apex
        }
        if (!(t >= 0.0) || t > cone.length.number)
            return;
        // Rounding never carries it out of the boxes around it.
        t = t < in ? in : t > out ? out : t;
        const int number = scene.numbers.data[triangle];
        if (before(after, after_number, t, number)
            && (found < asked.most || before(t, number, distances[found - 1], numbers[found - 1])))
            keep(t, number);
    }
    static inline void of(int number, const ConeScene& scene, const ConesAsked& asked) {
        const wp::vec3d& from = asked.apices.data[number];
        const wp::vec4d& end = asked.ends.data[number];
        const double slope = asked.slopes.data[number];
        const Cone cone = ConeWalk::cone(scene, from, end, slope);
        ConeWalk walk(scene, cone, slope, CONE_ADDED * (1.0 + slope), false);
        walk.after = asked.after.data[number];
        const size_t at = asked.most * (size_t)number;
        ConeHits hits = { scene,
                          asked,
                          cone,
                          wp::vec4d(from[0], from[1], from[2], 0.0),
                          end,
                          asked.distances.data + at,
                          asked.numbers.data + at,
                          asked.after.data[number],
                          asked.after_numbers.data[number],
                          0 };
        for (int triangle = walk.next(); triangle >= 0; triangle = walk.next()) {
            hits.show(triangle, walk);
            if (hits.found == asked.most)
                walk.wanted = hits.distances[hits.found - 1];
        }
        for (int k = hits.found; k < asked.most; ++k) {
            hits.distances[k] = HUGE_VAL;
            hits.numbers[k] = -1;
        }
    }
};
