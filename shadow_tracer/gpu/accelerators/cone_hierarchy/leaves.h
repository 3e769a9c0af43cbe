// needs: exact/light_space.h accelerators/cone_hierarchy/boxes.h
// constants: BOX_PAD LEAF_QUANTITIES MAGNITUDE_FLOOR
// arguments: LightSpace space, RayTree tree
// lanes
// The rays of a leaf together, and their box, LANES rays at a time.
struct WIDE(Leaf) {
    REAL low[4], high[4]; // U V W of directions, over the largest of them, and depth t

    inline void take(const REAL (&ray)[4], REAL& magnitude, bool inverse_mode) {
        typedef WIDE(Lanes) Lanes;
        const REAL u = Lanes::absolute(ray[0]), v = Lanes::absolute(ray[1]), w = Lanes::absolute(ray[2]), one = 1.0f;
        const REAL two = u > v ? u : v, inverse = one / (two > w ? two : w);
        magnitude = u + v + Lanes::absolute(ray[3]) + (float)MAGNITUDE_FLOOR;
        const REAL at[4] = { ray[0] * inverse, ray[1] * inverse, ray[2] * inverse,
                             WIDE(LightDepth)::of(ray[3], inverse, inverse_mode) };
        for (int k = 0; k < 4; ++k) {
            low[k] = at[k] < low[k] ? at[k] : low[k];
            high[k] = at[k] > high[k] ? at[k] : high[k];
        }
    }
    // Least and most of all lanes. By halving: a running minimum would have to be taken in order.
    static inline void join(REAL lows, REAL highs, float& least, float& most) {
        float low[LANES], high[LANES];
        WIDE(Lanes)::store(low, lows);
        WIDE(Lanes)::store(high, highs);
        for (int half = LANES / 2; half > 0; half /= 2)
            for (int j = 0; j < half; ++j) {
                low[j] = low[j] < low[j + half] ? low[j] : low[j + half];
                high[j] = high[j] > high[j + half] ? high[j] : high[j + half];
            }
        least = low[0];
        most = high[0];
    }
    static inline void make(int leaf, const LightSpace& space, const wp::array_t<wp::vec4>& rays, const RayTree& tree) {
        typedef WIDE(Lanes) Lanes;
        const int size = 1 << tree.log_leaf, first = leaf << tree.log_leaf, left = tree.counts.data[0] - first;
        const int used = left < size ? left : size;
        float* to = tree.leaves.data + (size_t)leaf * LEAF_QUANTITIES * size;
        tree.flags.data[leaf] = 0;
        tree.live.data[leaf] = used > 0 ? (int)(0xFFFFFFFFu >> (32 - used)) : 0;
        if (used <= 0) {
            NodeBox::store(tree, leaf, wp::vec3(1.0f), wp::vec3(-1.0f), 0.0f, 0.0f);
            return;
        }
        WIDE(Leaf) it;
        for (int k = 0; k < 4; ++k) {
            it.low[k] = 3.0e38f;
            it.high[k] = -3.0e38f;
        }
#pragma unroll 1
        for (int from = 0; from < used; from += LANES) {
#if LANES > 1
            enum { AHEAD = 64 };
            for (int j = from; j < from + LANES && first + AHEAD + j < tree.counts.data[0]; ++j)
                __builtin_prefetch(rays.data + tree.order.data[first + AHEAD + j]);
#endif
            float some[4][LANES];
            for (int j = 0; j < LANES; ++j) {
                // Lanes without a ray repeat the first one, and are not live.
                const wp::vec4 ray = rays.data[tree.order.data[first + (from + j < used ? from + j : 0)]];
                for (int k = 0; k < 4; ++k)
                    some[k][j] = ray[k];
            }
            REAL ray[4], magnitude;
            for (int k = 0; k < 4; ++k) {
                ray[k] = Lanes::load(some[k]);
                Lanes::store(to + k * size + from, ray[k]);
            }
            it.take(ray, magnitude, space.inverse != 0);
            Lanes::store(to + 4 * size + from, magnitude);
        }
        float low[4], high[4];
        for (int k = 0; k < 4; ++k)
            join(it.low[k], it.high[k], low[k], high[k]);
        NodeBox::store(tree, leaf, wp::vec3(low[0], low[1], low[2]), wp::vec3(high[0], high[1], high[2]),
                       low[3] - (float)BOX_PAD * fabsf(low[3]), high[3] + (float)BOX_PAD * fabsf(high[3]));
    }
};
