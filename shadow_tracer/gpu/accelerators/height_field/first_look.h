// needs: visibility/in_place.h accelerators/height_field/profile.h
// arguments: Structure structure, Sweep structure.sweep, DeviceChart wp::load(structure.charts.data), Asked asked
// constants: LIT SHADOWED NODES_VISITED COUNTER_ROWS FIRST_LOOK_BLOCK SWEEP_PIECES SWEEP_BESIDE
// lanes
// Rays to the sun before they go down the nodes: what the sweep says of them.
struct WIDE(FirstLook) {
    enum { BLOCK = FIRST_LOOK_BLOCK };
    typedef WIDE(Profile) Profile;
    typedef Profile::Number Number;
    typedef Profile::Truth Truth;

    static inline Number load(const double* from) {
#if LANES == 1
        return *from;
#else
        return *(const Number*)from;
#endif
    }
    // The rays of some numbers, at most LANES; returns which are left open, as bits.
    static inline int together(const int* rays, int count, int pieces, const DeviceChart& chart,
                               const Structure& structure, const Asked& asked, wp::int64& strips) {
        double each[5][LANES]; // position and bias, and whether the ray asks
        for (int j = 0; j < LANES; ++j) {
            const int ray = rays[j < count ? j : 0];
            const wp::vec4d& at = asked.positions.data[ray];
            for (int k = 0; k < 4; ++k)
                each[k][j] = at[k];
            const float start = asked.rays.data[ray][0];
            each[4][j] = (j < count) & (asked.states.data[ray] == LIT) & (start == start);
        }
        const Number sample[4] = { load(each[0]), load(each[1]), load(each[2]), load(each[3]) };
        Profile profile(structure.sweep, structure.heights.data, structure.bounds.data);
        profile.look(chart, load(each[4]) == 1.0, sample, asked.vertices.data, pieces);
        const int hidden = Profile::bits(profile.hidden), lit = Profile::bits(profile.lit);
        const wp::uint8 passes = structure.count == 1 ? 2 : 1;
        for (int j = 0; j < count; ++j) {
            asked.passed.data[rays[j]] = lit >> j & 1 ? passes : 0;
            if (hidden >> j & 1)
                asked.states.data[rays[j]] = SHADOWED;
        }
        strips += profile.strips;
        return Profile::bits(profile.active);
    }
    // Those from `first` to `last`: hides those that are hidden, and says of all others whether the chart, or all of
    // the structure, hides none of them.
    static inline void some(int first, int last, int row, const Structure& structure, const Asked& asked) {
        const int number = structure.sweep.number;
        const DeviceChart& chart = structure.charts.data[number];
        if (!(structure.beside.data[number] <= SWEEP_BESIDE)) {
            for (int ray = first; ray < last; ++ray)
                asked.passed.data[ray] = 0;
            return;
        }
        wp::int64 strips = 0;
#if LANES == 1
        for (int ray = first; ray < last; ++ray)
            together(&ray, 1, SWEEP_PIECES, chart, structure, asked, strips);
#else
        // Most are decided by few steps. Those that need more go on together, not each with others that wait for it.
        int left[BLOCK], count = last - first;
        for (int j = 0; j < count; ++j)
            left[j] = first + j;
        for (int pieces = 2; count > 0; pieces = pieces < 32 ? 4 * pieces : SWEEP_PIECES) {
            int kept = 0;
            for (int begin = 0; begin < count; begin += LANES) {
                const int some = count - begin < LANES ? count - begin : LANES;
                const int open = together(left + begin, some, pieces, chart, structure, asked, strips);
                for (int j = 0; j < some; ++j)
                    if (open >> j & 1)
                        left[kept++] = left[begin + j];
            }
            count = pieces < SWEEP_PIECES ? kept : 0;
        }
#endif
        if (strips)
            wp::atomic_add(asked.counters.data + (size_t)(row & (COUNTER_ROWS - 1)) * asked.counters.shape[1]
                               + NODES_VISITED,
                           strips);
    }
};
