// lanes
// A number, or LANES of them in as many vector registers as it takes; comparisons of them; what differs between the
// two.
#if LANES == 1
typedef float REAL;
typedef int MASK;
typedef double WIDE(Double);
#else
typedef float REAL __attribute__((ext_vector_type(LANES), aligned(4)));
typedef int MASK __attribute__((ext_vector_type(LANES)));
typedef bool WIDE(Bit) __attribute__((ext_vector_type(LANES)));
typedef double WIDE(Double) __attribute__((ext_vector_type(LANES)));
#endif
struct WIDE(Lanes) {
    enum { ALL = (1 << LANES) - 1 };
    // The lanes of a comparison that hold, as bits.
    static inline int bits(MASK x) {
#if LANES == 1
        return x != 0;
#elif LANES == 16
        return __builtin_bit_cast(unsigned short, __builtin_convertvector(x, WIDE(Bit)));
#else
        return __builtin_bit_cast(unsigned char, __builtin_convertvector(x, WIDE(Bit)));
#endif
    }
#if LANES > 1
    // The other way round.
    static inline MASK mask(int bits) {
#if LANES == 16
        return -__builtin_convertvector(__builtin_bit_cast(WIDE(Bit), (unsigned short)bits), MASK);
#else
        return -__builtin_convertvector(__builtin_bit_cast(WIDE(Bit), (unsigned char)bits), MASK);
#endif
    }
#endif
    static inline REAL absolute(REAL x) {
#if LANES == 1
        return fabsf(x);
#else
        return __builtin_elementwise_abs(x);
#endif
    }
    static inline WIDE(Double) absolute(WIDE(Double) x) {
#if LANES == 1
        return fabs(x);
#else
        return __builtin_elementwise_abs(x);
#endif
    }
    // Truncated; for what fits into an int.
    static inline MASK integer(REAL x) {
#if LANES == 1
        return (int)x;
#else
        return __builtin_convertvector(x, MASK);
#endif
    }
    // One over it, within 2^-14 of that.
    static inline REAL inverse(REAL x) {
#if LANES == 16 && defined(__AVX512F__)
        typedef float Sixteen __attribute__((vector_size(64)));
        const Sixteen all = __builtin_bit_cast(Sixteen, x);
        return __builtin_bit_cast(REAL, __builtin_ia32_rcp14ps512_mask(all, all, (unsigned short)ALL));
#else
        return 1.0f / x;
#endif
    }
    static inline REAL load(const float* from) { return *(const REAL*)from; }
    static inline void store(float* to, REAL x) { *(REAL*)to = x; }
};
