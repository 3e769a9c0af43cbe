// cpu
// needs: exact/frame_over.h exact/records.h exact/filter.h@16 exact/decision.h samples/view.h
// constants: SHADOWED MAGNITUDE_FLOOR FILTER_FACTOR SLOPE_FACTOR OFFSET_FACTOR U32 SETUP_ERROR
// constants: LARGEST_OFFSET
// arguments: LightFrame light
// Points and triangles so few that every pair is asked about, by one task: nothing is kept, so nothing is written but
// the answers. Points are taken some at a time, and of these sixteen; so are triangles, of which records are made.
struct EveryPair {
    enum { POINTS = 512, GROUPS = POINTS / 16, TRIANGLES = 64, CROWDED = 12 };
    typedef double Three[3];
    typedef float Row[POINTS];
    const LightFrame& frame;
    const wp::array_t<wp::vec3d>& vertices;
    const wp::array_t<wp::vec3i>& triangles;
    const double bias;
    const Three* point;
    wp::uint8* state;
    Row ray[5];         // U V W Z magnitude, of those that are left
    int number[POINTS]; // which point each of them is of
    int asking[GROUPS]; // of every sixteen of them those that nothing is known to hide, as bits
    int left;
    float record[16 * TRIANGLES];

    inline EveryPair(const LightFrame& frame, const wp::array_t<wp::vec3d>& vertices,
                     const wp::array_t<wp::vec3i>& triangles, double bias)
        : frame(frame), vertices(vertices), triangles(triangles), bias(bias) {}
    // The frame of a light over points: as points_anchor and make_anchor have it.
    static inline LightFrame over(const wp::array_t<wp::vec3d>& points, const LightFrame& light, double bias) {
        wp::vec3d low = points.data[0], high = low;
        for (int i = 1; i < points.shape[0]; ++i)
            for (int k = 0; k < 3; ++k) {
                const double x = points.data[i][k];
                low[k] = x < low[k] ? x : low[k];
                high[k] = x > high[k] ? x : high[k];
            }
        const wp::vec3d center = 0.5 * low + 0.5 * high;
        const double half = wp::length(high - center), radius = half > 4.0 * bias ? half : 4.0 * bias;
        LightFrame frame = light;
        FrameOver::complete(frame, center, 1.5 * (radius < 1e-30 ? 1e-30 : radius > 1e30 ? 1e30 : radius));
        return frame;
    }
    // Rays and states of n points.
    inline void take(int n) {
        const View view(frame);
        wp::uint8 found_state[POINTS]; // bytes may alias anything
        int there[POINTS];
        for (int i = 0; i < n; ++i) {
            const Projected found = view.of(point[i][0], point[i][1], point[i][2], bias, 1);
            ray[0][i] = found.u;
            ray[1][i] = found.v;
            ray[2][i] = found.w;
            ray[3][i] = found.z;
            ray[4][i] = fabsf(found.u) + fabsf(found.v) + fabsf(found.z) + (float)MAGNITUDE_FLOOR;
            there[i] = found.ray;
            found_state[i] = (wp::uint8)found.state;
        }
        memcpy(state, found_state, n);
        left = n;
        for (int group = 0; 16 * group < n; ++group) {
            asking[group] = 0;
            for (int j = 0; j < 16 && 16 * group + j < n; ++j)
                asking[group] |= there[16 * group + j] << j;
        }
        for (int i = 0; i < n; ++i)
            number[i] = i;
        close_up();
    }
    // Those that ask come together, if they leave whole sixteens.
    inline void close_up() {
        int still = 0;
        for (int group = 0; 16 * group < left; ++group)
            still += __builtin_popcount(asking[group]);
        if (still * 16 > left * CROWDED && still)
            return;
        int to = 0;
        for (int group = 0; 16 * group < left; ++group)
            for (int some = asking[group]; some; some &= some - 1, ++to) {
                const int from = 16 * group + __builtin_ctz(some);
                for (int k = 0; k < 5; ++k)
                    ray[k][to] = ray[k][from];
                number[to] = number[from];
            }
        left = to;
        for (int group = 0; 16 * group < left; ++group)
            asking[group] = left - 16 * group < 16 ? 0xFFFF >> (16 - (left - 16 * group)) : 0xFFFF;
    }
    // Whether the exact decision says that a triangle hides the point of a ray.
    __attribute__((noinline)) bool hides(int triangle, int ray) const {
        const wp::vec3i& corner = triangles.data[triangle];
        const Three& at = point[number[ray]];
        return Decision::of(wp::vec4d(at[0], at[1], at[2], bias), frame.light, vertices.data[corner[0]],
                            vertices.data[corner[1]], vertices.data[corner[2]])
               & 1;
    }
    // Shows the triangles from `first` on, of which there are records, to a group.
    inline void show(int group, int first, int count) {
        const int begin = 16 * group;
        const Real16 u = Lanes16::load(ray[0] + begin), v = Lanes16::load(ray[1] + begin),
                     w = Lanes16::load(ray[2] + begin), z = Lanes16::load(ray[3] + begin),
                     magnitude = Lanes16::load(ray[4] + begin);
        int open = asking[group];
        const float* at = record;
        for (int t = 0; t < count && open; ++t, at += 16) {
            int yes = 0;
            int found = open & Filter16::possible(at, u, v, w, z, magnitude, yes);
            if (!found)
                continue;
            for (int unsure = found & ~yes; unsure; unsure &= unsure - 1) {
                const int j = __builtin_ctz(unsure);
                if (!hides(first + t, begin + j))
                    found &= ~(1 << j);
            }
            open &= ~found;
        }
        for (int hidden = asking[group] & ~open; hidden; hidden &= hidden - 1)
            state[number[begin + __builtin_ctz(hidden)]] = SHADOWED;
        asking[group] = open;
    }
    inline void show_all(int triangle_count, int cull) {
        wp::array_t<wp::vec4> records;
        records.data = (wp::vec4*)record;
        wp::vec2i nothing; // how many cast nothing
        wp::array_t<wp::vec2i> silent;
        silent.data = &nothing;
        for (int first = 0; first < triangle_count && left; first += TRIANGLES) {
            const int last = triangle_count - first < TRIANGLES ? triangle_count : first + TRIANGLES;
            Records::block(first, last, frame, FILTER_FACTOR, SLOPE_FACTOR, OFFSET_FACTOR, U32, SETUP_ERROR,
                           LARGEST_OFFSET, vertices, triangles, 0, records, cull, 0, silent);
            for (int group = 0; 16 * group < left; ++group)
                show(group, first, last - first);
            close_up();
        }
    }
    static inline void ask(const LightFrame& light, double bias, int cull, int triangle_count,
                           const wp::array_t<wp::vec3d>& points, const wp::array_t<wp::vec3d>& vertices,
                           const wp::array_t<wp::vec3i>& triangles, const wp::array_t<wp::uint8>& states) {
        const LightFrame frame = over(points, light, bias);
        EveryPair some(frame, vertices, triangles, bias);
        for (int first = 0; first < points.shape[0]; first += POINTS) {
            some.point = (const Three*)(points.data + first), some.state = states.data + first;
            some.take(points.shape[0] - first < POINTS ? points.shape[0] - first : POINTS);
            some.show_all(triangle_count, cull);
        }
    }
};
