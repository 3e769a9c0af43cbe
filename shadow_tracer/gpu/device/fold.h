// cpu
// needs: device/lanes.h@16
// One number of sixteen, by halving: a running one would have to be taken in order.
struct Fold16 {
#define FOLDED(k) __builtin_shufflevector(x, x, HALF##k)
#define HALF8 8, 9, 10, 11, 12, 13, 14, 15, 8, 9, 10, 11, 12, 13, 14, 15
#define HALF4 4, 5, 6, 7, 4, 5, 6, 7, 4, 5, 6, 7, 4, 5, 6, 7
#define HALF2 2, 3, 2, 3, 2, 3, 2, 3, 2, 3, 2, 3, 2, 3, 2, 3
#define HALF1 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1
    static inline Real16 smaller(Real16 x, Real16 y) { return x < y ? x : y; }
    static inline float least(Real16 x) {
        x = smaller(x, FOLDED(8));
        x = smaller(x, FOLDED(4));
        x = smaller(x, FOLDED(2));
        return smaller(x, FOLDED(1))[0];
    }
#undef FOLDED
#undef HALF8
#undef HALF4
#undef HALF2
#undef HALF1
};
