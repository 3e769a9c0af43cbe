// float64 without contraction, whatever the options of the module are: the same bits on every device. A pragma
// says so to Clang; CUDA has intrinsics that are never contracted.
struct Arithmetic {
    static inline double add(double x, double y) {
        UNCONTRACTED
#if defined(__CUDA_ARCH__)
        return __dadd_rn(x, y);
#else
        return x + y;
#endif
    }
    static inline double sub(double x, double y) {
        UNCONTRACTED
#if defined(__CUDA_ARCH__)
        return __dadd_rn(x, -y);
#else
        return x - y;
#endif
    }
    static inline double mul(double x, double y) {
        UNCONTRACTED
#if defined(__CUDA_ARCH__)
        return __dmul_rn(x, y);
#else
        return x * y;
#endif
    }
    static inline double absolute(double x) { return x < 0.0 ? -x : x; }
    static inline double norm(double x, double y, double z) { return sqrt(add(add(mul(x, x), mul(y, y)), mul(z, z))); }
};
