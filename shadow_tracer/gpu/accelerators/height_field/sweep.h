// needs: device/lanes.h
// arguments: Sweep sweep
// lanes
// Bounds of the heights that hide the sun, carried along its way, for LANES bands; see sweep.py.
struct WIDE(Sweeper) {
    typedef WIDE(Lanes) Lanes;

    static inline REAL smaller(REAL x, REAL y) { return x < y ? x : y; }
    static inline REAL larger(REAL x, REAL y) { return x > y ? x : y; }
    static inline float unknown() { return (float)(HUGE_VAL - HUGE_VAL); }
    // Heights on a line, of the positions from `first` on, one each lane; not a number where there is none.
    static inline REAL on_line(const Sweep& sweep, const float* heights, int line, int first) {
        const float* from = heights + sweep.base + (wp::int64)line * sweep.next_line;
#if LANES == 1
        return first >= 0 && first < sweep.across ? from[(wp::int64)first * sweep.next] : unknown();
#else
        if (sweep.next == 1 && first >= 0 && first + LANES <= sweep.across)
            return Lanes::load(from + first);
        float some[LANES];
        for (int j = 0; j < LANES; ++j)
            some[j] =
                first + j >= 0 && first + j < sweep.across ? from[(wp::int64)(first + j) * sweep.next] : unknown();
        return Lanes::load(some);
#endif
    }
    // From the line that is the farthest towards the sun back to the first one.
    static inline void bands(const Sweep& sweep, int band, const wp::array_t<float>& heights,
                             const wp::array_t<float>& bounds) {
        const double beside = 0x1p-20;
        const REAL infinity = (float)HUGE_VAL;
        REAL hides = -infinity, above = -infinity, below = infinity;
        const size_t plane = (size_t)sweep.lines * sweep.pitch;
        for (int line = sweep.lines - 1; line >= 0; --line) {
            const int place = band - (int)floor(-(sweep.drift * line));
            if (place > sweep.across || place + LANES < 0) // what only touches the border, as rounded, counts
                continue;
            const double here = band + sweep.drift * line, next = band + sweep.drift * (line + 1);
            const float risen = (float)(sweep.rise * line), risen_next = (float)(sweep.rise * (line + 1));
            REAL least = infinity, most = -infinity;
            MASK whole = least == infinity; // as yet in all lanes
            const int first = (int)floor(here - beside), last = (int)ceil(here + 1.0 + beside);
            for (int k = first; k <= last; ++k) {
                const REAL z = on_line(sweep, heights.data, line, k);
                least = smaller(z, least);
                most = larger(z, most);
                whole = whole & (z == z);
            }
            hides = larger(most - risen, hides);
            if (line + 1 < sweep.lines) {
                const int begin = (int)floor((here < next ? here : next) - beside);
                const int end = (int)ceil((here < next ? next : here) + 1.0 + beside);
                MASK strip = whole;
                for (int k = begin; k <= end; ++k) {
                    const REAL z = on_line(sweep, heights.data, line, k);
                    const REAL beyond = on_line(sweep, heights.data, line + 1, k);
                    hides = larger(z - risen, larger(beyond - risen_next, hides));
                    strip = strip & (z == z) & (beyond == beyond);
                }
                above = strip ? above : -infinity;
                below = strip ? below : infinity;
            }
            above = whole ? larger(least - risen, above) : above;
            below = whole ? smaller(most - risen, below) : below;
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
