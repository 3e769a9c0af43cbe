// needs: accelerators/cone_hits.h
// arguments: ConeScene scene, ConesAsked asked, Counted counted
// Whole traversals, as the paper measures them: nothing ends them before the cone does, and no triangle is tested.
struct CountedCones {
    static inline Cone cone(int number, const ConeScene& scene, const ConesAsked& asked) {
        const wp::vec4d& way = asked.ends.data[number];
        const wp::vec3d& apex = asked.apices.data[number];
        return Cone(apex, Triple(wp::vec3d(way[0], way[1], way[2])), asked.slopes.data[number],
                    ConeWalk::reach(scene, apex));
    }
    static inline void count(int number, const ConeScene& scene, const ConesAsked& asked, const Counted& counted,
                             int together) {
        const double slope = asked.slopes.data[number];
        const Cone within = cone(number, scene, asked);
        ConeWalk walk(scene, within, slope, CONE_ADDED * (1.0 + slope), together != 0);
        int shown = 0;
        for (int triangle = walk.next(); triangle >= 0; triangle = walk.next(), ++shown)
            if (number < counted.marks.shape[0])
                counted.marks.data[(size_t)number * counted.marks.shape[1] + triangle] = 1;
        counted.nodes.data[number] = walk.spent - shown;
        counted.triangles.data[number] = shown;
    }
    // How many triangles that are in the cone have no mark, and how many have: all of the scene are tested.
    static inline void check(int number, const ConeScene& scene, const ConesAsked& asked, const Counted& counted, int) {
        const wp::vec3d& from = asked.apices.data[number];
        const wp::vec4d apex(from[0], from[1], from[2], 0.0);
        const Cone within = cone(number, scene, asked);
        int missed = 0, met = 0;
        for (int triangle = 0; triangle < scene.count; ++triangle) {
            const wp::vec3i& corners = scene.triangles.data[triangle];
            const wp::vec3d &p = scene.vertices.data[corners[0]], &q = scene.vertices.data[corners[1]],
                            &r = scene.vertices.data[corners[2]];
            if (!Cone::finite(p, q, r))
                continue;
            bool inside;
            if (within.slope.number > 0.0) {
                const Cone::Corner a = within.corner(p), b = within.corner(q), c = within.corner(r);
                inside =
                    !within.misses(a, b, c) && !Cone::flat(p, q, r) && ConeEntry::of(within, a, b, c).number >= 0.0;
            } else {
                inside = Decision::of(apex, asked.ends.data[number], p, q, r) & 1;
            }
            met += inside;
            missed += inside && !counted.marks.data[(size_t)number * counted.marks.shape[1] + triangle];
        }
        counted.nodes.data[number] = missed;
        counted.triangles.data[number] = met;
    }
};
