// needs: exact/cone.h
// Where a triangle enters a cone: the distance along the axis of its first point inside, rounded.
struct ConeEntry {
    const Cone& cone;
    Rounded first; // negative: none so far

    inline void meet(Rounded along) {
        if (along >= Rounded(0.0) && (first < Rounded(0.0) || along < first))
            first = along;
    }
    // |beside|^2 - slope^2 along^2
    inline Rounded excess(const Cone::Corner& c) const {
        const Rounded wide = cone.slope * c.along;
        return c.beside.dot(c.beside) - wide * wide;
    }
    inline void corner(const Cone::Corner& c) {
        if (excess(c) <= Rounded(0.0))
            meet(c.along);
    }
    inline void at(const Cone::Corner& a, Rounded rise, Rounded share) {
        if (share >= Rounded(0.0) && share <= Rounded(1.0))
            meet(a.along + rise * share);
    }
    // Where an edge comes through the mantle.
    inline void edge(const Cone::Corner& a, const Cone::Corner& b) {
        const Rounded rise = b.along - a.along, square = cone.slope * cone.slope;
        const Triple way = b.beside - a.beside;
        const Rounded two = way.dot(way) - square * rise * rise, one = a.beside.dot(way) - square * a.along * rise;
        const Rounded none = excess(a), root = one * one - two * none;
        if (two == Rounded(0.0)) {
            if (!(one == Rounded(0.0)))
                at(a, rise, -none / (one * Rounded(2.0)));
        } else if (root >= Rounded(0.0)) {
            // Whichever sign does not cancel, and the other root by their product.
            const Rounded sum = one < Rounded(0.0) ? root.root() - one : -(one + root.root());
            at(a, rise, sum / two);
            if (!(sum == Rounded(0.0)))
                at(a, rise, none / sum);
        }
    }
    // The nearest and the farthest point of the cone in the plane, if they are in the triangle.
    inline void middle(const Cone::Corner& a, const Cone::Corner& b, const Cone::Corner& c) {
        const Cone::Plane p = cone.plane(a, b, c);
        Triple side;
        const bool leaning = cone.across(p.across, side);
        for (int sign = -1; sign <= 1; sign += 2) {
            const Triple way = leaning ? cone.axis + side * (cone.slope * Rounded(sign)) : cone.axis;
            const Rounded rate = p.normal.dot(way);
            if (!(rate > Rounded(0.0)))
                continue;
            const Rounded along = p.off / rate;
            const Triple point = way * along;
            if (inside(a, b, p, point) && inside(b, c, p, point) && inside(c, a, p, point))
                meet(along);
        }
    }
    static inline bool inside(const Cone::Corner& a, const Cone::Corner& b, const Cone::Plane& p, const Triple& point) {
        const Triple edge = b.place - a.place;
        return edge.cross(point - a.at).dot(p.normal) * Rounded(p.turned) >= Rounded(0.0);
    }
    static inline Rounded of(const Cone& cone, const Cone::Corner& a, const Cone::Corner& b, const Cone::Corner& c) {
        ConeEntry entry = { cone, Rounded(-1.0) };
        entry.corner(a);
        entry.corner(b);
        entry.corner(c);
        entry.edge(a, b);
        entry.edge(b, c);
        entry.edge(c, a);
        entry.middle(a, b, c);
        return entry.first;
    }
};
