// needs: exact/rounded.h exact/determinant.h
// constants: CONE_BAND
// A cone from its apex to its end, and what is certain of it and a triangle; docs/exactness.md derives the bands. What
// is said to be so is so of the real cone, closed, edge and ends included; what is not may be.
struct Cone {
    struct Corner {
        Triple place;  // in the world
        Triple at;     // from the apex
        Triple beside; // of that what is across the axis
        Rounded along; // and along it
        Rounded size;
    };
    // Of a triangle's plane, turned away from the apex.
    struct Plane {
        Triple normal, across; // across: of the normal what is across the axis
        Rounded off;           // of the plane from the apex, in units of the normal
        Rounded along, aside;  // of the normal: its part along the axis, the size of that across it
        Rounded band;
        double turned; // 1, or -1 if a triangle's corners are clockwise as seen from the apex
        bool ahead;    // the apex is certainly not in the plane
    };
    Triple apex, axis; // the axis as a unit
    Rounded slope, length, band;

    // From `from` towards `to`, which may be the end; slope: the tangent of the half angle.
    inline Cone(const wp::vec3d& from, const Triple& way, double slope, double length)
        : apex(from), slope(slope), length(length), band(Rounded(CONE_BAND) * (Rounded(1.0) + Rounded(slope))) {
        axis = way * (Rounded(1.0) / way.length());
    }
    inline Corner corner(const wp::vec3d& place) const {
        Corner c;
        c.place = Triple(place);
        c.at = c.place - apex;
        c.along = c.at.dot(axis);
        c.beside = c.at - axis * c.along;
        c.size = c.at.length();
        return c;
    }
    static inline bool finite(const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c) {
        return wp::isfinite(a) && wp::isfinite(b) && wp::isfinite(c);
    }
    // Whether a triangle has no area, exactly: each component of its normal is a determinant.
    static inline bool flat(const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c) {
        const Triple one = Triple(b) - Triple(a), two = Triple(c) - Triple(a);
        const Triple normal = one.cross(two);
        if (Rounded(Arithmetic::absolute(normal.x.number) + Arithmetic::absolute(normal.y.number)
                    + Arithmetic::absolute(normal.z.number))
            > Rounded(CONE_BAND) * one.length() * two.length())
            return false;
#pragma unroll 1
        for (int k = 0; k < 3; ++k) {
            double value;
            int used = 0;
            const wp::vec4d unit(k == 0 ? 1.0 : 0.0, k == 1 ? 1.0 : 0.0, k == 2 ? 1.0 : 0.0, 0.0);
            if (Determinant::sign(unit, b, c, a, value, used) != 0)
                return false;
        }
        return true;
    }
    // Whether a triangle certainly misses the cone because both are apart along a way that is soon found: from the axis
    // to the triangle's middle. Most do.
    inline bool far_off(const wp::vec3d& p, const wp::vec3d& q, const wp::vec3d& r) const {
        const Triple a = Triple(p) - apex, b = Triple(q) - apex, c = Triple(r) - apex, sum = a + b + c;
        const Rounded one = a.dot(axis), two = b.dot(axis), three = c.dot(axis);
        const Triple side = sum - axis * (one + two + three);
        const Rounded steep = slope * side.length();
        const Rounded pad = band * sum.sum() * (a.sum() + b.sum() + c.sum());
        return side.dot(a) - steep * one > pad && side.dot(b) - steep * two > pad && side.dot(c) - steep * three > pad;
    }
    // How far a point is outside of the plane that touches the cone on the side of `side`, a unit across the axis.
    inline Rounded outside(const Corner& c, const Triple& side) const { return side.dot(c.beside) - slope * c.along; }
    // A unit across the axis, of what is nearly so; false if there is none.
    inline bool across(const Triple& way, Triple& side) const {
        const Rounded size = way.length();
        if (!(size > Rounded(0.0)))
            return false;
        const Triple unit = way * (Rounded(1.0) / size);
        const Triple straight = unit - axis * unit.dot(axis);
        const Rounded left = straight.length();
        if (!(left > Rounded(0.5)))
            return false;
        side = straight * (Rounded(1.0) / left);
        return true;
    }
    // Whether an edge certainly misses the cone. side: where the cone is nearest to it; `sided` if there is such.
    inline bool edge_misses(const Corner& a, const Corner& b, Triple& side, bool& sided) const {
        const Rounded pad = band * (a.size + b.size), slack = pad + band * length, high = length + slack;
        sided = false;
        if ((a.along < -slack && b.along < -slack) || (a.along > high && b.along > high))
            return true;
        // What of it is before the end.
        const Rounded rise = b.along - a.along, zero = 0.0, one = 1.0;
        Rounded first = zero, last = one;
        if (a.along > high)
            first = within((high - a.along) / rise, zero, one);
        else if (b.along > high)
            last = within((high - a.along) / rise, zero, one);
        // Where |beside| - slope * along is least there: it is convex.
        const Triple way = b.beside - a.beside;
        const Rounded square = way.dot(way);
        Rounded nearest = rise > zero ? last : first;
        if (square > zero) {
            const Rounded size = square.root(), foot = -(a.beside.dot(way) / square);
            const Rounded sine = slope * rise / size;
            if (sine <= -one)
                nearest = first;
            else if (sine < one)
                nearest = foot + (a.beside + way * foot).length() * sine / ((one - sine * sine).root() * size);
        }
        nearest = within(nearest, first, last);
        sided = across(a.beside + way * nearest, side);
        if (!sided)
            return false;
        const Rounded from = outside(a, side), to = outside(b, side);
        return from + (to - from) * first > pad && from + (to - from) * last > pad;
    }
    static inline Rounded within(Rounded x, Rounded low, Rounded high) { return x < low ? low : x > high ? high : x; }
    inline Plane plane(const Corner& a, const Corner& b, const Corner& c) const {
        const Triple one = b.place - a.place, two = c.place - a.place;
        Plane p;
        p.normal = one.cross(two);
        p.off = p.normal.dot(a.at);
        p.turned = p.off < Rounded(0.0) ? -1.0 : 1.0;
        p.normal = p.normal * Rounded(p.turned);
        p.off = p.off * Rounded(p.turned);
        p.along = p.normal.dot(axis);
        p.across = p.normal - axis * p.along;
        p.aside = p.across.length();
        p.band = band * one.length() * two.length() * (a.size + b.size + c.size + length);
        p.ahead = p.off > p.band;
        return p;
    }
    // Whether every ray of the cone certainly meets the plane before the end.
    inline bool cut_by(const Plane& p) const {
        return p.ahead && length * (p.along - slope * p.aside) - p.off > p.band;
    }
    // Of the plane through the apex and an edge: its normal, towards the triangle's third corner.
    static inline Triple edge_plane(const Corner& a, const Corner& b, const Plane& p) {
        return a.at.cross(b.place - a.place) * Rounded(p.turned);
    }
    inline Rounded edge_band(const Corner& a, const Corner& b) const {
        return band * a.size * (b.place - a.place).length();
    }
    // Whether all of the cone but its apex is certainly on the third corner's side of that plane.
    inline bool on_side(const Corner& a, const Corner& b, const Plane& p) const {
        const Triple normal = edge_plane(a, b, p);
        const Rounded along = normal.dot(axis);
        return along - slope * (normal - axis * along).length() > edge_band(a, b);
    }
    inline bool covered_by(const Corner& a, const Corner& b, const Corner& c, const Plane& p) const {
        return cut_by(p) && on_side(a, b, p) && on_side(b, c, p) && on_side(c, a, p);
    }
    // Whether a direction, of about a unit's size, certainly is on the other side of it.
    inline bool beyond(const Corner& a, const Corner& b, const Plane& p, const Triple& way) const {
        return edge_plane(a, b, p).dot(way) < -edge_band(a, b);
    }
    // Whether the cone is certainly beside a plane that touches it, and the triangle on the other side.
    inline bool apart(const Corner& a, const Corner& b, const Corner& c, const Triple& side) const {
        const Rounded pad = band * (a.size + b.size + c.size);
        return outside(a, side) > pad && outside(b, side) > pad && outside(c, side) > pad;
    }
    // Whether a triangle certainly misses the cone.
    inline bool misses(const Corner& a, const Corner& b, const Corner& c) const {
        const Rounded slack = band * (a.size + b.size + c.size + length), high = length + slack;
        if (a.along < -slack && b.along < -slack && c.along < -slack)
            return true;
        if (a.along > high && b.along > high && c.along > high)
            return true;
        Triple side;
        if (across(a.beside + b.beside + c.beside, side) && apart(a, b, c, side))
            return true;
        bool sided;
        if (!edge_misses(a, b, side, sided))
            return false;
        if (sided && apart(a, b, c, side))
            return true;
        if (!edge_misses(b, c, side, sided))
            return false;
        if (sided && apart(a, b, c, side))
            return true;
        if (!edge_misses(c, a, side, sided))
            return false;
        if (sided && apart(a, b, c, side))
            return true;
        // No edge meets the cone: all that the cone cuts out of the plane is within the triangle, or nothing of it.
        const Plane p = plane(a, b, c);
        if (!p.ahead)
            return false;
        if (p.off - length * (p.along + slope * p.aside) > p.band)
            return true;
        Triple way = axis;
        if (p.aside > Rounded(0.0) && across(p.across, side))
            way = axis + side * slope;
        if (!(length * p.normal.dot(way) - p.off > p.band))
            return false;
        return beyond(a, b, p, way) || beyond(b, c, p, way) || beyond(c, a, p, way);
    }
    // Whether what the triangle cuts out of the infinite cone is certainly before the end.
    inline bool before_end(const Corner& a, const Corner& b, const Corner& c, const Plane& p) const {
        const Rounded low = length - band * (a.size + b.size + c.size + length);
        return (a.along < low && b.along < low && c.along < low) || cut_by(p);
    }
};
