// needs: visibility/in_place.h
// The triangles of a quad. The plane through a ray's sample and the diagonal says for both on which side the ray
// passes; by that and four more of them most are ruled out.
struct Quad {
    // Shows them, whose numbers are `first` and the next; true if one hides the ray.
    static inline bool show(Query1& query, int first) {
        const auto& asked = query.asked;
        const wp::vec3i &one = asked.triangles.data[first], &two = asked.triangles.data[first + 1];
        const wp::vec3d &a = asked.vertices.data[one[0]], &c = asked.vertices.data[one[1]],
                        &d = asked.vertices.data[one[2]], &b = asked.vertices.data[two[2]];
        // Of those that lack a corner some are cut along the other diagonal; those that are left out have no corner.
        int possible = 3; // as bits
        if (wp::isfinite(a) && wp::isfinite(b) && wp::isfinite(c) && wp::isfinite(d)) {
            typedef InPlace1::Side Side;
            typedef InPlace1::Point Point;
            const Point p = InPlace1::point(query.sample()), way = query.way(p);
            const Point at_a = InPlace1::point(a), at_b = InPlace1::point(b), at_c = InPlace1::point(c),
                        at_d = InPlace1::point(d);
            if (Point::same(p, at_a) | Point::same(p, at_d)) { // corners of both
                query.tests += 2;
                return false;
            }
            const Side across = Side::of(p, way, at_d, at_a);
            if (Side::beside(Side::of(p, way, at_a, at_c), Side::of(p, way, at_c, at_d), across))
                possible -= 1;
            if (Side::beside(across.back(), Side::of(p, way, at_d, at_b), Side::of(p, way, at_b, at_a)))
                possible -= 2;
            query.tests += 2 - (possible & 1) - (possible >> 1);
        }
        // One call in a loop that stays a loop: what decides is large.
#pragma unroll 1
        for (int k = 0; k < 2; ++k)
            if ((possible >> k & 1) && query.visit(first + k))
                return true;
        return false;
    }
};
