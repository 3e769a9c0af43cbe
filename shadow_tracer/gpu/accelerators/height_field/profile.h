// needs: accelerators/height_field/place.h
// arguments: Sweep sweep, DeviceChart chart
// constants: SWEEP_PAD SWEEP_STEPS SWEEP_BESIDE SWEEP_WEIGHT
// A ray over the heights of a swept chart, strip by strip between two lines, until a bound says what becomes of it; see
// sweep.py.
struct Profile {
    enum { UNDECIDED, LIT, HIDDEN };
    const Sweep& sweep;
    const float* heights;
    double x, y, v; // where the ray is: along the lines' way, height, across
    double from;    // where along the way it begins to matter
    bool biased;
    bool clear; // it has met nothing so far
    int side;   // 1: it has been above the surface, -1: below it, where it mattered
    int strips; // that it has crossed

    inline Profile(const Sweep& sweep, const wp::array_t<float>& heights)
        : sweep(sweep), heights(heights.data), x(0.0), y(0.0), v(0.0), from(0.0), biased(false), clear(true), side(0),
          strips(0) {}
    inline double at(int line, int place) const {
        return heights[sweep.base + (wp::int64)line * sweep.next_line + (wp::int64)place * sweep.next];
    }
    static inline double snapped(double value) {
        const double whole = floor(value + 0.5);
        return fabs(value - whole) < SWEEP_BESIDE ? whole : value;
    }
    // The height of the surface within a quad.
    inline double surface(int line, int place, double X, double V) const {
        const double a = at(line, place), b = at(line + 1, place), c = at(line, place + 1), d = at(line + 1, place + 1);
        if (sweep.mirrored)
            return X + V <= 1.0 ? a + X * (b - a) + V * (c - a) : d + (1.0 - X) * (c - d) + (1.0 - V) * (b - d);
        return V >= X ? a + V * (c - a) + X * (d - c) : a + X * (b - a) + V * (d - b);
    }
    // Whether all quads that the ray may touch between two lines are there.
    inline bool whole(int line, double one, double two) const {
        const double low = one < two ? one : two, high = one < two ? two : one;
        const int first = (int)floor(low - 0x1p-20), last = (int)ceil(high + 0x1p-20);
        if (first < 0 || last >= sweep.across)
            return false;
        for (int k = first; k <= last; ++k) {
            const double sum = at(line, k) + at(line + 1, k);
            if (!(sum == sum))
                return false;
        }
        return true;
    }
    // Takes note of how far the ray is above the surface at a place along the way.
    inline bool note(double over, double place, int line, double one, double two, int& found) {
        const int now = over > SWEEP_PAD ? 1 : over < -SWEEP_PAD ? -1 : 0;
        if (now == 0 || side * now < 0) {
            found = now != 0 && whole(line, one, two) ? HIDDEN : UNDECIDED;
            return false;
        }
        clear &= now > 0;
        if (place >= from)
            side = now;
        return true;
    }
    // The bounds on a line of the band that the ray is in; null where that is beside the surface.
    inline const float* band(const float* bounds, int line) const {
        const int place = (int)floor(v - sweep.drift * x) - (int)floor(-(sweep.drift * line));
        return place < 0 || place >= sweep.across ? nullptr : bounds + (size_t)line * sweep.pitch + place;
    }
    // What the bounds on a line say, where the ray is now.
    inline int bounded(const float* bounds, int line) const {
        const float* here = band(bounds, line);
        if (!here)
            return UNDECIDED;
        const size_t plane = (size_t)sweep.lines * sweep.pitch;
        const double level = y - sweep.rise * line;
        if (clear && level > here[0] + sweep.pad)
            return LIT;
        if (biased)
            return UNDECIDED;
        const bool over = side > 0 && level < here[plane] - sweep.pad;
        const bool under = side < 0 && level > here[2 * plane] + sweep.pad;
        return over || under ? HIDDEN : UNDECIDED;
    }
    // To the next line; false if it is known what becomes of the ray.
    inline bool step(int line, int& found) {
        const double begin = v, x1 = line + 1, v1 = v + sweep.drift * (x1 - x);
        const float* here = heights + sweep.base + (wp::int64)line * sweep.next_line;
        for (;;) {
            int place = (int)floor(v);
            if (v == place && (sweep.drift < 0.0 || (sweep.drift == 0.0 && place == sweep.across - 1)))
                --place;
            if (place < 0 || place >= sweep.across - 1) {
                // It leaves the surface, unless it goes along the border.
                found = clear && fabs(sweep.drift) >= 0.5 ? LIT : UNDECIDED;
                return false;
            }
            const bool over = v1 > place + 1, under = v1 < place;
            const double v2 = over ? place + 1 : under ? place : v1;
            double x2 = over || under ? x + (v2 - v) / sweep.drift : x1;
            x2 = x2 < x1 ? x2 : x1;
            const double X1 = x - line, V1 = v - place, X2 = x2 - line, V2 = v2 - place;
            const double one = sweep.mirrored ? V1 - (1.0 - X1) : V1 - X1,
                         two = sweep.mirrored ? V2 - (1.0 - X2) : V2 - X2;
            const float* quad = here + (wp::int64)place * sweep.next;
            const double a = quad[0], b = quad[sweep.next_line], c = quad[sweep.next],
                         d = quad[sweep.next_line + sweep.next];
            if (one * two < 0.0) {
                const double share = one / (one - two), X = X1 + share * (X2 - X1);
                const double z = sweep.mirrored ? (1.0 - X) * c + X * b : (1.0 - X) * a + X * d;
                if (!note(y + sweep.rise * (X - X1) - z, line + X, line, begin, v1, found))
                    return false;
            }
            y += sweep.rise * (x2 - x);
            x = x2;
            v = v2;
            const bool end = !(over || under);
            const double z = end ? (1.0 - V2) * b + V2 * d : (1.0 - X2) * (over ? c : a) + X2 * (over ? d : b);
            if (!note(y - z, x, line, begin, v1, found))
                return false;
            if (end)
                return true;
        }
    }
    // What becomes of the ray from a sample to the sun.
    inline int look(const DeviceChart& chart, double beside, const wp::vec4d& sample, const wp::vec3d* vertices,
                    const float* bounds) {
        const double dx = sample[0] - chart.center[0], dy = sample[1] - chart.center[1],
                     dz = sample[2] - chart.center[2];
        const double weight = chart.weight * (fabs(dx) + fabs(dy) + fabs(dz)) + chart.weight_constant;
        if (!(beside <= SWEEP_BESIDE) || !(weight * (chart.rows + chart.columns) <= SWEEP_WEIGHT))
            return UNDECIDED;
        const Homogeneous q = Homogeneous::of(chart, dx, dy, dz, 1.0);
        const double column = snapped(q.s), row = snapped(q.t);
        const double along = sweep.by_rows ? row : column;
        x = sweep.mirrored ? sweep.lines - 1 - along : along;
        v = sweep.by_rows ? column : row;
        y = q.h;
        if (!inside())
            return UNDECIDED;
        bool corner = row == floor(row) && column == floor(column);
        if (corner) {
            const wp::vec3d& p = vertices[chart.first_vertex + (int)row * chart.columns + (int)column];
            corner = p[0] == sample[0] && p[1] == sample[1] && p[2] == sample[2];
        }
        const double bias = sample[3] * sweep.per_metre;
        biased = bias > 0.0;
        from = biased ? x + bias + 0x1p-20 : x;
        // Triangles at a corner never hide the corner.
        if (!corner) {
            int line = (int)floor(x), place = (int)floor(v), found;
            line -= line == sweep.lines - 1;
            place -= place == sweep.across - 1;
            if (!note(y - surface(line, place, x - line, v - place), x, line, v, v, found))
                return UNDECIDED;
        }
        for (; strips < SWEEP_STEPS; ++strips) {
            const int line = (int)floor(x);
            if (line >= sweep.lines - 1 || (sweep.rise >= 0.0 && side > 0 && y > 65536.0))
                return clear ? LIT : UNDECIDED;
            int found;
            if (!step(line, found))
                return found;
            found = bounded(bounds, line + 1);
            if (found != UNDECIDED)
                return found;
        }
        return UNDECIDED;
    }
    inline bool inside() const { return x >= 0.0 && x <= sweep.lines - 1 && v >= 0.0 && v <= sweep.across - 1; }
};
