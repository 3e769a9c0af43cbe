// constants: EXTENT_BITS
// Least and largest u and v, in four consecutive floats that many threads widen.
struct Extents {
    static inline void widen(float* box, float u, float v) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
        if (u != u || v != v)
            return;
        // Of the lanes that come here together for the same four, one widens them for all.
        const unsigned here = __activemask(), same = __match_any_sync(here, (unsigned long long)box);
        u = 0.0f + u; // no -0, whose order as an integer is another
        v = 0.0f + v;
        const int low_u = __reduce_min_sync(same, order(u)), high_u = __reduce_max_sync(same, order(u));
        const int low_v = __reduce_min_sync(same, order(v)), high_v = __reduce_max_sync(same, order(v));
        if ((threadIdx.x & 31) == __ffs(same) - 1)
            widen_by(box, number(low_u), number(low_v), number(high_u), number(high_v));
#else
        widen_by(box, u, v, u, v);
#endif
    }
    static inline void widen_by(float* box, float low_u, float low_v, float high_u, float high_v) {
        // Looking first keeps almost all threads from queueing for the same few addresses.
        if (low_u < box[0])
            wp::atomic_min(box, low_u);
        if (low_v < box[1])
            wp::atomic_min(box + 1, low_v);
        if (high_u > box[2])
            wp::atomic_max(box + 2, high_u);
        if (high_v > box[3])
            wp::atomic_max(box + 3, high_v);
    }
    // Integers in the order of numbers, and back.
    static inline int order(float x) {
        int bits;
        memcpy(&bits, &x, 4);
        return bits < 0 ? bits ^ EXTENT_BITS : bits;
    }
    static inline float number(int ordered) {
        const int bits = ordered < 0 ? ordered ^ EXTENT_BITS : ordered;
        float x;
        memcpy(&x, &bits, 4);
        return x;
    }
};
