// cpu
// needs: device/lanes.h@16
// Lists that are written without a branch.
struct Compress {
    // `first` and the number of each bit of sixteen that is set, one behind the other; returns how many. There must be
    // room for sixteen, whatever is set.
    static inline int numbers(int* to, int bits, int first) {
#if defined(__AVX512F__)
        typedef int Sixteen __attribute__((vector_size(64)));
        typedef int Anywhere __attribute__((vector_size(64), aligned(4)));
        const Sixteen lane = { 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15 };
        const Sixteen all = lane + first;
        *(Anywhere*)to = __builtin_ia32_compresssi512_mask(all, all, (unsigned short)bits);
        return __builtin_popcount(bits);
#else
        int count = 0;
        for (; bits; bits &= bits - 1)
            to[count++] = first + __builtin_ctz(bits);
        return count;
#endif
    }
    // The same number sixteen times.
    static inline void fill(int* to, int value) {
        for (int j = 0; j < 16; ++j)
            to[j] = value;
    }
};
