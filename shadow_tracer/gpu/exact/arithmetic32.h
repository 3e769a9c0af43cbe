// float32 without contraction: the same bits on every device.
struct Arithmetic32 {
    static inline float plus(float x, float y) {
        UNCONTRACTED
#if defined(__CUDA_ARCH__)
        return __fadd_rn(x, y);
#else
        return x + y;
#endif
    }
    static inline float minus(float x, float y) {
        UNCONTRACTED
#if defined(__CUDA_ARCH__)
        return __fadd_rn(x, -y);
#else
        return x - y;
#endif
    }
    static inline float times(float x, float y) {
        UNCONTRACTED
#if defined(__CUDA_ARCH__)
        return __fmul_rn(x, y);
#else
        return x * y;
#endif
    }
};
