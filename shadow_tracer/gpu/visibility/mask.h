// needs: exact/decision.h visibility/sides.h
// arguments: Asked asked
// constants: SHADOWED RAYS LEAF_TESTS NODES_VISITED RETESTED EXACT COUNTER_ROWS MASK_PAD
// The query *mask*: which of up to 64 points of a light a sample does not see. All of them in one walk, of the bundle
// of rays to a sphere around the points; queries.py derives the filter's pad.
struct PointMask1 {
    enum { SPREADS = 1 };
#if defined(__CUDA_ARCH__)
    enum { TOGETHER = 1, GROUP = 1 };
    typedef double Reals;
    typedef int Bits;
    static inline wp::uint64 bits(Bits x) { return x & 1; }
#else
    // Points that are judged together.
    enum { TOGETHER = 8, GROUP = 0xFF, MOST = 64 };
    typedef double Reals __attribute__((ext_vector_type(8), aligned(8)));
    typedef decltype(Reals() < Reals()) Bits;
    typedef bool Bit8s __attribute__((ext_vector_type(8)));
    static inline wp::uint64 bits(Bits x) {
        return __builtin_bit_cast(unsigned char, __builtin_convertvector(x, Bit8s));
    }
    double x[MOST], y[MOST], z[MOST], length[MOST], far[MOST]; // of the sample that asks, once they are `known`
    bool known;
    // For the walk: places in its structure where points have been hidden from the sample before.
    enum { KEPT = 8 };
    int kept[KEPT], keeps;
    // And whether it has been worth of late to look closer at what is below a node: each look costs as much as it must
    // spare on average. Where it has not, it is tried again now and then.
    struct Spares {
        enum { LEAST = -4, MOST = 16, GAIN = 2, SELDOM = 31 };
        int balance;

        inline bool worth(wp::int64 nodes) const { return balance >= 0 || !(nodes & SELDOM); }
        inline void learn(int spared) {
            const int now = balance + GAIN * spared - 1;
            balance = now < LEAST ? LEAST : now > MOST ? MOST : now;
        }
    } spares;
    // Samples that follow each other in a list, which mostly are close to each other: the walk may know that nothing
    // hides any point from those up to `end`. Whether it has been worth of late to find out.
    struct Neighbours {
        enum { TOGETHER = 16, FEWEST = 4 };
        int end;
        bool free;
        Spares tries;
    } neighbours;
    // The triangle that hid all points from the sample before, less the number of that sample, and whether it was the
    // same of the one before: mostly samples of a list are on triangles that follow each other, too.
    int ahead;
    bool follows;
#endif
    // To the middle of the light; magnitudes of the way to any point, times the pad; the least and the most length.
    wp::vec3d middle;
    double farthest, shortest, longest;
    const Asked& asked;
    int ray[1], taken;
    int hider; // the triangle that hid a point last, -1 if none has
    wp::uint64 open;
    wp::int64 rays, tests, nodes, retested, exact;

    inline explicit PointMask1(const Asked& asked)
        : asked(asked), taken(0), hider(-1), open(0), rays(0), tests(0), nodes(0), retested(0), exact(0) {
#if !defined(__CUDA_ARCH__)
        keeps = 0, spares.balance = 0;
        neighbours.end = 0, neighbours.free = false, neighbours.tries.balance = 0;
        ahead = 0, follows = false;
#endif
    }
    // One in `every`, of an image no columns: numbers are scattered first (the finalizer of MurmurHash3), and the least
    // are taken. Remainders would not do, as those by a power of two depend on low bits alone.
    inline bool chosen(int number) const {
        unsigned mixed = (unsigned)number;
        mixed = (mixed ^ mixed >> 16) * 0x85EBCA6Bu;
        mixed = (mixed ^ mixed >> 13) * 0xC2B2AE35u;
        return (wp::uint64)(mixed ^ mixed >> 16) * (wp::uint64)asked.every >> 32 == 0;
    }
    // Samples in turn: of an image in tiles of four by four pixels of each four rows, so that each is close to those
    // before it.
    inline int turn(int number) const {
        enum { SIDE = 4 };
        const int width = asked.width, whole = SIDE * width;
        if (width <= 0 || number / whole * whole + whole > asked.samples)
            return number;
        const int base = number / whole * whole, within = number - base, tiled = width / SIDE * SIDE * SIDE;
        if (within < tiled)
            return base + (within >> 2 & 3) * width + (within >> 4) * SIDE + (within & 3);
        const int rest = within - tiled, columns = width % SIDE;
        return base + rest / columns * width + width - columns + rest % columns;
    }
    inline void take(int number) {
#if !defined(__CUDA_ARCH__)
        number = turn(number);
#endif
        if (asked.states.data[number] > SHADOWED || !chosen(number))
            return;
        ray[0] = number;
        taken = 1;
    }
    inline bool full() const { return taken == 1; }
    inline void begin() {
        open = ~(wp::uint64)0 >> (64 - asked.count);
        hider = -1;
        rays += asked.count;
        const wp::vec4d &at = asked.positions.data[ray[0]], &light = asked.middle;
        const wp::vec3d& e = asked.extent;
        middle = wp::vec3d(light[0] - light[3] * at[0], light[1] - light[3] * at[1], light[2] - light[3] * at[2]);
        farthest = MASK_PAD * (Sides::Plane::sum(middle) + Sides::Plane::sum(e));
        // To the nearest and the farthest corner of the box around the points; a flat light's is flat.
        double near = 0.0, far = 0.0;
        for (int k = 0; k < 3; ++k) {
            const double apart = fabs(middle[k]), least = apart > e[k] ? apart - e[k] : 0.0;
            near += least * least, far += (apart + e[k]) * (apart + e[k]);
        }
        longest = sqrt(far), shortest = sqrt(near) - 1e-12 * longest; // more than roundings
#if !defined(__CUDA_ARCH__)
        known = false;
#endif
    }
#if !defined(__CUDA_ARCH__)
    // The box around the samples from this one on that ask, up to where those end that are looked at together; how many
    // they are.
    inline int around(wp::vec3d& low, wp::vec3d& high) {
        const int first = ray[0];
        neighbours.end = first - first % Neighbours::TOGETHER + Neighbours::TOGETHER;
        low = high =
            wp::vec3d(asked.positions.data[first][0], asked.positions.data[first][1], asked.positions.data[first][2]);
        int count = 0;
        for (int number = first; number < neighbours.end && number < asked.samples; ++number) {
            if (asked.states.data[number] > SHADOWED)
                continue;
            ++count;
            const wp::vec4d& at = asked.positions.data[number];
            for (int k = 0; k < 3; ++k) {
                low[k] = at[k] < low[k] ? at[k] : low[k];
                high[k] = at[k] > high[k] ? at[k] : high[k];
            }
        }
        return count;
    }
    inline void know() {
        const wp::vec4d& p = asked.positions.data[ray[0]];
        for (int k = 0; k < asked.count; ++k) {
            const wp::vec4d& light = asked.points.data[k];
            x[k] = light[0] - light[3] * p[0], y[k] = light[1] - light[3] * p[1], z[k] = light[2] - light[3] * p[2];
            length[k] = sqrt(x[k] * x[k] + y[k] * y[k] + z[k] * z[k]);
            far[k] = MASK_PAD * (fabs(x[k]) + fabs(y[k]) + fabs(z[k]));
        }
        known = true;
    }
    // Takes in what a filter has found: the points that a triangle surely hides, and those that it may hide, as bits.
    inline void judged(int triangle, wp::uint64 sure, wp::uint64 maybe) {
        wp::uint64 hidden = open & maybe;
        for (wp::uint64 left = asked.cull == 0 ? hidden & ~sure : hidden; left; left &= left - 1)
            if (!hides(lowest(left), triangle))
                hidden &= ~(left & -left);
        open &= ~hidden;
        if (hidden)
            hider = triangle;
    }
    // The same of one point and some triangles, as bits; none of them hides it for sure.
    inline void judged_at(int k, const int* triangles, int maybe) {
        while (maybe && !hides(k, triangles[__builtin_ctz(maybe)]))
            maybe &= maybe - 1;
        open &= ~((wp::uint64)(maybe != 0) << k);
    }
    // A triangle hides all of them, whatever its side.
    inline void hidden_by(int triangle) {
        open = 0;
        hider = triangle;
        follows = asked.width <= 0 && ahead == triangle - ray[0];
        ahead = triangle - ray[0];
    }
    // Whether the triangle that follows the one that hid all points from the sample before hides them all.
    inline bool hidden_by_next() {
        const int triangle = ray[0] + ahead;
        if (!follows || triangle < 0 || triangle >= asked.triangle_count)
            return false;
        ++tests;
        const wp::vec3i& corner = asked.triangles.data[triangle];
        const wp::vec3d &a = asked.vertices.data[corner[0]], &b = asked.vertices.data[corner[1]],
                        &c = asked.vertices.data[corner[2]];
        const wp::vec4d& at = asked.positions.data[ray[0]];
        follows = wp::isfinite(a) && wp::isfinite(b) && wp::isfinite(c)
                  && together(Sides(wp::vec3d(at[0], at[1], at[2]), a, b, c), at[3], asked.middle[3]) == ALL;
        if (follows)
            hidden_by(triangle);
        return follows;
    }
    inline bool hides(int k, int triangle) {
        const wp::vec3i& corner = asked.triangles.data[triangle];
        return hides(k, asked.vertices.data[corner[0]], asked.vertices.data[corner[1]], asked.vertices.data[corner[2]]);
    }
#endif
    // The exact decision about light point number k, and where front faces cast nothing about that.
    inline bool hides(int k, const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c) {
        const wp::vec4d light = asked.points.data[k];
        ++retested;
        double value;
        int used = 0;
        if (asked.cull != 0 && Determinant::sign(light, b, c, a, value, used) >= 0)
            return false;
        const int answer = Decision::of(asked.positions.data[ray[0]], light, a, b, c);
        exact += answer >> 1;
        return answer & 1;
    }
    // Points of the light from the sample: where they are, their distance, and its magnitude times the pad. Of a light
    // at infinity, the ways to them and their lengths: 0 and 1 times a number are exact, contracted or not.
    struct Ways {
        Reals x, y, z, length, far;
    };
    inline Ways ways(int first) const {
#if defined(__CUDA_ARCH__)
        const wp::vec4d &light = asked.points.data[first], &p = asked.positions.data[ray[0]];
        const double dx = light[0] - light[3] * p[0], dy = light[1] - light[3] * p[1], dz = light[2] - light[3] * p[2];
        return { dx, dy, dz, sqrt(dx * dx + dy * dy + dz * dz), MASK_PAD * (fabs(dx) + fabs(dy) + fabs(dz)) };
#else
        return { *(const Reals*)(x + first), *(const Reals*)(y + first), *(const Reals*)(z + first),
                 *(const Reals*)(length + first), *(const Reals*)(far + first) };
#endif
    }
    // All points of the light together: NONE is hidden, ALL are, or SOME may be. Each determinant of a point is within
    // what the box around the points lets it be.
    enum { NONE, ALL, SOME };
    struct Span {
        double low, high;

        inline Span(const Sides::Plane& plane, const wp::vec3d& middle, const wp::vec3d& e, double far) {
            const double at = plane.at(middle), pad = plane.size * far,
                         beside = fabs(plane.x) * e[0] + fabs(plane.y) * e[1] + fabs(plane.z) * e[2];
            low = at - beside - pad, high = at + beside + pad;
        }
    };
    inline int together(const Sides& sides, double bias, double w) const {
        const Span ab(sides.edge[0], middle, asked.extent, farthest), bc(sides.edge[1], middle, asked.extent, farthest),
            ca(sides.edge[2], middle, asked.extent, farthest);
        const bool negative = (ab.high < 0.0) | (bc.high < 0.0) | (ca.high < 0.0);
        const bool positive = (ab.low > 0.0) | (bc.low > 0.0) | (ca.low > 0.0);
        if (negative & positive)
            return NONE;
        if (!sides.sure)
            return SOME;
        const Span own(sides.own, middle, asked.extent, farthest);
        const double side = sides.here > 0.0 ? 1.0 : -1.0, here = fabs(sides.here);
        const double low = side * (side > 0.0 ? own.low : own.high), high = side * (side > 0.0 ? own.high : own.low);
        // Behind the own plane are points by -(w here + ...); low and high are of what is added to w here.
        const double least_behind = -high - w * (here + sides.reach), most_behind = -low - w * (here - sides.reach);
        if (most_behind < 0.0)
            return NONE;
        const double fewest = bias * (w * (here - sides.reach) + least_behind);
        if (least_behind > 0.0 && 1.000000000001 * (here + sides.reach) * longest < fewest)
            return NONE;
        const bool inside =
            ((ab.low > 0.0) & (bc.low > 0.0) & (ca.low > 0.0)) | ((ab.high < 0.0) & (bc.high < 0.0) & (ca.high < 0.0));
        const double most = bias * (w * (here + sides.reach) + most_behind);
        const bool after = (here - sides.reach) * shortest > 1.000000000001 * most;
        return inside && after && least_behind > 0.0 && asked.cull == 0 ? ALL : SOME;
    }
    // What the filter says about them: those that are surely hidden, and those that may be.
    // w: 1, or 0 for a light at infinity.
    static inline void judge(const Sides& sides, double bias, double w, const Ways& way, Bits& hidden, Bits& maybe) {
        Reals at[3], pad[3];
        for (int k = 0; k < 3; ++k) {
            at[k] = sides.edge[k].x * way.x + sides.edge[k].y * way.y + sides.edge[k].z * way.z;
            pad[k] = sides.edge[k].size * way.far;
        }
        const Reals there = w * sides.here + sides.own.x * way.x + sides.own.y * way.y + sides.own.z * way.z;
        const Reals off = w * sides.reach + sides.own.size * way.far;
        const Bits inside = (at[0] > pad[0]) | (at[1] > pad[1]) | (at[2] > pad[2]);
        const Bits outside = (at[0] < -pad[0]) | (at[1] < -pad[1]) | (at[2] < -pad[2]);
        const Bits all = ((at[0] > pad[0]) & (at[1] > pad[1]) & (at[2] > pad[2]))
                         | ((at[0] < -pad[0]) & (at[1] < -pad[1]) & (at[2] < -pad[2]));
        const double side = sides.here > 0.0 ? 1.0 : -1.0, here = fabs(sides.here);
        const Reals behind = -side * there; // of the own plane, seen from the sample
        // The biased start is on the sample's side, too, by more than what either computation may be off.
        const Reals least = (here - sides.reach) * way.length, most = w * (here + sides.reach) + behind + off;
        // Or it surely is not: mostly the sample's own surface, of which it is a little behind.
        const Reals most_here = (here + sides.reach) * way.length, fewest = w * (here - sides.reach) + behind - off;
        const Bits same = behind<-off, other = behind> off;
        const Bits after = bias > 0.0 ? Bits(least > 1.000000000001 * bias * most) : other;
        const Bits before = 1.000000000001 * most_here < bias * fewest;
        maybe = ~(inside & outside);
        hidden = all & other & after;
        if (sides.sure)
            maybe &= ~(same | before);
        else
            hidden &= ~hidden;
    }
    // Shows a triangle; true if no point is seen any more.
    inline bool visit(int triangle) {
        ++tests;
        const wp::vec3i& corner = asked.triangles.data[triangle];
        const wp::vec3d a = asked.vertices.data[corner[0]], b = asked.vertices.data[corner[1]],
                        c = asked.vertices.data[corner[2]];
        if (!wp::isfinite(a) || !wp::isfinite(b) || !wp::isfinite(c))
            return false;
#if !defined(__CUDA_ARCH__)
        if (!known)
            know();
#endif
        const wp::vec4d& at = asked.positions.data[ray[0]];
        const Sides sides(wp::vec3d(at[0], at[1], at[2]), a, b, c);
        const int answer = together(sides, at[3], asked.middle[3]);
        if (answer == NONE)
            return false;
        const wp::uint64 before = open;
        if (answer == ALL)
            open = 0;
        for (int first = 0; first < asked.count; first += TOGETHER) {
            const wp::uint64 mine = open >> first & GROUP;
            if (!mine)
                continue;
            Bits sure, maybe;
            judge(sides, at[3], asked.middle[3], ways(first), sure, maybe);
            wp::uint64 hidden = mine & bits(maybe);
            if (!hidden)
                continue;
            const wp::uint64 certain = asked.cull == 0 ? bits(sure) : 0;
            for (wp::uint64 left = hidden & ~certain; left; left &= left - 1)
                if (!hides(first + lowest(left), a, b, c))
                    hidden &= ~(left & -left);
            open &= ~(hidden << first);
        }
        if (open != before)
            hider = triangle;
        return open == 0;
    }
    static inline int lowest(wp::uint64 bits) {
#if defined(__CUDA_ARCH__)
        return __ffsll((long long)bits) - 1;
#else
        return __builtin_ctzll(bits);
#endif
    }
    inline void everything() {
        for (int t = 0; t < asked.triangle_count; ++t)
            if (visit(t))
                return;
    }
    inline int triangle_count() const { return asked.triangle_count; }
    // The sample, the middle of the light, and how far its points are from there along each axis [m]; at infinity, how
    // far the ends of the ways to them are from the end of the way to its middle, which has length 1, across that.
    inline const wp::vec4d& sample() const { return asked.positions.data[ray[0]]; }
    inline const wp::vec4d& light() const { return asked.middle; }
    inline const wp::vec3d& spread() const { return asked.extent; }
    static inline bool shortened(double& metres) { return false; }
    inline void end() {
        asked.seen.data[ray[0]] = open;
        taken = 0;
    }
    inline void report(int row) const {
        wp::int64* counter = asked.counters.data + (size_t)(row & (COUNTER_ROWS - 1)) * asked.counters.shape[1];
        const wp::int64 counts[5] = { rays, tests, nodes, retested, exact };
        const int columns[5] = { RAYS, LEAF_TESTS, NODES_VISITED, RETESTED, EXACT };
        for (int k = 0; k < 5; ++k)
            if (counts[k])
                wp::atomic_add(counter + columns[k], counts[k]);
    }
};
typedef PointMask1 Query1;
