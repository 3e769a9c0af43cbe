// needs: device/lanes.h
// lanes
// Float64 numbers in lanes: what comparing them gives, and what differs between one and LANES of them.
struct WIDE(Doubles) {
#if LANES == 1
    typedef int Truth;
#else
    typedef long Truth __attribute__((ext_vector_type(LANES)));
#endif
    // The lanes of a comparison that hold, as bits.
    static inline int bits(Truth x) {
#if LANES == 1
        return x != 0;
#elif LANES == 16
        return __builtin_bit_cast(unsigned short, __builtin_convertvector(x, WIDE(Bit)));
#else
        return __builtin_bit_cast(unsigned char, __builtin_convertvector(x, WIDE(Bit)));
#endif
    }
    static inline WIDE(Double) root(WIDE(Double) x) {
#if LANES == 1
        return sqrt(x);
#else
        return __builtin_elementwise_sqrt(x);
#endif
    }
#if LANES == 16
    typedef double Eight __attribute__((ext_vector_type(8), aligned(8)));
    typedef double Four __attribute__((ext_vector_type(4), aligned(8)));
    static inline Double16 both(Eight low, Eight high) {
        return __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    }
    // Four numbers of each of sixteen, turned into sixteen of each of four: shuffles take less than gathers.
    static inline void turn(const double* const (&from)[16], Double16 (&to)[4]) {
        Eight half[2][4];
        for (int side = 0; side < 2; ++side) {
            Eight e[4];
            for (int j = 0; j < 4; ++j)
                e[j] = __builtin_shufflevector(*(const Four*)from[8 * side + j], *(const Four*)from[8 * side + j + 4],
                                               0, 1, 2, 3, 4, 5, 6, 7);
            for (int j = 0; j < 2; ++j) {
                const Eight one = j ? __builtin_shufflevector(e[0], e[1], 1, 9, 3, 11, 5, 13, 7, 15)
                                    : __builtin_shufflevector(e[0], e[1], 0, 8, 2, 10, 4, 12, 6, 14);
                const Eight two = j ? __builtin_shufflevector(e[2], e[3], 1, 9, 3, 11, 5, 13, 7, 15)
                                    : __builtin_shufflevector(e[2], e[3], 0, 8, 2, 10, 4, 12, 6, 14);
                half[side][j] = __builtin_shufflevector(one, two, 0, 1, 8, 9, 4, 5, 12, 13);
                half[side][j + 2] = __builtin_shufflevector(one, two, 2, 3, 10, 11, 6, 7, 14, 15);
            }
        }
        for (int k = 0; k < 4; ++k)
            to[k] = both(half[0][k], half[1][k]);
    }
#endif
    static inline REAL narrow(WIDE(Double) x) {
#if LANES == 1
        return (float)x;
#else
        return __builtin_convertvector(x, REAL);
#endif
    }
    static inline WIDE(Double) widen(REAL x) {
#if LANES == 1
        return x;
#else
        return __builtin_convertvector(x, WIDE(Double));
#endif
    }
};
