// constants: MASK_PAD
// A triangle from the sample: planes through it and the edges, the own one, and on which side of that it is. In
// float64; queries.py derives the pad.
struct Sides {
    // A determinant from the sample: three components and the sum of the magnitudes of what they are made of.
    struct Plane {
        double x, y, z, size;

        static inline double sum(const wp::vec3d& a) { return fabs(a[0]) + fabs(a[1]) + fabs(a[2]); }
        static inline Plane through(const wp::vec3d& a, const wp::vec3d& b) {
            return { a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0], sum(a) * sum(b) };
        }
        inline double at(const wp::vec3d& a) const { return x * a[0] + y * a[1] + z * a[2]; }
    };
    static inline wp::vec3d between(const wp::vec3d& from, const wp::vec3d& to) {
        return wp::vec3d(to[0] - from[0], to[1] - from[1], to[2] - from[2]);
    }
    Plane edge[3], own;
    double here, reach; // the sample's determinant with the own plane, and what that is a sum of
    bool sure;

    inline Sides(const wp::vec3d& p, const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c) {
        const wp::vec3d to_a = between(p, a), ab = between(a, b);
        edge[0] = Plane::through(to_a, ab);
        edge[1] = Plane::through(between(p, b), between(b, c));
        edge[2] = Plane::through(between(p, c), between(c, a));
        own = Plane::through(ab, between(a, c));
        here = -own.at(to_a);
        reach = MASK_PAD * own.size * Plane::sum(to_a);
        sure = fabs(here) > reach;
    }
};
