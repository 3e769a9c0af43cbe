// needs: exact/decision.h cone_walk
// constants: CONE_FREE CONE_PARTLY CONE_BLOCKED CONE_ADDED
// arguments: ConeScene scene, ConesAsked asked
// What is certain of a cone: cones.py says why.
struct ConeOutcome {
    const ConeScene& scene;
    const Cone& cone;
    const wp::vec4d apex, end;
    bool met, partly, axis;

    inline const wp::vec3d& vertex(int number) const { return scene.vertices.data[number]; }
    // Whether the edge's other triangle certainly goes on where this one ends, as seen from the apex.
    inline bool goes_on(int triangle, int edge, const Cone::Corner& a, const Cone::Corner& b,
                        const Cone::Plane& plane) const {
        const int other = scene.neighbours.data[triangle][edge];
        if (other < 0)
            return false;
        const wp::vec3i& corners = scene.triangles.data[other / 3];
        const int k = other % 3;
        const Triple from(vertex(corners[k])), to(vertex(corners[k == 2 ? 0 : k + 1]));
        if (!(from.same(a.place) && to.same(b.place)) && !(from.same(b.place) && to.same(a.place)))
            return false;
        const Triple third = Triple(vertex(corners[k == 0 ? 2 : k - 1])) - cone.apex;
        return Cone::edge_plane(a, b, plane).dot(third) < -(cone.edge_band(a, b) * third.length());
    }
    // True if the triangle hides the end from the apex.
    inline bool on_axis(const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c) const {
        return Decision::of(apex, end, a, b, c) & 1;
    }
    // True if that is enough: one triangle hides all.
    inline bool show(int triangle) {
        const wp::vec3i& corners = scene.triangles.data[triangle];
        const wp::vec3d &p = vertex(corners[0]), &q = vertex(corners[1]), &r = vertex(corners[2]);
        if (!Cone::finite(p, q, r) || cone.far_off(p, q, r))
            return false;
        const Cone::Corner a = cone.corner(p), b = cone.corner(q), c = cone.corner(r);
        if (cone.misses(a, b, c) || Cone::flat(p, q, r))
            return false;
        met = true;
        const Cone::Plane plane = cone.plane(a, b, c);
        if (cone.covered_by(a, b, c, plane))
            return true;
        if (partly)
            return false;
        Triple side;
        bool sided;
        partly = !plane.ahead || !cone.before_end(a, b, c, plane)
                 || !(cone.edge_misses(a, b, side, sided) || goes_on(triangle, 0, a, b, plane))
                 || !(cone.edge_misses(b, c, side, sided) || goes_on(triangle, 1, b, c, plane))
                 || !(cone.edge_misses(c, a, side, sided) || goes_on(triangle, 2, c, a, plane));
        axis = axis || (!partly && on_axis(p, q, r));
        return false;
    }
    // Of the ray alone, exactly: it is hidden or not.
    inline int whole_ray(ConeWalk& walk, int budget) const {
        for (int triangle = walk.next(); triangle >= 0; triangle = walk.next()) {
            if (walk.spent > budget)
                return CONE_PARTLY;
            const wp::vec3i& corners = scene.triangles.data[triangle];
            const wp::vec3d &p = vertex(corners[0]), &q = vertex(corners[1]), &r = vertex(corners[2]);
            if (Cone::finite(p, q, r) && on_axis(p, q, r))
                return CONE_BLOCKED;
        }
        return walk.spent > budget ? CONE_PARTLY : CONE_FREE;
    }
    inline int whole(ConeWalk& walk, int budget) {
        for (int triangle = walk.next(); triangle >= 0; triangle = walk.next()) {
            if (walk.spent > budget)
                return CONE_PARTLY;
            const bool before = partly;
            if (show(triangle))
                return CONE_BLOCKED;
            // What may still hide all is a triangle before the axis.
            if (partly && !before)
                walk.spread(0.0, CONE_ADDED);
        }
        if (walk.spent > budget)
            return CONE_PARTLY;
        return !met ? CONE_FREE : axis && !partly ? CONE_BLOCKED : CONE_PARTLY;
    }
    static inline void of(int number, const ConeScene& scene, const ConesAsked& asked) {
        const wp::vec3d& from = asked.apices.data[number];
        const wp::vec4d& end = asked.ends.data[number];
        const double slope = asked.slopes.data[number];
        const Cone cone = ConeWalk::cone(scene, from, end, slope);
        ConeWalk walk(scene, cone, slope, CONE_ADDED * (1.0 + slope), true);
        walk.budget = asked.budget;
        ConeOutcome outcome = { scene, cone, wp::vec4d(from[0], from[1], from[2], 0.0), end, false, false, false };
        const int found = slope == 0.0 ? outcome.whole_ray(walk, asked.budget) : outcome.whole(walk, asked.budget);
        asked.outcomes.data[number] = (unsigned char)found;
    }
};
