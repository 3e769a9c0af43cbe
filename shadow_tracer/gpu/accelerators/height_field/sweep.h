// needs: device/lanes.h
// arguments: Sweep sweep
// constants: SWEEP_STRETCH
// lanes
// Bounds of the heights that hide the sun, carried along its way, for LANES bands; see sweep.py.
struct WIDE(Sweeper) {
    typedef WIDE(Lanes) Lanes;

    static inline REAL smaller(REAL x, REAL y) { return x < y ? x : y; }
    static inline REAL larger(REAL x, REAL y) { return x > y ? x : y; }
    static inline float unknown() { return (float)(HUGE_VAL - HUGE_VAL); }
    // Heights on a line, which lie side by side, of the positions from `first` on, one each lane; not a number where
    // there is none.
    static inline REAL on_line(const Sweep& sweep, const float* heights, int line, int first) {
        const float* from = heights + sweep.base + (wp::int64)line * sweep.next_line;
#if LANES == 1
        return first >= 0 && first < sweep.across ? from[first] : unknown();
#else
        if (first >= 0 && first + LANES <= sweep.across)
            return Lanes::load(from + first);
        float some[LANES];
        for (int j = 0; j < LANES; ++j)
            some[j] = first + j >= 0 && first + j < sweep.across ? from[first + j] : unknown();
        return Lanes::load(some);
#endif
    }
    // The largest level of the surface along both edges of bands from a line to the next, in between these: where they
    // cross diagonals and rows between quads. Whatever is there is whole.
    struct Edges {
        const Sweep& sweep;
        const float* heights;
        const int line, place; // of the first band's edge
        REAL most;

        inline Edges(const Sweep& sweep, const float* heights, int line, int place)
            : sweep(sweep), heights(heights), line(line), place(place), most(-(float)HUGE_VAL) {}
        // After so much of the way, between corners on both lines, so many places from the edge's.
        inline void cross(double share, int on_line, int on_next) {
            if (!(share > 0.0 && share < 1.0))
                return;
            const float two = (float)share, one = (float)(1.0 - share), risen = (float)(sweep.rise * (line + share));
            for (int edge = 0; edge < 2; ++edge) {
                const REAL here = WIDE(Sweeper)::on_line(sweep, heights, line, place + edge + on_line);
                const REAL next = WIDE(Sweeper)::on_line(sweep, heights, line + 1, place + edge + on_next);
                most = larger(one * here + two * next - risen, most);
            }
        }
        // All of it, of edges that are so far behind their places on the line.
        inline REAL of(double behind) {
            const double drift = sweep.drift;
            for (int quad = 0; quad < 2; ++quad) {
                if (sweep.mirrored)
                    cross((1.0 + quad - behind) / (1.0 + drift), quad + 1, quad);
                else
                    cross((behind + quad) / (1.0 - drift), -quad, 1 - quad);
            }
            const int row = drift > 0.0 ? 1 : 0;
            cross((row - behind) / drift, row, row);
            return most;
        }
    };
    // From the line that is the farthest towards the sun back to the first one.
    static inline void bands(const Sweep& sweep, int band, const wp::array_t<float>& heights,
                             const wp::array_t<float>& bounds) {
        const double beside = 0x1p-20;
        const REAL infinity = (float)HUGE_VAL;
        REAL hides = -infinity, stretch = -infinity, above = -infinity, below = infinity;
        const size_t plane = (size_t)sweep.lines * sweep.pitch;
        for (int line = sweep.lines - 1; line >= 0; --line) {
            const int place = band - (int)floor(-(sweep.drift * line));
            if (place > sweep.across || place + LANES < 0) // what only touches the border, as rounded, counts
                continue;
            const double here = band + sweep.drift * line, next = band + sweep.drift * (line + 1);
            const float risen = (float)(sweep.rise * line), risen_next = (float)(sweep.rise * (line + 1));
            MASK whole = hides == hides; // as yet in all lanes
            REAL corners = -infinity;
            const int first = (int)floor(here - beside), last = (int)ceil(here + 1.0 + beside);
            for (int k = first; k <= last; ++k) {
                const REAL z = on_line(sweep, heights.data, line, k);
                corners = larger(z - risen, corners);
                whole = whole & (z == z);
            }
            // What the line has of the band: both edges, and the corner between them.
            const int edge = (int)floor(here);
            const double behind = here - edge;
            const float two = (float)behind, one = (float)(1.0 - behind);
            const REAL middle = on_line(sweep, heights.data, line, edge + 1);
            const REAL left = one * on_line(sweep, heights.data, line, edge) + two * middle;
            const REAL right = one * middle + two * on_line(sweep, heights.data, line, edge + 2);
            const REAL least = smaller(left, smaller(middle, right)) - risen;
            const REAL most = larger(left, larger(middle, right)) - risen;
            MASK strip = whole;
            if (line + 1 < sweep.lines) {
                const int begin = (int)floor((here < next ? here : next) - beside);
                const int end = (int)ceil((here < next ? next : here) + 1.0 + beside);
                for (int k = begin; k <= end; ++k) {
                    const REAL z = on_line(sweep, heights.data, line, k);
                    const REAL beyond = on_line(sweep, heights.data, line + 1, k);
                    corners = larger(z - risen, larger(beyond - risen_next, corners));
                    strip = strip & (z == z) & (beyond == beyond);
                }
                const REAL edges = Edges(sweep, heights.data, line, edge).of(behind);
                const REAL here_and_on = strip ? larger(edges, most) : corners;
                hides = larger(here_and_on, hides);
                stretch = larger(here_and_on, stretch);
                above = strip ? above : -infinity;
                below = strip ? below : infinity;
            } else
                hides = larger(whole ? most : corners, hides);
            above = whole ? larger(least, above) : above;
            below = whole ? smaller(most, below) : below;
            if (line % SWEEP_STRETCH == 0) {
                store(sweep, bounds.data + 3 * plane + (size_t)(line / SWEEP_STRETCH) * sweep.pitch, place, stretch);
                stretch = whole ? most : corners;
            }
            store(sweep, bounds.data + (size_t)line * sweep.pitch, place, hides);
            store(sweep, bounds.data + plane + (size_t)line * sweep.pitch, place, above);
            store(sweep, bounds.data + 2 * plane + (size_t)line * sweep.pitch, place, below);
        }
    }
    static inline void store(const Sweep& sweep, float* to, int place, REAL values) {
#if LANES == 1
        if (place >= 0 && place < sweep.across)
            to[place] = values;
#else
        if (place >= 0 && place + LANES <= sweep.across) {
            Lanes::store(to + place, values);
            return;
        }
        float some[LANES];
        Lanes::store(some, values);
        for (int j = 0; j < LANES; ++j)
            if (place + j >= 0 && place + j < sweep.across)
                to[place + j] = some[j];
#endif
    }
};
