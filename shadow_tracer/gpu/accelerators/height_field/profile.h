// needs: device/lanes.h accelerators/height_field/place.h
// arguments: Sweep sweep, DeviceChart chart
// constants: SWEEP_STRETCH SWEEP_PAD SWEEP_BESIDE SWEEP_WEIGHT
// lanes
// LANES rays over the heights of a swept chart, from line to line, row to row and diagonal to diagonal, until a bound
// says what becomes of them; see sweep.py.
struct WIDE(Profile) {
#if LANES == 1
    typedef double Number;
    typedef int Truth;
#else
    typedef double Number __attribute__((ext_vector_type(LANES), aligned(8)));
    typedef long Truth __attribute__((ext_vector_type(LANES), aligned(8)));
#endif
    const Sweep& sweep;
    const float *heights, *bounds;
    Number x, y, v;           // where the rays are: along the lines' way, height, across
    Number from;              // where along the way it begins to matter
    Number line, begin, next; // the last line; where they crossed it, or began behind it; where they cross the next one
    Number side;              // 1: it has been above the surface, -1: below it, where it mattered
    Truth biased;
    Truth clear;       // it has met nothing so far
    Truth active;      // those of which it is not known
    Truth lit, hidden; // what has been found out
    wp::int64 strips;  // that they have crossed, all together

    inline WIDE(Profile)(const Sweep& sweep, const float* heights, const float* bounds)
        : sweep(sweep), heights(heights), bounds(bounds), strips(0) {}
    static inline int bits(Truth x) {
#if LANES == 1
        return x != 0;
#else
        return __builtin_bit_cast(unsigned short, __builtin_convertvector(x, WIDE(Bit)));
#endif
    }
    static inline int count(Truth x) {
#if LANES == 1
        return x != 0;
#else
        return __builtin_popcount(bits(x));
#endif
    }
    static inline Number down(Number x) {
#if LANES == 1
        return floor(x);
#else
        return __builtin_elementwise_floor(x);
#endif
    }
    static inline Number size(Number x) {
#if LANES == 1
        return fabs(x);
#else
        return __builtin_elementwise_abs(x);
#endif
    }
    static inline double lane(Number x, int j) {
#if LANES == 1
        return x;
#else
        return x[j];
#endif
    }
    static inline Number load(const double* from) {
#if LANES == 1
        return *from;
#else
        return *(const Number*)from;
#endif
    }
    static inline Number smaller(Number x, Number y) { return x < y ? x : y; }
    // Where `asked`, numbers of an array, whole ones from `index` on.
    static inline Number gather(const float* from, Truth asked, Number index) {
#if LANES == 1
        return asked ? from[(wp::int64)index] : 0.0;
#else
        const Truth number = __builtin_convertvector(asked ? index : (Number)0.0, Truth);
        float some[LANES];
        for (int j = 0; j < LANES; ++j)
            some[j] = from[number[j]];
        return __builtin_convertvector(WIDE(Lanes)::load(some), Number);
#endif
    }
    static inline Number snapped(Number value) {
        const Number whole = down(value + 0.5);
        return size(value - whole) < SWEEP_BESIDE ? whole : value;
    }
    // Corners of a quad: on the line and on the next one, at the place and at the next one.
    struct Quad {
        Number a, b, c, d;
    };
    inline Quad quad(Truth asked, Number at, Number place) const {
        const float* from = heights + sweep.base;
        const Number index = at * (double)sweep.next_line + place * (double)sweep.next;
        return { gather(from, asked, index), gather(from + sweep.next_line, asked, index),
                 gather(from + sweep.next, asked, index), gather(from + sweep.next_line + sweep.next, asked, index) };
    }
    // The height of the surface within a quad.
    inline Number surface(const Quad& q, Number X, Number V) const {
        if (sweep.mirrored)
            return X + V <= 1.0 ? q.a + X * (q.b - q.a) + V * (q.c - q.a)
                                : q.d + (1.0 - X) * (q.c - q.d) + (1.0 - V) * (q.b - q.d);
        return V >= X ? q.a + V * (q.c - q.a) + X * (q.d - q.c) : q.a + X * (q.b - q.a) + V * (q.d - q.b);
    }
    // Those of some lanes of which all quads that the ray may touch between its lines are there.
    inline Truth whole(Truth some) const {
        Truth found = some;
        for (int j = 0; j < LANES; ++j)
            if (bits(some) >> j & 1) {
                const double one = lane(begin, j), two = lane(next, j);
                const int first = (int)floor((one < two ? one : two) - 0x1p-20);
                const int last = (int)ceil((one < two ? two : one) + 0x1p-20);
                const float* here = heights + sweep.base + (wp::int64)lane(line, j) * sweep.next_line;
                bool there = first >= 0 && last < sweep.across;
                for (int k = first; there && k <= last; ++k) {
                    const float sum =
                        here[(wp::int64)k * sweep.next] + here[sweep.next_line + (wp::int64)k * sweep.next];
                    there = sum == sum;
                }
#if LANES == 1
                found = there;
#else
                found[j] = there ? found[j] : 0;
#endif
            }
        return found;
    }
    // Takes note of how far rays are above the surface at places along the way.
    inline void note(Truth some, Number over, Number place) {
        const Number one = 1.0, none = 0.0;
        const Number now = over > SWEEP_PAD ? one : (over < -SWEEP_PAD ? -one : none);
        const Truth changed = some & ((now == 0.0) | (side * now < 0.0));
        const Truth crossed = changed & (now != 0.0);
        if (bits(crossed))
            hidden = hidden | whole(crossed);
        active = active & (changed == 0);
        clear = clear & ((some == 0) | (now > 0.0));
        side = (some & (place >= from)) ? now : side;
    }
    // The place of a band on a line, where its bounds are.
    inline Number bound(Number at) const { return down(v - sweep.drift * x) - down(-(sweep.drift * at)); }
    // What the bounds on a line say that rays have come to.
    inline void bounded(Truth some, Number at) {
        const Number place = bound(at);
        const Truth there = some & (place >= 0.0) & (place < (double)sweep.across); // else it is beside the surface
        const Number index = at * (double)sweep.pitch + place, level = y - sweep.rise * at;
        const double pad = sweep.pad;
        const Truth above = there & clear & (level > gather(bounds, there, index) + pad);
        lit = lit | above;
        active = active & (above == 0);
        const Truth left = there & (above == 0) & (biased == 0);
        if (bits(left)) {
            const size_t plane = (size_t)sweep.lines * sweep.pitch;
            const Truth over = (side > 0.0) & (level < gather(bounds + plane, left, index) - pad);
            const Truth under = (side < 0.0) & (level > gather(bounds + 2 * plane, left, index) + pad);
            const Truth met = left & (over | under);
            hidden = hidden | met;
            active = active & (met == 0);
        }
    }
    // Some are on a line, or behind it where they begin.
    inline void enter(Truth some) {
        Truth over = some & (line >= (double)(sweep.lines - 1));
        if (sweep.rise >= 0.0)
            over = over | (some & (side > 0.0) & (y > 65536.0));
        lit = lit | (over & clear);
        active = active & (over == 0);
        begin = some ? v : begin;
        next = some ? v + sweep.drift * (line + 1.0 - x) : next;
    }
    // Rays that are on the first line of a stretch, and above all that their bands hold of it, go on to its end;
    // returns which.
    inline Truth jump() {
        const double lines = SWEEP_STRETCH;
        const Number stretch = line * (1.0 / lines);
        Truth some = active & clear & (side > 0.0) & (x == line) & (stretch == down(stretch))
                     & (line + lines <= (double)(sweep.lines - 1));
        if (!bits(some))
            return some;
        const Number place = bound(line);
        some = some & (place >= 0.0) & (place < (double)sweep.across);
        const float* stretches = bounds + 3 * (size_t)sweep.lines * sweep.pitch;
        const Number most = gather(stretches, some, stretch * (double)sweep.pitch + place);
        some = some & (y - sweep.rise * line > most + (double)sweep.pad);
        if (!bits(some))
            return some;
        strips += count(some);
        x = some ? line + lines : x;
        y = some ? y + sweep.rise * lines : y;
        v = some ? v + sweep.drift * lines : v;
        line = some ? x : line;
        bounded(some, line);
        enter(some & active);
        return some;
    }
    // To where the ray leaves the quad that it is in.
    inline void step() {
        const Truth jumped = jump(), active = this->active & (jumped == 0);
        if (!bits(active))
            return;
        const Number x1 = line + 1.0;
        Number place = down(v);
        if (sweep.drift < 0.0)
            place = v == place ? place - 1.0 : place;
        else if (sweep.drift == 0.0)
            place = ((v == place) & (place == (double)(sweep.across - 1))) ? place - 1.0 : place;
        const Truth out = active & ((place < 0.0) | (place >= (double)(sweep.across - 1)));
        // It leaves the surface, unless it goes along the border.
        lit = lit | (fabs(sweep.drift) >= 0.5 ? out & clear : out & 0);
        this->active = this->active & (out == 0);
        const Truth some = active & (out == 0);
        const Truth over = next > place + 1.0, under = next < place, cut = over | under;
        const Number v2 = over ? place + 1.0 : (under ? place : next);
        Number x2 = x1;
        if (bits(cut & some))
            x2 = cut ? smaller(x + (v2 - v) / sweep.drift, x1) : x1;
        const Number X1 = x - line, V1 = v - place, X2 = x2 - line, V2 = v2 - place;
        const Number one = sweep.mirrored ? V1 - (1.0 - X1) : V1 - X1, two = sweep.mirrored ? V2 - (1.0 - X2) : V2 - X2;
        const Quad q = quad(some, line, place);
        const Truth diagonal = some & (one * two < 0.0);
        if (bits(diagonal)) {
            const Number share = one / (one - two), X = X1 + share * (X2 - X1);
            const Number z = sweep.mirrored ? (1.0 - X) * q.c + X * q.b : (1.0 - X) * q.a + X * q.d;
            note(diagonal, y + sweep.rise * (X - X1) - z, line + X);
        }
        y = some ? y + sweep.rise * (x2 - x) : y;
        x = some ? x2 : x;
        v = some ? v2 : v;
        const Number z = cut ? (1.0 - X2) * (over ? q.c : q.a) + X2 * (over ? q.d : q.b) : (1.0 - V2) * q.b + V2 * q.d;
        note(some, y - z, x);
        const Truth arrived = some & this->active & (cut == 0);
        if (bits(arrived)) {
            strips += count(arrived);
            line = arrived ? line + 1.0 : line;
            bounded(arrived, line);
            enter(arrived & this->active);
        }
    }
    static inline Number row(const wp::vec4d& m, Number x, Number y, Number z) {
        return m[0] * x + m[1] * y + m[2] * z + m[3];
    }
#if LANES > 1
    // Rays that have not been decided yet, to go on with.
    struct Open {
        enum { ROOM = 512 };
        double numbers[8][ROOM + LANES], flags[2][ROOM + LANES];
        int rays[ROOM + LANES], count;
    };
    // Adds those that are left to some.
    inline void leave(Open& open, const int* rays) const {
        const Number numbers[8] = { x, y, v, from, line, begin, next, side };
        const Number one = 1.0, none = 0.0, flags[2] = { biased ? one : none, clear ? one : none };
        for (int left = bits(active), j; left; left &= left - 1) {
            j = __builtin_ctz(left);
            for (int k = 0; k < 8; ++k)
                open.numbers[k][open.count] = lane(numbers[k], j);
            for (int k = 0; k < 2; ++k)
                open.flags[k][open.count] = lane(flags[k], j);
            open.rays[open.count++] = rays[j];
        }
    }
    // Takes up to LANES of them, from one on.
    inline void resume(const Open& open, int first, int count) {
        Number* numbers[8] = { &x, &y, &v, &from, &line, &begin, &next, &side };
        for (int k = 0; k < 8; ++k)
            *numbers[k] = load(open.numbers[k] + first);
        biased = load(open.flags[0] + first) == 1.0;
        clear = load(open.flags[1] + first) == 1.0;
        active = (Truth)(x == x);
        for (int j = count; j < LANES; ++j)
            active[j] = 0;
        lit = hidden = active & 0;
    }
#endif
    // Goes on, for so many pieces of the way.
    inline void go(int pieces) {
        for (int k = 0; bits(active) && k < pieces; ++k)
            step();
    }
    // Begins with rays from samples to the sun; those of `asked` alone.
    inline void look(const DeviceChart& chart, Truth asked, const Number sample[4], const wp::vec3d* vertices) {
        const Number dx = sample[0] - chart.center[0], dy = sample[1] - chart.center[1],
                     dz = sample[2] - chart.center[2];
        const Number weight = chart.weight * (size(dx) + size(dy) + size(dz)) + chart.weight_constant;
        const Number column = snapped(row(chart.s, dx, dy, dz)), place = snapped(row(chart.t, dx, dy, dz));
        const Number along = sweep.by_rows ? place : column;
        x = sweep.mirrored ? sweep.lines - 1 - along : along;
        v = sweep.by_rows ? column : place;
        y = row(chart.h, dx, dy, dz);
        active = asked & (weight * (double)(chart.rows + chart.columns) <= SWEEP_WEIGHT) & (x >= 0.0)
                 & (x <= (double)(sweep.lines - 1)) & (v >= 0.0) & (v <= (double)(sweep.across - 1));
        lit = hidden = active & 0;
        if (!bits(active))
            return;
        clear = active;
        side = 0.0;
        biased = sample[3] > 0.0;
        from = biased ? x + sample[3] * sweep.per_metre + 0x1p-20 : x;
        line = down(x);
        begin = next = v;
        const Number first = line == (double)(sweep.lines - 1) ? line - 1.0 : line;
        const Number left = down(v), beside = left == (double)(sweep.across - 1) ? left - 1.0 : left;
        const Number over = y - surface(quad(active, first, beside), x - first, v - beside);
        // Triangles at a corner never hide the corner.
        note(active & (corner(chart, sample, place, column, over, vertices) == 0), over, x);
        // The surface of the own line is not what a bound that hides them tells of.
        bounded(active & (x == line) & (side != 0.0), line);
        enter(active);
    }
    // Those that are positions of the surface.
    inline Truth corner(const DeviceChart& chart, const Number sample[4], Number row, Number column, Number over,
                        const wp::vec3d* vertices) const {
        Truth found = active & (row == down(row)) & (column == down(column)) & (size(over) <= SWEEP_PAD);
        for (int j = 0; bits(found) && j < LANES; ++j)
            if (bits(found) >> j & 1) {
                const wp::vec3d& p =
                    vertices[chart.first_vertex + (int)lane(row, j) * chart.columns + (int)lane(column, j)];
                const bool same =
                    p[0] == lane(sample[0], j) && p[1] == lane(sample[1], j) && p[2] == lane(sample[2], j);
#if LANES == 1
                found = same;
#else
                found[j] = same ? found[j] : 0;
#endif
            }
        return found;
    }
};
