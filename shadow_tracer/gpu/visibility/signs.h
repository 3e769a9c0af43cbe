// needs: device/doubles.h
// constants: MASK_PAD IN_PLACE_LEAST
// lanes
// LANES pairs of a ray and a triangle in float64, from the sample: which signs of the exact decision are certain;
// queries.py derives the pad.
struct WIDE(Signs) {
    typedef WIDE(Lanes) Lanes;
    typedef WIDE(Doubles) Doubles;
    typedef WIDE(Double) Number;

    struct Point {
        Number x, y, z;

        static inline Point between(const Point& from, const Point& to) {
            return { to.x - from.x, to.y - from.y, to.z - from.z };
        }
        inline Number sum() const { return Lanes::absolute(x) + Lanes::absolute(y) + Lanes::absolute(z); }
        inline Number length() const { return Doubles::root(x * x + y * y + z * z); }
        static inline int same(const Point& p, const Point& q) {
            return Doubles::bits((p.x == q.x) & (p.y == q.y) & (p.z == q.z));
        }
    };
    // The plane through the origin and two points: three components and what their magnitudes are sums of.
    struct Plane {
        Number x, y, z, size;

        static inline Plane through(const Point& a, const Point& b) {
            CONTRACTED
            return { a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x, a.sum() * b.sum() };
        }
        inline Number at(const Point& a) const {
            CONTRACTED
            return x * a.x + y * a.y + z * a.z;
        }
    };
    // The determinant of the ray's way and an edge from the sample, and by how much it may be off: its sign is the side
    // that the ray passes the edge on.
    struct Side {
        Number value, off;

        static inline Side of(const Point& p, const Point& way, const Point& a, const Point& b) {
            CONTRACTED
            const Plane plane = Plane::through(Point::between(p, a), Point::between(a, b));
            return { plane.at(way), MASK_PAD * way.sum() * plane.size };
        }
        // The same edge, from its end to its begin.
        inline Side back() const { return { -value, off }; }
        // Whether it is certain that the ray passes beside a triangle of these edges.
        static inline int beside(const Side& x, const Side& y, const Side& z) {
            return Doubles::bits(((x.value > x.off) | (y.value > y.off) | (z.value > z.off))
                                 & ((x.value < -x.off) | (y.value < -y.off) | (z.value < -z.off)));
        }
        // Whether the ray certainly passes it on the right, or on the left, as the light sees a triangle that turns to
        // the left where `turn` is 1, and to the right where it is -1.
        inline int right(Number turn) const { return Doubles::bits(turn * value < -off - IN_PLACE_LEAST); }
        inline int left(Number turn) const { return Doubles::bits(turn * value > off + IN_PLACE_LEAST); }
    };
    // The plane of a triangle: determinants of the sample and of the light with it, and by how much they may be off.
    struct Own {
        Number here, reach, there, off;

        static inline Own of(const Point& p, const Point& way, bool bounded, const Point& a, const Point& b,
                             const Point& c) {
            CONTRACTED
            const double w = bounded ? 1.0 : 0.0;
            const Point to_a = Point::between(p, a);
            const Plane plane = Plane::through(Point::between(a, b), Point::between(a, c));
            const Number here = -plane.at(to_a), reach = MASK_PAD * plane.size * to_a.sum();
            return { here, reach, plane.at(way) + w * here, MASK_PAD * plane.size * way.sum() + w * reach };
        }
        // Whether it is certain that sample and light are on the same side of it, or that the biased start is not
        // behind it, if the light is farther off than that, and the sample nearer. It is for most of those around a
        // sample, which would go to exact arithmetic, as the sample lies in their planes.
        inline int misses(Number bias, Number length, bool bounded) const {
            CONTRACTED
            const Number beyond = length - (bounded ? 1.0 : 0.0) * bias;
            return Doubles::bits(
                ((here > reach) & (there > off)) | ((here < -reach) & (there < -off))
                | ((bias > 0.0)
                   & ((Lanes::absolute(here) + reach) * beyond <= 0.99999999 * bias * (Lanes::absolute(there) - off))));
        }
        // Whether it is certain, of one that does not miss it, that the biased start is behind it, and the light before
        // it.
        inline int between(Number bias, Number length, bool bounded) const {
            CONTRACTED
            const Number behind = Lanes::absolute(here) - reach, before = Lanes::absolute(there) - off;
            const Number all = Lanes::absolute(there) + off;
            const Number front = all + (bounded ? 1.0 : 0.0) * (Lanes::absolute(here) + reach);
            return Doubles::bits((behind > IN_PLACE_LEAST) & (before > IN_PLACE_LEAST)
                                 & (behind * length >= 1.00000001 * bias * front));
        }
    };
};
