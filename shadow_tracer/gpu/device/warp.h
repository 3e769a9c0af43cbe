// What 32 neighbouring threads do together on CUDA, each of them a lane. The CPU has no such groups: there the first of
// the 32 does the work of all, lane by lane, and the others return at once. On CUDA all 32 are to come to `joined` and
// to `take` together: what leads there may depend on nothing that differs between them.
struct Warp {
    static inline bool works(int thread) {
#if defined(__CUDA_ARCH__)
        return true;
#else
        return (thread & 31) == 0;
#endif
    }
    // The lanes that this thread does the work of: from the first on, before the last.
    static inline int first() {
#if defined(__CUDA_ARCH__)
        return threadIdx.x & 31;
#else
        return 0;
#endif
    }
    static inline int last() {
#if defined(__CUDA_ARCH__)
        return (threadIdx.x & 31) + 1;
#else
        return 32;
#endif
    }
    // A bit for each lane, from the bits of those that each thread does the work of.
    static inline unsigned joined(unsigned own) {
#if defined(__CUDA_ARCH__)
        return __ballot_sync(0xFFFFFFFFu, own != 0);
#else
        return own;
#endif
    }
    // The next number of a counter, the same for all lanes.
    static inline int take(int* counter) {
#if defined(__CUDA_ARCH__)
        int number = 0;
        if ((threadIdx.x & 31) == 0)
            number = atomicAdd(counter, 1);
        return __shfl_sync(0xFFFFFFFFu, number, 0);
#else
        return wp::atomic_add(counter, 1);
#endif
    }
    // Of a mask that is not 0.
    static inline int lowest(unsigned mask) {
#if defined(__CUDA_ARCH__)
        return __ffs(mask) - 1;
#else
        return __builtin_ctz(mask);
#endif
    }
    static inline int count(unsigned mask) {
#if defined(__CUDA_ARCH__)
        return __popc(mask);
#else
        return __builtin_popcount(mask);
#endif
    }
    // Adds what the lanes that come here together bring, where the first of them says: one of several places whose sum
    // counts.
    static inline void add(wp::int64* to, int number) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
        const unsigned here = __activemask();
        const int sum = __reduce_add_sync(here, number);
        if ((threadIdx.x & 31) == __ffs(here) - 1)
            wp::atomic_add(to, (wp::int64)sum);
#else
        wp::atomic_add(to, (wp::int64)number);
#endif
    }
};
