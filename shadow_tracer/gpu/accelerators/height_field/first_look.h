// needs: visibility/in_place.h accelerators/height_field/profile.h
// arguments: Structure structure, Sweep structure.sweep, DeviceChart wp::load(structure.charts.data), Asked asked
// constants: LIT SHADOWED NODES_VISITED COUNTER_ROWS SWEEP_PIECES SWEEP_BESIDE
// lanes
// Rays to the sun before they go down the nodes: what the sweep says of them.
struct WIDE(FirstLook) {
    enum { FIRST = 2 }; // pieces of the way that rays go before those that are left are put together
    typedef WIDE(Profile) Profile;
    typedef Profile::Number Number;
    typedef Profile::Truth Truth;
    const DeviceChart& chart;
    const Structure& structure;
    const Asked& asked;
    Profile profile;

    inline WIDE(FirstLook)(const DeviceChart& chart, const Structure& structure, const Asked& asked)
        : chart(chart), structure(structure), asked(asked),
          profile(structure.sweep, structure.heights.data, structure.bounds.data) {}
    // Begins with up to LANES rays.
    inline void begin(const int* rays, int count) {
        double each[5][LANES]; // position and bias, and whether the ray asks
        for (int j = 0; j < LANES; ++j) {
            const int ray = rays[j < count ? j : 0];
            const wp::vec4d& at = asked.positions.data[ray];
            for (int k = 0; k < 4; ++k)
                each[k][j] = at[k];
            each[4][j] = (j < count) & (asked.states.data[ray] == LIT) & WIDE(InPlace)::has_ray(asked, ray);
        }
        const Number sample[4] = { Profile::load(each[0]), Profile::load(each[1]), Profile::load(each[2]),
                                   Profile::load(each[3]) };
        profile.look(chart, Profile::load(each[4]) == 1.0, sample, asked.vertices.data);
    }
    // Goes on with them, and notes what has become of them.
    inline void go(const int* rays, int count, int pieces) {
        profile.go(pieces);
        const int hidden = Profile::bits(profile.hidden), lit = Profile::bits(profile.lit);
        const wp::uint8 passes = structure.count == 1 ? 2 : 1;
        for (int j = 0; j < count; ++j) {
            asked.passed.data[rays[j]] = lit >> j & 1 ? passes : 0;
            if (hidden >> j & 1)
                asked.states.data[rays[j]] = SHADOWED;
        }
    }
#if LANES > 1
    // Most are decided by few steps. Those that need more go on together, not each with others that wait for it.
    inline void rest(Profile::Open& open) {
        for (int done = FIRST; done < SWEEP_PIECES; done *= 4) {
            const int count = open.count;
            open.count = 0;
            for (int first = 0; first < count; first += LANES) {
                int rays[LANES];
                const int some = count - first < LANES ? count - first : LANES;
                memcpy(rays, open.rays + first, sizeof(rays));
                profile.resume(open, first, some);
                go(rays, some, 3 * done);
                profile.leave(open, rays);
            }
        }
        open.count = 0;
    }
#endif
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
        WIDE(FirstLook) looks(chart, structure, asked);
#if LANES == 1
        for (int ray = first; ray < last; ++ray) {
            looks.begin(&ray, 1);
            looks.go(&ray, 1, SWEEP_PIECES);
        }
#else
        Profile::Open open = {};
        for (int begin = first; begin < last; begin += LANES) {
            int rays[LANES];
            for (int j = 0; j < LANES; ++j)
                rays[j] = begin + j;
            const int some = last - begin < LANES ? last - begin : LANES;
            looks.begin(rays, some);
            looks.go(rays, some, FIRST);
            looks.profile.leave(open, rays);
            if (open.count >= Profile::Open::ROOM - LANES || begin + LANES >= last)
                looks.rest(open);
        }
#endif
        if (looks.profile.strips)
            wp::atomic_add(asked.counters.data + (size_t)(row & (COUNTER_ROWS - 1)) * asked.counters.shape[1]
                               + NODES_VISITED,
                           looks.profile.strips);
    }
};
