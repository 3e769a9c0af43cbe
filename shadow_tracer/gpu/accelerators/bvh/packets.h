// cpu
// needs: query@16 exact/light.h accelerators/segment.h accelerators/bvh/descent.h@16
// constants: FAR_AWAY LONGEST WIDEST PATIENCE
// arguments: Tree structure
// Sixteen rays together through the tree with sixteen children per node: as a bundle if they are close, else one by
// one; every triangle that may be met is shown to all of them.
struct Walk16 {
    typedef double Reals __attribute__((ext_vector_type(16), aligned(8)));
    typedef decltype(Reals() < Reals()) Longs;
    enum { MISSES, MEETS, TOO_FAR, DONE, TOO_MUCH, APART, WIDTH = 16, HOPELESS = 8 };
    // Where rays begin and end in the box of the scene, in units of its extent; and the lanes that meet it, as bits.
    double begin[3][WIDTH], end[3][WIDTH];
    int meeting;

    static inline Reals smaller(Reals x, Reals y) { return x < y ? x : y; }
    static inline Reals larger(Reals x, Reals y) { return x > y ? x : y; }
    // Of sixteen.
    static inline double least(Reals x) {
        const auto eight = x.lo < x.hi ? x.lo : x.hi;
        const auto four = eight.lo < eight.hi ? eight.lo : eight.hi;
        const auto two = four.lo < four.hi ? four.lo : four.hi;
        return two[0] < two[1] ? two[0] : two[1];
    }
    static inline int bits(Longs x) { return Lanes16::bits(__builtin_convertvector(x, Mask16)); }
    // As Segment::place does it for one.
    inline int place(const Query16& query, const SceneBox& box) {
        const wp::vec4d& light = query.answers.lights.data[0].light;
        const double per_metre = box.inverse_extent;
        double samples[3][WIDTH];
        for (int j = 0; j < WIDTH; ++j) {
            const wp::vec4d& at = query.answers.positions.data[query.ray[j < query.taken ? j : 0]];
            for (int k = 0; k < 3; ++k)
                samples[k][j] = at[k];
        }
        const bool far = light[3] == 0.0;
        const wp::vec4d away = LightSide::towards(wp::vec3d(0.0, 0.0, 0.0), light);
        Reals from = 0.0, to = far ? HUGE_VAL : 1.0, start[3], way[3];
        Longs near = from == from;
        for (int k = 0; k < 3; ++k) {
            const Reals at = *(const Reals*)samples[k];
            start[k] = (at - box.center[k]) * per_metre;
            way[k] = far ? Reals(away[k]) : (light[k] - at) * per_metre;
            // Beyond, products may be infinite.
            near &= (start[k] <= FAR_AWAY) & (start[k] >= -FAR_AWAY) & (way[k] <= LONGEST) & (way[k] >= -LONGEST);
            const Reals tiny = 1.0e-20, inverse = 1.0 / (((way[k] < tiny) & (way[k] > -tiny)) ? tiny : way[k]);
            const Reals one = (-box.half[k] - start[k]) * inverse, two = (box.half[k] - start[k]) * inverse;
            from = larger(from, smaller(one, two));
            to = smaller(to, larger(one, two));
        }
        if (bits(near) != Lanes16::ALL)
            return TOO_FAR;
        meeting = bits(from <= to) & Lanes16::ALL >> (WIDTH - query.taken);
        for (int k = 0; k < 3; ++k) {
            *(Reals*)begin[k] = start[k] + way[k] * from;
            *(Reals*)end[k] = start[k] + way[k] * to;
        }
        return meeting ? MEETS : MISSES;
    }
    // Sends those lanes as a bundle, or the only one; or says why not.
    inline int bundle(int lanes, const Tree& tree, Query16& query) const {
        double middle[2][3], spread = 0.0;
        const double (*ends[2])[WIDTH] = { begin, end };
        for (int side = 0; side < 2; ++side) {
            double square = 0.0;
            for (int k = 0; k < 3; ++k) {
                const double* at = ends[side][k];
                double low = HUGE_VAL, high = -HUGE_VAL;
                if (lanes == Lanes16::ALL) {
                    low = least(*(const Reals*)at);
                    high = -least(-*(const Reals*)at);
                }
                for (int left = lanes == Lanes16::ALL ? 0 : lanes; left; left &= left - 1) {
                    const double x = at[__builtin_ctz(left)];
                    low = x < low ? x : low;
                    high = x > high ? x : high;
                }
                middle[side][k] = 0.5 * (low + high);
                square += 0.25 * (high - low) * (high - low);
            }
            spread = square > spread ? square : spread;
        }
        spread = 1.00001 * sqrt(spread);
        if (!(spread <= WIDEST) && (lanes & (lanes - 1)))
            return spread <= HOPELESS * WIDEST ? TOO_MUCH : APART;
        double way[3], square = 0.0;
        for (int k = 0; k < 3; ++k) {
            way[k] = middle[1][k] - middle[0][k];
            square += way[k] * way[k];
        }
        const double length = sqrt(square), scale = length > 0.0 ? 1.0 / length : 0.0;
        wp::vec3 origin, direction;
        for (int k = 0; k < 3; ++k) {
            origin[k] = (float)middle[0][k];
            direction[k] = Segment::away_from_zero(way[k] * scale);
        }
        Descent16 descent(tree, origin, direction, Segment::holding(length), (float)spread);
        const int rays = __builtin_popcount(lanes);
        return descent.go(query, nullptr, rays == 1 ? Descent16::NO_END : PATIENCE * rays) ? DONE : TOO_MUCH;
    }
    static inline void walk(const Tree& tree, Query16& query) {
        Walk16 it;
        const int place = it.place(query, tree.box);
        if (place == TOO_FAR)
            query.everything();
        if (place != MEETS)
            return;
        // All, or halves of what is too much, or each alone.
        int stack[WIDTH], top = 1;
        stack[0] = it.meeting;
        while (top) {
            const int lanes = stack[--top] & query.asking, done = lanes ? it.bundle(lanes, tree, query) : DONE;
            int low = lanes;
            for (int half = __builtin_popcount(lanes) / 2; half; --half)
                low &= low - 1;
            if (done == TOO_MUCH) {
                stack[top++] = low;
                stack[top++] = lanes & ~low;
            }
            for (int left = done == APART ? lanes : 0; left; left &= left - 1)
                stack[top++] = left & -left;
        }
    }
};
