// needs: exact/decision.h cone_walk
// constants: CONE_FREE CONE_PARTLY CONE_BLOCKED CONE_ADDED CONES_OF_A_HINT LARGEST_SHEET NO_BUDGET
// arguments: ConeScene scene, ConesAsked asked
// What is certain of a cone: docs/exactness.md says why.
struct ConeOutcome {
    const ConeScene& scene;
    const Cone& cone;
    const wp::vec4d apex, end;

    // Triangles that go on one in the other.
    struct Sheet {
        enum { REACHED = 4, NONE = 3 };
        int members[LARGEST_SHEET]; // four times a triangle, and its edge from which it was reached
        int count;
        // False if there is no room.
        inline bool add(int triangle, int edge) {
            for (int k = 0; k < count; ++k)
                if (members[k] / REACHED == triangle)
                    return true;
            if (count == LARGEST_SHEET)
                return false;
            members[count++] = REACHED * triangle + edge;
            return true;
        }
    };
    inline const wp::vec3d& vertex(int number) const { return scene.vertices.data[number]; }
    // What certainly goes on where a triangle ends at an edge, as seen from the apex: three times another triangle, and
    // its edge; or -1.
    inline int goes_on(int triangle, int edge, const Cone::Corner& a, const Cone::Corner& b,
                       const Cone::Plane& plane) const {
        const int other = scene.neighbours.data[triangle][edge];
        if (other < 0)
            return -1;
        const wp::vec3i& corners = scene.triangles.data[other / 3];
        const int k = other % 3;
        const Triple from(vertex(corners[k])), to(vertex(corners[k == 2 ? 0 : k + 1]));
        if (!(from.same(a.place) && to.same(b.place)) && !(from.same(b.place) && to.same(a.place)))
            return -1;
        const Triple third = Triple(vertex(corners[k == 0 ? 2 : k - 1])) - cone.apex;
        return Cone::edge_plane(a, b, plane).dot(third) < -(cone.edge_band(a, b) * third.length()) ? other : -1;
    }
    // False if the cone may reach over an edge where nothing goes on; what does joins the sheet.
    inline bool closed(Sheet& sheet, int triangle, int edge, const Cone::Corner& a, const Cone::Corner& b,
                       const Cone::Plane& plane) const {
        Triple side;
        bool sided;
        if (cone.edge_misses(a, b, side, sided))
            return true;
        const int other = goes_on(triangle, edge, a, b, plane);
        return other >= 0 && sheet.add(other / 3, other % 3);
    }
    // True if the triangle hides the end from the apex.
    inline bool on_axis(const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c) const {
        return Decision::of(apex, end, a, b, c) & 1;
    }
    // Whether a sheet that begins with a triangle certainly hides all. What is looked at for that comes off the budget.
    inline bool hidden_by_sheet(ConeWalk& walk, int first) const {
        Sheet sheet;
        sheet.count = 0;
        sheet.add(first, Sheet::NONE);
        const bool line = cone.slope.number == 0.0; // the triangle hides it or not, whatever goes on
        bool axis = false;
        for (int k = 0; k < sheet.count; ++k) {
            if (k > 0 && --walk.budget < walk.spent)
                return false;
            const int triangle = sheet.members[k] / Sheet::REACHED, from = sheet.members[k] % Sheet::REACHED;
            const wp::vec3i& corners = scene.triangles.data[triangle];
            const wp::vec3d &p = vertex(corners[0]), &q = vertex(corners[1]), &r = vertex(corners[2]);
            if (!Cone::finite(p, q, r))
                return false;
            bool beside = false;
            if (!line) {
                const Cone::Corner a = cone.corner(p), b = cone.corner(q), c = cone.corner(r);
                const Cone::Plane plane = cone.plane(a, b, c);
                if (!plane.ahead || !cone.before_end(a, b, c, plane))
                    return false;
                if (!(from == 0 || closed(sheet, triangle, 0, a, b, plane))
                    || !(from == 1 || closed(sheet, triangle, 1, b, c, plane))
                    || !(from == 2 || closed(sheet, triangle, 2, c, a, plane)))
                    return false;
                beside = cone.beyond(a, b, plane, cone.axis) || cone.beyond(b, c, plane, cone.axis)
                         || cone.beyond(c, a, plane, cone.axis);
            }
            if (!axis && !beside && on_axis(p, q, r)) // in one place: the exact decision is much code
                axis = true;
        }
        return axis;
    }
    // Whether a triangle certainly hides all, alone or with those that go on from it.
    inline bool hidden_by(ConeWalk& walk, int triangle, bool alone) const {
        const wp::vec3i& corners = scene.triangles.data[triangle];
        const wp::vec3d &p = vertex(corners[0]), &q = vertex(corners[1]), &r = vertex(corners[2]);
        if (!Cone::finite(p, q, r))
            return false;
        if (alone && cone.slope.number != 0.0) {
            const Cone::Corner a = cone.corner(p), b = cone.corner(q), c = cone.corner(r);
            if (cone.covered_by(a, b, c, cone.plane(a, b, c)))
                return true;
        }
        return hidden_by_sheet(walk, triangle);
    }
    inline bool misses(int triangle, bool near_by) const {
        const wp::vec3i& corners = scene.triangles.data[triangle];
        const wp::vec3d &p = vertex(corners[0]), &q = vertex(corners[1]), &r = vertex(corners[2]);
        if (!Cone::finite(p, q, r) || (!near_by && cone.far_off(p, q, r)))
            return true;
        return cone.misses(cone.corner(p), cone.corner(q), cone.corner(r)) || Cone::flat(p, q, r);
    }
    // hint: what may hide all, and is looked at first, or -1; then what does.
    inline int whole(ConeWalk& walk, int& hint) const {
        bool met = false, guessed = hint >= 0;
        int triangle = hint;
        hint = -1;
        if (cone.slope.number == 0.0)
            walk.narrow();
        if (!guessed)
            triangle = walk.next();
        for (; triangle >= 0; triangle = walk.next(), guessed = false) {
            if (walk.spent > walk.budget)
                return CONE_PARTLY;
            const bool unknown = !guessed && !walk.narrowed && !walk.together; // whether it is near the cone at all
            if (unknown && misses(triangle, false))
                continue;
            // One place for this: what it takes is much.
            if ((guessed || walk.through_it) && hidden_by(walk, triangle, guessed || walk.covers_it)) {
                hint = triangle;
                return CONE_BLOCKED;
            }
            if (!guessed && !walk.narrowed && (unknown || !misses(triangle, true))) {
                met = true;
                walk.narrow(); // what hides all is on the axis
            }
        }
        return walk.spent > walk.budget ? CONE_PARTLY : met ? CONE_PARTLY : CONE_FREE;
    }
    static inline void of(int number, const ConeScene& scene, const ConesAsked& asked) {
        const wp::vec3d& from = asked.apices.data[number];
        const wp::vec4d& end = asked.ends.data[number];
        const double slope = asked.slopes.data[number];
        const Cone cone = ConeWalk::cone(scene, from, end, slope);
        ConeWalk walk(scene, cone, slope, CONE_ADDED * (1.0 + slope), true);
        walk.budget = asked.budget;
        const ConeOutcome outcome = { scene, cone, wp::vec4d(from[0], from[1], from[2], 0.0), end };
        int& hint = asked.hints.data[number / CONES_OF_A_HINT];
        int first = asked.budget < NO_BUDGET ? -1 : hint;
        asked.outcomes.data[number] = (unsigned char)outcome.whole(walk, first);
        hint = first;
    }
};
